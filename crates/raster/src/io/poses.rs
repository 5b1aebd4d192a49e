//! One door to every pose file: the format is recognised from the content.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::io::bop;
use crate::io::input::Input;
use crate::io::pose_csv::{CsvOptions, read_pose_csv};
use crate::io::speed;
use crate::io::table::{PoseTable, Unit};

/// Format of pose files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// Recognised from the content of each file.
    #[default]
    Auto,
    /// CSV with the header `id,qw,qx,qy,qz,tx,ty,tz`.
    Csv,
    /// BOP result CSV, or `scene_gt.json`.
    Bop,
    /// SPEED / SPEED+ JSON, or a submission CSV without header.
    Speed,
}

/// How to read a pose file.
#[derive(Debug, Clone, Default)]
pub struct PoseOptions {
    /// Format asked for; a file that clearly is of another kind is read as what it is.
    pub format: Format,
    /// Unit of translations; by default millimetres for BOP files and metres for all others.
    pub unit: Option<Unit>,
    /// Extra CSV columns to keep.
    pub keep: Vec<String>,
}

/// Read a table of poses. `-` is standard input; gzip is unpacked; a folder must be a BOP scene
/// (`scene_gt.json` in it) or a split (`000001/scene_gt.json`, ...).
///
/// # Errors
/// [`Error::Read`]; [`Error::Malformed`] naming file, line and column.
pub fn read_poses(path: &Path, options: &PoseOptions) -> Result<PoseTable> {
    if path.is_dir() {
        return read_folder(path, options);
    }
    read_input(Input::open(path)?, bop::scene_of(path), options)
}

/// Read a table of poses from bytes under a name.
///
/// # Errors
/// As [`read_poses`].
pub fn parse_poses(name: &str, bytes: Vec<u8>, options: &PoseOptions) -> Result<PoseTable> {
    read_input(Input::from_bytes(name, bytes)?, None, options)
}

fn read_input(mut input: Input, scene: Option<u32>, options: &PoseOptions) -> Result<PoseTable> {
    input.refuse_binary()?;
    let mut head = input.peek()?;
    if let Some(rest) = head.strip_prefix(b"\xef\xbb\xbf") {
        head = rest;
    }
    let head = head.trim_ascii_start();
    let first_line = head.split(|&b| b == b'\n' || b == b'\r').next().unwrap_or_default();
    let bop_unit = options.unit.unwrap_or(Unit::Millimetre);
    let unit = options.unit.unwrap_or(Unit::Metre);
    match head.first() {
        Some(b'{') if options.format != Format::Csv => bop::read_scene_gt(input, bop_unit, scene),
        Some(b'[') if options.format != Format::Csv => speed::read_speed_json(input, unit),
        _ if bop::is_bop_header(first_line) => bop::read_bop_csv(input, bop_unit),
        _ if options.format == Format::Speed && !has_header(first_line)
            || options.format == Format::Auto && speed::is_speed_row(first_line) =>
        {
            speed::read_speed_csv(input, unit)
        }
        _ => read_pose_csv(input, CsvOptions { unit, keep: &options.keep }),
    }
}

/// The line holds a column named `id`.
fn has_header(line: &[u8]) -> bool {
    let unquoted = |f: &[u8]| {
        let f = f.trim_ascii();
        f.strip_prefix(b"\"").and_then(|f| f.strip_suffix(b"\"")).unwrap_or(f).to_ascii_lowercase()
    };
    line.split(|&b| b == b',').any(|f| unquoted(f) == b"id")
}

/// A BOP scene, or all scenes of a split.
fn read_folder(path: &Path, options: &PoseOptions) -> Result<PoseTable> {
    let read = |source| Error::Read { path: path.to_owned(), source };
    let mut files: Vec<PathBuf> = Vec::new();
    if path.join("scene_gt.json").is_file() {
        files.push(path.join("scene_gt.json"));
    } else {
        for entry in std::fs::read_dir(path).map_err(read)? {
            let file = entry.map_err(read)?.path().join("scene_gt.json");
            if file.is_file() {
                files.push(file);
            }
        }
    }
    files.sort();
    let unit = options.unit.unwrap_or(Unit::Millimetre);
    let mut all: Option<PoseTable> = None;
    for file in files {
        let scene = bop::scene_of(&file);
        let table = bop::read_scene_gt(Input::open(&file)?, unit, scene)?;
        match &mut all {
            None => all = Some(table),
            Some(all) => append(all, table),
        }
    }
    let mut all = all.ok_or_else(|| {
        let text = "it is a directory, and no BOP scene: there is no scene_gt.json in it";
        read(std::io::Error::new(std::io::ErrorKind::IsADirectory, text))
    })?;
    all.name = path.display().to_string();
    all.source.path.clone_from(&all.name);
    Ok(all)
}

fn append(all: &mut PoseTable, more: PoseTable) {
    all.poses.extend(more.poses);
    if let (Some(a), Some(b)) = (&mut all.targets, more.targets) {
        a.extend(b);
    }
    if let (Some(a), Some(b)) = (&mut all.scores, more.scores) {
        a.extend(b);
    }
    all.warnings.extend(more.warnings);
    // The digest of a folder is that of its files' digests in order.
    all.source = all.source.joined(&more.source);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotation;

    fn parse(text: &str, format: Format) -> Result<PoseTable> {
        let options = PoseOptions { format, ..PoseOptions::default() };
        parse_poses("x", text.as_bytes().to_vec(), &options)
    }

    fn refused(text: &str, format: Format) -> String {
        parse(text, format).expect_err("malformed").to_string()
    }

    /// A quarter turn about z, 2 m in front of the camera, in every format.
    const QUARTER: [&str; 7] = [
        "id,qw,qx,qy,qz,tx,ty,tz\n7,1,0,0,1,0,0,2\n",
        "tz,ty,tx,rz,ry,rx,id\n2,0,0,1.5707963267948966,0,0,7\n",
        "id,r11,r12,r13,r21,r22,r23,r31,r32,r33,tx,ty,tz\n7,0,-1,0,1,0,0,0,0,1,0,0,2\n",
        "scene_id,im_id,obj_id,score,R,t,time\n1,7,1,0.5,0 -1 0 1 0 0 0 0 1,0 0 2000,-1\n",
        "{\"7\": [{\"cam_R_m2c\": [0,-1,0,1,0,0,0,0,1], \"cam_t_m2c\": [0,0,2000], \"obj_id\": 1}]}",
        "img7.jpg,1,0,0,1,0,0,2\n",
        "[{\"filename\": \"7\", \"q_vbs2tango_true\": [1,0,0,1], \"r_Vo2To_vbs_true\": [0,0,2]}]",
    ];

    #[test]
    fn every_format_is_recognised_and_means_the_same() {
        let quarter = rotation::from_axis_angle([0.0, 0.0, 0.5 * std::f64::consts::PI]);
        let quarter = quarter.expect("finite");
        for text in QUARTER {
            let table = parse(text, Format::Auto).expect(text);
            assert!(rotation::angle(table.poses[0].rotation, quarter) < 1e-15, "{text}");
            assert!((table.poses[0].translation.z - 2.0).abs() < 1e-15, "{text}");
            assert_eq!(table.len(), 1);
        }
    }

    #[test]
    fn a_headerless_row_is_no_csv_but_may_be_a_submission() {
        let row = "frame7,1,0,0,1,0,0,2\n";
        assert!(refused(row, Format::Auto).contains("header"));
        assert_eq!(parse(row, Format::Speed).expect("eight fields").id(0), "frame7");
    }

    #[test]
    fn units_are_those_of_the_format_or_as_asked() {
        let options = PoseOptions { unit: Some(Unit::Metre), ..PoseOptions::default() };
        let bop = parse_poses("x", QUARTER[3].as_bytes().to_vec(), &options).expect("sound");
        assert!((bop.poses[0].translation.z - 2000.0).abs() < 1e-12);
        let options = PoseOptions { unit: Some(Unit::Millimetre), ..PoseOptions::default() };
        let csv = parse_poses("x", QUARTER[0].as_bytes().to_vec(), &options).expect("sound");
        assert!((csv.poses[0].translation.z - 0.002).abs() < 1e-18);
    }

    #[test]
    fn json_refusals_say_where() {
        let gt = |r: &str, t: &str| {
            format!("{{\"3\": [{{\"cam_R_m2c\": {r}, \"cam_t_m2c\": {t}, \"obj_id\": 1}}]}}")
        };
        let text = refused(&gt("[1,0,0,0,1,0,0,0,2]", "[0,0,1]"), Format::Auto);
        assert!(
            text.starts_with("x:3[0].cam_R_m2c: found a matrix that is not orthonormal"),
            "{text}"
        );
        let text = refused(&gt("[1,0,0,0,1,0,0,0,1]", "[0,0]"), Format::Auto);
        assert!(text.starts_with("x:3[0].cam_t_m2c: found 2 numbers, expected 3"), "{text}");
        let text = refused("{\"3\": [\n{\"obj_id\": nan}]}", Format::Auto);
        assert!(text.starts_with("x:2:"), "{text}");
        let text =
            refused("[{\"filename\": \"a\", \"q\": [0,0,0,0], \"r\": [0,0,1]}]", Format::Auto);
        assert!(text.starts_with("x:[0].q: found a quaternion of zero norm"), "{text}");
        let twice = "{\"3\": [], \"3\": []}";
        assert!(refused(twice, Format::Auto).contains("duplicate image id"));
        assert!(refused("{}", Format::Auto).contains("no pose"));
        assert!(refused("[] x", Format::Auto).contains("trailing"));
    }

    #[test]
    fn a_folder_of_scenes_is_one_table() {
        let folder = tempfile::tempdir().expect("a folder");
        for scene in ["000002", "000001"] {
            let scene = folder.path().join(scene);
            std::fs::create_dir(&scene).expect("writable");
            std::fs::write(scene.join("scene_gt.json"), QUARTER[4]).expect("writable");
        }
        let table = read_poses(folder.path(), &PoseOptions::default()).expect("two scenes");
        assert_eq!([table.id(0), table.id(1)], ["1/7/1", "2/7/1"]);
        let empty = tempfile::tempdir().expect("a folder");
        let error = read_poses(empty.path(), &PoseOptions::default()).expect_err("no scene");
        assert!(error.to_string().contains("directory"), "{error}");
    }
}
