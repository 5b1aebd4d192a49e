//! Any bytes as a BOP result file or scene_gt.json.
#![no_main]

use dronepose_raster::io::{Format, PoseOptions, parse_poses};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let options = PoseOptions { format: Format::Bop, ..PoseOptions::default() };
    let _ = parse_poses("fuzz", bytes.to_vec(), &options);
});
