//! DIB-R's mask as Kaolin 0.1 computes it (`kaolin.graphics.dib_renderer`).
//!
//! - A pixel is 1 if a face whose normal has `n_z >= 0` in Kaolin's camera frame (y up, looking
//!   down -z) holds its centre, half-open at the bounding box.
//! - Any other multiplies, in the order of their index, the first `knum` faces, of either winding,
//!   whose bounding box grown by `boxlen` holds its centre.
//!
//! Which pixels are in the box of a face is decided in `f64` by the expressions of the original, so
//! that the same faces are counted; coordinates are multiplied by 1000 as `DIBRenderer` does. So is
//! which pixels are in a face where a centre may be on an edge that bounds the faces with `n_z >= 0`;
//! elsewhere they are those of any point-sampled mask (see `cover`).
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
use super::real::{BIT, LANES, Lanes, Real};
use super::sums::Sums;
use super::tiles::{Places, SIDE, Tiles};
use super::visits::{Bounds, MOST, Visit, of_face};

/// The boxes of faces, and how many a pixel counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boxes<'a> {
    /// Of each image point, by [`grown`].
    pub(super) bounds: &'a [Bounds],
    pub(super) knum: usize,
}

/// The pixels that the boxes of visits hold: a bit for each column and row from the first tile on.
struct Cells {
    columns: [u32; LANES],
    rows: [u32; LANES],
}

/// The first pixel of each row of a tile, for rows as the bits of an index.
const ROWS: [u16; 1 << SIDE] = {
    let mut rows = [0; 1 << SIDE];
    let mut n = 0;
    while n < rows.len() {
        rows[n] = (n & 1 | (n & 2) << 3 | (n & 4) << 6 | (n & 8) << 9) as u16;
        n += 1;
    }
    rows
};

impl Cells {
    const fn new() -> Self {
        Self { columns: [0; LANES], rows: [0; LANES] }
    }

    #[inline(always)]
    fn set(&mut self, source: &Source<'_>, bounds: &[Bounds], visits: &[Visit]) {
        let mut boxes = [[0; 4]; LANES];
        for (out, visit) in boxes.iter_mut().zip(visits) {
            of_face(bounds, source.faces[visit.face as usize], out);
        }
        let [x, y] = source.rectangle.first.map(|tile| tile as i32);
        let mut sides = [[0; LANES]; 4];
        for (lane, (bounds, visit)) in boxes.iter().zip(visits).enumerate() {
            let column = SIDE as i32 * (x + i32::from(visit.column));
            let row = SIDE as i32 * (y + i32::from(visit.row));
            sides[0][lane] = bounds[0] - column;
            sides[1][lane] = -bounds[2] - column;
            sides[2][lane] = bounds[1] - row;
            sides[3][lane] = -bounds[3] - row;
        }
        let [left, right, top, bottom] = sides;
        for l in 0..LANES {
            self.columns[l] = below(right[l]) & !below(left[l]);
            self.rows[l] = below(bottom[l]) & !below(top[l]);
        }
    }

    /// Those of a tile, a bit each.
    #[inline(always)]
    fn of(&self, lane: usize, tile: usize) -> u32 {
        let four = |bits: u32, tile: usize| (bits >> (SIDE * (tile % MOST))) & 0xF;
        let columns = four(self.columns[lane % LANES], tile);
        columns * u32::from(ROWS[four(self.rows[lane % LANES], tile / MOST) as usize])
    }
}

/// The first so many bits.
#[inline(always)]
fn below(bits: i32) -> u32 {
    !u32::MAX.unbounded_shl(bits.max(0) as u32)
}

/// Those of them that count, of all tiles of the visits.
struct Counting {
    pixels: [[u16; MOST * MOST]; LANES],
}

impl Counting {
    const fn new() -> Self {
        Self { pixels: [[0; MOST * MOST]; LANES] }
    }

    /// Leave out those that have met `most` faces before, one visit after another.
    #[inline(always)]
    fn set(&mut self, cells: &Cells, items: &Items, met: &mut [[i32; LANES]], most: i32) {
        for (lane, tile) in items.all.iter() {
            let held = cells.of(lane, tile);
            let met = &mut met[items.place(lane, tile)];
            let mut bits = [0; LANES];
            for l in 0..LANES {
                let counts = (held & BIT[l] != 0) & (met[l] < most);
                met[l] += i32::from(counts);
                bits[l] = if counts { BIT[l] } else { 0 };
            }
            self.pixels[lane % LANES][tile % (MOST * MOST)] =
                bits.iter().fold(0, |bits, bit| bits | bit) as u16;
        }
    }

    #[inline(always)]
    fn of(&self, lane: usize, tile: usize) -> u32 {
        u32::from(self.pixels[lane % LANES][tile % (MOST * MOST)])
    }
}

/// Pixels of a tile that have met less than `most` faces so far; asked for, they have met one more.
struct Counted<'a> {
    pixels: u32,
    met: &'a mut [i32; LANES],
    most: i32,
}

impl Pixels for Counted<'_> {
    #[inline(always)]
    fn keep<R: Real>(&mut self, lane: usize, number: R) -> R {
        let has = (self.pixels & BIT[lane] != 0) & (self.met[lane] < self.most);
        self.met[lane] += i32::from(has);
        if has { number } else { R::ZERO }
    }
}

/// As [`kernel::draw`]; the faces that a pixel meets are `COUNTED` where they may be too many.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn draw<R: Real, const COUNTED: bool>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => draw_all::<R, true, COUNTED>(source, boxes, tiles, visits),
        _ => draw_all::<R, { crate::FUSED }, COUNTED>(source, boxes, tiles, visits),
    }
}

/// As [`kernel::back`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn back<R: Real, const COUNTED: bool>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
    factor: f64,
    out: [&mut [f64]; 2],
) {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => back_all::<R, true, COUNTED>(source, boxes, tiles, visits, factor, out),
        _ => back_all::<R, { crate::FUSED }, COUNTED>(source, boxes, tiles, visits, factor, out),
    }
}

#[inline(always)]
fn draw_all<R: Real, const FMA: bool, const COUNTED: bool>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
) {
    let (mut block, mut cells) = (Block::new(), Cells::new());
    let mut items = Items::new(tiles.rectangle.count[0]);
    let places = Places::new(&source.units);
    let most = i32::try_from(boxes.knum).unwrap_or(i32::MAX);
    let Tiles { values, met, .. } = tiles;
    let mut draw = |nearest: &Lanes<R>, at: usize, pixels: u32| {
        let values = &mut values[at];
        if COUNTED {
            let pixels = Counted { pixels, met: &mut met[at], most };
            kernel::draw_one::<R, FMA, false>(nearest, values, pixels);
        } else {
            kernel::draw_one::<R, FMA, false>(nearest, values, Held(pixels));
        }
    };
    for visits in visits.chunks(LANES) {
        block.load(source, visits);
        cells.set(source, boxes.bounds, visits);
        items.find_all(visits);
        let nearest = |lane, tile| kernel::nearest::<R, FMA>(&block, lane, places.of(tile));
        let place = |lane, tile| (items.place(lane, tile), cells.of(lane, tile));
        let mut list = items.all.iter();
        let Some((lane, tile)) = list.next() else { continue };
        let (mut from, mut at) = (nearest(lane, tile), place(lane, tile));
        // The next is measured while this one waits for its exponential.
        for (lane, tile) in list {
            let next = nearest(lane, tile);
            draw(&from, at.0, at.1);
            (from, at) = (next, place(lane, tile));
        }
        draw(&from, at.0, at.1);
    }
}

#[inline(always)]
fn back_all<R: Real, const FMA: bool, const COUNTED: bool>(
    source: &Source<'_>,
    boxes: Boxes<'_>,
    tiles: &mut Tiles<R>,
    visits: &[Visit],
    factor: f64,
    [du, dv]: [&mut [f64]; 2],
) {
    let (mut block, mut cells) = (Block::new(), Cells::new());
    let mut items = Items::new(tiles.rectangle.count[0]);
    let (mut sums, mut counting) = (Sums::new(), Counting::new());
    let places = Places::new(&source.units);
    let most = i32::try_from(boxes.knum).unwrap_or(i32::MAX);
    let Tiles { values, met, .. } = tiles;
    for visits in visits.chunks(LANES) {
        block.load_near(source, visits, true);
        cells.set(source, boxes.bounds, visits);
        if COUNTED {
            items.find_all(visits);
            counting.set(&cells, &items, met, most);
        }
        items.find(visits, &block, |_| u64::MAX);
        let held =
            |lane, tile| Held(if COUNTED { counting.of(lane, tile) } else { cells.of(lane, tile) });
        sums.clear();
        for (record, tile) in items.one.iter() {
            let values = &values[items.place(record, tile)];
            let from = Measured::new::<FMA>(&block, record, places.of(tile));
            let pixels = held(record, tile);
            kernel::back_one::<R, FMA, false>(&from, values, sums.of(record), pixels);
        }
        for (lane, tile) in items.all.iter() {
            let values = &values[items.place(lane, tile)];
            let (place, sums, pixels) = (places.of(tile), &mut sums, held(lane, tile));
            kernel::back_tile::<R, FMA, false>(&block, lane, place, values, sums, pixels);
        }
        sums.scatter(source, &block, visits, factor, du, dv);
    }
}
