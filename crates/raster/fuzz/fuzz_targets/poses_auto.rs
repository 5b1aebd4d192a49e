//! Any bytes as a pose file whose format is recognised.
#![no_main]

use dronepose_raster::io::{PoseOptions, parse_poses};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = parse_poses("fuzz", bytes.to_vec(), &PoseOptions::default());
});
