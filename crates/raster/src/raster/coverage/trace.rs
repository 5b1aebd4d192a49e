//! The outline of the union, piece by piece, and what a move of it does to the areas.
//!
//! A visible stretch of an edge that moves outwards sweeps its pixel: the gradient for the area is
//! that for the stretch, times its length, along its normal, shared out between the two ends of
//! the edge by where its middle lies between them.

use super::super::outline::{Extent, NetEdge};
use super::super::{Mode, Model, Pixel, Size};
use super::UNIT;
use super::cell::{Piece, single, transposed};
use super::solver::{Sink, Solver};

/// The outline of an image.
#[derive(Debug, Clone)]
pub struct Trace {
    of: Kind,
    pub(super) extent: Extent,
    pub(super) segments: Vec<Segment>,
}

impl Trace {
    pub(super) fn new(of: Kind, extent: Extent) -> Self {
        Self { of, extent, segments: Vec::new() }
    }

    /// Memory in bytes.
    pub(in super::super) fn bytes(&self) -> usize {
        self.segments.capacity() * size_of::<Segment>()
    }

    /// Whether it can be that of a mask of this kind.
    pub(in super::super) fn is_of(&self, model: &Model, size: Size, mode: Mode) -> bool {
        let vertices = model.vertex_count();
        matches!(mode, Mode::Coverage { sigma } if self.of == Kind { vertices, size, sigma })
    }
}

/// What an outline must have in common with the image whose gradient is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Kind {
    pub(super) vertices: usize,
    pub(super) size: Size,
    pub(super) sigma: f64,
}

/// What is visible of an edge in one pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pixel: u32,
    /// Image points at the ends of the edge.
    from: u32,
    to: u32,
    /// Outer normal times length.
    u: f64,
    v: f64,
    /// Where its middle is between the ends.
    middle: f64,
}

/// Add the gradient for image points, given the one for areas.
pub(super) fn apply<T: Pixel>(segments: &[Segment], weights: &[T], du: &mut [f64], dv: &mut [f64]) {
    for s in segments {
        let weight = weights[s.pixel as usize].to_f64();
        let (u, v) = (weight * s.u, weight * s.v);
        let (along_u, along_v) = (s.middle * u, s.middle * v);
        let (from, to) = (s.from as usize, s.to as usize);
        du[from] += u - along_u;
        dv[from] += v - along_v;
        du[to] += along_u;
        dv[to] += along_v;
    }
}

/// Collects segments: by a sweep down, and for (nearly) level edges by one to the right.
pub(super) struct Tracer<'a> {
    pub(super) edges: &'a [NetEdge],
    pub(super) solver: &'a mut Solver,
    pub(super) turned: &'a mut Vec<Piece>,
    pub(super) segments: &'a mut Vec<Segment>,
}

impl Tracer<'_> {
    /// Covered area of a pixel, the outline in which is kept.
    #[inline(always)]
    pub(super) fn pixel(
        &mut self,
        pixel: u32,
        row: usize,
        column: usize,
        pieces: &[Piece],
        layers: i32,
    ) -> f64 {
        let (edges, row, column) = (self.edges, row as f64, column as f64);
        if let [p] = pieces {
            let (area, visible) = single(p, layers);
            if let Some(ahead) = visible {
                let e = &edges[p.edge as usize];
                let middle = if e.is_steep() {
                    (0.5 * (p.y0 + p.y1) + row - e.y0) / (e.y1 - e.y0)
                } else {
                    (0.5 * (p.x0 + p.x1) + column - e.x0) / (e.x1 - e.x0)
                };
                let (u, v) = (p.y1 - p.y0, p.x0 - p.x1);
                let (u, v) = if ahead { (u, v) } else { (-u, -v) };
                self.segments.push(Segment { pixel, from: e.from, to: e.to, u, v, middle });
            }
            return area;
        }
        let segments = &mut *self.segments;
        let steep = |p: &Piece| edges[p.edge as usize].is_steep();
        let mut down = Down { edges, segments, pixel, row, area: 0.0 };
        self.solver.solve(UNIT, pieces, layers, &mut down);
        let area = down.area;
        if !pieces.iter().all(steep) {
            transposed(pieces, self.turned);
            let mut right = Right { edges, segments, pixel, column };
            self.solver.solve(UNIT, self.turned, layers, &mut right);
        }
        area
    }
}

/// Results of the sweep down.
struct Down<'a> {
    edges: &'a [NetEdge],
    segments: &'a mut Vec<Segment>,
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
        if e.is_steep() {
            self.segments.push(Segment {
                pixel: self.pixel,
                from: e.from,
                to: e.to,
                u: height,
                v: -e.slope * height,
                middle: (middle + self.row - e.y0) / (e.y1 - e.y0),
            });
        }
    }
}

/// Results of the sweep to the right: its right-hand side is below.
struct Right<'a> {
    edges: &'a [NetEdge],
    segments: &'a mut Vec<Segment>,
    pixel: u32,
    column: f64,
}

impl Sink for Right<'_> {
    fn area(&mut self, _area: f64) {}

    fn edge(&mut self, edge: u32, width: f64, middle: f64) {
        let e = &self.edges[edge as usize];
        if !e.is_steep() {
            let whole = 1.0 / (e.x1 - e.x0);
            self.segments.push(Segment {
                pixel: self.pixel,
                from: e.from,
                to: e.to,
                u: -(e.y1 - e.y0) * whole * width,
                v: width,
                middle: (middle + self.column - e.x0) * whole,
            });
        }
    }
}
