//! Anchors: places in a scene where somebody stood, such as those of a scan's panoramas. World
//! frame, metres.

use std::collections::HashMap;
use std::io::Read as _;
use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Place, Result, quoted};
use crate::io::Unit;
use crate::io::bop::json_error;
use crate::io::input::{Input, InputFile, MAX_JSON};
use crate::io::pose_csv::{number, read_id};
use crate::io::records::{Records, text};
use crate::io::table::{not_a_rotation, translation};
use crate::rotation;

/// Formats of anchors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// JSON or CSV by the first character.
    #[default]
    Auto,
    /// Matterport3D's `SCAN_connectivity.json`.
    Matterport,
    /// A header with `x,y,z` and perhaps `id`.
    Csv,
}

/// How anchors are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// The format.
    pub format: Format,
    /// Whether viewpoints whose `included` is false count (Matterport3D: they overlap with others).
    pub all: bool,
}

/// Places of a scene.
#[derive(Debug, Clone)]
pub struct Anchors {
    /// The file.
    pub source: InputFile,
    /// Names; the number of the row where there are none.
    pub names: Vec<String>,
    /// Metres, world frame.
    pub positions: Vec<DVec3>,
    /// Viewpoints that were left out because `included` is false.
    pub excluded: usize,
    /// Pairs of anchors at one place (nearer than 1 mm).
    pub coincident: usize,
}

const EXPECTED: &str = "Matterport3D's [{\"image_id\": \"...\", \"pose\": [16 numbers, row major, \
                        camera to world], \"included\": true}]";

/// One viewpoint of a `connectivity` file: `pose` is `world_from_cam`, row by row, z up; the camera
/// is `OpenCV`'s. `visible`, `unobstructed` and `height` are not needed here.
#[derive(Deserialize)]
struct Viewpoint {
    image_id: String,
    pose: Vec<f64>,
    #[serde(default = "yes")]
    included: bool,
}

fn yes() -> bool {
    true
}

/// Read anchors from a file, a pipe, or standard input (`-`).
///
/// # Errors
/// [`Error::Read`]; [`Error::Malformed`] naming line and column, or the entry.
pub fn read_anchors(path: &Path, options: Options) -> Result<Anchors> {
    read(Input::open(path)?, options)
}

/// As [`read_anchors`], from bytes under a name.
///
/// # Errors
/// As [`read_anchors`].
pub fn parse_anchors(name: &str, bytes: Vec<u8>, options: Options) -> Result<Anchors> {
    read(Input::from_bytes(name, bytes)?, options)
}

fn read(mut input: Input, options: Options) -> Result<Anchors> {
    input.refuse_binary()?;
    let place = input.place();
    let first = input.peek()?.iter().find(|b| !b.is_ascii_whitespace()).copied();
    let json = match options.format {
        Format::Auto => matches!(first, Some(b'[' | b'{')),
        Format::Matterport => true,
        Format::Csv => false,
    };
    let mut anchors = if json { matterport(input, options.all)? } else { csv(input)? };
    if anchors.positions.is_empty() {
        let found = match anchors.excluded {
            0 => "no anchor".to_owned(),
            n => format!("{n} viewpoints, of which none is included"),
        };
        return Err(Error::malformed(place, found, "one at least"));
    }
    anchors.coincident = coincident(&anchors.positions);
    Ok(anchors)
}

/// Pairs that are nearer than 1 mm.
fn coincident(positions: &[DVec3]) -> usize {
    let mut p = positions.to_vec();
    p.sort_by(|a, b| a.x.total_cmp(&b.x));
    let near = |i: usize| {
        let ahead = p[i + 1..].iter().take_while(|q| q.x - p[i].x < 1e-3);
        ahead.filter(|q| q.distance(p[i]) < 1e-3).count()
    };
    (0..p.len()).map(near).sum()
}

fn matterport(mut input: Input, all: bool) -> Result<Anchors> {
    let file = input.name.clone();
    let viewpoints: Vec<Viewpoint> = serde_json::from_reader((&mut input).take(MAX_JSON))
        .map_err(|e| json_error(&file, &e, EXPECTED))?;
    let at = |k: usize, what: &str| Place::file(&file).column(format!("[{k}].{what}"));
    let mut anchors = Anchors::empty(input.finish("matterport")?);
    let mut seen = HashMap::new();
    for (k, viewpoint) in viewpoints.into_iter().enumerate() {
        if let Some(before) = seen.insert(viewpoint.image_id.clone(), k) {
            let found =
                format!("{} again, first in [{before}]", quoted(viewpoint.image_id.as_bytes()));
            return Err(Error::malformed(at(k, "image_id"), found, "every viewpoint once"));
        }
        let place = || at(k, "pose");
        let Ok(m) = <[f64; 16]>::try_from(viewpoint.pose.as_slice()) else {
            let found = format!("{} numbers", viewpoint.pose.len());
            return Err(Error::malformed(place(), found, "16, a 4x4 matrix row by row"));
        };
        let exact = |x: f64, wanted: f64| (x - wanted).abs() < 1e-6;
        if !(m[12..15].iter().all(|x| exact(*x, 0.0)) && exact(m[15], 1.0)) {
            let found = format!("a last row {:?}", &m[12..]);
            return Err(Error::malformed(place(), found, "0 0 0 1: row major, not column major"));
        }
        let rows = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]];
        rotation::from_matrix(rows).map_err(|e| not_a_rotation(place(), e))?;
        let position = translation([m[3], m[7], m[11]], Unit::Metre, place)?;
        if viewpoint.included || all {
            anchors.names.push(viewpoint.image_id);
            anchors.positions.push(position);
        } else {
            anchors.excluded += 1;
        }
    }
    Ok(anchors)
}

fn csv(input: Input) -> Result<Anchors> {
    let mut records = Records::new(input)?;
    let file = records.name().to_owned();
    let mut anchors: Option<(usize, Option<usize>, [usize; 3])> = None;
    let (mut names, mut positions) = (Vec::new(), Vec::new());
    let mut seen = HashMap::new();
    while let Some(record) = records.next_record()? {
        let line = record.line;
        let mut fields = Vec::new();
        record.split_into(&mut fields);
        let Some((count, id, columns)) = anchors else {
            let header: Vec<String> = fields
                .iter()
                .map(|f| text(f).unwrap_or_default().to_ascii_lowercase())
                .map(|n| n.trim_start_matches('#').trim().to_owned())
                .collect();
            let find = |wanted: &str| header.iter().position(|n| n == wanted);
            let (Some(x), Some(y), Some(z)) = (find("x"), find("y"), find("z")) else {
                return Err(Error::malformed(
                    Place::line(&file, line),
                    quoted(record.text()),
                    "a header with x,y,z (metres, z up) and perhaps id; or a Matterport3D \
                     connectivity file",
                ));
            };
            anchors = Some((fields.len(), find("id"), [x, y, z]));
            continue;
        };
        if fields.len() != count {
            return Err(Error::malformed(
                Place::line(&file, line),
                format!("{} fields", fields.len()),
                format!("{count}, as the header has"),
            ));
        }
        let place = |column: &str| Place::line(&file, line).column(column);
        let mut p = [0.0; 3];
        for (k, slot) in p.iter_mut().enumerate() {
            *slot = number(fields[columns[k]], || place(["x", "y", "z"][k]))?;
        }
        positions.push(translation(p, Unit::Metre, || place("x"))?);
        let name = match id {
            Some(column) => read_id(fields[column], || place("id"))?.into_owned(),
            None => names.len().to_string(),
        };
        if let Some(before) = seen.insert(name.clone(), line) {
            let found = format!("{} again, first in line {before}", quoted(name.as_bytes()));
            return Err(Error::malformed(place("id"), found, "every anchor once"));
        }
        names.push(name);
    }
    let mut found = Anchors::empty(records.into_input().finish("csv")?);
    (found.names, found.positions) = (names, positions);
    Ok(found)
}

impl Anchors {
    fn empty(source: InputFile) -> Self {
        Self { source, names: Vec::new(), positions: Vec::new(), excluded: 0, coincident: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Anchors> {
        parse_anchors("a", text.as_bytes().to_vec(), Options::default())
    }

    fn viewpoint(id: &str, pose: &str, included: bool) -> String {
        format!(
            "{{\"image_id\":\"{id}\",\"pose\":[{pose}],\"included\":{included},\"height\":1.5}}"
        )
    }

    const POSE: &str = "0,0,1,2,-1,0,0,3,0,-1,0,1.5,0,0,0,1";

    #[test]
    fn a_viewpoint_stands_in_the_last_column_of_its_pose() {
        let text = format!("[{},{}]", viewpoint("v", POSE, true), viewpoint("w", POSE, false));
        let anchors = parse(&text).expect("anchors");
        assert_eq!(anchors.positions, [DVec3::new(2.0, 3.0, 1.5)]);
        assert_eq!((anchors.names[0].as_str(), anchors.excluded), ("v", 1));
        let all = Options { all: true, ..Options::default() };
        let anchors = parse_anchors("a", text.into_bytes(), all).expect("anchors");
        assert_eq!((anchors.positions.len(), anchors.coincident), (2, 1));
    }

    #[test]
    fn csv_has_names_or_numbers() {
        let anchors = parse("id,z,y,x\nhall,3,2,1\nroom,0,0,0\n").expect("anchors");
        assert_eq!(anchors.names, ["hall", "room"]);
        assert_eq!(anchors.positions[0], DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(parse("x,y,z\n1,2,3\n").expect("anchors").names, ["0"]);
    }

    #[test]
    fn what_is_no_anchor_is_refused_by_name() {
        let one = |pose: &str| format!("[{}]", viewpoint("v", pose, true));
        let column_major = "0,-1,0,0,0,0,-1,0,1,0,0,0,2,3,1.5,1";
        let twice = format!("[{},{}]", viewpoint("v", POSE, true), viewpoint("v", POSE, true));
        for (text, expected) in [
            ("", "a: found an empty file"),
            ("[]", "a: found no anchor"),
            ("[1]", "a:1:3: found JSON with"),
            ("[{\"image_id\":\"v\"", "a:1:16: found JSON with"),
            (&one("1,2"), "a:[0].pose: found 2 numbers, expected 16"),
            (&one(column_major), "a:[0].pose: found a last row [2.0, 3.0, 1.5, 1.0]"),
            (&one("2,0,0,0,0,2,0,0,0,0,2,0,0,0,0,1"), "a:[0].pose: found a matrix that is not"),
            (&twice, "a:[1].image_id: found 'v' again, first in [0]"),
            (&format!("[{}]", viewpoint("v", POSE, false)), "a: found 1 viewpoints, of which none"),
            ("a,b\n1,2\n", "a:1: found 'a,b', expected a header with x,y,z"),
            ("x,y,z\n1,2\n", "a:2: found 2 fields, expected 3"),
            ("x,y,z\n1,nan,2\n", "a:2:y: found 'nan'"),
            ("id,x,y,z\nv,1,2,3\nv,1,2,3\n", "a:3:id: found 'v' again, first in line 2"),
            ("x,y,z\n", "a: found no anchor"),
        ] {
            let error = parse(text).expect_err("refused").to_string();
            assert!(error.starts_with(expected), "{text:?}: {error}");
        }
    }
}
