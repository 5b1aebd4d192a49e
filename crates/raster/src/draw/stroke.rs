//! Lines with soft edges.

use super::{Canvas, Rgb};

/// Two ends `(u, v)`, in pixels.
pub type Segment = [[f64; 2]; 2];

impl Canvas {
    /// Draw lines of a width in pixels, round at their ends. Where lines meet or cross, the colour
    /// is not mixed in twice.
    pub fn stroke(&mut self, segments: &[Segment], width: f64, color: Rgb, alpha: f64) {
        let reach = 0.5 * width + 0.5;
        let mut covered = vec![0.0_f32; self.pixels.len()];
        for &[a, b] in segments {
            let Some([a, b]) = self.near(a, b, reach) else { continue };
            let range = |p: f64, q: f64, n: usize| {
                let low = (p.min(q) - reach).floor().max(0.0) as usize;
                low..((p.max(q) + reach).ceil().max(0.0) as usize).min(n)
            };
            for y in range(a[1], b[1], self.height) {
                for x in range(a[0], b[0], self.width) {
                    let d = distance([x as f64 + 0.5, y as f64 + 0.5], a, b);
                    let cover = (reach - d).clamp(0.0, width.min(1.0)) as f32;
                    let pixel = &mut covered[y * self.width + x];
                    *pixel = pixel.max(cover);
                }
            }
        }
        self.tint(&covered, color, alpha);
    }

    /// The part of a line that is near the picture, so that a line of any length is drawn in no time.
    fn near(&self, a: [f64; 2], b: [f64; 2], reach: f64) -> Option<Segment> {
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for (k, size) in [(0, self.width), (1, self.height)] {
            let (low, high) = (-2.0 * reach, size as f64 + 2.0 * reach);
            let step = b[k] - a[k];
            if !a[k].is_finite() || !step.is_finite() {
                return None;
            }
            if step == 0.0 {
                if a[k] < low || a[k] > high {
                    return None;
                }
                continue;
            }
            let (s, t) = ((low - a[k]) / step, (high - a[k]) / step);
            from = from.max(s.min(t));
            to = to.min(s.max(t));
        }
        let at = |s: f64| [a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])];
        (from <= to).then(|| [at(from), at(to)])
    }

    /// Draw the frame of a rectangle.
    pub fn frame(&mut self, corner: [f64; 2], size: [f64; 2], width: f64, color: Rgb) {
        let [x, y] = corner;
        let (right, bottom) = (x + size[0], y + size[1]);
        let corners = [[x, y], [right, y], [right, bottom], [x, bottom]];
        let sides: Vec<Segment> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        self.stroke(&sides, width, color, 1.0);
    }
}

/// From a point to a line between two ends.
fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length2 = dx * dx + dy * dy;
    let along = (p[0] - a[0]) * dx + (p[1] - a[1]) * dy;
    let s = if length2 > 0.0 { (along / length2).clamp(0.0, 1.0) } else { 0.0 };
    (p[0] - a[0] - s * dx).hypot(p[1] - a[1] - s * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_as_much_as_it_is_wide() {
        let mut canvas = Canvas::new(20, 9, [0; 3]);
        canvas.stroke(&[[[-5.0, 4.5], [25.0, 4.5]]], 3.0, [255; 3], 1.0);
        let column: Vec<u8> = (0..9).map(|y| canvas.pixels()[y * 20 + 10][0]).collect();
        assert_eq!(column, [0, 0, 0, 255, 255, 255, 0, 0, 0]);
        let mut thin = Canvas::new(20, 9, [0; 3]);
        thin.stroke(&[[[0.0, 4.5], [20.0, 4.5]], [[3.0, 4.5], [20.0, 4.5]]], 0.5, [255; 3], 1.0);
        assert_eq!(thin.pixels()[4 * 20 + 10][0], 128);
    }

    #[test]
    fn far_and_endless_lines_cost_nothing() {
        let mut canvas = Canvas::new(8, 8, [0; 3]);
        let far = [[1e12, 1e12], [2e12, 1e12]];
        let odd = [[f64::NAN, 0.0], [1.0, f64::INFINITY]];
        canvas.stroke(&[far, odd], 2.0, [255; 3], 1.0);
        assert!(canvas.pixels().iter().all(|p| *p == [0; 3]));
        canvas.stroke(&[[[-1e12, 4.5], [1e12, 4.5]]], 1.0, [255; 3], 1.0);
        assert_eq!(canvas.pixels()[4 * 8 + 3], [255; 3]);
    }
}
