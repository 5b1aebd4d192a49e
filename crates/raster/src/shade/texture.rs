//! Images on surfaces: a pyramid of halved images, trilinear, with more samples where a pixel's
//! footprint is long.

use crate::error::{Error, Result};
use crate::shade::srgb;

/// Samples along the longer side of a footprint at most.
const LONGEST: f64 = 4.0;

/// An image of sRGB colours that repeats in both directions.
///
/// Coordinates `(u, v)` go from the lower left corner, `(0, 0)`, to the upper right one, `(1, 1)`,
/// as in OBJ and COLLADA files; glTF counts `v` from the top.
#[derive(Debug, Clone)]
pub struct Texture {
    levels: Vec<Level>,
}

#[derive(Debug, Clone)]
struct Level {
    width: usize,
    height: usize,
    /// sRGB, and opacity.
    texels: Vec<[u8; 4]>,
}

impl Texture {
    /// From rows of RGB, the upper one first, `(H, W, 3)`.
    ///
    /// # Errors
    /// [`Error::Argument`] where the length is not `3 height width`, or a side is 0 or above 16384.
    pub fn new(size: (usize, usize), rgb: &[u8]) -> Result<Self> {
        check(size, rgb.len(), 3)?;
        let texels = rgb.as_chunks::<3>().0.iter().map(|&[r, g, b]| [r, g, b, 255]).collect();
        Ok(Self::of(size, texels))
    }

    /// From rows of RGB and opacity (255 hides what is behind), `(H, W, 4)`. Colours are not
    /// multiplied by the opacity.
    ///
    /// # Errors
    /// As [`Texture::new`], with `4 height width`.
    pub fn with_opacity(size: (usize, usize), rgba: &[u8]) -> Result<Self> {
        check(size, rgba.len(), 4)?;
        Ok(Self::of(size, rgba.as_chunks::<4>().0.to_vec()))
    }

    fn of((height, width): (usize, usize), texels: Vec<[u8; 4]>) -> Self {
        let mut levels = vec![Level { width, height, texels }];
        while let Some(last) = levels.last().filter(|l| l.width > 1 || l.height > 1) {
            let next = last.halved();
            levels.push(next);
        }
        Self { levels }
    }

    /// Rows and columns of the image.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.levels[0].height, self.levels[0].width)
    }

    /// Mean of linear RGB over the image, as far as its smallest level tells.
    #[must_use]
    pub fn mean(&self) -> [f32; 3] {
        let [red, green, blue, _] = self.smallest();
        [red, green, blue]
    }

    /// The smallest level: linear RGB, and opacity.
    pub(super) fn smallest(&self) -> [f32; 4] {
        self.levels.last().map_or([0.0; 4], |level| level.texel(0, 0))
    }

    /// Linear RGB and opacity at `(u, v)` where a pixel to the right changes them by `slopes[0]` and one down by
    /// `slopes[1]`.
    #[must_use]
    pub fn sample(&self, uv: [f64; 2], slopes: [[f64; 2]; 2]) -> [f32; 4] {
        let (height, width) = self.size();
        let sides = [width as f64, height as f64];
        let texels = slopes.map(|slope| [slope[0] * sides[0], slope[1] * sides[1]]);
        let lengths = texels.map(|[x, y]| (x * x + y * y).sqrt());
        let long = usize::from(lengths[1] > lengths[0]);
        let (longer, shorter) = (lengths[long], lengths[1 - long]);
        if !longer.is_finite() || longer <= 1.0 {
            return self.levels[0].bilinear(uv);
        }
        let shorter = shorter.max(longer / LONGEST).max(1.0);
        let steps = (longer / shorter).ceil().max(1.0);
        let level = shorter.log2();
        let mut sum = [0.0_f32; 4];
        for k in 0..steps as usize {
            let along = (k as f64 + 0.5) / steps - 0.5;
            let place = [0, 1].map(|c| uv[c] + along * slopes[long][c]);
            let colour = self.trilinear(place, level);
            sum.iter_mut().zip(colour).for_each(|(sum, c)| *sum += c);
        }
        sum.map(|c| c / steps as f32)
    }

    fn trilinear(&self, uv: [f64; 2], level: f64) -> [f32; 4] {
        let last = self.levels.len() - 1;
        let level = level.clamp(0.0, last as f64);
        let fine = level.floor();
        let (k, part) = (fine as usize, (level - fine) as f32);
        let near = self.levels[k].bilinear(uv);
        if part == 0.0 || k == last {
            return near;
        }
        let far = self.levels[k + 1].bilinear(uv);
        [0, 1, 2, 3].map(|c| near[c] + part * (far[c] - near[c]))
    }
}

impl Level {
    fn texel(&self, x: usize, y: usize) -> [f32; 4] {
        let [r, g, b, opacity] = self.texels[y * self.width + x];
        let [r, g, b] = [r, g, b].map(srgb::decode);
        [r, g, b, f32::from(opacity) / 255.0]
    }

    /// The mean of the four texels around a place.
    fn bilinear(&self, [u, v]: [f64; 2]) -> [f32; 4] {
        let (x, y) = (around(u, self.width), around(1.0 - v, self.height));
        let [a, b, c, d] =
            [(x.0, y.0), (x.1, y.0), (x.0, y.1), (x.1, y.1)].map(|(x, y)| self.texel(x, y));
        [0, 1, 2, 3].map(|k| {
            let (upper, lower) = (a[k] + x.2 * (b[k] - a[k]), c[k] + x.2 * (d[k] - c[k]));
            upper + y.2 * (lower - upper)
        })
    }

    /// Half as wide and high; means of linear light over the texels that each new one covers.
    fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let span = |k: usize, new: usize, old: usize| k * old / new..((k + 1) * old).div_ceil(new);
        let mut texels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let (mut sum, mut count) = ([0.0_f32; 4], 0.0);
                for j in span(y, height, self.height) {
                    for i in span(x, width, self.width) {
                        let colour = self.texel(i, j);
                        sum.iter_mut().zip(colour).for_each(|(sum, c)| *sum += c);
                        count += 1.0;
                    }
                }
                let [r, g, b, opacity] = sum.map(|c| c / count);
                let [r, g, b] = [r, g, b].map(srgb::encode);
                texels.push([r, g, b, (255.0 * opacity).round() as u8]);
            }
        }
        Self { width, height, texels }
    }
}

/// Refuses sizes and lengths that do not fit.
fn check((height, width): (usize, usize), length: usize, channels: usize) -> Result<()> {
    let refuse = |message: String| Err(Error::argument("texture", message));
    if !(1..=16_384).contains(&height) || !(1..=16_384).contains(&width) {
        return refuse(format!("{height} x {width} pixels; expected sides of 1 to 16384"));
    }
    let expected = channels * height * width;
    if length != expected {
        return refuse(format!("{length} bytes, expected {expected}"));
    }
    Ok(())
}

/// The two texels on both sides of a coordinate along a side that repeats, and the share of the
/// second.
fn around(coordinate: f64, side: usize) -> (usize, usize, f32) {
    let place = (coordinate - whole(coordinate) as f64) * side as f64 - 0.5;
    let first = whole(place);
    let part = (place - first as f64) as f32;
    // -1 to side - 1; further only where the coordinate is beyond what an i64 holds.
    let first = if first < 0 { side - 1 } else { (first as usize).min(side - 1) };
    (first, if first + 1 == side { 0 } else { first + 1 }, part.clamp(0.0, 1.0))
}

/// The largest whole number not above `x`, without a call of the library; 0 for NaN.
fn whole(x: f64) -> i64 {
    let towards_zero = x as i64;
    towards_zero - i64::from(x < towards_zero as f64)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "colours of single texels are exact")]
mod tests {
    use super::*;

    fn checks(side: usize) -> Texture {
        let rgb: Vec<u8> = (0..side * side)
            .flat_map(|k| [if (k / side + k % side).is_multiple_of(2) { 255 } else { 0 }; 3])
            .collect();
        Texture::new((side, side), &rgb).unwrap()
    }

    #[test]
    fn centres_of_texels_have_their_colours() {
        let rgb = [255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
        let texture = Texture::new((2, 2), &rgb).unwrap();
        let at = |u, v| texture.sample([u, v], [[0.0; 2]; 2]);
        assert_eq!(at(0.25, 0.75), [1.0, 0.0, 0.0, 1.0]); // the first row is the upper one
        assert_eq!(at(0.75, 0.75), [0.0, 1.0, 0.0, 1.0]);
        assert_eq!(at(0.25, 0.25), [0.0, 0.0, 1.0, 1.0]);
        assert_eq!(at(-0.25, 5.25), at(0.75, 0.25)); // repeats
        assert_eq!(at(0.5, 0.5), [0.5, 0.5, 0.5, 1.0]);
    }

    #[test]
    fn a_footprint_over_many_texels_is_their_mean() {
        let texture = checks(64);
        let wide = texture.sample([0.3, 0.6], [[0.5, 0.0], [0.0, 0.5]]);
        assert!(wide[..3].iter().all(|c| (c - 0.5).abs() < 0.01), "{wide:?}");
        let mean = texture.mean();
        assert!(mean.iter().all(|c| (c - 0.5).abs() < 0.01), "{mean:?}");
    }

    #[test]
    fn a_long_footprint_keeps_what_it_does_not_cross() {
        // Rows of black and white, seen along them: no blur across.
        let rgb: Vec<u8> =
            (0..64 * 64).flat_map(|k| [if k / 64 % 2 == 0 { 255 } else { 0 }; 3]).collect();
        let texture = Texture::new((64, 64), &rgb).unwrap();
        let white = texture.sample([0.5, 1.0 - 0.5 / 64.0], [[4.0 / 64.0, 0.0], [0.0, 1.0 / 64.0]]);
        assert!(white[0] > 0.9, "{white:?}");
        let both = texture.sample([0.5, 0.5], [[0.0, 4.0 / 64.0], [1.0 / 64.0, 0.0]]);
        assert!((both[0] - 0.5).abs() < 0.1, "{both:?}");
    }

    #[test]
    fn opacity_is_interpolated_and_halved_as_it_is() {
        let rgba = [255, 0, 0, 0, 255, 0, 0, 255, 255, 0, 0, 51, 255, 0, 0, 51];
        let texture = Texture::with_opacity((2, 2), &rgba).unwrap();
        let at = |u, v| texture.sample([u, v], [[0.0; 2]; 2]);
        assert_eq!(at(0.25, 0.75), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(at(0.75, 0.75)[3], 1.0);
        assert!((at(0.5, 0.75)[3] - 0.5).abs() < 1e-6);
        let far = texture.sample([0.5, 0.5], [[9.0, 0.0], [0.0, 9.0]]);
        assert!((far[3] - 0.35).abs() < 2e-3 && far[0] == 1.0, "{far:?}");
        assert!(Texture::with_opacity((2, 2), &rgba[..12]).is_err());
    }

    #[test]
    fn odd_sides_and_wrong_lengths() {
        let texture = Texture::new((3, 5), &[128; 45]).unwrap();
        assert_eq!(texture.mean(), [srgb::decode(128); 3]);
        let far = texture.sample([1e9, -1e9], [[1e9, 0.0], [0.0, f64::INFINITY]]);
        assert!(far.iter().all(|c| c.is_finite()));
        assert!(Texture::new((3, 5), &[0; 44]).is_err());
        assert!(Texture::new((0, 5), &[]).is_err());
    }
}
