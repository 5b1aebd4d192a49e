//! Net edges row by row: their parts, the columns those enter, and the pixels to solve.

use pulp::{Simd, WithSimd};

use super::super::Pixel;
use super::super::order::RowOrder;
use super::super::outline::{Extent, NetEdge};
use super::cell::Piece;
use super::columns::{
    Columns, LEFT_FIRST, LEFT_ON, MOST_STEPS, NOT_AT_ALL, RIGHT_FIRST, RIGHT_LAST, RIGHT_ON,
};
use super::lanes::{self, Batch, Place, Solved};
use super::parts::{self, Group};
use super::target::Target;
use super::waiting::{Lists, Waiting};

/// Buffers of a walk.
#[derive(Debug, Default)]
pub(super) struct Rows {
    order: RowOrder,
    /// The edges of the current row.
    live: Vec<u32>,
    groups: Vec<Group>,
    columns: Columns,
    /// The pieces of some rows, and one place for those that are none.
    pieces: Vec<Piece>,
    /// The pixels to solve of these rows.
    waiting: Lists,
    /// Made when it is first needed: buffers are taken from their thread and put back, and this
    /// one is too large to be copied.
    batches: Option<Box<Batches>>,
}

/// So many pieces are laid, about, before pixels are solved, those with equally many one after the
/// other: nothing foretells how many the next pixel of a row has.
const PIECES: u32 = 4096;

/// Pixels that wait for others with the same number of pieces.
#[derive(Debug, Default)]
struct Batches {
    one: Batch<1>,
    two: Batch<2>,
    three: Batch<3>,
    four: Batch<4>,
    five: Batch<5>,
    six: Batch<6>,
    eight: Batch<8>,
    sixteen: Batch<{ lanes::MOST }>,
    solved: Solved,
}

/// Go over the rows of an extent. With `AREAS`, every pixel of the extent is written; with
/// `TRACED`, the outline is kept.
pub(super) fn walk<T: Pixel, const AREAS: bool, const TRACED: bool>(
    rows: &mut Rows,
    edges: &[NetEdge],
    extent: Extent,
    target: &mut Target<'_, T>,
) {
    let walk = Walk::<T, AREAS, TRACED> { rows, edges, extent, target };
    super::ARCH.with(|arch| arch.dispatch(walk));
}

/// As [`walk`], on one instruction set.
#[cfg(test)]
pub(super) fn walk_on<S: Simd, T: Pixel>(
    s: S,
    rows: &mut Rows,
    edges: &[NetEdge],
    extent: Extent,
    target: &mut Target<'_, T>,
) {
    s.vectorize(Walk::<T, true, true> { rows, edges, extent, target });
}

struct Walk<'a, 'b, T, const AREAS: bool, const TRACED: bool> {
    rows: &'a mut Rows,
    edges: &'a [NetEdge],
    extent: Extent,
    target: &'a mut Target<'b, T>,
}

impl<T: Pixel, const AREAS: bool, const TRACED: bool> WithSimd for Walk<'_, '_, T, AREAS, TRACED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, s: S) {
        let Self { rows, edges, extent, target } = self;
        rows.walk::<S, T, AREAS, TRACED>(s, edges, extent, target);
    }
}

impl Rows {
    #[inline(always)]
    fn walk<S: Simd, T: Pixel, const AREAS: bool, const TRACED: bool>(
        &mut self,
        s: S,
        edges: &[NetEdge],
        extent: Extent,
        target: &mut Target<'_, T>,
    ) {
        let (first, last) = extent.rows;
        let (begin, end) = extent.columns;
        let (left, width) = (begin as f64, (end - begin) as f64);
        self.order.begin(edges, first, last);
        self.columns.begin(end - begin);
        self.live.clear();
        for k in self.order.starting(0) {
            let e = &edges[self.order.edge(k) as usize];
            if e.y0 < first as f64 {
                self.columns.cross(parts::column_at(e, first as f64, left, width), e.step);
            }
        }
        self.columns.start();
        let mut batches = self.batches.take().unwrap_or_default();
        let mut free = 0;
        for row in first..last {
            let top = row as f64;
            self.continue_to(edges, row - first, top);
            let mut steps = 0_u32;
            let ids = &self.live[..];
            let count = ids.len().div_ceil(lanes::WIDE);
            if self.groups.len() < count {
                self.groups.resize(count, Group::default());
            }
            let groups = &mut self.groups[..count];
            // One after the other: what is written lane by lane is on its way to memory until it
            // is read as a register.
            for (group, ids) in groups.iter_mut().zip(ids.chunks(lanes::WIDE)) {
                group.load(edges, ids);
            }
            for group in groups.iter_mut() {
                group.cut(s, top, left, width);
            }
            for group in groups.iter() {
                for l in 0..group.count {
                    steps = steps.saturating_add(group.step[l].unsigned_abs());
                    enter(&mut self.columns, group, l);
                }
            }
            let (pixel, column) = (target.pixel(row, begin), begin as u32);
            let start = Place { pixel, row: row as u32, column, layers: 0 };
            let line = if AREAS { target.line(row, extent) } else { &mut [] };
            let told_apart = steps <= MOST_STEPS;
            let (end, left) = self.columns.scan(free, told_apart, start, line, &mut self.waiting);
            if !left {
                continue;
            }
            let none = end as usize;
            if self.pieces.len() <= none {
                self.pieces.resize(none + 1, Piece::default());
            }
            for group in &*groups {
                for l in 0..group.count {
                    lay(&mut self.columns, &mut self.pieces[..=none], group, l);
                }
            }
            free = end;
            if free > PIECES {
                batches.take::<T, AREAS, TRACED>(edges, &mut self.waiting, &self.pieces, target);
                free = 0;
            }
        }
        batches.take::<T, AREAS, TRACED>(edges, &mut self.waiting, &self.pieces, target);
        if AREAS {
            target.complete();
        }
        batches.flush::<T, AREAS, TRACED>(edges, target);
        self.batches = Some(batches);
    }

    /// Leave the edges that are in a row.
    #[inline(always)]
    fn continue_to(&mut self, edges: &[NetEdge], row: usize, top: f64) {
        let mut kept = 0;
        for k in 0..self.live.len() {
            let edge = self.live[k];
            self.live[kept] = edge;
            kept += usize::from(edges[edge as usize].y1 >= top);
        }
        self.live.truncate(kept);
        self.live.extend(self.order.starting(row).map(|k| self.order.edge(k)));
    }
}

/// The columns that a part enters.
#[inline(always)]
fn enter(columns: &mut Columns, group: &Group, l: usize) {
    let ((from, to), step) = (group.columns(l), group.step[l]);
    columns.cross(to, group.step_below(l));
    // Without a branch, as nothing foretells which way a part runs.
    let (right, left) = (usize::from(from < to), usize::from(from > to));
    columns.enter(from, step, right * RIGHT_FIRST + left * LEFT_FIRST);
    columns.enter(to, step, NOT_AT_ALL - right * (NOT_AT_ALL - RIGHT_LAST) - left);
    if (to - from).abs() > 1 {
        let way = if from < to { RIGHT_ON } else { LEFT_ON };
        for column in from.min(to) + 1..from.max(to) {
            columns.enter(column, step, way);
        }
    }
}

/// The pieces of a part.
#[inline(always)]
fn lay(columns: &mut Columns, pieces: &mut [Piece], group: &Group, l: usize) {
    let (from, to) = group.columns(l);
    let nowhere = pieces.len() - 1;
    let place = columns.place(from, true) as usize;
    let begin = group.begin(l);
    pieces[place] = begin;
    let more = from != to;
    let place = columns.place(to, more) as usize;
    pieces[if more { place } else { nowhere }] = group.end(l);
    if (to - from).abs() > 1 {
        let mut y = begin.y1;
        let way = if from < to { 1 } else { -1 };
        let mut column = from + way;
        while column != to {
            let piece = group.middle(l, column, y);
            y = piece.y1;
            pieces[columns.place(column, true) as usize] = piece;
            column += way;
        }
    }
}

impl Batches {
    /// Take all that wait.
    #[inline(always)]
    fn take<T: Pixel, const AREAS: bool, const TRACED: bool>(
        &mut self,
        edges: &[NetEdge],
        waiting: &mut Lists,
        pieces: &[Piece],
        target: &mut Target<'_, T>,
    ) {
        let [one, two, three, four, five, six, eight, sixteen, more] = waiting;
        let (s, from) = (&mut self.solved, (edges, pieces));
        put::<T, _, AREAS, TRACED>(&mut self.one, s, from, one, target);
        put::<T, _, AREAS, TRACED>(&mut self.two, s, from, two, target);
        put::<T, _, AREAS, TRACED>(&mut self.three, s, from, three, target);
        put::<T, _, AREAS, TRACED>(&mut self.four, s, from, four, target);
        put::<T, _, AREAS, TRACED>(&mut self.five, s, from, five, target);
        put::<T, _, AREAS, TRACED>(&mut self.six, s, from, six, target);
        put::<T, _, AREAS, TRACED>(&mut self.eight, s, from, eight, target);
        put::<T, _, AREAS, TRACED>(&mut self.sixteen, s, from, sixteen, target);
        for w in more.drain(..) {
            target.solve::<AREAS, TRACED>(edges, w.place, w.of(pieces));
        }
    }

    #[inline(always)]
    fn flush<T: Pixel, const AREAS: bool, const TRACED: bool>(
        &mut self,
        edges: &[NetEdge],
        target: &mut Target<'_, T>,
    ) {
        let solved = &mut self.solved;
        finish::<T, _, AREAS, TRACED>(&mut self.one, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.two, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.three, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.four, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.five, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.six, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.eight, solved, edges, target);
        finish::<T, _, AREAS, TRACED>(&mut self.sixteen, solved, edges, target);
    }
}

/// Add pixels to their batch, and solve that whenever it is full.
#[inline(always)]
fn put<T: Pixel, const N: usize, const AREAS: bool, const TRACED: bool>(
    batch: &mut Batch<N>,
    solved: &mut Solved,
    (edges, pieces): (&[NetEdge], &[Piece]),
    waiting: &mut Vec<Waiting>,
    target: &mut Target<'_, T>,
) {
    for w in waiting.drain(..) {
        if batch.push(w.place, w.of(pieces)) {
            finish::<T, N, AREAS, TRACED>(batch, solved, edges, target);
        }
    }
}

/// Solve a batch and hand out what came of it.
#[inline(always)]
fn finish<T: Pixel, const N: usize, const AREAS: bool, const TRACED: bool>(
    batch: &mut Batch<N>,
    solved: &mut Solved,
    edges: &[NetEdge],
    target: &mut Target<'_, T>,
) {
    if batch.count == 0 {
        return;
    }
    batch.solve(solved);
    for l in 0..batch.count {
        let place = batch.places[l];
        if N > 1 && solved.handed_back[l] > 0.0 {
            let pieces: [Piece; N] = std::array::from_fn(|i| batch.piece(i, l));
            target.solve::<AREAS, TRACED>(edges, place, &pieces[..batch.count_of(l)]);
            continue;
        }
        if AREAS {
            target.set(place.pixel, solved.area[l]);
        }
        if TRACED {
            target.trace(edges, batch, solved, l);
        }
    }
    batch.clear();
}
