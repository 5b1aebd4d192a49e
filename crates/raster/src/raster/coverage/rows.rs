//! Net edges row by row and pixel by pixel: which pixels an outline can run through.
//!
//! The number of layers at the upper left corner of a pixel counts the edges that cross the upper
//! side of the row to its left. A pixel that no edge enters is covered or not; one whose corner has
//! more layers than the edges in it can take away is covered; only the others are solved. Nothing
//! is carried from one pixel to the next but whole numbers, so no rounding error can spread.

use super::super::order::RowOrder;
use super::super::outline::{Extent, NetEdge};
use super::cell::{LEFT_0, LEFT_1, Piece, RIGHT_0, RIGHT_1, TOP};

/// The part of an edge inside a row, in pixels; `y` from the top of the row.
#[derive(Debug, Clone, Copy)]
struct Part {
    x0: f64,
    y0: f64,
    x1: f64,
    y1: f64,
    edge: u32,
    step: i32,
    /// Columns of the two ends, on the canvas, and one beyond it on either side.
    c0: i32,
    c1: i32,
    top: bool,
}

/// What a row consists of, from left to right.
pub(super) trait Visitor {
    /// Covered pixels `from..to` that no outline enters; those that are named nowhere are empty.
    fn covered(&mut self, row: usize, from: usize, to: usize);
    /// A pixel to solve; coordinates are from its upper left corner.
    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32);
}

/// What enters a pixel.
///
/// On the way from a corner to a point inside, first along the side and then across, a piece is
/// crossed once or not at all, or once on the side and back again: it changes the number of layers
/// by its step or by nothing. In which direction depends on whether it leaves through the side
/// that the way begins on.
#[derive(Debug, Clone, Copy, Default)]
struct Entered {
    /// How many pieces.
    count: u32,
    /// Layers at the lower left corner minus those at the upper left one.
    down: i32,
    /// How many layers the pieces can take away, seen from the upper left, upper right, lower
    /// left and lower right corner.
    taken: [i32; 4],
}

impl Entered {
    #[inline(always)]
    fn add(&mut self, down: i32, taken: [i32; 4]) {
        self.count += 1;
        self.down += down;
        for (sum, taken) in self.taken.iter_mut().zip(taken) {
            *sum += taken;
        }
    }
}

/// Buffers of a walk.
#[derive(Debug, Default)]
pub(super) struct Rows {
    order: RowOrder,
    live: Vec<Live>,
    /// One bit for each column in which something happens in this row.
    touched: Vec<u64>,
    parts: Vec<Part>,
    /// For each column: change of layers at its upper left corner.
    change: Vec<i32>,
    entered: Vec<Entered>,
    /// For each column to solve: where its pieces go.
    place: Vec<u32>,
    pieces: Vec<Piece>,
    todo: Vec<(u32, u32, u32, i32)>,
}

const NOWHERE: u32 = u32::MAX;

/// An edge in the current row.
#[derive(Debug, Clone, Copy)]
struct Live {
    edge: u32,
    /// Where it comes through the upper side of the row.
    x: f64,
}

impl Rows {
    /// Visit the pixels of the extent.
    pub(super) fn walk(&mut self, edges: &[NetEdge], extent: Extent, visitor: &mut impl Visitor) {
        let (first, last) = extent.rows;
        self.order.begin(edges, first, last);
        let (c0, c1) = extent.columns;
        let columns = c1 - c0;
        self.change.clear();
        self.change.resize(columns + 1, 0);
        self.entered.clear();
        self.entered.resize(columns, Entered::default());
        self.touched.clear();
        self.touched.resize(columns.div_ceil(64), 0);
        self.place.clear();
        self.place.resize(columns, NOWHERE);
        self.live.clear();
        for row in first..last {
            self.cut_row(edges, row, first, (c0 as i32, c1 as i32));
            self.visit_row(row, c0, columns, visitor);
        }
    }

    /// The parts of the edges in a row; edges that end there are dropped.
    fn cut_row(&mut self, edges: &[NetEdge], row: usize, first: usize, columns: (i32, i32)) {
        let top = row as f64;
        self.parts.clear();
        let mut kept = 0;
        for k in 0..self.live.len() {
            let Live { edge, x } = self.live[k];
            if let Some(x) = self.cut(edges, edge, (x, 0.0), true, top, columns) {
                self.live[kept] = Live { edge, x };
                kept += 1;
            }
        }
        self.live.truncate(kept);
        for k in self.order.starting(row - first) {
            let edge = self.order.edge(k);
            let e = &edges[edge as usize];
            let above = e.y0 < top; // of the first row
            let start = if above { (e.x_at(top), 0.0) } else { (e.x0, e.y0 - top) };
            if let Some(x) = self.cut(edges, edge, start, above, top, columns) {
                self.live.push(Live { edge, x });
            }
        }
    }

    /// The part of an edge in a row, from its start in it. Where it goes on to the next one.
    #[inline(always)]
    fn cut(
        &mut self,
        edges: &[NetEdge],
        edge: u32,
        (x0, y0): (f64, f64),
        from_above: bool,
        top: f64,
        (c0, c1): (i32, i32),
    ) -> Option<f64> {
        let e = &edges[edge as usize];
        let bottom = top + 1.0;
        let goes_on = e.y1 >= bottom;
        let (x1, y1) = if goes_on { (e.x_at(bottom), 1.0) } else { (e.x1, e.y1 - top) };
        let next = goes_on.then_some(x1);
        let column = |x: f64| {
            // One column beyond the canvas stands for all.
            if x < f64::from(c0) {
                c0 - 1
            } else if x >= f64::from(c1) {
                c1
            } else {
                x as i32
            }
        };
        let (a, b) = (column(x0), column(x1));
        if from_above && a < c1 {
            let at = (a + 1 - c0) as usize;
            self.change[at] += e.step;
            if a + 1 < c1 {
                self.touched[at / 64] |= 1 << (at % 64);
            }
        }
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        if high < c0 || low >= c1 {
            return next;
        }
        let (p, n) = (e.step.max(0), (-e.step).max(0));
        if low == high {
            let at = (low - c0) as usize;
            self.touched[at / 64] |= 1 << (at % 64);
            self.entered[at].add(0, [n, p, n, p]);
        } else {
            for c in low.max(c0)..=high.min(c1 - 1) {
                let at = (c - c0) as usize;
                self.touched[at / 64] |= 1 << (at % 64);
                let (first, last) = (c == a, c == b);
                let (down, taken) = if a < b {
                    // To the right: in through the left side but for the first, and out through
                    // the right side but for the last.
                    let down = if first { 0 } else { -e.step };
                    (down, [if first { n } else { p }, p, n, if last { p } else { n }])
                } else {
                    let down = if last { 0 } else { e.step };
                    (down, [n, if first { p } else { n }, if last { n } else { p }, p])
                };
                self.entered[at].add(down, taken);
            }
        }
        let step = e.step;
        self.parts.push(Part { x0, y0, x1, y1, edge, step, c0: a, c1: b, top: from_above });
        next
    }

    fn visit_row(&mut self, row: usize, c0: usize, columns: usize, visitor: &mut impl Visitor) {
        let (mut layers, mut begin, mut covered) = (0, 0, false);
        let mut total = 0;
        self.todo.clear();
        for word in 0..self.touched.len() {
            let mut bits = std::mem::take(&mut self.touched[word]);
            while bits != 0 {
                let c = 64 * word + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                layers += std::mem::take(&mut self.change[c]);
                let Entered { count, down, taken } = std::mem::take(&mut self.entered[c]);
                let behind = layers > 0;
                let mut now = behind;
                if count > 0 {
                    let right = layers + self.change[c + 1];
                    // At the lower right corner: as below the next pixel's upper left one.
                    let below = right + self.entered.get(c + 1).map_or(0, |next| next.down);
                    let least = (layers - taken[0])
                        .max(right - taken[1])
                        .max(layers + down - taken[2])
                        .max(if c + 1 < columns { below - taken[3] } else { 0 });
                    if least <= 0 {
                        if covered && begin < c {
                            visitor.covered(row, c0 + begin, c0 + c);
                        }
                        (begin, covered) = (c + 1, behind);
                        self.place[c] = total;
                        self.todo.push((c as u32, total, count, layers));
                        total += count;
                        continue;
                    }
                    now = true;
                }
                if now != covered {
                    if covered && begin < c {
                        visitor.covered(row, c0 + begin, c0 + c);
                    }
                    (begin, covered) = (c, now);
                }
                if behind != now {
                    if covered {
                        visitor.covered(row, c0 + begin, c0 + c + 1);
                    }
                    (begin, covered) = (c + 1, behind);
                }
            }
        }
        if covered && begin < columns {
            visitor.covered(row, c0 + begin, c0 + columns);
        }
        self.change[columns] = 0;
        if self.todo.is_empty() {
            return;
        }
        if self.pieces.len() < total as usize {
            self.pieces.resize(total as usize, Piece::default());
        }
        for k in 0..self.parts.len() {
            let part = self.parts[k];
            self.cut_columns(&part, c0 as i32, (c0 + columns) as i32);
        }
        for &(c, place, count, layers) in &self.todo {
            self.place[c as usize] = NOWHERE;
            let pieces = &self.pieces[place as usize..(place + count) as usize];
            visitor.pixel(row, c0 + c as usize, pieces, layers);
        }
    }

    /// The pieces of a part in the columns to solve.
    #[expect(clippy::manual_clamp, reason = "two comparisons, without the assertion of clamp")]
    #[inline(always)]
    fn cut_columns(&mut self, part: &Part, c0: i32, c1: i32) {
        let Part { x0, y0, x1, y1, edge, step, c0: a, c1: b, top } = *part;
        let first = if top { TOP } else { 0 };
        let mut add = |c: i32, piece: Piece| {
            let place = &mut self.place[(c - c0) as usize];
            if *place != NOWHERE {
                let x = f64::from(c);
                let within = |x: f64| {
                    if x < 0.0 {
                        0.0
                    } else if x > 1.0 {
                        1.0
                    } else {
                        x
                    }
                };
                self.pieces[*place as usize] =
                    Piece { x0: within(piece.x0 - x), x1: within(piece.x1 - x), ..piece };
                *place += 1;
            }
        };
        if a == b {
            add(a, Piece { x0, y0, x1, y1, step, edge, flags: first });
            return;
        }
        let slope = (y1 - y0) / (x1 - x0);
        let at = |x: f64, after: f64| {
            let y = y0 + (x - x0) * slope;
            let y = if y < after { after } else { y };
            if y > y1 { y1 } else { y }
        };
        let (mut x, mut y, mut flags) = (x0, y0, first);
        if a < b {
            for c in a..=b {
                if c >= c1 {
                    break;
                }
                let (to, below) =
                    if c == b { (x1, y1) } else { (f64::from(c + 1), at(f64::from(c + 1), y)) };
                if c >= c0 {
                    let flags = if c == b { flags } else { flags | RIGHT_1 };
                    add(c, Piece { x0: x, y0: y, x1: to, y1: below, step, edge, flags });
                }
                (x, y, flags) = (to, below, LEFT_0);
            }
        } else {
            for c in (b..=a).rev() {
                if c < c0 {
                    break;
                }
                let (to, below) =
                    if c == b { (x1, y1) } else { (f64::from(c), at(f64::from(c), y)) };
                if c < c1 {
                    let flags = if c == b { flags } else { flags | LEFT_1 };
                    add(c, Piece { x0: x, y0: y, x1: to, y1: below, step, edge, flags });
                }
                (x, y, flags) = (to, below, RIGHT_0);
            }
        }
    }
}
