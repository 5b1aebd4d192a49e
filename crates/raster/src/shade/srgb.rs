//! Between sRGB bytes and linear light (IEC 61966-2-1).

use std::sync::LazyLock;

/// Linear values of the bytes.
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|k| to_linear(k as f64 / 255.0) as f32));

/// Where bytes end: the first linear value of byte `k + 1`.
static ENDS: LazyLock<[f32; 255]> =
    LazyLock::new(|| std::array::from_fn(|k| to_linear((k as f64 + 0.5) / 255.0) as f32));

/// Steps of the table of first guesses.
const STEPS: usize = 4096;

/// The byte at the start of each step.
static GUESS: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let at = |k: usize| ENDS.partition_point(|&end| end <= k as f32 / STEPS as f32);
    (0..STEPS).map(|k| at(k) as u8).collect()
});

/// The curve from an encoded value, 0 to 1, to linear light.
fn to_linear(x: f64) -> f64 {
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Linear light of a byte, 0 to 1.
#[must_use]
pub fn decode(byte: u8) -> f32 {
    LINEAR[usize::from(byte)]
}

/// The byte nearest to linear light, which is clamped to 0 to 1; NaN is 0.
#[must_use]
pub fn encode(linear: f32) -> u8 {
    if linear >= 1.0 {
        return 255;
    }
    if linear.is_nan() || linear <= 0.0 {
        return 0;
    }
    let mut byte = GUESS[(linear * STEPS as f32) as usize];
    while byte < 255 && linear >= ENDS[usize::from(byte)] {
        byte += 1;
    }
    byte
}

/// Encode a slice.
///
/// # Panics
/// If the lengths differ.
pub fn encode_all(linear: &[f32], out: &mut [u8]) {
    assert_eq!(linear.len(), out.len(), "out: as many bytes as values");
    out.iter_mut().zip(linear).for_each(|(out, &x)| *out = encode(x));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_survive_a_round_trip() {
        for byte in 0..=255 {
            assert_eq!(encode(decode(byte)), byte);
        }
    }

    #[test]
    fn known_values() {
        assert_eq!(encode(0.5), 188);
        assert_eq!([encode(0.215_860_5), decode(0) as u8, decode(255) as u8], [128, 0, 1]);
        assert!((decode(188) - 0.502_886_5).abs() < 1e-6); // half the light is byte 188
        assert_eq!([encode(-1.0), encode(f32::NAN), encode(2.0), encode(1.0)], [0, 0, 255, 255]);
    }

    #[test]
    fn the_nearest_byte_is_found() {
        for k in 0..=100_000 {
            let x = k as f32 / 100_000.0;
            let encoded =
                if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
            let exact = 255.0 * encoded;
            assert!((f32::from(encode(x)) - exact).abs() < 0.5 + 1e-3, "{x}");
        }
    }
}
