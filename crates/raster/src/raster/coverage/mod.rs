//! The area of the union of the projected triangles inside each pixel, and its gradient.
//!
//! `S = g_sigma * A`, where `A_ij` is the area of the union inside pixel `(i, j)` and `g` a
//! separable Gaussian. The mask depends on the union only: not on the order of the faces, their
//! winding, duplicates or how a surface is cut into triangles; the sum of the mask is the area of
//! the union. The gradient is the boundary integral of Reynolds' transport theorem: where a
//! stretch of outline of length `l` moves outwards by `d`, its pixel gains the area `l d`.
//! Crossings of edges need no derivative of their own (they move along the outline).
//!
//! The area inside a pixel is exact up to rounding in `f64`, for every input: see `rows` and
//! `cell`.

mod cell;
mod pairs;
mod rows;
mod solver;
mod trace;

use std::cell::RefCell;
use std::thread::LocalKey;

use rayon::prelude::*;

use self::cell::{Piece, Rectangle, single};
use self::rows::{Rows, Visitor};
use self::solver::{Sink, Solver};
pub use self::trace::Trace;
use self::trace::{Kind, Segment, Tracer};
use super::blur::{self, Buffers};
use super::outline::{Extent, Outline};
use super::{Model, Pixel, Screen, Size};

/// Buffers for a band of rows.
#[derive(Debug, Default)]
struct Worker {
    rows: Rows,
    solver: Solver,
    turned: Vec<Piece>,
    segments: Vec<Segment>,
}

thread_local! {
    static OUTLINE: RefCell<Outline> = RefCell::default();
    static WORKER: RefCell<Worker> = RefCell::default();
}

/// Lend a buffer of this thread. It is taken out meanwhile: a thread that waits for bands may be
/// given another image to draw.
fn lend<B: Default, O>(kept: &'static LocalKey<RefCell<B>>, work: impl FnOnce(&mut B) -> O) -> O {
    let mut buffer = kept.take();
    let out = work(&mut buffer);
    kept.set(buffer);
    out
}

const UNIT: Rectangle = Rectangle { left: 0.0, right: 1.0, top: 0.0, bottom: 1.0 };

/// An extent of more pixels than this is shared out in bands.
const LARGE: usize = 1 << 18;

/// Rows of a band.
const BAND: usize = 64;

/// Rows of the parts of an extent that are worked on side by side: the same for any number of
/// threads.
fn rows_of_band(extent: Extent) -> usize {
    let rows = extent.rows.1 - extent.rows.0;
    let large = rows * (extent.columns.1 - extent.columns.0) > LARGE;
    if large { BAND } else { rows }
}

/// The part of an extent with the number `k`.
fn band(extent: Extent, rows: usize, k: usize) -> Extent {
    let first = extent.rows.0 + k * rows;
    Extent { rows: (first, (first + rows).min(extent.rows.1)), ..extent }
}

/// Draw the mask; every pixel of `out` is written. `sigma` in pixels.
pub fn draw<T: Pixel>(model: &Model, screen: &Screen, size: Size, sigma: f64, out: &mut [T]) {
    draw_traced(model, screen, size, sigma, out, false);
}

/// As [`draw`]. With `traced`, the outline is returned too, so that [`back_of`] need not find it
/// again; `None` for an image that is shared out in bands or has faces cut at the near plane.
pub(super) fn draw_traced<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    out: &mut [T],
    traced: bool,
) -> Option<Trace> {
    blur::with_kernel(sigma, |kernel| {
        lend(&OUTLINE, |outline| {
            let (height, width) = kernel.padded(size);
            outline.find(model, screen, kernel.radius() as f64, height as f64, width as f64);
            if size.pixels() > LARGE {
                out.par_chunks_mut(BAND * size.width).for_each(|rows| rows.fill(T::default()));
            } else {
                out.fill(T::default());
            }
            let extent = outline.extent(height, width)?;
            let kind = Kind { vertices: model.vertex_count(), size, sigma };
            let mut trace = (traced && !screen.is_clipped()).then(|| Trace::new(kind, extent));
            if kernel.radius() == 0 {
                let (first, last) = extent.rows;
                let out = &mut out[first * width..last * width];
                return areas(outline, extent, out, width, 0, trace);
            }
            blur::with_buffers(|buffers: &mut Buffers<T>| {
                let (n, m) = (extent.rows.1 - extent.rows.0, extent.columns.1 - extent.columns.0);
                let canvas = &mut buffers.canvas;
                canvas.clear();
                canvas.resize(n * m, T::default());
                trace = areas(outline, extent, canvas, m, extent.columns.0, trace.take());
                kernel.forward(buffers, extent.rows, extent.columns, size, out);
            });
            trace
        })
    })
}

/// The areas of the rows of an extent, from column `first` on, `stride` pixels a row, into zeros.
fn areas<T: Pixel>(
    outline: &Outline,
    extent: Extent,
    out: &mut [T],
    stride: usize,
    first: usize,
    trace: Option<Trace>,
) -> Option<Trace> {
    let rows = rows_of_band(extent);
    let edges = &outline.edges[..];
    let paint = |band: Extent, out: &mut [T], trace: Option<&mut Trace>| {
        lend(&WORKER, |worker| {
            let Worker { rows, solver, turned, segments } = worker;
            let canvas = Canvas { out, stride, origin: (band.rows.0, first) };
            let Some(trace) = trace else {
                rows.walk(edges, band, &mut Painter { canvas, solver });
                return;
            };
            segments.clear();
            let tracer = Tracer { edges, solver, turned, segments };
            rows.walk(edges, band, &mut Both { canvas, tracer });
            trace.segments.clone_from(segments);
        });
    };
    if rows == extent.rows.1 - extent.rows.0 {
        let mut trace = trace;
        paint(extent, out, trace.as_mut());
        trace
    } else {
        let parts = out.par_chunks_mut(rows * stride).enumerate();
        parts.for_each(|(k, out)| paint(band(extent, rows, k), out, None));
        None
    }
}

/// Add the gradient of `sum(upstream * mask)` for image points to `du` and `dv`.
pub fn back<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    upstream: &[T],
    du: &mut [f64],
    dv: &mut [f64],
) {
    back_of(None, model, screen, size, sigma, upstream, [du, dv]);
}

/// As [`back`], with the trace of the same image or without.
pub(super) fn back_of<T: Pixel>(
    trace: Option<&Trace>,
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    upstream: &[T],
    [du, dv]: [&mut [f64]; 2],
) {
    blur::with_kernel(sigma, |kernel| {
        lend(&OUTLINE, |outline| {
            let (height, width) = kernel.padded(size);
            let extent = if let Some(trace) = trace {
                trace.extent
            } else {
                outline.find(model, screen, kernel.radius() as f64, height as f64, width as f64);
                let Some(extent) = outline.extent(height, width) else { return };
                extent
            };
            let mut forces = |weights: &[T], stride: usize, first: usize| match trace {
                Some(trace) => trace::apply(&trace.segments, weights, du, dv),
                None => forces(outline, extent, weights, stride, first, du, dv),
            };
            if kernel.radius() == 0 {
                let (first, last) = extent.rows;
                forces(&upstream[first * width..last * width], width, 0);
            } else {
                blur::with_buffers(|buffers: &mut Buffers<T>| {
                    kernel.adjoint(upstream, size, extent.rows, extent.columns, buffers);
                    let canvas = &buffers.canvas;
                    forces(canvas, extent.columns.1 - extent.columns.0, extent.columns.0);
                });
            }
            let topology = screen.is_clipped().then_some(&*outline);
            for gradient in [du, dv] {
                match topology {
                    Some(outline) => outline.share(model, gradient),
                    None => model.topology().share(gradient),
                }
            }
        });
    });
}

/// The gradient for image points from the one for the areas of an extent, from column `first` on.
fn forces<T: Pixel>(
    outline: &Outline,
    extent: Extent,
    weights: &[T],
    stride: usize,
    first: usize,
    du: &mut [f64],
    dv: &mut [f64],
) {
    let edges = &outline.edges[..];
    let one = |band: Extent, weights: &[T], du: &mut [f64], dv: &mut [f64]| {
        lend(&WORKER, |worker| {
            let Worker { rows, solver, turned, segments } = worker;
            segments.clear();
            let tracer = Tracer { edges, solver, turned, segments };
            rows.walk(
                edges,
                band,
                &mut OutlineOnly { tracer, stride, origin: (band.rows.0, first) },
            );
            trace::apply(segments, weights, du, dv);
        });
    };
    let rows = rows_of_band(extent);
    let height = extent.rows.1 - extent.rows.0;
    if rows == height {
        one(extent, weights, du, dv);
        return;
    }
    let parts: Vec<_> = (0..height.div_ceil(rows))
        .into_par_iter()
        .map(|k| {
            let (mut du, mut dv) = (vec![0.0; du.len()], vec![0.0; dv.len()]);
            one(band(extent, rows, k), &weights[k * rows * stride..], &mut du, &mut dv);
            (du, dv)
        })
        .collect();
    for (part_u, part_v) in parts {
        for (sum, part) in du.iter_mut().zip(part_u).chain(dv.iter_mut().zip(part_v)) {
            *sum += part;
        }
    }
}

/// Where areas go.
struct Canvas<'a, T> {
    out: &'a mut [T],
    stride: usize,
    /// Row and column of the first pixel.
    origin: (usize, usize),
}

impl<T: Pixel> Canvas<'_, T> {
    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> usize {
        (row - self.origin.0) * self.stride + column - self.origin.1
    }

    #[inline(always)]
    fn cover(&mut self, row: usize, from: usize, to: usize) {
        let (from, to) = (self.at(row, from), self.at(row, to));
        self.out[from..to].fill(T::from_f64(1.0));
    }

    #[inline(always)]
    fn set(&mut self, at: usize, area: f64) {
        self.out[at] = T::from_f64(area.clamp(0.0, 1.0));
    }
}

/// Adds up areas.
struct Sum(f64);

impl Sink for Sum {
    #[inline(always)]
    fn area(&mut self, area: f64) {
        self.0 += area;
    }

    #[inline(always)]
    fn edge(&mut self, _edge: u32, _height: f64, _middle: f64) {}
}

/// Writes areas.
struct Painter<'a, T> {
    canvas: Canvas<'a, T>,
    solver: &'a mut Solver,
}

impl<T: Pixel> Visitor for Painter<'_, T> {
    fn covered(&mut self, row: usize, from: usize, to: usize) {
        self.canvas.cover(row, from, to);
    }

    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32) {
        let area = if let [piece] = pieces {
            single(piece, layers).0
        } else {
            let mut sum = Sum(0.0);
            self.solver.solve(UNIT, pieces, layers, &mut sum);
            sum.0
        };
        self.canvas.set(self.canvas.at(row, column), area);
    }
}

/// Writes areas and keeps the outline.
struct Both<'a, T> {
    canvas: Canvas<'a, T>,
    tracer: Tracer<'a>,
}

impl<T: Pixel> Visitor for Both<'_, T> {
    fn covered(&mut self, row: usize, from: usize, to: usize) {
        self.canvas.cover(row, from, to);
    }

    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32) {
        let at = self.canvas.at(row, column);
        let area = self.tracer.pixel(at as u32, row, column, pieces, layers);
        self.canvas.set(at, area);
    }
}

/// Keeps the outline.
struct OutlineOnly<'a> {
    tracer: Tracer<'a>,
    stride: usize,
    /// Row and column of the pixel with the number 0.
    origin: (usize, usize),
}

impl Visitor for OutlineOnly<'_> {
    fn covered(&mut self, _row: usize, _from: usize, _to: usize) {}

    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32) {
        let at = (row - self.origin.0) * self.stride + column - self.origin.1;
        self.tracer.pixel(at as u32, row, column, pieces, layers);
    }
}

#[cfg(test)]
mod tests;
