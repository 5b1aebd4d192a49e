//! Which pixels of a row are covered, which are not, and which an outline can run through.
//!
//! The number of layers at the upper left corner of a pixel counts the edges that cross the upper
//! side of the row to its left. A pixel that no edge enters is covered or not. One that has edges
//! in it is covered if a corner has more layers than they can take away; only the others are
//! solved. Nothing is carried from one pixel to the next but whole numbers, so no rounding error
//! can spread.

use super::super::Pixel;
use super::lanes::Place;
use super::waiting::{Lists, Waiting, list_of};

/// Columns that are looked at together.
const CHUNK: usize = 16;

/// Where column 0 is in the arrays: the one before it, which stands for all that is on the left of
/// the canvas, has a place too.
const SHIFT: i32 = CHUNK as i32;

/// A row of columns.
#[derive(Debug, Default)]
pub(super) struct Columns {
    width: usize,
    /// Change of layers at the lower left corner, from the column before.
    change: Vec<i32>,
    /// How many pieces enter.
    count: Vec<u32>,
    /// How many layers the pieces can take away, seen from the upper left, upper right, lower left
    /// and lower right corner: 16 bits each.
    ///
    /// On the way from a corner to a point inside, first along the side and then across, a piece
    /// is crossed once or not at all, or once on the side and back again: it changes the number of
    /// layers by its step or by nothing. In which direction depends on whether it leaves through
    /// the side that the way begins on.
    taken: Vec<u64>,
    /// Layers at the upper left corners, and at the lower left ones.
    upper: Vec<i32>,
    lower: Vec<i32>,
    /// Where the next piece of a column goes.
    place: Vec<u32>,
    /// Whether anything is in a chunk.
    touched: Vec<bool>,
}

/// How a part crosses a column: it begins and ends there;
pub(super) const STAYS: usize = 0;
/// to the right: its first column, one between, the last one;
pub(super) const RIGHT_FIRST: usize = 1;
pub(super) const RIGHT_ON: usize = 2;
pub(super) const RIGHT_LAST: usize = 3;
/// to the left;
pub(super) const LEFT_FIRST: usize = 4;
pub(super) const LEFT_ON: usize = 5;
pub(super) const LEFT_LAST: usize = 6;
/// or it does not.
pub(super) const NOT_AT_ALL: usize = 7;

/// For each way, first with a positive step and then with a negative one: which corners see the
/// layers fall.
const FALLS: [[u64; 2]; 8] = {
    let mut table = [[0; 2]; 8];
    // Bits of the corners to which a step to the right is a fall; to the others one to the left
    // is.
    let ways = [
        (STAYS, 0b1010),
        (RIGHT_FIRST, 0b0010),
        (RIGHT_ON, 0b0011),
        (RIGHT_LAST, 0b1011),
        (LEFT_FIRST, 0b1110),
        (LEFT_ON, 0b1100),
        (LEFT_LAST, 0b1000),
    ];
    let mut k = 0;
    while k < ways.len() {
        let (way, falls) = ways[k];
        let mut corner = 0;
        while corner < 4 {
            let positive = (falls >> corner) & 1;
            table[way][0] |= positive << (16 * corner);
            table[way][1] |= (1 - positive) << (16 * corner);
            corner += 1;
        }
        k += 1;
    }
    table
};

/// Rows whose edges have more steps than this are not told apart by what they take away.
pub(super) const MOST_STEPS: u32 = u16::MAX as u32;

impl Columns {
    pub(super) fn begin(&mut self, columns: usize) {
        let chunks = (columns + 2).div_ceil(CHUNK) + 1;
        let all = CHUNK * (chunks + 1);
        self.width = columns;
        clear(&mut self.change, all, 0);
        clear(&mut self.count, all, 0);
        clear(&mut self.taken, all, 0);
        clear(&mut self.upper, all, 0);
        clear(&mut self.lower, all, 0);
        clear(&mut self.place, all, 0);
        clear(&mut self.touched, chunks, false);
    }

    #[inline(always)]
    fn at(column: i32) -> usize {
        (column + SHIFT) as usize
    }

    /// An edge that goes on below the row, in this column.
    #[inline(always)]
    pub(super) fn cross(&mut self, column: i32, step: i32) {
        let at = Self::at(column + 1);
        self.change[at] += step;
        self.touched[at / CHUNK] = true;
    }

    /// A piece that enters a column.
    #[inline(always)]
    pub(super) fn enter(&mut self, column: i32, step: i32, way: usize) {
        let at = Self::at(column);
        self.count[at] += u32::from(way != NOT_AT_ALL);
        let falls = FALLS[way % 8][usize::from(step < 0)];
        self.taken[at] = self.taken[at].wrapping_add(falls * u64::from(step.unsigned_abs()));
        self.touched[at / CHUNK] = true;
    }

    /// The layers at the upper side of the first row: what has been crossed so far.
    pub(super) fn start(&mut self) {
        let mut layers = 0;
        for (change, lower) in self.change.iter_mut().zip(&mut self.lower) {
            layers += std::mem::take(change);
            *lower = layers;
        }
        self.touched.fill(false);
    }

    /// The row is complete: write what is covered and what is not, list what is left to do, and
    /// begin the next row. The place behind those of the pieces, from `free` on, and whether
    /// anything is left. `start` is the place of column 0, `out` the row, or empty.
    #[inline(always)]
    pub(super) fn scan<T: Pixel>(
        &mut self,
        free: u32,
        told_apart: bool,
        start: Place,
        out: &mut [T],
        lists: &mut Lists,
    ) -> (u32, bool) {
        std::mem::swap(&mut self.upper, &mut self.lower);
        let end = self.add_up(free);
        let (mut chunk, mut left) = (0, false);
        while chunk < self.touched.len() {
            // The columns of the chunks on the canvas.
            let first = self.column_of(chunk);
            if std::mem::take(&mut self.touched[chunk]) {
                let next = self.column_of(chunk + 1);
                let line = if out.is_empty() { &mut [][..] } else { &mut out[first..next] };
                left |= self.scan_chunk(chunk, told_apart, (start, first, next), line, lists);
                chunk += 1;
                continue;
            }
            let covered = self.upper[chunk * CHUNK] > 0;
            chunk = self.next_touched(chunk);
            if !out.is_empty() {
                let value = if covered { T::from_f64(1.0) } else { T::default() };
                out[first..self.column_of(chunk)].fill(value);
            }
        }
        (end, left)
    }

    /// The first column of a chunk on the canvas; its width, of those that are right of it.
    #[inline(always)]
    fn column_of(&self, chunk: usize) -> usize {
        (chunk * CHUNK).saturating_sub(CHUNK).min(self.width)
    }

    /// The first chunk from one on in which anything is, or their number.
    #[inline(always)]
    fn next_touched(&self, chunk: usize) -> usize {
        let mut next = chunk;
        while next < self.touched.len() && !self.touched[next] {
            next += 1;
        }
        next
    }

    /// Add up layers and places. A loop of its own: what it writes one by one is on its way to
    /// memory until it is read as a register.
    #[inline(always)]
    fn add_up(&mut self, free: u32) -> u32 {
        let (mut layers, mut free) = (0, free);
        let mut chunk = 0;
        while chunk < self.touched.len() {
            let base = chunk * CHUNK;
            if !self.touched[chunk] {
                chunk = self.next_touched(chunk);
                self.lower[base..chunk * CHUNK].fill(layers);
                continue;
            }
            chunk += 1;
            let (Some(change), Some(count), Some(lower), Some(place)) = (
                self.change[base..].first_chunk::<CHUNK>(),
                self.count[base..].first_chunk::<CHUNK>(),
                self.lower[base..].first_chunk_mut::<CHUNK>(),
                self.place[base..].first_chunk_mut::<CHUNK>(),
            ) else {
                break;
            };
            for l in 0..CHUNK {
                layers += change[l];
                lower[l] = layers;
                place[l] = free;
                free += count[l];
            }
        }
        free
    }

    #[inline(always)]
    fn scan_chunk<T: Pixel>(
        &mut self,
        chunk: usize,
        told_apart: bool,
        (start, first, next): (Place, usize, usize),
        line: &mut [T],
        lists: &mut Lists,
    ) -> bool {
        let base = chunk * CHUNK;
        let (Some(change), Some(count), Some(taken), Some(upper), Some(lower), Some(places)) = (
            self.change[base..].first_chunk::<{ CHUNK + 1 }>(),
            self.count[base..].first_chunk::<CHUNK>(),
            self.taken[base..].first_chunk::<CHUNK>(),
            self.upper[base..].first_chunk::<{ CHUNK + 1 }>(),
            self.lower[base..].first_chunk::<CHUNK>(),
            self.place[base..].first_chunk::<CHUNK>(),
        ) else {
            return false;
        };
        let mut least = [0_i32; CHUNK];
        for l in 0..CHUNK {
            let of = |corner: u32| ((taken[l] >> (16 * corner)) & 0xFFFF) as i32;
            let a = upper[l].wrapping_sub(of(0));
            let b = upper[l + 1].wrapping_sub(of(1));
            let c = lower[l].wrapping_sub(of(2));
            // The column after may not be added up: its change is.
            let d = lower[l].wrapping_add(change[l + 1]).wrapping_sub(of(3));
            let (a, c) = (if a > b { a } else { b }, if c > d { c } else { d });
            let most = if a > c { a } else { c };
            let most = if told_apart { most } else { 0 };
            least[l] = if count[l] == 0 { upper[l] } else { most };
        }
        if let Some(line) = line.first_chunk_mut::<CHUNK>() {
            for l in 0..CHUNK {
                line[l] = if least[l] > 0 { T::from_f64(1.0) } else { T::default() };
            }
        } else {
            for (pixel, least) in line.iter_mut().zip(least) {
                *pixel = if least > 0 { T::from_f64(1.0) } else { T::default() };
            }
        }
        let mut bits = 0_u32;
        for l in 0..CHUNK {
            bits |= u32::from((count[l] > 0) & (least[l] <= 0)) << l;
        }
        bits &= (1 << (next - first)) - 1;
        let left = bits != 0;
        while bits != 0 {
            let l = bits.trailing_zeros() as usize % CHUNK;
            bits &= bits - 1;
            let place = start.right((first + l) as u32, upper[l]);
            let waiting = Waiting { place, first: places[l], count: count[l] };
            list_of(lists, count[l]).push(waiting);
        }
        self.change[base..base + CHUNK].fill(0);
        self.count[base..base + CHUNK].fill(0);
        self.taken[base..base + CHUNK].fill(0);
        left
    }

    /// A place for the next piece of a column.
    #[inline(always)]
    pub(super) fn place(&mut self, column: i32, taken: bool) -> u32 {
        let place = &mut self.place[Self::at(column)];
        let at = *place;
        *place += u32::from(taken);
        at
    }
}

fn clear<T: Copy>(list: &mut Vec<T>, length: usize, value: T) {
    list.clear();
    list.resize(length, value);
}
