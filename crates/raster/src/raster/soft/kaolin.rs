//! DIB-R's mask as Kaolin 0.1 computes it (`kaolin.graphics.dib_renderer`).
//!
//! - A pixel is 1 if a face whose normal has `n_z >= 0` in Kaolin's camera frame (y up, looking
//!   down -z) holds its centre, half-open at the bounding box.
//! - Any other multiplies, in the order of their index, the first `knum` faces, of either winding,
//!   whose bounding box grown by `boxlen` holds its centre.
//!
//! Which pixels are in a face or its box is decided in `f64` by the expressions of the original, so
//! that the same faces are counted; coordinates are multiplied by 1000 as `DIBRenderer` does.
//! Distances are those of the exact mask. The gradient treats boxes, counts and the pixels inside
//! as constant, as the original's does.

use std::ops::Range;

use multiversion::multiversion;

use super::faces::{Block, Source};
use super::kernel::{self, BlockSums, FUSED};
use super::real::{LANES, Real};
use super::tiles::{Run, SIDE, Tiles};
use crate::raster::{KaolinCutoff, Model, Screen, Size};

/// What `DIBRenderer` multiplies coordinates by.
const MULTIPLIER: f64 = 1000.0;
/// Added to denominators, in multiplied units.
const EPSILON: f64 = 1e-15;
/// Faces at this depth (metres, down -z) or beyond are not drawn.
const DEEPEST: f64 = -1000.0;

/// Add the pixels inside of faces to `runs`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn cover(model: &Model, screen: &Screen, size: Size, runs: &mut Vec<Run>) {
    let grid = Grid::new(size, 0.0);
    for face in screen.faces(model) {
        if !is_front(screen, face) {
            continue;
        }
        let corners = grid.corners(&screen.u, &screen.v, *face);
        let depth = face.map(|k| -screen.z[k as usize]);
        let [columns, rows] = grid.pixels(&corners);
        for row in rows {
            let y = grid.y(row);
            for column in columns.clone() {
                if holds(&corners, &depth, [grid.x(column), y]) {
                    let [row, from, to] = [row, column, column + 1].map(|n| n as u32);
                    runs.push(Run { row, from, to });
                }
            }
        }
    }
}

/// Whether `n_z >= 0` in Kaolin's camera frame.
#[inline(always)]
fn is_front(screen: &Screen, face: &[u32; 3]) -> bool {
    let [a, b, c] = face.map(|k| (screen.x[k as usize], -screen.y[k as usize]));
    (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0) >= 0.0
}

/// Whether a face holds a pixel, at a depth that is drawn.
#[inline(always)]
fn holds(corners: &[[f64; 2]; 3], depth: &[f64; 3], [x, y]: [f64; 2]) -> bool {
    let [[ax, ay], [bx, by], [cx, cy]] = *corners;
    let (m, p, n, q) = (bx - ax, by - ay, cx - ax, cy - ay);
    let k = m * q - n * p + EPSILON;
    let w1 = ((x - ax) * q - n * (y - ay)) / k;
    let w2 = (m * (y - ay) - (x - ax) * p) / k;
    let w0 = 1.0 - w1 - w2;
    let z = w0 * depth[0] + w1 * depth[1] + w2 * depth[2];
    !(w0 < 0.0 || w1 < 0.0 || w2 < 0.0) && z > DEEPEST
}

/// Pixel centres in multiplied NDC, x to the right, y up, and how much boxes are grown.
#[derive(Debug, Clone, Copy)]
struct Grid {
    size: Size,
    /// Half a pixel.
    half: [f64; 2],
    /// A pixel, as a part of half the image.
    part: [f64; 2],
    margin: f64,
}

impl Grid {
    fn new(size: Size, margin: f64) -> Self {
        let [width, height] = [size.width, size.height].map(|side| side as f64);
        let (half, part) =
            ([MULTIPLIER / width, MULTIPLIER / height], [2.0 / width, -2.0 / height]);
        Self { size, half, part, margin }
    }

    #[inline(always)]
    fn corners(&self, u: &[f64], v: &[f64], face: [u32; 3]) -> [[f64; 2]; 3] {
        face.map(|k| {
            let (u, v) = (u[k as usize], v[k as usize]);
            [(u * self.part[0] - 1.0) * MULTIPLIER, (v * self.part[1] + 1.0) * MULTIPLIER]
        })
    }

    #[inline(always)]
    fn x(&self, column: usize) -> f64 {
        self.half[0] * (2.0 * column as f64 + 1.0 - self.size.width as f64)
    }

    #[inline(always)]
    fn y(&self, row: usize) -> f64 {
        self.half[1] * (self.size.height as f64 - 2.0 * row as f64 - 1.0)
    }

    /// Columns and rows of the centres in the half-open bounding box, grown.
    #[inline(always)]
    fn pixels(&self, corners: &[[f64; 2]; 3]) -> [Range<usize>; 2] {
        let range = |axis: usize| {
            let [a, b, c] = corners.map(|p| p[axis]);
            let (low, high) = (a.least(b).least(c), a.most(b).most(c));
            (low - self.margin, high + self.margin)
        };
        let ((left, right), (low, high)) = (range(0), range(1));
        let Size { height, width } = self.size;
        // About the first pixel from a place on; the comparisons decide.
        let near = |ndc: f64, side: usize| {
            let side = side as f64;
            let pixel = (ndc * (0.5 / MULTIPLIER) + 0.5) * side + 0.5;
            let pixel = if pixel > 0.0 { pixel } else { 0.0 };
            (if pixel < side { pixel } else { side }) as usize
        };
        let column = |limit: f64| first(near(limit, width), width, |k| self.x(k) >= limit);
        let row = |limit: f64| first(near(-limit, height), height, |k| self.y(k) < limit);
        // Of rows that go down: from the first below `high` to the one before the first below `low`.
        [column(left)..column(right), row(high)..row(low)]
    }
}

/// The first of `0..n` from which on `is` holds, near `guess`.
#[inline(always)]
fn first(guess: usize, n: usize, is: impl Fn(usize) -> bool) -> usize {
    let mut k = guess.min(n);
    while k > 0 && is(k - 1) {
        k -= 1;
    }
    while k < n && !is(k) {
        k += 1;
    }
    k
}

/// The column and the row of each pixel of a tile.
const COLUMN: [i32; LANES] = [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3];
const ROW: [i32; LANES] = [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3];

/// The pixels of a tile that are in a box and have met less than `most` faces so far; they have met
/// one more.
#[inline(always)]
fn meet(tile: &Met, met: &mut [i32; LANES], most: i32) -> [bool; LANES] {
    let Met { across: [left, right], down: [top, bottom], .. } = *tile;
    let mut here = [false; LANES];
    for l in 0..LANES {
        let across = (COLUMN[l] >= left) & (COLUMN[l] < right);
        let down = (ROW[l] >= top) & (ROW[l] < bottom);
        here[l] = across & down & (met[l] < most);
        met[l] += i32::from(here[l]);
    }
    here
}

/// A tile that a box meets: with its column and row, its place, and where the box begins and ends,
/// in pixels from the first of the tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Met {
    column: usize,
    row: usize,
    at: usize,
    across: [i32; 2],
    down: [i32; 2],
}

/// Faces in order, and what is counted of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boxes<'a, 'b> {
    source: &'a Source<'b>,
    grid: Grid,
    most: i32,
}

impl<'a, 'b> Boxes<'a, 'b> {
    pub(super) fn new(source: &'a Source<'b>, size: Size, cutoff: KaolinCutoff) -> Self {
        let most = i32::try_from(cutoff.knum).unwrap_or(i32::MAX);
        Self { source, grid: Grid::new(size, cutoff.boxlen * MULTIPLIER), most }
    }

    /// List the tiles in use that the box of a face meets.
    #[inline(always)]
    fn list<R: Real>(&self, face: [u32; 3], tiles: &Tiles<R>, list: &mut Vec<Met>) {
        list.clear();
        let corners = self.grid.corners(self.source.u, self.source.v, face);
        let pixels = self.grid.pixels(&corners);
        let (first, count) = (tiles.rectangle.first, tiles.rectangle.count);
        let [columns, rows] = [0, 1].map(|axis| {
            let from = (pixels[axis].start / SIDE).saturating_sub(first[axis]);
            let to = pixels[axis].end.div_ceil(SIDE).saturating_sub(first[axis]);
            from..to.min(count[axis])
        });
        if pixels.iter().any(Range::is_empty) || columns.is_empty() || rows.is_empty() {
            return;
        }
        let from = |axis: usize, tile: usize, pixel: usize| {
            pixel as i32 - (SIDE * (first[axis] + tile)) as i32
        };
        for row in rows.clone().step_by(8) {
            for column in columns.clone().step_by(8) {
                let mut used = tiles.used(column, row, columns.end - column, rows.end - row);
                while used != 0 {
                    let at = used.trailing_zeros() as usize;
                    let (c, r) = (column + at % 8, row + at / 8);
                    let [x, y] = &pixels;
                    let across = [from(0, c, x.start), from(0, c, x.end)];
                    let down = [from(1, r, y.start), from(1, r, y.end)];
                    list.push(Met { column: c, row: r, at: r * count[0] + c, across, down });
                    used &= used - 1;
                }
            }
        }
    }
}

/// As [`kernel::draw`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn draw<R: Real>(boxes: Boxes<'_, '_>, tiles: &mut Tiles<R>) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => draw_all::<R, true>(boxes, tiles),
        _ => draw_all::<R, FUSED>(boxes, tiles),
    }
}

/// As [`kernel::back`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn back<R: Real>(
    boxes: Boxes<'_, '_>,
    tiles: &mut Tiles<R>,
    factor: f64,
    du: &mut [f64],
    dv: &mut [f64],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => back_all::<R, true>(boxes, tiles, factor, [du, dv]),
        _ => back_all::<R, FUSED>(boxes, tiles, factor, [du, dv]),
    }
}

#[inline(always)]
fn draw_all<R: Real, const FMA: bool>(boxes: Boxes<'_, '_>, tiles: &mut Tiles<R>) {
    let source = boxes.source;
    let (mut block, mut list) = (Block::new(), std::mem::take(&mut tiles.list));
    tiles.meet_nobody();
    let mut first = 0;
    while first < source.faces.len() {
        let count = block.load(source, first, false);
        for lane in 0..count {
            boxes.list(source.faces[first + lane], tiles, &mut list);
            for tile in &list {
                let here = meet(tile, &mut tiles.met[tile.at], boxes.most);
                let values = &mut tiles.values[tile.at];
                let mut after = *values;
                let place = [&tiles.x[tile.column], &tiles.y[tile.row]];
                kernel::draw_tile::<R, FMA, false>(&block, lane, place, &mut after);
                for l in 0..LANES {
                    values[l] = if here[l] { after[l] } else { values[l] };
                }
            }
        }
        first += LANES;
    }
    tiles.list = list;
}

#[inline(always)]
fn back_all<R: Real, const FMA: bool>(
    boxes: Boxes<'_, '_>,
    tiles: &mut Tiles<R>,
    factor: f64,
    [du, dv]: [&mut [f64]; 2],
) {
    let source = boxes.source;
    let (mut block, mut list) = (Block::new(), std::mem::take(&mut tiles.list));
    let mut block_sums = BlockSums::new();
    tiles.meet_nobody();
    let mut first = 0;
    while first < source.faces.len() {
        let count = block.load(source, first, false);
        for lane in 0..count {
            let mut sums = [[[R::ZERO; LANES]; 4]; 3];
            boxes.list(source.faces[first + lane], tiles, &mut list);
            for tile in &list {
                let here = meet(tile, &mut tiles.met[tile.at], boxes.most);
                let mut values = tiles.values[tile.at];
                for l in 0..LANES {
                    values[l] = if here[l] { values[l] } else { R::ZERO };
                }
                let place = [&tiles.x[tile.column], &tiles.y[tile.row]];
                kernel::back_tile::<R, FMA, false>(&block, lane, place, &values, &mut sums);
            }
            block_sums.set(lane, !list.is_empty(), &sums);
        }
        kernel::scatter(source, &block, [first, count], &block_sums, factor, du, dv);
        first += LANES;
    }
    tiles.list = list;
}
