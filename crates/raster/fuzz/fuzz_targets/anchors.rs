#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| dronepose_raster_fuzz::anchors(bytes));
