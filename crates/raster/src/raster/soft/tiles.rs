//! The image as tiles of 4x4 pixels, as far as a shape reaches.

use std::ops::Range;

use super::real::{LANES, Lanes, Real};
use super::visits::MOST;
use crate::raster::{Background, Pixel, Size};

/// Side of a tile in pixels.
pub(super) const SIDE: usize = 4;

/// The last pixel centre of a tile from its first, in tiles.
pub(super) const LAST: f64 = (SIDE - 1) as f64 / SIDE as f64;

/// How pixels become widths: a squared length in widths is the exponent of the profile, as one of
/// 2. The origin is the centre of the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Units {
    /// Widths in a pixel, per axis.
    pub(super) scale: [f64; 2],
    /// Half the image, in pixels.
    pub(super) half: [f64; 2],
    /// How far a face reaches, in widths.
    pub(super) reach: f64,
}

impl Units {
    /// `scale` and `exponent` are those of `exp`.
    pub(super) fn new(size: Size, scale: [f64; 2], exponent: f64) -> Self {
        let half = [0.5 * size.width as f64, 0.5 * size.height as f64];
        let root = std::f64::consts::LOG2_E.sqrt();
        Self { scale: scale.map(|s| s * root), half, reach: exponent.sqrt() * root }
    }

    /// How far a face reaches, in pixels, and one pixel more.
    pub(super) fn reach_in_pixels(&self, axis: usize) -> f64 {
        self.reach / self.scale[axis] + 1.0
    }

    /// The largest coordinate of a point of the image, in widths.
    pub(super) fn extent(&self) -> f64 {
        (self.half[0] * self.scale[0]).max(self.half[1] * self.scale[1])
    }
}

/// A rectangle of tiles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Rectangle {
    /// First tile in the image, `(column, row)`.
    pub(super) first: [usize; 2],
    /// Number of tiles, `(columns, rows)`.
    pub(super) count: [usize; 2],
}

impl Rectangle {
    /// What `low..high` (pixels) covers of the image within reach; `None` where that is nothing.
    pub(super) fn around(size: Size, units: &Units, low: [f64; 2], high: [f64; 2]) -> Option<Self> {
        let sides = [size.width, size.height];
        let (mut first, mut count) = ([0; 2], [0; 2]);
        for axis in 0..2 {
            let reach = units.reach_in_pixels(axis);
            first[axis] = (low[axis] - reach).clamp(0.0, sides[axis] as f64) as usize / SIDE;
            let end = (high[axis] + reach).clamp(0.0, sides[axis] as f64).ceil() as usize;
            count[axis] = end.div_ceil(SIDE).saturating_sub(first[axis]);
        }
        count.iter().all(|&count| count > 0).then_some(Self { first, count })
    }

    pub(super) fn tiles(&self) -> usize {
        self.count[0] * self.count[1]
    }

    /// In pixels, cut at the image: columns, rows.
    pub(super) fn pixels(&self, size: Size) -> [Range<usize>; 2] {
        let range = |axis: usize, side: usize| {
            let first = SIDE * self.first[axis];
            first..(first + SIDE * self.count[axis]).min(side)
        };
        [range(0, size.width), range(1, size.height)]
    }

    /// The band with the number `k` of so many rows of tiles.
    pub(super) fn band(&self, rows: usize, k: usize) -> Self {
        let [column, row] = self.first;
        let [columns, all] = self.count;
        Self { first: [column, row + k * rows], count: [columns, rows.min(all - k * rows)] }
    }
}

/// Covered pixels next to each other in a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    pub(super) row: u32,
    pub(super) from: u32,
    pub(super) to: u32,
}

impl Run {
    pub(super) fn new(row: usize, columns: Range<usize>) -> Self {
        let [row, from, to] = [row, columns.start, columns.end].map(|n| n as u32);
        Self { row, from, to }
    }
}

/// A value for each pixel of a rectangle of tiles, and which of the tiles are in use.
#[derive(Debug)]
pub(super) struct Tiles<R> {
    pub(super) rectangle: Rectangle,
    /// Row by row; pixels within a tile too.
    pub(super) values: Vec<Lanes<R>>,
    /// Faces that the pixels have met, where these are counted.
    pub(super) met: Vec<[i32; LANES]>,
    /// Whether each of the eight tiles from `(c, r)` on to the right is in use, a bit each, at
    /// `c * stride + r`; the column after the last one has none.
    eights: Vec<u8>,
}

impl<R: Real> Default for Tiles<R> {
    fn default() -> Self {
        Self {
            rectangle: Rectangle::default(),
            values: Vec::new(),
            met: Vec::new(),
            eights: Vec::new(),
        }
    }
}

/// Pixel centres of the columns and the rows of a visit's tiles, in widths from the first of them.
#[derive(Debug)]
pub(super) struct Places<R> {
    x: [Lanes<R>; MOST],
    y: [Lanes<R>; MOST],
}

impl<R: Real> Places<R> {
    pub(super) fn new(units: &Units) -> Self {
        let at = |axis: usize, tile: usize, pixel: usize| {
            R::of((SIDE * tile + pixel) as f64 * units.scale[axis])
        };
        let x = |tile: usize| Lanes(std::array::from_fn(|lane| at(0, tile, lane % SIDE)));
        let y = |tile: usize| Lanes(std::array::from_fn(|lane| at(1, tile, lane / SIDE)));
        Self { x: std::array::from_fn(x), y: std::array::from_fn(y) }
    }

    /// Of the tile `8 row + column`.
    #[inline(always)]
    pub(super) fn of(&self, tile: usize) -> [&Lanes<R>; 2] {
        [&self.x[tile % MOST], &self.y[tile / MOST % MOST]]
    }
}

impl<R: Real> Tiles<R> {
    /// Every pixel of the image gets `value`, those of the tiles that lie outside of it get 0.
    pub(super) fn fill(&mut self, size: Size, value: R) {
        self.values.clear();
        self.values.resize(self.rectangle.tiles(), Lanes([value; LANES]));
        self.blank(size);
    }

    /// No pixel has met any face.
    pub(super) fn meet_nobody(&mut self) {
        self.met.clear();
        self.met.resize(self.values.len(), [0; LANES]);
    }

    /// Set the pixels outside of the image to 0.
    fn blank(&mut self, size: Size) {
        let count = self.rectangle.count;
        let [columns, rows] = self.rectangle.pixels(size).map(|range| range.len() % SIDE);
        if columns > 0 {
            for tile in self.values.iter_mut().skip(count[0] - 1).step_by(count[0]) {
                tile.chunks_exact_mut(SIDE).for_each(|line| line[columns..].fill(R::ZERO));
            }
        }
        if rows > 0 {
            for tile in &mut self.values[count[0] * (count[1] - 1)..] {
                tile[SIDE * rows..].fill(R::ZERO);
            }
        }
    }

    /// Set the pixels of runs to 0. They are in the order of their rows.
    pub(super) fn cover(&mut self, runs: &[Run], size: Size) {
        let [columns, rows] = self.rectangle.pixels(size);
        let count = self.rectangle.count[0];
        let first = runs.partition_point(|run| (run.row as usize) < rows.start);
        for run in runs[first..].iter().take_while(|run| (run.row as usize) < rows.end) {
            let row = run.row as usize;
            let (from, to) =
                ((run.from as usize).max(columns.start), (run.to as usize).min(columns.end));
            if from >= to {
                continue;
            }
            let (line, lane) = ((row - rows.start) / SIDE, SIDE * (row % SIDE));
            let tiles = &mut self.values[line * count..(line + 1) * count];
            let (from, to) = (from - columns.start, to - columns.start);
            let (first, last) = (from / SIDE, (to - 1) / SIDE);
            for (column, tile) in tiles[first..=last].iter_mut().enumerate() {
                let begin = SIDE * (first + column);
                for (k, value) in tile[lane..lane + SIDE].iter_mut().enumerate() {
                    let inside = (from..to).contains(&(begin + k));
                    *value = if inside { R::ZERO } else { *value };
                }
            }
        }
    }

    /// The tiles in use are those where a pixel is not 0.
    pub(super) fn mark(&mut self) {
        let (columns, stride) = (self.rectangle.count[0], self.stride());
        self.eights.clear();
        self.eights.resize((columns + 1) * stride, 0);
        for (row, tiles) in self.values.chunks_exact(columns).enumerate() {
            for (column, tile) in tiles.iter().enumerate() {
                let mut most = R::ZERO;
                for t in &**tile {
                    most = most.most(t.abs());
                }
                self.eights[column * stride + row] = u8::from(most > R::ZERO);
            }
        }
        for column in (1..columns).rev() {
            let (left, right) = self.eights.split_at_mut(column * stride);
            for (left, right) in left[(column - 1) * stride..].iter_mut().zip(right) {
                *left |= *right << 1;
            }
        }
    }

    /// Rows of eights: those of the tiles, and eight without any.
    fn stride(&self) -> usize {
        self.rectangle.count[1] + MOST
    }

    /// The tiles in use among 8x8 from a corner on that is one of them, or next to the last ones: bit
    /// `8 row + column`.
    #[inline(always)]
    pub(super) fn used(&self, column: usize, row: usize) -> u64 {
        let at = column * self.stride() + row;
        let mut bytes = [0; MOST];
        bytes.copy_from_slice(&self.eights[at..at + MOST]);
        u64::from_le_bytes(bytes)
    }

    /// The tiles as a mask, `1 - value`, into an image from row `top` on, which is 0 where there are
    /// no tiles.
    pub(super) fn compose<T: Pixel>(
        &self,
        size: Size,
        (out, top): (&mut [T], usize),
        background: Background,
    ) {
        let Rectangle { first, count: [count, _] } = self.rectangle;
        let [columns, rows] = self.rectangle.pixels(size);
        let seen = (rows.start - top..rows.end - top, columns.clone());
        background.fill_around(out, T::default(), size.width, seen);
        for row in rows {
            let line = &mut out[(row - top) * size.width..(row - top + 1) * size.width];
            let (tile, lane) = (row / SIDE - first[1], SIDE * (row % SIDE));
            let tiles = &self.values[tile * count..(tile + 1) * count];
            let mut pixels = line[columns.clone()].chunks_exact_mut(SIDE);
            let mut tiles = tiles.iter();
            for (pixels, tile) in pixels.by_ref().zip(tiles.by_ref()) {
                for (pixel, value) in pixels.iter_mut().zip(&tile[lane..lane + SIDE]) {
                    *pixel = T::from_f64((R::ONE - *value).wide());
                }
            }
            if let Some(tile) = tiles.next() {
                for (pixel, value) in pixels.into_remainder().iter_mut().zip(&tile[lane..]) {
                    *pixel = T::from_f64((R::ONE - *value).wide());
                }
            }
        }
    }

    /// Multiply by an image over `scale`, and forget the pixels where the mask is full.
    pub(super) fn weigh<T: Pixel>(&mut self, size: Size, image: &[T], scale: f64) {
        let Rectangle { first, count: [count, _] } = self.rectangle;
        let [columns, rows] = self.rectangle.pixels(size);
        let inverse = 1.0 / scale;
        for row in rows {
            let line = &image[row * size.width..(row + 1) * size.width];
            let (tile, lane) = (row / SIDE - first[1], SIDE * (row % SIDE));
            let tiles = &mut self.values[tile * count..(tile + 1) * count];
            for (pixels, tile) in line[columns.clone()].chunks(SIDE).zip(tiles) {
                for (pixel, value) in pixels.iter().zip(&mut tile[lane..lane + SIDE]) {
                    let kept = if *value > R::FULL { *value } else { R::ZERO };
                    *value = kept * R::of(pixel.to_f64() * inverse);
                }
            }
        }
        self.blank(size);
    }
}
