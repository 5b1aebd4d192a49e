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

mod cover;
mod points;

use multiversion::multiversion;

pub(super) use self::cover::cover;
pub(super) use self::points::Points;
use self::points::of_face;
use super::faces::{Block, Source};
use super::kernel::{self, Measured, Pixels};
use super::real::{LANES, Real};
use super::sums::Sums;
use super::tiles::{Rectangle, SIDE, Tiles};
use crate::raster::KaolinCutoff;

/// Faces in order, and what is counted of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boxes<'a, 'b> {
    source: &'a Source<'b>,
    points: &'a Points,
    most: i32,
}

impl<'a, 'b> Boxes<'a, 'b> {
    pub(super) fn new(source: &'a Source<'b>, points: &'a Points, cutoff: KaolinCutoff) -> Self {
        let most = i32::try_from(cutoff.knum).unwrap_or(i32::MAX);
        Self { source, points, most }
    }

    /// List the tiles in use that the boxes of a block meet, one face after another; how many they
    /// are. What follows them in the list is of no account.
    #[inline(always)]
    fn list<R: Real>(
        &self,
        block: &Block<R>,
        faces: &[[u32; 3]],
        tiles: &Tiles<R>,
        list: &mut Vec<Met>,
    ) -> usize {
        let mut count = 0;
        let Rectangle { first, count: [across, down] } = tiles.rectangle;
        let [x, y] = first.map(|tile| (SIDE * tile) as i32);
        let end = |pixel: i32, count: usize| (pixel.max(0) as usize).div_ceil(SIDE).min(count);
        for (lane, &face) in faces.iter().enumerate() {
            let bounds = of_face(&self.points.grown, face);
            let (left, right) = (bounds[0] - x, -bounds[2] - x);
            let (top, bottom) = (bounds[1] - y, -bounds[3] - y);
            let (columns, rows) = (end(right, across), end(bottom, down));
            let begin = [block.tiles[0][lane], block.tiles[2][lane]];
            if left >= right || top >= bottom {
                continue;
            }
            for row in (top.max(0) as usize / SIDE..rows).step_by(8) {
                for column in (left.max(0) as usize / SIDE..columns).step_by(8) {
                    let mut used = tiles.used(column, row, columns - column, rows - row);
                    let one = block.near.from(lane, &block.tiles, [column, row]);
                    if list.len() < count + 64 {
                        list.resize(2 * (count + 64), Met::default());
                    }
                    let (c, r) = ((SIDE * column) as i32, (SIDE * row) as i32);
                    let in_columns = columns_of(left - c, right - c);
                    let in_rows = rows_of(top - r, bottom - r);
                    while used != 0 {
                        let bit = used.trailing_zeros() as usize;
                        let (c, r) = (column + bit % 8, row + bit / 8);
                        let at = r * across + c;
                        let pixels = in_columns[bit % 8] & in_rows[bit / 8 % 8] & tiles.open[at];
                        let record = LANES as u32 * edge_of(one, bit) + lane as u32;
                        let (place, at) = ([c as i32 - begin[0], r as i32 - begin[1]], at as u32);
                        list[count] = Met { record, place, at, pixels };
                        count += usize::from(pixels != 0);
                        used &= used - 1;
                    }
                }
            }
        }
        count
    }
}

/// The pixels of each of eight tiles next to each other that are in the columns of a box, which may
/// begin and end anywhere.
#[inline(always)]
fn columns_of(from: i32, to: i32) -> [u32; 8] {
    let mut pixels = [0; 8];
    for (tile, pixels) in pixels.iter_mut().enumerate() {
        let first = (SIDE * tile) as i32;
        let (from, to) = ((from - first).clamp(0, 4), (to - first).clamp(0, 4));
        *pixels = ((0xF << from) & (0xF >> (4 - to))) * 0x1111;
    }
    pixels
}

/// The same of tiles below each other and the rows of a box.
#[inline(always)]
fn rows_of(from: i32, to: i32) -> [u32; 8] {
    let mut pixels = [0; 8];
    for (tile, pixels) in pixels.iter_mut().enumerate() {
        let first = (SIDE * tile) as i32;
        let (from, to) = ((from - first).clamp(0, 4), (to - first).clamp(0, 4));
        *pixels = (0xFFFF << (4 * from)) & (0xFFFF >> (16 - 4 * to));
    }
    pixels
}

/// Records from here on are all edges of a face.
const ALL: usize = 3 * LANES;

/// The edge that alone gives the distance to a tile, or 3.
#[inline(always)]
fn edge_of(one: [u64; 3], at: usize) -> u32 {
    let [a, b, c] = one.map(|bits| (bits >> at) as u32 & 1);
    3 - 3 * a - 2 * b - c
}

/// A tile that the box of a face meets.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Met {
    /// `16 k + lane` for the one edge `k` to measure of a face of the block, with 3 for [`ALL`].
    record: u32,
    /// `(column, row)` from the first tile within reach of the face.
    place: [i32; 2],
    /// Among all tiles.
    at: u32,
    /// Those in the box that are not covered, a bit each.
    pixels: u32,
}

/// The bit of each pixel of a tile.
const BIT: [u32; LANES] = {
    let mut bits = [0; LANES];
    let mut l = 0;
    while l < LANES {
        bits[l] = 1 << l;
        l += 1;
    }
    bits
};

/// Pixels of a tile that have met less than `most` faces so far; asked for, they have met one more.
struct Counted<'a> {
    pixels: u32,
    met: &'a mut [i32; LANES],
    most: i32,
}

impl Pixels for Counted<'_> {
    #[inline(always)]
    fn has(&mut self, lane: usize) -> bool {
        let has = (self.pixels & BIT[lane] != 0) & (self.met[lane] < self.most);
        self.met[lane] += i32::from(has);
        has
    }
}

/// As [`kernel::draw`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn draw<R: Real>(boxes: Boxes<'_, '_>, tiles: &mut Tiles<R>) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => draw_all::<R, true>(boxes, tiles),
        _ => draw_all::<R, { crate::FUSED }>(boxes, tiles),
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
        _ => back_all::<R, { crate::FUSED }>(boxes, tiles, factor, [du, dv]),
    }
}

#[inline(always)]
fn draw_all<R: Real, const FMA: bool>(boxes: Boxes<'_, '_>, tiles: &mut Tiles<R>) {
    let faces = boxes.source.faces;
    let (mut block, mut list) = (Block::new(), std::mem::take(&mut tiles.list));
    tiles.meet_nobody();
    let mut first = 0;
    while first < faces.len() {
        let count = block.load(boxes.source, first, true);
        let met = boxes.list(&block, &faces[first..first + count], tiles, &mut list);
        let Tiles { values, met: counts, places, .. } = &mut *tiles;
        for tile in &list[..met] {
            let (record, at) = (tile.record as usize, tile.at as usize);
            let lane = record % LANES;
            let place = places.at(tile.place);
            let (values, met) = (&mut values[at], &mut counts[at]);
            let pixels = Counted { pixels: tile.pixels, met, most: boxes.most };
            if record >= ALL {
                kernel::draw_tile::<R, FMA, false>(&block, lane, place, values, pixels);
            } else {
                let from = Measured::new::<FMA>(&block, record, place);
                kernel::draw_one::<R, FMA, false>(&from, values, pixels);
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
    let faces = boxes.source.faces;
    let (mut block, mut list) = (Block::new(), std::mem::take(&mut tiles.list));
    let mut sums = Sums::new();
    tiles.meet_nobody();
    let mut first = 0;
    while first < faces.len() {
        let count = block.load(boxes.source, first, true);
        let met = boxes.list(&block, &faces[first..first + count], tiles, &mut list);
        let Tiles { values, met: counts, places, .. } = &mut *tiles;
        sums.clear();
        for tile in &list[..met] {
            let (record, at) = (tile.record as usize, tile.at as usize);
            let lane = record % LANES;
            let place = places.at(tile.place);
            let (values, met) = (&values[at], &mut counts[at]);
            let pixels = Counted { pixels: tile.pixels, met, most: boxes.most };
            sums.any[lane] = true;
            if record >= ALL {
                let sums = &mut sums;
                kernel::back_tile::<R, FMA, false>(&block, lane, place, values, sums, pixels);
            } else {
                let from = Measured::new::<FMA>(&block, record, place);
                kernel::back_one::<R, FMA, false>(&from, values, sums.of(record), pixels);
            }
        }
        sums.scatter(boxes.source, &block, [first, count], factor, du, dv);
        first += LANES;
    }
    tiles.list = list;
}
