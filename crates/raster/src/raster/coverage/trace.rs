//! The outline of the union, piece by piece, and what a move of it does to the areas.
//!
//! A visible stretch of an edge that moves outwards sweeps its pixel: the gradient for the area is
//! that for the stretch, times its length, along its normal, shared out between the two ends of
//! the edge by where its middle lies between them.

use super::super::outline::Extent;
use super::super::spare::Spare;
use super::super::{Mode, Model, Pixel, Size};

/// The outline of an image.
#[derive(Debug, Clone)]
pub struct Trace {
    of: Kind,
    pub(super) extent: Extent,
    pub(super) segments: Vec<Segment>,
}

static SPARE: Spare<Segment> = Spare::new();

impl Drop for Trace {
    fn drop(&mut self) {
        SPARE.give(std::mem::take(&mut self.segments));
    }
}

impl Trace {
    pub(super) fn new(of: Kind, extent: Extent) -> Self {
        Self { of, extent, segments: SPARE.take() }
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
    pub(super) pixel: u32,
    /// Image points at the ends of the edge.
    pub(super) from: u32,
    pub(super) to: u32,
    /// Outer normal times length.
    pub(super) u: f64,
    pub(super) v: f64,
    /// Where its middle is between the ends.
    pub(super) middle: f64,
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
