//! Which faces are where in an image, to ask what is seen at any place.

use super::setup::Prepared;
use crate::raster::Size;

/// Tiles of an image at most, and entries in them.
const TILES: usize = 1 << 18;
const ENTRIES: usize = 1 << 26;

/// For each square of an image, the faces that may be in it.
#[derive(Debug)]
pub(super) struct Tiles {
    side: usize,
    columns: usize,
    starts: Vec<u32>,
    records: Vec<u32>,
    /// The largest `1/z` of each.
    nearest: Vec<f64>,
}

impl Tiles {
    pub(super) fn new(prepared: &Prepared, size: Size) -> Self {
        let mut side = 4;
        while size.width.div_ceil(side) * size.height.div_ceil(side) > TILES {
            side *= 2;
        }
        let span = |[first, end]: [i32; 2], side: usize| {
            first as usize / side..(end as usize - 1) / side + 1
        };
        let boxes = || prepared.records().iter();
        let entries = |side: usize| -> usize {
            boxes().map(|r| span(r.columns, side).len() * span(r.rows, side).len()).sum()
        };
        while entries(side) > ENTRIES && side < size.width.max(size.height) {
            side *= 2;
        }
        let columns = size.width.div_ceil(side);
        // Counted two places further on, so that filling in moves each start to its place.
        let mut starts = vec![0_u32; columns * size.height.div_ceil(side) + 2];
        for record in boxes() {
            for row in span(record.rows, side) {
                for column in span(record.columns, side) {
                    starts[row * columns + column + 2] += 1;
                }
            }
        }
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let mut records = vec![0; starts.last().map_or(0, |&n| n as usize)];
        for (k, record) in boxes().enumerate() {
            for row in span(record.rows, side) {
                for column in span(record.columns, side) {
                    let next = &mut starts[row * columns + column + 1];
                    records[*next as usize] = k as u32;
                    *next += 1;
                }
            }
        }
        let nearest = records.iter().map(|&k| prepared.records()[k as usize].range[1]).collect();
        Self { side, columns, starts, records, nearest }
    }

    /// Whether a face at this point of the image has `1/z` above `nearness`.
    pub(super) fn hides(&self, prepared: &Prepared, [u, v]: [f64; 2], nearness: f64) -> bool {
        let tile = v as usize / self.side * self.columns + u as usize / self.side;
        let records = self.starts[tile] as usize..self.starts[tile + 1] as usize;
        let pairs = self.nearest[records.clone()].iter().zip(&self.records[records]);
        pairs
            .filter(|(nearest, _)| **nearest > nearness)
            .any(|(_, &k)| prepared.records()[k as usize].at(u, v).is_some_and(|w| w > nearness))
    }
}
