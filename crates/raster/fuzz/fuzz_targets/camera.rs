//! Any bytes as a camera file, or as the text of --camera.
#![no_main]

use dronepose_raster::{camera::Intrinsics, eval::Cameras};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = Cameras::parse("fuzz", bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = Intrinsics::parse(text);
    }
});
