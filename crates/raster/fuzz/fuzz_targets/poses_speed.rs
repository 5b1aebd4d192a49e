//! Any bytes as a SPEED file.
#![no_main]

use dronepose_raster::io::{Format, PoseOptions, parse_poses};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let options = PoseOptions { format: Format::Speed, ..PoseOptions::default() };
    let _ = parse_poses("fuzz", bytes.to_vec(), &options);
});
