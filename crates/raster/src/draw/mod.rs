//! Small pictures for people: colours, lines, outlines, labels and sheets on an RGB canvas.
//!
//! Positions are those of images everywhere in this crate: `(0, 0)` is the corner, the centre of
//! the pixel in row `i` and column `j` is `(j + 0.5, i + 0.5)`.

mod color;
mod contour;
mod sheet;
mod stroke;
mod text;
mod wire;

pub use self::color::{BLUE, GREEN, INK, ORANGE, PAPER, RED, SOFT, TEAL, mix, turbo};
pub use self::contour::contour;
pub use self::sheet::{Cell, sheet};
pub use self::stroke::Segment;
pub use self::text::{LINE_HEIGHT, fitted, text_width};
pub use self::wire::{axes, box_edges};

/// Red, green and blue.
pub type Rgb = [u8; 3];

/// A picture in memory, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
}

impl Canvas {
    /// Of one colour.
    #[must_use]
    pub fn new(width: usize, height: usize, color: Rgb) -> Self {
        Self { width, height, pixels: vec![color; width * height] }
    }

    /// From its pixels, row by row.
    ///
    /// # Panics
    /// If there are not `width * height`.
    #[must_use]
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<Rgb>) -> Self {
        assert_eq!(pixels.len(), width * height, "pixels: (H, W)");
        Self { width, height, pixels }
    }

    /// From a mask of 0 to 1 in shades of grey.
    ///
    /// # Panics
    /// If there are not `width * height` numbers.
    #[must_use]
    pub fn from_mask(width: usize, height: usize, mask: &[f32]) -> Self {
        let gray = |&m: &f32| [(m.clamp(0.0, 1.0) * 255.0).round() as u8; 3];
        Self::from_pixels(width, height, mask.iter().map(gray).collect())
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row by row.
    #[must_use]
    pub fn pixels(&self) -> &[Rgb] {
        &self.pixels
    }

    /// Mix a colour into a pixel; outside, nothing happens.
    pub fn blend(&mut self, x: usize, y: usize, color: Rgb, alpha: f64) {
        if x < self.width && y < self.height {
            let pixel = &mut self.pixels[y * self.width + x];
            *pixel = mix(*pixel, color, alpha);
        }
    }

    /// Mix a colour in by a mask of 0 to 1 of the same size, times `alpha`.
    pub fn tint(&mut self, mask: &[f32], color: Rgb, alpha: f64) {
        for (pixel, &m) in self.pixels.iter_mut().zip(mask) {
            *pixel = mix(*pixel, color, alpha * f64::from(m));
        }
    }

    /// Put a picture on this one, its corner at `(x, y)`; what hangs over is cut off.
    pub fn paste(&mut self, picture: &Self, x: usize, y: usize) {
        if x >= self.width {
            return;
        }
        let width = picture.width.min(self.width - x);
        let rows = picture.pixels.chunks_exact(picture.width.max(1));
        for (row, line) in rows.enumerate().take(self.height.saturating_sub(y)) {
            let from = (y + row) * self.width + x;
            self.pixels[from..from + width].copy_from_slice(&line[..width]);
        }
    }

    /// The rectangle at `(x, y)` of this size, as far as it lies inside.
    #[must_use]
    pub fn crop(&self, x: usize, y: usize, width: usize, height: usize) -> Self {
        let (x, y) = (x.min(self.width), y.min(self.height));
        let (width, height) = (width.min(self.width - x), height.min(self.height - y));
        let rows = (y..y + height).flat_map(|row| {
            let from = row * self.width + x;
            self.pixels[from..from + width].iter().copied()
        });
        Self::from_pixels(width, height, rows.collect())
    }

    /// Every pixel as a square of `times` pixels.
    #[must_use]
    pub fn enlarged(&self, times: usize) -> Self {
        let (width, height) = (self.width * times, self.height * times);
        let at = |k: usize| self.pixels[k / width / times * self.width + k % width / times];
        Self::from_pixels(width, height, (0..width * height).map(at).collect())
    }

    /// Another size, each pixel the mean over the area it covers.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let across = shares(self.width, width);
        let down = shares(self.height, height);
        let mut pixels = Vec::with_capacity(width * height);
        for rows in &down {
            for columns in &across {
                let mut sum = [0.0; 3];
                for &(y, wy) in rows {
                    for &(x, wx) in columns {
                        let pixel = self.pixels[y * self.width + x];
                        for (s, c) in sum.iter_mut().zip(pixel) {
                            *s += wy * wx * f64::from(c);
                        }
                    }
                }
                pixels.push(sum.map(|s| s.round().clamp(0.0, 255.0) as u8));
            }
        }
        Self::from_pixels(width, height, pixels)
    }

    /// The largest picture of the same shape within `width` and `height`; never enlarged.
    #[must_use]
    pub fn fitted(self, width: usize, height: usize) -> Self {
        let scale = (width as f64 / self.width as f64).min(height as f64 / self.height as f64);
        if scale >= 1.0 {
            return self;
        }
        let side = |n: usize| ((n as f64 * scale).round() as usize).max(1);
        self.resized(side(self.width), side(self.height))
    }
}

/// For each of `to` pixels along an axis, the pixels of `from` it covers and their weights.
fn shares(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let step = from as f64 / to as f64;
    let share = |k: usize| {
        let (low, high) = (k as f64 * step, (k + 1) as f64 * step);
        let pixels = low as usize..(high.ceil() as usize).clamp(low as usize + 1, from);
        let inside = |x: usize| (high.min((x + 1) as f64) - low.max(x as f64)).max(0.0);
        pixels.map(|x| (x, inside(x) / step)).collect()
    };
    (0..to).map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Canvas {
        Canvas::from_pixels(4, 2, (0..8).map(|k| [10 * k, 0, 0]).collect())
    }

    #[test]
    fn pasting_and_cropping_stay_inside() {
        let mut canvas = Canvas::new(5, 3, PAPER);
        canvas.paste(&ramp(), 3, 2);
        assert_eq!(canvas.pixels()[2 * 5 + 3..], [[0, 0, 0], [10, 0, 0]]);
        canvas.paste(&ramp(), 7, 0);
        canvas.paste(&ramp(), 0, 9);
        assert_eq!(ramp().crop(2, 1, 9, 9).pixels(), [[60, 0, 0], [70, 0, 0]]);
        assert_eq!(ramp().crop(9, 9, 2, 2).pixels().len(), 0);
    }

    #[test]
    fn resizing_keeps_the_mean() {
        let canvas = ramp();
        assert_eq!(canvas.resized(1, 1).pixels(), [[35, 0, 0]]);
        assert_eq!(canvas.resized(2, 1).pixels(), [[25, 0, 0], [45, 0, 0]]);
        assert_eq!(canvas.resized(4, 2), canvas);
        assert_eq!(canvas.enlarged(3).resized(4, 2), canvas);
        assert_eq!(canvas.clone().fitted(100, 100), canvas);
        let small = canvas.fitted(3, 1);
        assert_eq!((small.width(), small.height()), (2, 1));
    }

    #[test]
    fn a_mask_becomes_grey_and_tints() {
        let mask = [0.0, 0.5, 1.0, 2.0];
        let canvas = Canvas::from_mask(4, 1, &mask);
        assert_eq!(canvas.pixels(), [[0; 3], [128; 3], [255; 3], [255; 3]]);
        let mut canvas = Canvas::new(2, 1, [0; 3]);
        canvas.tint(&[0.0, 1.0], [200, 100, 0], 0.5);
        assert_eq!(canvas.pixels(), [[0; 3], [100, 50, 0]]);
    }
}
