//! Any bytes as a pose CSV, with an extra column kept.
#![no_main]

use dronepose_raster::io::{Format, PoseOptions, parse_poses};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let options =
        PoseOptions { format: Format::Csv, keep: vec!["scene".into()], ..PoseOptions::default() };
    if let Ok(table) = parse_poses("fuzz", bytes.to_vec(), &options) {
        assert!(table.poses.iter().all(|p| p.translation.is_finite() && p.rotation.is_normalized()));
    }
});
