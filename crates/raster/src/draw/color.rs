//! The colours of our pictures.

use super::Rgb;

/// Behind everything.
pub const PAPER: Rgb = [250, 250, 248];
/// Text.
pub const INK: Rgb = [38, 42, 48];
/// Text of less weight, and thin lines.
pub const SOFT: Rgb = [128, 134, 142];
/// Outlines.
pub const ORANGE: Rgb = [255, 140, 26];
/// Silhouettes.
pub const TEAL: Rgb = [0, 168, 150];
/// The x axis.
pub const RED: Rgb = [226, 54, 54];
/// The y axis.
pub const GREEN: Rgb = [46, 170, 66];
/// The z axis.
pub const BLUE: Rgb = [52, 104, 240];

/// From `a` at 0 to `b` at 1.
#[must_use]
pub fn mix(a: Rgb, b: Rgb, share: f64) -> Rgb {
    let share = share.clamp(0.0, 1.0);
    let one = |k: usize| {
        let (a, b) = (f64::from(a[k]), f64::from(b[k]));
        (a + share * (b - a)).round() as u8
    };
    [one(0), one(1), one(2)]
}

/// From blue at 0 through green and yellow to red at 1: Google's Turbo colour map, in the
/// polynomials that its authors give (Mikhailov, "Turbo, An Improved Rainbow Colormap", 2019).
#[must_use]
pub fn turbo(x: f64) -> Rgb {
    const COEFFICIENTS: [[f64; 6]; 3] = [
        [
            0.135_721_38,
            4.615_392_60,
            -42.660_322_58,
            132.131_082_34,
            -152.942_393_96,
            59.286_379_43,
        ],
        [0.091_402_61, 2.194_188_39, 4.842_966_58, -14.185_033_33, 4.277_298_57, 2.829_566_04],
        [
            0.106_673_30,
            12.641_946_08,
            -60.582_048_36,
            110.362_767_71,
            -89.903_109_12,
            27.348_249_73,
        ],
    ];
    let x = x.clamp(0.0, 1.0);
    COEFFICIENTS.map(|c| {
        let value = c.iter().rev().fold(0.0, |sum, c| sum * x + c);
        (255.0 * value).round().clamp(0.0, 255.0) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_goes_from_blue_to_red() {
        let (low, middle, high) = (turbo(0.1), turbo(0.5), turbo(0.95));
        assert!(low[2] > low[0] && high[0] > high[2] && middle[1] > 200);
        assert_eq!(turbo(-3.0), turbo(0.0));
        assert_eq!(mix([0, 100, 200], [100, 0, 200], 0.5), [50, 50, 200]);
    }
}
