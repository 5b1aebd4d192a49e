//! Any bytes as an OBJ file.
#![no_main]

use dronepose_raster::io::obj::parse_obj;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(mesh) = parse_obj(bytes, "fuzz") {
        assert!(mesh.vertices().iter().all(|v| v.is_finite()));
    }
});
