//! Any bytes as a PLY file.
#![no_main]

use dronepose_raster::io::ply::parse_ply;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = parse_ply(bytes, "fuzz");
});
