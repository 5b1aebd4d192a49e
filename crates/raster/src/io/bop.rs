//! The files of the BOP benchmark: result CSV, `scene_gt.json`, `models_info.json`, cameras.
//!
//! Lengths are millimetres, `R` is row-major, poses are model to camera (OpenCV).
//! <https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md>

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};

use crate::error::{Error, Place, Result, quoted, visible};
use crate::io::input::{Input, InputFile, MAX_JSON};
use crate::io::pose_csv::number;
use crate::io::records::Records;
use crate::io::table::{Departures, PoseTable, Strings, Target, Unit, row_limit, translation};
use crate::pose::Pose;

const COLUMNS: [&str; 6] = ["scene_id", "im_id", "obj_id", "score", "r", "t"];

/// Whether a first line is the header of a BOP result CSV.
#[must_use]
pub fn is_bop_header(line: &[u8]) -> bool {
    let line = line.to_ascii_lowercase();
    let mut fields = line.split(|&b| b == b',').map(<[u8]>::trim_ascii);
    fields.clone().any(|f| f == b"im_id") && fields.any(|f| f == b"obj_id")
}

/// Read a BOP result CSV: `scene_id,im_id,obj_id,score,R,t[,time]`.
///
/// # Errors
/// [`Error::Malformed`] naming line and column; [`Error::Read`].
pub fn read_bop_csv(input: Input, unit: Unit) -> Result<PoseTable> {
    let mut records = Records::new(input)?;
    let name = records.name().to_owned();
    let mut columns = [0; 6];
    let mut width = 0;
    if let Some(record) = records.next_record()? {
        let (line, mut fields) = (record.line, Vec::new());
        record.split_into(&mut fields);
        width = fields.len();
        for (slot, column) in columns.iter_mut().zip(COLUMNS) {
            let at = fields.iter().position(|f| f.eq_ignore_ascii_case(column.as_bytes()));
            *slot = at.ok_or_else(|| {
                Error::malformed(
                    Place::line(&name, line).column(column),
                    format!("a header without it: {}", quoted(&fields.join(&b","[..]))),
                    "the header scene_id,im_id,obj_id,score,R,t,time of a BOP result file",
                )
            })?;
        }
    }
    let (mut poses, mut lines, mut targets, mut scores) = (vec![], vec![], vec![], vec![]);
    let mut departures = Departures::default();
    while let Some(record) = records.next_record()? {
        let (line, mut fields) = (record.line, Vec::with_capacity(width));
        record.split_into(&mut fields);
        let place = |column: &str| Place::line(&name, line).column(column);
        if fields.len() != width {
            return Err(Error::malformed(
                Place::line(&name, line),
                format!("{} fields", fields.len()),
                format!("{width}, as in the header"),
            ));
        }
        row_limit(poses.len(), &name)?;
        let [scene, image, object, score, r, t] = columns.map(|k| fields[k]);
        targets.push(Target {
            scene: Some(whole(scene, || place("scene_id"))?),
            image: whole(image, || place("im_id"))?,
            object: whole(object, || place("obj_id"))?,
        });
        scores.push(number(score, || place("score"))?);
        let r: [f64; 9] = numbers(r, || place("R"))?;
        let rows = [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]];
        let rotation = departures.matrix(rows, || place("R"))?;
        let t = translation(numbers(t, || place("t"))?, unit, || place("t"))?;
        poses.push(Pose::new(rotation, t));
        lines.push(u32::try_from(line).unwrap_or(u32::MAX));
    }
    if poses.is_empty() {
        return Err(Error::malformed(
            Place::file(&name),
            "a header without any row",
            "at least one estimate below it",
        ));
    }
    Ok(PoseTable {
        source: records.into_input().finish("bop-csv")?,
        name,
        unit,
        ids: Strings::default(),
        poses,
        lines,
        targets: Some(targets),
        scores: Some(scores),
        extra: Vec::new(),
        warnings: departures.warnings(),
    })
}

fn whole(field: &[u8], place: impl Fn() -> Place) -> Result<u32> {
    let parsed = std::str::from_utf8(field).ok().and_then(|t| t.parse().ok());
    parsed.ok_or_else(|| Error::malformed(place(), quoted(field), "a whole number"))
}

fn numbers<const N: usize>(field: &[u8], place: impl Fn() -> Place) -> Result<[f64; N]> {
    let mut out = [0.0; N];
    let mut parts = field.split(u8::is_ascii_whitespace).filter(|p| !p.is_empty());
    let count = parts.clone().count();
    if count != N {
        return Err(Error::malformed(
            place(),
            format!("{count} numbers"),
            format!("{N} numbers separated by spaces"),
        ));
    }
    for slot in &mut out {
        *slot = number(parts.next().unwrap_or_default(), &place)?;
    }
    Ok(out)
}

/// An array of numbers, at most a hundred: a packed file can hold billions.
pub(crate) struct Numbers(pub(crate) Vec<f64>);

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Few;
        impl<'de> Visitor<'de> for Few {
            type Value = Numbers;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an array of numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Numbers, A::Error> {
                let mut numbers = Vec::new();
                while let Some(number) = seq.next_element()? {
                    if numbers.len() == 100 {
                        return Err(serde::de::Error::custom("an array of more than 100 numbers"));
                    }
                    numbers.push(number);
                }
                Ok(Numbers(numbers))
            }
        }
        deserializer.deserialize_seq(Few)
    }
}

#[derive(Deserialize)]
struct GtInstance {
    #[serde(rename = "cam_R_m2c")]
    r: Numbers,
    #[serde(rename = "cam_t_m2c")]
    t: Numbers,
    obj_id: u32,
    #[serde(default)]
    score: Option<f64>,
}

/// A JSON object in the order of the file.
struct InOrder<T>(Vec<(String, T)>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for InOrder<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Pairs<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Pairs<T> {
            type Value = InOrder<T>;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an object {\"image id\": [instances]}")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(InOrder(pairs))
            }
        }
        deserializer.deserialize_map(Pairs(std::marker::PhantomData))
    }
}

/// A JSON error with file, line and column.
pub(crate) fn json_error(name: &str, e: &serde_json::Error, expected: &str) -> Error {
    let place = Place { file: name.into(), line: Some(e.line() as u64), column: None };
    let mut found = e.to_string();
    if let Some(at) = found.rfind(" at line") {
        found.truncate(at);
    }
    Error::malformed(
        place.column(e.column().to_string()),
        format!("JSON with {}", brief(&found)),
        expected,
    )
}

/// A message that may hold a text of the file, of any length.
fn brief(message: &str) -> String {
    match message.char_indices().nth(160) {
        Some((end, _)) => format!("{}…", visible(&message[..end])),
        None => visible(message).into_owned(),
    }
}

/// Read `scene_gt.json`: `{"image": [{"cam_R_m2c": [9], "cam_t_m2c": [3], "obj_id": 1}]}`.
///
/// The scene is the number of the folder (`000002/scene_gt.json`), or unknown.
///
/// # Errors
/// [`Error::Malformed`] naming image and instance; [`Error::Read`].
pub fn read_scene_gt(mut input: Input, unit: Unit, scene: Option<u32>) -> Result<PoseTable> {
    let name = input.name.clone();
    let parsed: Result<InOrder<Vec<GtInstance>>, _> =
        serde_json::from_reader((&mut input).take(MAX_JSON));
    let expected = "a BOP scene_gt.json: {\"image id\": [{\"cam_R_m2c\": [9 numbers], \
                    \"cam_t_m2c\": [3 numbers], \"obj_id\": 1}]}";
    let images = parsed.map_err(|e| json_error(&name, &e, expected))?;
    let mut table = PoseTable {
        source: input.finish("bop-json")?,
        name,
        unit,
        ids: Strings::default(),
        poses: Vec::new(),
        lines: Vec::new(),
        targets: None,
        scores: None,
        extra: Vec::new(),
        warnings: Vec::new(),
    };
    let (mut targets, mut scores) = (Vec::new(), Vec::new());
    let mut departures = Departures::default();
    let mut seen = std::collections::HashSet::new();
    for (key, instances) in images.0 {
        let at =
            |k: usize, field: &str| Place::file(&table.name).column(format!("{key}[{k}].{field}"));
        let image = whole(key.as_bytes(), || at(0, "image id"))?;
        if !seen.insert(image) {
            let place = Place::file(&table.name).column(format!("image {key}"));
            return Err(Error::malformed(place, "a duplicate image id", "every image once"));
        }
        for (k, instance) in instances.into_iter().enumerate() {
            row_limit(table.poses.len(), &table.name)?;
            let r = exactly::<9>(&instance.r.0, || at(k, "cam_R_m2c"))?;
            let rows = [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]];
            let rotation = departures.matrix(rows, || at(k, "cam_R_m2c"))?;
            let t = exactly::<3>(&instance.t.0, || at(k, "cam_t_m2c"))?;
            let t = translation(t, unit, || at(k, "cam_t_m2c"))?;
            table.poses.push(Pose::new(rotation, t));
            targets.push(Target { scene, image, object: instance.obj_id });
            scores.push(instance.score.unwrap_or(1.0));
        }
    }
    if table.poses.is_empty() {
        return Err(Error::malformed(Place::file(&table.name), "no pose", "at least one"));
    }
    table.targets = Some(targets);
    table.scores = Some(scores);
    table.warnings = departures.warnings();
    Ok(table)
}

fn exactly<const N: usize>(values: &[f64], place: impl Fn() -> Place) -> Result<[f64; N]> {
    values.try_into().map_err(|_| {
        Error::malformed(place(), format!("{} numbers", values.len()), format!("{N} numbers"))
    })
}

/// The scene that a path `.../000002/scene_gt.json` belongs to.
#[must_use]
pub fn scene_of(path: &Path) -> Option<u32> {
    path.parent()?.file_name()?.to_str()?.parse().ok()
}

/// What `models_info.json` says of an object, in metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjectInfo {
    /// Largest distance of two vertices.
    pub diameter: Option<f64>,
    /// Poses of the model in itself that look the same, the identity left out.
    pub discrete: Vec<Pose>,
    /// Axis and a point on it, for each continuous symmetry.
    pub continuous: Vec<(glam::DVec3, glam::DVec3)>,
}

#[derive(Deserialize)]
struct RawAxis {
    axis: Vec<f64>,
    #[serde(default)]
    offset: Vec<f64>,
}

#[derive(Deserialize, Default)]
struct RawInfo {
    diameter: Option<f64>,
    #[serde(default)]
    symmetries_discrete: Vec<Vec<f64>>,
    #[serde(default)]
    symmetries_continuous: Vec<RawAxis>,
}

/// Read `models_info.json`, or a file that holds the symmetry keys of a single object (then the
/// key is empty). Lengths are in `unit`, millimetres in BOP.
///
/// # Errors
/// [`Error::Malformed`] naming the object and the entry; [`Error::Read`].
pub fn read_models_info(
    mut input: Input,
    unit: Unit,
) -> Result<(BTreeMap<String, ObjectInfo>, InputFile)> {
    let name = input.name.clone();
    let expected = "symmetries as in BOP's models_info.json: {\"object id\": {\"symmetries_discrete\": \
                    [[16 numbers]], \"symmetries_continuous\": [{\"axis\": [..], \"offset\": [..]}]}}";
    let bytes = input.read_all(64 << 20)?;
    let top: InOrder<serde_json::Value> =
        serde_json::from_slice(&bytes).map_err(|e| json_error(&name, &e, expected))?;
    let single = top.0.iter().any(|(key, _)| key.starts_with("symmetries_"));
    let mut raw = Vec::new();
    if single {
        let info = serde_json::from_slice(&bytes).map_err(|e| json_error(&name, &e, expected))?;
        raw.push((String::new(), info));
    } else {
        for (key, value) in top.0 {
            let info: RawInfo = serde_json::from_value(value).map_err(|e| {
                Error::malformed(
                    Place::file(&name).column(&key),
                    format!("JSON with {}", brief(&e.to_string())),
                    expected,
                )
            })?;
            raw.push((key, info));
        }
    }
    let mut infos = BTreeMap::new();
    for (key, info) in raw {
        let info =
            object_info(&info, unit, |entry| Place::file(&name).column(format!("{key}.{entry}")))?;
        infos.insert(key, info);
    }
    Ok((infos, input.finish("json")?))
}

fn object_info(raw: &RawInfo, unit: Unit, place: impl Fn(&str) -> Place) -> Result<ObjectInfo> {
    let mut info = ObjectInfo::default();
    if let Some(diameter) = raw.diameter {
        if !(diameter > 0.0 && diameter.is_finite()) {
            let found = format!("{diameter}");
            return Err(Error::malformed(place("diameter"), found, "a length above zero"));
        }
        info.diameter = Some(unit.to_metres(diameter));
    }
    for (k, m) in raw.symmetries_discrete.iter().enumerate() {
        let at = || place(&format!("symmetries_discrete[{k}]"));
        let m = exactly::<16>(m, at)?;
        let rows = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]];
        let rotation = Departures::default().matrix(rows, at)?;
        let t = translation([m[3], m[7], m[11]], unit, at)?;
        info.discrete.push(Pose::new(rotation, t));
    }
    for (k, axis) in raw.symmetries_continuous.iter().enumerate() {
        let at = || place(&format!("symmetries_continuous[{k}]"));
        let direction = exactly::<3>(&axis.axis, at)?;
        let offset =
            if axis.offset.is_empty() { [0.0; 3] } else { exactly::<3>(&axis.offset, at)? };
        let direction = translation(direction, Unit::Metre, at)?.try_normalize();
        let direction = direction
            .ok_or_else(|| Error::malformed(at(), "an axis of zero length", "a direction"))?;
        info.continuous.push((direction, translation(offset, unit, at)?));
    }
    Ok(info)
}

#[derive(Deserialize)]
struct RawSceneCamera {
    #[serde(rename = "cam_K")]
    k: Vec<f64>,
}

/// `cam_K` of every image in a `scene_camera.json`, row-major.
///
/// # Errors
/// [`Error::Malformed`] naming the image.
pub fn parse_scene_camera(bytes: &[u8], name: &str) -> Result<BTreeMap<u32, [f64; 9]>> {
    let expected = "a BOP scene_camera.json: {\"image id\": {\"cam_K\": [9 numbers]}}";
    let images: InOrder<RawSceneCamera> =
        serde_json::from_slice(bytes).map_err(|e| json_error(name, &e, expected))?;
    let mut out = BTreeMap::new();
    for (key, camera) in images.0 {
        let at = || Place::file(name).column(format!("{key}.cam_K"));
        out.insert(whole(key.as_bytes(), at)?, exactly::<9>(&camera.k, at)?);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn infos(text: &str) -> Result<BTreeMap<String, ObjectInfo>> {
        let input = Input::from_bytes("models_info.json", text.as_bytes().to_vec())?;
        Ok(read_models_info(input, Unit::Millimetre)?.0)
    }

    #[test]
    fn symmetries_are_read_in_metres() {
        let text = r#"{"5": {"diameter": 100, "size_x": 1,
            "symmetries_discrete": [[-1,0,0,20, 0,-1,0,0, 0,0,1,0, 0,0,0,1]],
            "symmetries_continuous": [{"axis": [0,0,2], "offset": [10,0,0]}]}}"#;
        let info = &infos(text).expect("sound")["5"];
        assert_eq!(info.diameter, Some(0.1));
        assert!((info.discrete[0].translation.x - 0.02).abs() < 1e-18);
        assert_eq!(info.continuous, [(glam::DVec3::Z, glam::DVec3::new(0.01, 0.0, 0.0))]);
        let single = infos(r#"{"symmetries_continuous": [{"axis": [0,1,0]}]}"#).expect("sound");
        assert_eq!(single[""].continuous[0].0, glam::DVec3::Y);
    }

    #[test]
    fn malformed_symmetries_name_their_entry() {
        for (text, place) in [
            (
                r#"{"5": {"symmetries_discrete": [[1,2,3]]}}"#,
                "5.symmetries_discrete[0]: found 3 numbers",
            ),
            (
                r#"{"5": {"symmetries_continuous": [{"axis": [0,0,0]}]}}"#,
                "5.symmetries_continuous[0]: found an axis",
            ),
            (r#"{"5": {"diameter": -1}}"#, "5.diameter: found -1"),
            (r#"{"5": 3}"#, "5: found JSON"),
            ("[", ":1:"),
        ] {
            let error = infos(text).expect_err(text).to_string();
            assert!(error.starts_with("models_info.json") && error.contains(place), "{error}");
        }
    }

    #[test]
    fn the_folder_names_the_scene() {
        assert_eq!(scene_of(Path::new("test/000002/scene_gt.json")), Some(2));
        assert_eq!(scene_of(Path::new("scene_gt.json")), None);
    }

    #[test]
    fn a_refusal_is_one_short_line_whatever_the_json_holds() {
        let long = "x".repeat(10_000);
        for json in [
            r#"{"\n\u001b[2J": [{"cam_R_m2c": [], "cam_t_m2c": [], "obj_id": 1}]}"#.to_owned(),
            format!(r#"{{"{long}": [{{"cam_R_m2c": [], "cam_t_m2c": [], "obj_id": 1}}]}}"#),
            format!(r#"{{"1": "{long}"}}"#),
            format!(r#"{{"1": [{{"cam_R_m2c": [{}0"#, "0,".repeat(100)),
        ] {
            let input = Input::from_bytes("gt.json", json.into_bytes()).expect("in memory");
            let error = read_scene_gt(input, Unit::Metre, None).expect_err("refused").to_string();
            assert!(error.starts_with("gt.json:") && error.len() < 500, "{error}");
            assert!(!error.contains(char::is_control), "{error:?}");
        }
    }
}
