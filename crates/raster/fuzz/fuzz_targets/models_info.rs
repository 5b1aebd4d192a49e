//! Any bytes as a symmetry file.
#![no_main]

use dronepose_raster::io::{Unit, bop::read_models_info, input::Input};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(input) = Input::from_bytes("fuzz", bytes.to_vec()) {
        let _ = read_models_info(input, Unit::Millimetre);
    }
});
