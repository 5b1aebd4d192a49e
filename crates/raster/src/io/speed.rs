//! SPEED and SPEED+ files: JSON labels, JSON submissions, headerless CSV submissions.
//!
//! The quaternion `q_vbs2tango` is scalar first, and its numbers, read as a Hamilton quaternion,
//! are the rotation `cam_from_model`; `r_Vo2To_vbs_true` is the translation in metres.
//! Kisantal et al., "Satellite Pose Estimation Challenge", 2020; Park et al., "SPEED+", 2022.

use std::io::Read;

use serde::Deserialize;
use serde::de::{Deserializer, SeqAccess, Visitor};

use crate::error::{Error, Place, Result};
use crate::io::bop::{Numbers, json_error};
use crate::io::input::{Input, InputFile, MAX_JSON};
use crate::io::pose_csv::{number, read_id};
use crate::io::records::Records;
use crate::io::table::{Departures, PoseTable, Strings, Unit, row_limit, translation};
use crate::pose::Pose;

/// A first line looks like a row of a SPEED submission: an image file name and seven numbers.
#[must_use]
pub fn is_speed_row(line: &[u8]) -> bool {
    let mut fields = line.split(|&b| b == b',').map(<[u8]>::trim_ascii);
    let image = fields.next().is_some_and(|name| {
        let name = name.to_ascii_lowercase();
        [&b".jpg"[..], b".jpeg", b".png"].iter().any(|e| name.ends_with(e))
    });
    let numeric = |f: &[u8]| std::str::from_utf8(f).is_ok_and(|t| t.parse::<f64>().is_ok());
    image && fields.clone().count() == 7 && fields.all(numeric)
}

struct Rows {
    name: String,
    unit: Unit,
    ids: Strings,
    poses: Vec<Pose>,
    lines: Vec<u32>,
    departures: Departures,
}

impl Rows {
    fn new(name: &str, unit: Unit) -> Self {
        Self {
            name: name.to_owned(),
            unit,
            ids: Strings::default(),
            poses: Vec::new(),
            lines: Vec::new(),
            departures: Departures::default(),
        }
    }

    fn push(
        &mut self,
        id: &str,
        q: [f64; 4],
        t: [f64; 3],
        at: impl Fn(&str) -> Place,
    ) -> Result<()> {
        row_limit(self.poses.len(), &self.name)?;
        let rotation = self.departures.quat_wxyz(q, || at("q"))?;
        let t = translation(t, self.unit, || at("t"))?;
        self.ids.push(id);
        self.poses.push(Pose::new(rotation, t));
        Ok(())
    }

    fn into_table(self, source: InputFile) -> Result<PoseTable> {
        if self.poses.is_empty() {
            return Err(Error::malformed(Place::file(&self.name), "no pose", "at least one"));
        }
        Ok(PoseTable {
            source,
            name: self.name,
            unit: self.unit,
            ids: self.ids,
            poses: self.poses,
            lines: self.lines,
            targets: None,
            scores: None,
            extra: Vec::new(),
            warnings: self.departures.warnings(),
        })
    }
}

/// Read a submission CSV without header: `filename,q0,q1,q2,q3,tx,ty,tz`, scalar first.
///
/// # Errors
/// [`Error::Malformed`] naming line and column; [`Error::Read`].
pub fn read_speed_csv(input: Input, unit: Unit) -> Result<PoseTable> {
    const NAMES: [&str; 8] = ["filename", "q0", "q1", "q2", "q3", "tx", "ty", "tz"];
    let mut records = Records::new(input)?;
    let mut rows = Rows::new(records.name(), unit);
    while let Some(record) = records.next_record()? {
        let (line, mut fields) = (record.line, Vec::with_capacity(8));
        record.split_into(&mut fields);
        if fields.len() != 8 {
            return Err(Error::malformed(
                Place::line(&rows.name, line),
                format!("{} fields", fields.len()),
                "8: filename,q0,q1,q2,q3,tx,ty,tz (a SPEED submission has no header)",
            ));
        }
        let name = rows.name.clone();
        let place = |column: &str| Place::line(&name, line).column(column);
        let id = read_id(fields[0], || place("filename"))?;
        let mut v = [0.0; 7];
        for (k, slot) in v.iter_mut().enumerate() {
            *slot = number(fields[k + 1], || place(NAMES[k + 1]))?;
        }
        rows.push(&id, [v[0], v[1], v[2], v[3]], [v[4], v[5], v[6]], |what| {
            place(if what == "q" { "q0..q3" } else { "tx..tz" })
        })?;
        rows.lines.push(u32::try_from(line).unwrap_or(u32::MAX));
    }
    let source = records.into_input().finish("speed-csv")?;
    rows.into_table(source)
}

#[derive(Deserialize)]
struct Label {
    filename: String,
    #[serde(alias = "q_vbs2tango", alias = "q_vbs2tango_true")]
    q: Numbers,
    #[serde(alias = "r_Vo2To_vbs_true", alias = "r_Vo2To_vbs")]
    r: Numbers,
}

/// Read JSON labels (`q_vbs2tango`, `q_vbs2tango_true`) or a JSON submission (`q`, `r`).
///
/// # Errors
/// [`Error::Malformed`] naming the entry; [`Error::Read`].
pub fn read_speed_json(mut input: Input, unit: Unit) -> Result<PoseTable> {
    let expected = "a SPEED file: [{\"filename\": \"img000001.jpg\", \"q_vbs2tango\": [w, x, y, z], \
                    \"r_Vo2To_vbs_true\": [x, y, z]}] (labels), or the keys q and r (submission)";
    let mut rows = Rows::new(&input.name, unit);
    let name = input.name.clone();
    let mut refused = None;
    let mut deserializer = serde_json::Deserializer::from_reader((&mut input).take(MAX_JSON));
    let mut count = 0_usize;
    let parsed = Labels(&mut |label: Label| {
        let at = |what: &str| Place::file(&name).column(format!("[{count}].{what}"));
        let pushed = label_row(&label, at).and_then(|(q, t)| rows.push(&label.filename, q, t, at));
        count += 1;
        pushed.map_err(|e| refused = Some(e)).is_ok()
    })
    .read(&mut deserializer);
    if let Some(error) = refused {
        return Err(error);
    }
    parsed.and_then(|()| deserializer.end()).map_err(|e| json_error(&name, &e, expected))?;
    let source = input.finish("speed-json")?;
    rows.into_table(source)
}

fn label_row(label: &Label, at: impl Fn(&str) -> Place) -> Result<([f64; 4], [f64; 3])> {
    let wrong = |what: &str, n: usize, wanted: &str| {
        Error::malformed(at(what), format!("{n} numbers"), format!("{wanted} numbers"))
    };
    if label.filename.is_empty() {
        return Err(Error::malformed(at("filename"), "an empty id", "a file name"));
    }
    let q = label.q.0.as_slice().try_into().map_err(|_| wrong("q", label.q.0.len(), "4"))?;
    let t = label.r.0.as_slice().try_into().map_err(|_| wrong("r", label.r.0.len(), "3"))?;
    Ok((q, t))
}

/// Hands every label of a JSON array to a function, one at a time, until that says stop.
struct Labels<'f>(&'f mut dyn FnMut(Label) -> bool);

impl Labels<'_> {
    fn read<'de, D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Labels<'_> {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an array of labels")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<(), A::Error> {
        while let Some(label) = seq.next_element()? {
            if !(self.0)(label) {
                return Err(serde::de::Error::custom("refused"));
            }
        }
        Ok(())
    }
}
