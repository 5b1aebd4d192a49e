//! The outline of the union, piece by piece, and what a move of it does to the areas.
//!
//! A visible stretch of an edge that moves outwards sweeps its pixel: the gradient for the area is
//! that for the stretch, times its length, along its normal, shared out between the two ends of
//! the edge by where its middle lies between them.

use multiversion::multiversion;

use super::super::outline::Extent;
use super::super::spare::Spare;
use super::super::{Mode, Model, Pixel, Size};

/// The outline of an image.
#[derive(Debug, Clone)]
pub struct Trace {
    of: Kind,
    pub(super) extent: Extent,
    pub(super) segments: Segments,
}

static SPARE: Spare<Segment> = Spare::new();

impl Drop for Trace {
    fn drop(&mut self) {
        SPARE.give(std::mem::take(&mut self.segments.list));
    }
}

impl Trace {
    pub(super) fn new(of: Kind, extent: Extent) -> Self {
        Self { of, extent, segments: Segments { list: SPARE.take(), count: 0 } }
    }

    /// Memory in bytes.
    pub(in super::super) fn bytes(&self) -> usize {
        self.segments.list.capacity() * size_of::<Segment>()
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

/// A list that is written to before it is known whether anything is added.
#[derive(Debug, Clone, Default)]
pub(super) struct Segments {
    /// What is behind the first `count` is of no account.
    list: Vec<Segment>,
    count: usize,
}

impl Segments {
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// Make room for so many more.
    #[inline(always)]
    pub(super) fn reserve(&mut self, more: usize) {
        if self.list.len() < self.count + more {
            self.list.resize((self.count + more).next_power_of_two(), Segment::default());
        }
    }

    /// Add one, for which there is room, if there is anything of it: without a branch, as nothing
    /// foretells that.
    #[inline(always)]
    pub(super) fn put(&mut self, segment: Segment, visible: bool) {
        self.list[self.count] = segment;
        self.count += usize::from(visible);
    }

    pub(super) fn push(&mut self, segment: Segment) {
        self.reserve(1);
        self.put(segment, true);
    }
}

/// What is visible of an edge in one pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Segment {
    pub(super) pixel: u32,
    /// Image points at the ends of the edge.
    pub(super) from: u32,
    pub(super) to: u32,
    /// Whether lengths are counted along columns; along rows otherwise.
    pub(super) level: bool,
    /// How far it goes, with the sign of the outer normal along the other axis.
    pub(super) length: f64,
    /// The length weighted with where it is: 0 at the first end, 1 at the second.
    pub(super) moment: f64,
    /// What an edge goes along the other axis for each pixel along this one.
    pub(super) slope: f64,
}

/// Add the gradient for image points, given the one for areas.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
pub(super) fn apply<T: Pixel>(segments: &Segments, weights: &[T], du: &mut [f64], dv: &mut [f64]) {
    for s in &segments.list[..segments.count] {
        let weight = weights[s.pixel as usize].to_f64();
        let (all, to_part) = (weight * s.length, weight * s.moment);
        let from_part = all - to_part;
        let (from, to) = (s.from as usize, s.to as usize);
        let (along, across) = if s.level { (&mut *dv, &mut *du) } else { (&mut *du, &mut *dv) };
        along[from] += from_part;
        across[from] -= s.slope * from_part;
        along[to] += to_part;
        across[to] -= s.slope * to_part;
    }
}
