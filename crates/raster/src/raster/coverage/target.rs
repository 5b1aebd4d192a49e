//! Where areas and outlines go.

use super::super::outline::{Extent, NetEdge};
use super::super::{Background, Pixel};
use super::UNIT;
use super::cell::{Piece, transposed};
use super::lanes::{Batch, Place, Solved};
use super::solver::{Sink, Solver};
use super::trace::{Segment, Segments};

/// Where the results of an image or of a band of it go.
pub(super) struct Target<'a, T> {
    /// The rows, or nothing where areas are not asked for.
    out: &'a mut [T],
    layout: Layout,
    /// So many pixels are written, but for those to solve.
    written: usize,
    segments: &'a mut Segments,
    solver: &'a mut Solver,
    turned: &'a mut Vec<Piece>,
}

/// How the pixels of an output follow each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub(super) stride: usize,
    /// Row and column of the first pixel.
    pub(super) origin: (usize, usize),
    /// How empty ones are written.
    pub(super) background: Background,
}

impl<'a, T: Pixel> Target<'a, T> {
    pub(super) fn new(
        out: &'a mut [T],
        layout: Layout,
        segments: &'a mut Segments,
        (solver, turned): (&'a mut Solver, &'a mut Vec<Piece>),
    ) -> Self {
        Self { out, layout, written: 0, segments, solver, turned }
    }

    /// The number of a pixel.
    #[inline(always)]
    pub(super) fn pixel(&self, row: usize, column: usize) -> u32 {
        let Layout { stride, origin, .. } = self.layout;
        ((row - origin.0) * stride + column - origin.1) as u32
    }

    /// The columns of an extent in a row, to be written; what is before them is empty, as far as
    /// it is not written yet.
    #[inline(always)]
    pub(super) fn line(&mut self, row: usize, extent: Extent) -> &mut [T] {
        let Layout { stride, origin, background } = self.layout;
        let at = (row - origin.0) * stride;
        let [from, to] = [extent.columns.0, extent.columns.1].map(|c| at + c - origin.1);
        background.fill(&mut self.out[self.written..from], T::default());
        self.written = to;
        &mut self.out[from..to]
    }

    /// What is behind the last row is empty.
    pub(super) fn complete(&mut self) {
        self.layout.background.fill(&mut self.out[self.written..], T::default());
        self.written = self.out.len();
    }

    #[inline(always)]
    pub(super) fn set(&mut self, pixel: u32, area: f64) {
        let area = if area < 0.0 { 0.0 } else { area };
        let area = if area > 1.0 { 1.0 } else { area };
        self.out[pixel as usize] = T::from_f64(area);
    }

    /// Solve a pixel on its own.
    #[inline(never)]
    pub(super) fn solve<const AREAS: bool, const TRACED: bool>(
        &mut self,
        edges: &[NetEdge],
        place: Place,
        pieces: &[Piece],
    ) {
        let Place { pixel, row, column, layers } = place;
        let mut down = Down {
            edges,
            segments: TRACED.then_some(&mut *self.segments),
            pixel,
            row: f64::from(row),
            area: 0.0,
        };
        self.solver.solve(UNIT, pieces, layers, &mut down);
        let area = down.area;
        if AREAS {
            self.set(pixel, area);
        }
        if TRACED && !pieces.iter().all(|p| edges[p.edge as usize].is_steep()) {
            transposed(pieces, self.turned);
            let column = f64::from(column);
            let mut right = Right { edges, segments: self.segments, pixel, column };
            self.solver.solve(UNIT, self.turned, layers, &mut right);
        }
    }

    /// Keep the outline in a pixel of a batch.
    #[inline(always)]
    pub(super) fn trace<const N: usize>(
        &mut self,
        edges: &[NetEdge],
        batch: &Batch<N>,
        solved: &Solved,
        lane: usize,
    ) {
        let place = batch.places[lane];
        let (pixel, row) = (place.pixel, f64::from(place.row));
        self.segments.reserve(batch.count_of(lane));
        for i in 0..batch.count_of(lane) {
            let e = &edges[batch.edge(i, lane)];
            if N == 1 && !e.is_steep() {
                let (p, shown) = (batch.piece(i, lane), solved.pieces[i].first[lane]);
                if shown != 0.0 {
                    let middle = 0.5 * (p.x0 + p.x1) + f64::from(place.column);
                    self.segments.push(Segment::level(e, pixel, shown * (p.x0 - p.x1), middle));
                }
                continue;
            }
            let (height, moment) = (solved.pieces[i].height[lane], solved.pieces[i].moment[lane]);
            if (height != 0.0) | (moment != 0.0) {
                self.segments.push(Segment::steep(e, pixel, height, moment + height * row));
            }
        }
    }
}

impl Segment {
    /// Stretches of a steep edge in a pixel: the sum of their heights, and that weighted with the
    /// rows where they are.
    #[inline(always)]
    fn steep(e: &NetEdge, pixel: u32, height: f64, moment: f64) -> Self {
        let moment = (moment - height * e.y0) / (e.y1 - e.y0);
        let NetEdge { from, to, slope, .. } = *e;
        Self { pixel, from, to, level: false, length: height, moment, slope }
    }

    /// A stretch of another edge: its width, and the column of its middle.
    #[inline(always)]
    fn level(e: &NetEdge, pixel: u32, width: f64, middle: f64) -> Self {
        let whole = e.x1 - e.x0;
        let (slope, moment) = ((e.y1 - e.y0) / whole, width * ((middle - e.x0) / whole));
        Self { pixel, from: e.from, to: e.to, level: true, length: width, moment, slope }
    }
}

/// Results of the sweep down.
struct Down<'a> {
    edges: &'a [NetEdge],
    segments: Option<&'a mut Segments>,
    pixel: u32,
    row: f64,
    area: f64,
}

impl Sink for Down<'_> {
    #[inline(always)]
    fn area(&mut self, area: f64) {
        self.area += area;
    }

    #[inline(always)]
    fn edge(&mut self, edge: u32, height: f64, middle: f64) {
        let e = &self.edges[edge as usize];
        if let Some(segments) = &mut self.segments
            && e.is_steep()
        {
            segments.push(Segment::steep(e, self.pixel, height, height * (middle + self.row)));
        }
    }
}

/// Results of the sweep to the right: its right-hand side is below.
struct Right<'a> {
    edges: &'a [NetEdge],
    segments: &'a mut Segments,
    pixel: u32,
    column: f64,
}

impl Sink for Right<'_> {
    fn area(&mut self, _area: f64) {}

    #[inline(always)]
    fn edge(&mut self, edge: u32, width: f64, middle: f64) {
        let e = &self.edges[edge as usize];
        if !e.is_steep() {
            self.segments.push(Segment::level(e, self.pixel, width, middle + self.column));
        }
    }
}
