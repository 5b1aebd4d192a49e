//! The line along which a mask is one half.

use super::Segment;

/// The level set of a mask `(H, W)`, as short lines: marching squares between the centres of the
/// pixels, with linear interpolation. Where the four corners of a square leave two ways, their mean
/// decides. A silhouette that leaves the picture is open there.
///
/// # Panics
/// If the mask has not `width * height` numbers.
#[must_use]
pub fn contour(mask: &[f32], width: usize, height: usize, level: f64) -> Vec<Segment> {
    assert_eq!(mask.len(), width * height, "mask: (H, W)");
    let at = |x: usize, y: usize| f64::from(mask[y * width + x]) - level;
    let mut lines = Vec::new();
    for y in 0..height.saturating_sub(1) {
        for x in 0..width.saturating_sub(1) {
            // Corners in turn: top left, top right, bottom right, bottom left.
            let corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)];
            let values = corners.map(|(x, y)| at(x, y));
            let inside = values.map(|v| v >= 0.0);
            if inside == [true; 4] || inside == [false; 4] {
                continue;
            }
            // Where side k, from corner k to the next, meets the level.
            let crossing = |k: usize| {
                let (a, b) = (values[k], values[(k + 1) % 4]);
                let s = a / (a - b);
                let ((x0, y0), (x1, y1)) = (corners[k], corners[(k + 1) % 4]);
                let between = |p: usize, q: usize| p as f64 + 0.5 + s * (q as f64 - p as f64);
                [between(x0, x1), between(y0, y1)]
            };
            let sides: Vec<usize> = (0..4).filter(|&k| inside[k] != inside[(k + 1) % 4]).collect();
            if let [a, b] = *sides {
                lines.push([crossing(a), crossing(b)]);
                continue;
            }
            let joined = values.iter().sum::<f64>() >= 0.0;
            let shift = usize::from(joined == inside[0]);
            for k in [0, 2] {
                let (a, b) = ((k + 3 + shift) % 4, (k + shift) % 4);
                lines.push([crossing(a), crossing(b)]);
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_has_the_length_of_its_outline() {
        let (width, height, radius) = (60, 50, 15.0);
        let mask: Vec<f32> = (0..width * height)
            .map(|k| {
                let (x, y) = ((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
                let d = (x - 31.0).hypot(y - 24.0);
                (0.5 + radius - d).clamp(0.0, 1.0) as f32
            })
            .collect();
        let lines = contour(&mask, width, height, 0.5);
        let length: f64 = lines.iter().map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        let round = std::f64::consts::TAU * radius;
        assert!((length / round - 1.0).abs() < 0.01, "{length} {round}");
        for [a, _] in lines {
            assert!(((a[0] - 31.0).hypot(a[1] - 24.0) - radius).abs() < 0.2);
        }
    }

    #[test]
    fn every_end_is_shared_also_at_a_saddle() {
        for mask in [
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.9, 0.1, 0.0, 0.0, 0.1, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.7, 0.0, 0.0, 0.7, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 1.0, 0.0, 0.0, 1.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0],
        ] {
            let lines = contour(&mask, 4, 4, 0.5);
            assert_eq!(lines.len(), 8);
            let ends: Vec<[f64; 2]> = lines.iter().flatten().copied().collect();
            for end in &ends {
                let near = |p: &&[f64; 2]| (p[0] - end[0]).hypot(p[1] - end[1]) < 1e-12;
                assert_eq!(ends.iter().filter(near).count(), 2, "{mask:?}");
            }
        }
        assert!(contour(&[1.0; 9], 3, 3, 0.5).is_empty());
        assert!(contour(&[1.0], 1, 1, 0.5).is_empty());
    }
}
