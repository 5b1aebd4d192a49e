//! Pixel centres and image points as Kaolin's rasteriser has them.

use multiversion::multiversion;

use super::super::real::{LANES, ROUND_DOUBLE};
use crate::raster::{Screen, Size};

/// What `DIBRenderer` multiplies coordinates by.
const MULTIPLIER: f64 = 1000.0;

/// Where the pixel centres of a bounding box begin and end: first column, first row, and the
/// column and the row after the last, these two negative: the bounds of a face are the least ones
/// of its corners.
pub(super) type Bounds = [i32; 4];

/// Pixel centres in multiplied NDC, x to the right, y up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// Columns, rows.
    sides: [f64; 2],
    /// Half a pixel.
    half: [f64; 2],
    /// A pixel, as a part of half the image.
    part: [f64; 2],
}

/// What boxes and insides are decided by, for each image point.
#[derive(Debug, Default)]
pub(in super::super) struct Points {
    /// In multiplied NDC.
    pub(super) x: Vec<f64>,
    pub(super) y: Vec<f64>,
    /// Bounds of the centres that the box of a face holds.
    pub(super) held: Vec<Bounds>,
    /// The same of the grown box.
    pub(super) grown: Vec<Bounds>,
}

impl Points {
    /// Those of a screen; boxes are grown by `boxlen` (NDC).
    pub(in super::super) fn set(&mut self, screen: &Screen, size: Size, boxlen: f64) {
        let grid = Grid::new(size);
        let Self { x, y, held, grown } = self;
        x.clear();
        x.extend(screen.u.iter().map(|u| (u * grid.part[0] - 1.0) * MULTIPLIER));
        y.clear();
        y.extend(screen.v.iter().map(|v| (v * grid.part[1] + 1.0) * MULTIPLIER));
        bounds(&grid, [x, y], 0.0, held);
        bounds(&grid, [x, y], boxlen * MULTIPLIER, grown);
    }
}

/// The bounds of a face from those of the image points.
#[inline(always)]
pub(super) fn of_face(bounds: &[Bounds], face: [u32; 3]) -> Bounds {
    let [a, b, c] = face.map(|k| bounds[k as usize]);
    [0, 1, 2, 3].map(|k| a[k].min(b[k]).min(c[k]))
}

/// The bounds of the half-open box of each point, grown by `margin`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn bounds(grid: &Grid, [x, y]: [&[f64]; 2], margin: f64, out: &mut Vec<Bounds>) {
    out.clear();
    out.resize(x.len(), [0; 4]);
    let chunks = x.chunks(LANES).zip(y.chunks(LANES));
    for ((x, y), out) in chunks.zip(out.chunks_mut(LANES)) {
        let (mut px, mut py) = ([0.0; LANES], [0.0; LANES]);
        px[..x.len()].copy_from_slice(x);
        py[..y.len()].copy_from_slice(y);
        let mut lanes = [[0; LANES]; 4];
        for l in 0..LANES {
            lanes[0][l] = grid.first_column(px[l] - margin);
            lanes[1][l] = grid.first_row(py[l] + margin);
            lanes[2][l] = -grid.first_column(px[l] + margin);
            lanes[3][l] = -grid.first_row(py[l] - margin);
        }
        for (l, out) in out.iter_mut().enumerate() {
            *out = [lanes[0][l], lanes[1][l], lanes[2][l], lanes[3][l]];
        }
    }
}

impl Grid {
    pub(super) fn new(size: Size) -> Self {
        let [width, height] = [size.width as f64, size.height as f64];
        let half = [MULTIPLIER / width, MULTIPLIER / height];
        Self { sides: [width, height], half, part: [2.0 / width, -2.0 / height] }
    }

    /// The centres of a column.
    #[inline(always)]
    pub(super) fn x(&self, column: f64) -> f64 {
        self.half[0] * (2.0 * column + 1.0 - self.sides[0])
    }

    /// The centres of a row.
    #[inline(always)]
    pub(super) fn y(&self, row: f64) -> f64 {
        self.half[1] * (self.sides[1] - 2.0 * row - 1.0)
    }

    /// The first column whose centres are at `limit` or to the right of it.
    #[inline(always)]
    fn first_column(&self, limit: f64) -> i32 {
        let side = self.sides[0];
        let k = guess(limit, side);
        // The comparisons decide: the guess is off by one at most.
        let less = (k > 0.0) & (self.x(k - 1.0) >= limit);
        let more = (k < side) & (self.x(k) < limit);
        whole(k, less, more)
    }

    /// The first row whose centres are below `limit`.
    #[inline(always)]
    fn first_row(&self, limit: f64) -> i32 {
        let side = self.sides[1];
        let k = guess(-limit, side);
        let less = (k > 0.0) & (self.y(k - 1.0) < limit);
        let more = (k < side) & (self.y(k) >= limit);
        whole(k, less, more)
    }
}

/// About the first pixel from a place on, of so many.
#[inline(always)]
fn guess(place: f64, side: f64) -> f64 {
    let pixel = (place * (0.5 / MULTIPLIER) + 0.5) * side + 0.5;
    let pixel = if pixel > 0.0 { pixel } else { 0.0 };
    let pixel = if pixel < side { pixel } else { side };
    let rounded = (pixel + ROUND_DOUBLE) - ROUND_DOUBLE;
    rounded - if rounded > pixel { 1.0 } else { 0.0 }
}

#[inline(always)]
fn whole(k: f64, less: bool, more: bool) -> i32 {
    let k = k - if less { 1.0 } else { 0.0 } + if more { 1.0 } else { 0.0 };
    (k + ROUND_DOUBLE).to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_begin_and_end_where_every_centre_says() {
        for (height, width) in [(1, 1), (7, 5), (240, 320), (33, 1001)] {
            let size = Size { height, width };
            let grid = Grid::new(size);
            let mut seed = 5_u64;
            let mut next = || {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (seed >> 11) as f64 / (1_u64 << 53) as f64
            };
            let mut places = vec![-1e300, -1e9, -1000.0, 0.0, 1000.0, 1e9, 1e300];
            places.extend((0..500).map(|_| 2400.0 * next() - 1200.0));
            // Centres themselves, and the numbers next to them.
            for k in 0..width.min(200) {
                places.extend([grid.x(k as f64), grid.x(k as f64).next_up()]);
            }
            for k in 0..height.min(200) {
                places.extend([grid.y(k as f64), grid.y(k as f64).next_down()]);
            }
            for limit in places {
                let column = (0..width).find(|&k| grid.x(k as f64) >= limit).unwrap_or(width);
                let row = (0..height).find(|&k| grid.y(k as f64) < limit).unwrap_or(height);
                assert_eq!(grid.first_column(limit), column as i32, "{limit}");
                assert_eq!(grid.first_row(limit), row as i32, "{limit}");
            }
        }
    }
}
