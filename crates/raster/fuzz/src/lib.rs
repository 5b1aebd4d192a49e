//! What every parser promises, whatever the bytes: it neither panics nor hangs, what it accepts is
//! finite, and what it says is one line that begins with the file's name.
//!
//! The fuzz targets call these, and so does `tests/corpus.rs` on the stable toolchain.

use dronepose_raster::camera::Intrinsics;
use dronepose_raster::error::{Error, Result};
use dronepose_raster::eval::Cameras;
use dronepose_raster::io::bop::read_models_info;
use dronepose_raster::io::input::Input;
use dronepose_raster::io::obj::parse_obj;
use dronepose_raster::io::ply::parse_ply;
use dronepose_raster::io::stl::parse_stl;
use dronepose_raster::io::{Format, PoseOptions, PoseTable, Unit, parse_poses};
use dronepose_raster::synth::{anchors as places, flight as flights};
use dronepose_raster::{Mesh, Pose};

/// The file's name.
const NAME: &str = "fuzz";

/// Takes any bytes, and panics if a promise is broken.
pub type Parser = fn(&[u8]);

/// Every parser by the name of its target and of its corpus.
pub const TARGETS: [(&str, Parser); 11] = [
    ("poses_auto", poses_auto),
    ("poses_csv", poses_csv),
    ("poses_bop", poses_bop),
    ("poses_speed", poses_speed),
    ("models_info", models_info),
    ("camera", camera),
    ("mesh_obj", mesh_obj),
    ("mesh_ply", mesh_ply),
    ("mesh_stl", mesh_stl),
    ("flight", flight),
    ("anchors", anchors),
];

/// Any bytes as a pose file whose format is recognised.
pub fn poses_auto(bytes: &[u8]) {
    poses(bytes, &PoseOptions::default());
}

/// Any bytes as a pose CSV, with an extra column kept.
pub fn poses_csv(bytes: &[u8]) {
    let keep = vec!["scene".into()];
    poses(bytes, &PoseOptions { format: Format::Csv, keep, ..PoseOptions::default() });
}

/// Any bytes as a BOP result file or `scene_gt.json`.
pub fn poses_bop(bytes: &[u8]) {
    poses(bytes, &PoseOptions { format: Format::Bop, ..PoseOptions::default() });
}

/// Any bytes as a SPEED file.
pub fn poses_speed(bytes: &[u8]) {
    poses(bytes, &PoseOptions { format: Format::Speed, ..PoseOptions::default() });
}

/// Any bytes as a symmetry file.
pub fn models_info(bytes: &[u8]) {
    let read = Input::from_bytes(NAME, bytes.to_vec());
    let Some((infos, _)) = accepted(read.and_then(|i| read_models_info(i, Unit::Millimetre)))
    else {
        return;
    };
    for info in infos.values() {
        assert!(info.diameter.is_none_or(f64::is_finite));
        info.discrete.iter().for_each(sound);
        for (axis, point) in &info.continuous {
            assert!(axis.is_normalized() && point.is_finite());
        }
    }
}

/// Any bytes as a camera file, or as the text of `--camera`.
pub fn camera(bytes: &[u8]) {
    let finite = |k: &Intrinsics| assert!(k.matrix().as_flattened().iter().all(|c| c.is_finite()));
    if let Some(cameras) = accepted(Cameras::parse(NAME, bytes)) {
        assert!(!cameras.is_empty());
        cameras.get(Some(0)).into_iter().for_each(finite);
        cameras.get(Some(1)).into_iter().for_each(finite);
    }
    if let Ok(text) = std::str::from_utf8(bytes) {
        match Intrinsics::parse(text) {
            Ok(camera) => finite(&camera),
            Err(error) => one_line(&error.to_string()),
        }
    }
}

/// Any bytes as an OBJ file.
pub fn mesh_obj(bytes: &[u8]) {
    mesh(parse_obj(bytes, NAME));
}

/// Any bytes as a PLY file.
pub fn mesh_ply(bytes: &[u8]) {
    mesh(parse_ply(bytes, NAME));
}

/// Any bytes as an STL file.
pub fn mesh_stl(bytes: &[u8]) {
    mesh(parse_stl(bytes, NAME));
}

/// Any bytes as a flight, by its first line and in every format.
pub fn flight(bytes: &[u8]) {
    use flights::Format;
    for format in
        [Format::Auto, Format::Uava, Format::Airsim, Format::Tum, Format::Euroc, Format::Csv]
    {
        let options = flights::Options { format, ..flights::Options::default() };
        let parsed = flights::parse_flight(NAME, bytes.to_vec(), &options);
        let Some(flight) = accepted(parsed) else { continue };
        assert!(flight.time.windows(2).all(|w| w[0] < w[1]) && !flight.segments.is_empty());
        flight.issues.iter().for_each(|i| one_line(&i.text));
        if let Ok(track) = flight.resample(60.0) {
            for (p, q) in track.positions.iter().zip(&track.rotations) {
                sound(&Pose::new(*q, *p));
            }
        }
    }
}

/// Any bytes as anchors.
pub fn anchors(bytes: &[u8]) {
    let parsed = places::parse_anchors(NAME, bytes.to_vec(), places::Options::default());
    let Some(found) = accepted(parsed) else { return };
    assert!(!found.names.is_empty() && found.names.len() == found.positions.len());
    assert!(found.positions.iter().all(|p| p.is_finite()));
}

fn poses(bytes: &[u8], options: &PoseOptions) {
    let Some(table) = accepted(parse_poses(NAME, bytes.to_vec(), options)) else { return };
    assert!(!table.is_empty());
    columns_are_of_one_length(&table);
    table.poses.iter().for_each(sound);
    for warning in &table.warnings {
        assert!(warning.starts_with(NAME), "{warning:?}");
        one_line(warning);
    }
    for row in 0..table.len() {
        one_line(&table.place(row, "t").to_string());
    }
}

fn columns_are_of_one_length(table: &PoseTable) {
    let n = table.len();
    assert!(table.lines.is_empty() || table.lines.len() == n);
    match &table.targets {
        Some(targets) => assert_eq!(targets.len(), n),
        None => assert_eq!(table.ids.len(), n),
    }
    assert!(table.scores.iter().all(|s| s.len() == n && s.iter().all(|x| x.is_finite())));
    assert!(table.extra.iter().all(|c| c.values.len() == n));
}

fn sound(pose: &Pose) {
    assert!(pose.rotation.is_normalized() && pose.translation.is_finite(), "{pose:?}");
}

fn mesh(parsed: Result<Mesh>) {
    let Some(mesh) = accepted(parsed) else { return };
    let n = mesh.vertices().len();
    assert!(n > 0 && mesh.vertices().iter().all(|v| v.is_finite()));
    assert!(mesh.faces().as_flattened().iter().all(|&k| (k as usize) < n));
}

/// What was accepted; the words of a refusal are looked at.
fn accepted<T>(result: Result<T>) -> Option<T> {
    let error = match result {
        Ok(value) => return Some(value),
        Err(error) => error,
    };
    let text = error.to_string();
    let begins = match error {
        Error::Read { .. } => format!("cannot read {NAME}: "),
        _ => NAME.to_owned(),
    };
    assert!(text.starts_with(&begins), "{text:?}");
    one_line(&text);
    None
}

fn one_line(text: &str) {
    assert!(!text.contains(char::is_control) && text.len() < 2000, "{text:?}");
}
