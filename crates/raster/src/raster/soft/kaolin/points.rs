//! Pixel centres and image points as Kaolin's rasteriser has them.

use multiversion::multiversion;

use super::super::real::{LANES, ROUND_DOUBLE};
use super::super::visits::Bounds;
use crate::raster::{Screen, Size};

/// What `DIBRenderer` multiplies coordinates by.
const MULTIPLIER: f64 = 1000.0;

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

/// What insides are decided by, for each image point.
#[derive(Debug)]
pub(super) struct Points {
    /// In multiplied NDC.
    pub(super) x: Vec<f64>,
    pub(super) y: Vec<f64>,
    /// Bounds of the centres that the box of a face holds.
    pub(super) held: Vec<Bounds>,
}

impl Points {
    /// Those of a screen.
    pub(super) fn new(screen: &Screen, size: Size) -> Self {
        let grid = Grid::new(size);
        let mut held = Vec::new();
        bounds(&grid, screen, 0.0, &mut held);
        Self {
            x: screen.u.iter().map(|&u| grid.across(u)).collect(),
            y: screen.v.iter().map(|&v| grid.up(v)).collect(),
            held,
        }
    }
}

/// The bounds of the box that each image point alone would have, grown by `boxlen` (NDC).
pub(in super::super) fn grown(screen: &Screen, size: Size, boxlen: f64, out: &mut Vec<Bounds>) {
    bounds(&Grid::new(size), screen, boxlen * MULTIPLIER, out);
}

/// The bounds of the half-open box of each point, grown by `margin`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn bounds(grid: &Grid, screen: &Screen, margin: f64, out: &mut Vec<Bounds>) {
    out.resize(screen.u.len(), [0; 4]);
    let chunks = screen.u.chunks(LANES).zip(screen.v.chunks(LANES));
    for ((u, v), out) in chunks.zip(out.chunks_mut(LANES)) {
        let (mut pu, mut pv) = ([0.0; LANES], [0.0; LANES]);
        pu[..u.len()].copy_from_slice(u);
        pv[..v.len()].copy_from_slice(v);
        let mut lanes = [[0; LANES]; 4];
        for l in 0..LANES {
            let (x, y) = (grid.across(pu[l]), grid.up(pv[l]));
            lanes[0][l] = grid.first_column(x - margin);
            lanes[1][l] = grid.first_row(y + margin);
            lanes[2][l] = -grid.first_column(x + margin);
            lanes[3][l] = -grid.first_row(y - margin);
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

    /// Multiplied NDC of a place in pixels, x.
    #[inline(always)]
    fn across(&self, u: f64) -> f64 {
        (u * self.part[0] - 1.0) * MULTIPLIER
    }

    /// The same, y.
    #[inline(always)]
    fn up(&self, v: f64) -> f64 {
        (v * self.part[1] + 1.0) * MULTIPLIER
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
