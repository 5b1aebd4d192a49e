//! Edges in the order of the rows they start in.

use multiversion::multiversion;

use super::outline::NetEdge;

/// For each row of a range, the edges that are in it.
#[derive(Debug, Default)]
pub(super) struct RowOrder {
    /// Edges that start in row `r` of the range (or before it, for the first):
    /// `order[start[r]..start[r + 1]]`.
    start: Vec<u32>,
    order: Vec<u32>,
    /// The row that each edge starts in.
    row: Vec<u32>,
}

impl RowOrder {
    /// Begin with row `first`; rows up to `last` follow.
    pub(super) fn begin(&mut self, edges: &[NetEdge], first: usize, last: usize) {
        let rows = last - first;
        self.start.clear();
        self.start.resize(rows + 3, 0);
        self.row.clear();
        self.row.resize(edges.len(), 0);
        rows_of(edges, first as f64, rows, &mut self.row);
        for &row in &self.row {
            self.start[row as usize + 1] += 1;
        }
        for k in 1..self.start.len() {
            self.start[k] += self.start[k - 1];
        }
        self.order.clear();
        self.order.resize(edges.len(), 0);
        for (id, &row) in self.row.iter().enumerate() {
            let slot = &mut self.start[row as usize];
            self.order[*slot as usize] = id as u32;
            *slot += 1;
        }
        // Each start has become the next one.
        self.start.copy_within(0..=rows, 1);
        self.start[0] = 0;
    }

    /// Places of the edges that start in a row, counted from the first.
    #[inline(always)]
    pub(super) fn starting(&self, row: usize) -> std::ops::Range<usize> {
        self.start[row] as usize..self.start[row + 1] as usize
    }

    /// The edge at a place.
    #[inline(always)]
    pub(super) fn edge(&self, place: usize) -> u32 {
        self.order[place]
    }
}

/// The row that each edge starts in; those that end before the range have a row of their own, behind
/// the last.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
fn rows_of(edges: &[NetEdge], first: f64, rows: usize, out: &mut [u32]) {
    for (out, e) in out.iter_mut().zip(edges) {
        let below = e.y0 - first;
        let below = if below > 0.0 { below } else { 0.0 };
        let row = if below < rows as f64 { below as i32 as u32 } else { rows as u32 };
        *out = if e.y1 >= first { row } else { rows as u32 + 1 };
    }
}
