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
pub(super) use self::points::grown;
use super::faces::{Block, Source};
use super::items::Items;
use super::kernel::{self, Held, Measured, Pixels};
use super::real::{BIT, LANES, Real};
use super::sums::Sums;
use super::tiles::{Places, SIDE, Tiles};
use super::visits::{Bounds, MOST, Visit};

/// The boxes of faces, and how many a pixel counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boxes<'a> {
    /// Of each image point, by [`grown`].
    pub(super) bounds: &'a [Bounds],
    pub(super) knum: usize,
}

/// The pixels of its tiles that a visit holds, a bit each.
struct Cells {
    /// For each tile `8 row + column` and visit.
    held: [[u32; LANES]; MOST * MOST],
}

impl Cells {
    const fn new() -> Self {
        Self { held: [[0; LANES]; MOST * MOST] }
    }

    /// Those of the boxes.
    #[inline(always)]
    fn set(&mut self, source: &Source<'_>, bounds: &[Bounds], visits: &[Visit]) {
        let mut boxes = [[0; 4]; LANES];
        for (bounds_of, visit) in boxes.iter_mut().zip(visits) {
            let [a, b, c] = source.faces[visit.face as usize].map(|k| bounds[k as usize]);
            for k in 0..4 {
                bounds_of[k] = a[k].min(b[k]).min(c[k]);
            }
        }
        let [x, y] = source.rectangle.first.map(|tile| tile as i32);
        let mut sides = [[0; LANES]; 4];
        let mut used = 0;
        for (lane, visit) in visits.iter().take(LANES).enumerate() {
            let [left, top, right, bottom] = boxes[lane];
            let column = SIDE as i32 * (x + i32::from(visit.column));
            let row = SIDE as i32 * (y + i32::from(visit.row));
            sides[0][lane] = left - column;
            sides[1][lane] = -right - column;
            sides[2][lane] = top - row;
            sides[3][lane] = -bottom - row;
            used |= visit.used;
        }
        let [left, right, top, bottom] = sides;
        let used = used.to_le_bytes();
        let columns = used.iter().fold(0, |columns, row| columns | row);
        let columns = (8 - columns.leading_zeros()) as usize;
        let mut in_columns = [[0; LANES]; MOST];
        for (tile, pixels) in in_columns[..columns].iter_mut().enumerate() {
            let first = (SIDE * tile) as i32;
            for l in 0..LANES {
                let (from, to) = within(left[l] - first, right[l] - first);
                let four = (0xF << from) & (0xF >> (4 - to));
                let eight = four | four << 4;
                pixels[l] = eight | eight << 8;
            }
        }
        for (row, held) in self.held.chunks_exact_mut(MOST).enumerate() {
            if used[row] == 0 {
                continue;
            }
            let first = (SIDE * row) as i32;
            let mut in_row = [0; LANES];
            for l in 0..LANES {
                let (from, to) = within(top[l] - first, bottom[l] - first);
                in_row[l] = (0xFFFF << (4 * from)) & (0xFFFF >> (16 - 4 * to));
            }
            for (held, in_column) in held.iter_mut().zip(&in_columns[..columns]) {
                for l in 0..LANES {
                    held[l] = in_row[l] & in_column[l];
                }
            }
        }
    }

    /// Leave those that have met less than `most` faces before, tile after tile.
    #[inline(always)]
    fn count(&mut self, items: &Items, met: &mut [[i32; LANES]], most: i32) {
        for (lane, tile) in items.all.iter() {
            let held = &mut self.held[tile % (MOST * MOST)][lane % LANES];
            let met = &mut met[items.place(lane, tile)];
            let mut left = [0; LANES];
            for l in 0..LANES {
                let counts = (*held & BIT[l] != 0) & (met[l] < most);
                met[l] += i32::from(counts);
                left[l] = if counts { BIT[l] } else { 0 };
            }
            *held = left.iter().fold(0, |bits, bit| bits | bit);
        }
    }

    #[inline(always)]
    fn of(&self, lane: usize, tile: usize) -> u32 {
        self.held[tile % (MOST * MOST)][lane % LANES]
    }
}

/// As pixels of a tile, none of them where the end is before the beginning.
#[inline(always)]
fn within(from: i32, to: i32) -> (u32, u32) {
    let clamp = |n: i32| n.max(0).min(SIDE as i32) as u32;
    (clamp(from), clamp(to))
}

/// Pixels of a tile that have met less than `most` faces so far; asked for, they have met one more.
struct Counted<'a> {
    pixels: u32,
    met: &'a mut [i32; LANES],
    most: i32,
}

impl Pixels for Counted<'_> {
    #[inline(always)]
    fn choose<R: Real>(&mut self, lane: usize, counts: R, else_: R) -> R {
        let has = (self.pixels & BIT[lane] != 0) & (self.met[lane] < self.most);
        self.met[lane] += i32::from(has);
        if has { counts } else { else_ }
    }
}

/// As [`kernel::draw`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn draw<R: Real>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => draw_all::<R, true>(source, boxes, tiles, visits),
        _ => draw_all::<R, { crate::FUSED }>(source, boxes, tiles, visits),
    }
}

/// As [`kernel::back`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn back<R: Real>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
    factor: f64,
    out: [&mut [f64]; 2],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => back_all::<R, true>(source, boxes, tiles, visits, factor, out),
        _ => back_all::<R, { crate::FUSED }>(source, boxes, tiles, visits, factor, out),
    }
}

#[inline(always)]
fn draw_all<R: Real, const FMA: bool>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
) {
    let (mut block, mut items, mut cells) = (Block::new(), Items::new(), Cells::new());
    let (places, stride) = (Places::new(&source.units), tiles.rectangle.count[0]);
    let most = i32::try_from(boxes.knum).unwrap_or(i32::MAX);
    tiles.meet_nobody();
    let Tiles { values, met, .. } = tiles;
    for visits in visits.chunks(LANES) {
        block.load(source, visits);
        cells.set(source, boxes.bounds, visits);
        items.find_all(visits, stride);
        for (lane, tile) in items.all.iter() {
            let (at, pixels) = (items.place(lane, tile), cells.of(lane, tile));
            let (values, met) = (&mut values[at], &mut met[at]);
            let pixels = Counted { pixels, met, most };
            kernel::draw_tile::<R, FMA, false>(&block, lane, places.of(tile), values, pixels);
        }
    }
}

#[inline(always)]
fn back_all<R: Real, const FMA: bool>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
    factor: f64,
    [du, dv]: [&mut [f64]; 2],
) {
    let (mut block, mut items, mut cells) = (Block::new(), Items::new(), Cells::new());
    let mut sums = Sums::new();
    let (places, stride) = (Places::new(&source.units), tiles.rectangle.count[0]);
    let most = i32::try_from(boxes.knum).unwrap_or(i32::MAX);
    let counted = boxes.knum < source.faces.len();
    tiles.meet_nobody();
    let Tiles { values, met, .. } = tiles;
    for visits in visits.chunks(LANES) {
        block.load_near(source, visits, true);
        cells.set(source, boxes.bounds, visits);
        if counted {
            items.find_all(visits, stride);
            cells.count(&items, met, most);
        }
        items.find(visits, stride, &block, |_| u64::MAX);
        sums.clear();
        for (record, tile) in items.one.iter() {
            let values = &values[items.place(record, tile)];
            let from = Measured::new::<FMA>(&block, record, places.of(tile));
            let pixels = Held(cells.of(record, tile));
            kernel::back_one::<R, FMA, false>(&from, values, sums.of(record), pixels);
        }
        for (lane, tile) in items.all.iter() {
            let values = &values[items.place(lane, tile)];
            let pixels = Held(cells.of(lane, tile));
            let (place, sums) = (places.of(tile), &mut sums);
            kernel::back_tile::<R, FMA, false>(&block, lane, place, values, sums, pixels);
        }
        sums.scatter(source, &block, visits, factor, du, dv);
    }
}
