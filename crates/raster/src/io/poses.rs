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
