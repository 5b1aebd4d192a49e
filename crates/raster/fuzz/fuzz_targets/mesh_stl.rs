//! Any bytes as an STL file.
#![no_main]

use dronepose_raster::io::stl::parse_stl;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = parse_stl(bytes, "fuzz");
});
