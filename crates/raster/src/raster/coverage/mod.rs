//! The area of the union of the projected triangles inside each pixel, and its gradient.
//!
//! `S = g_sigma * A`, where `A_ij` is the area of the union inside pixel `(i, j)` and `g` a
//! separable Gaussian. The mask depends on the union only: not on the order of the faces, their
//! winding, duplicates or how a surface is cut into triangles; the sum of the mask is the area of
//! the union. The gradient is the boundary integral of Reynolds' transport theorem: where a
//! stretch of outline of length `l` moves outwards by `d`, its pixel gains the area `l d`.
//! Crossings of edges need no derivative of their own (they move along the outline).
//!
//! Row by row, edges are cut into pieces (`parts`), whole numbers tell which pixels an outline can
//! run through (`columns`), and those with few pieces are solved eight at a time (`lanes`), the
//! others one by one (`pairs`, `cell`). The area inside a pixel is exact up to rounding in `f64`,
//! for every input.

#![expect(
    clippy::inline_always,
    clippy::needless_bitwise_bool,
    clippy::needless_range_loop,
    reason = "lanes: a function that is not inlined loses the instruction set of its caller"
)]

mod cell;
mod columns;
mod lanes;
mod pairs;
mod parts;
mod register;
mod rows;
mod solver;
mod target;
mod trace;
mod waiting;

use std::cell::RefCell;
use std::thread::LocalKey;

use pulp::Arch;
use rayon::prelude::*;

use self::cell::{Piece, Rectangle};
use self::rows::{Rows, walk};
use self::solver::Solver;
use self::target::{Layout, Target};
pub use self::trace::Trace;
use self::trace::{Kind, Segments};
use super::blur::{self, Buffers};
use super::outline::{Extent, Outline};
use super::{Background, Model, Pixel, Screen, Size, add_in_order};

/// Buffers for a band of rows.
#[derive(Debug, Default)]
struct Worker {
    rows: Rows,
    solver: Solver,
    turned: Vec<Piece>,
    segments: Segments,
}

thread_local! {
    static ARCH: Arch = Arch::new();
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
    let rows = extent.height();
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
    draw_traced(model, screen, size, sigma, (out, Background::Near), false);
}

/// As [`draw`]. With `traced`, the outline is returned too, so that [`back_of`] need not find it
/// again; `None` for an image that is shared out in bands or has faces cut at the near plane.
pub(super) fn draw_traced<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    (out, background): (&mut [T], Background),
    traced: bool,
) -> Option<Trace> {
    blur::with_kernel(sigma, |kernel| {
        lend(&OUTLINE, |outline| {
            let (height, width) = kernel.padded(size);
            outline.find(model, screen, kernel.radius() as f64, height as f64, width as f64);
            let extent = outline.extent(height, width);
            let clear = |out: &mut [T]| background.fill_together(out, T::default());
            // Those who work on an image as a whole write all of it, and those who work on bands
            // the rows of these.
            match extent {
                Some(extent) if kernel.radius() == 0 => {
                    if rows_of_band(extent) < extent.height() {
                        clear(&mut out[..extent.rows.0 * size.width]);
                        clear(&mut out[extent.rows.1 * size.width..]);
                    }
                }
                _ => clear(out),
            }
            let extent = extent?;
            let kind = Kind { vertices: model.vertex_count(), size, sigma };
            let mut trace = (traced && !screen.is_clipped()).then(|| Trace::new(kind, extent));
            if kernel.radius() == 0 {
                let layout = Layout { stride: width, origin: (0, 0), background };
                return areas(outline, extent, out, layout, trace);
            }
            blur::with_buffers(|buffers: &mut Buffers<T>| {
                let (n, m) = (extent.height(), extent.columns.1 - extent.columns.0);
                let canvas = &mut buffers.canvas;
                canvas.resize(n * m, T::default());
                let origin = (extent.rows.0, extent.columns.0);
                let layout = Layout { stride: m, origin, background: Background::Near };
                trace = areas(outline, extent, canvas, layout, trace.take());
                kernel.forward(buffers, extent.rows, extent.columns, size, out);
            });
            trace
        })
    })
}

/// The areas of an extent; every pixel of the rows of the extent is written, and, of images that
/// are worked on as a whole, every other too.
fn areas<T: Pixel>(
    outline: &Outline,
    extent: Extent,
    out: &mut [T],
    layout: Layout,
    trace: Option<Trace>,
) -> Option<Trace> {
    let rows = rows_of_band(extent);
    let Layout { stride, origin, .. } = layout;
    let edges = &outline.edges[..];
    let paint = |band: Extent, origin, out: &mut [T], trace: Option<&mut Trace>| {
        lend(&WORKER, |worker| {
            let Worker { rows, solver, turned, segments } = worker;
            let (traced, segments) = match trace {
                Some(trace) => (true, &mut trace.segments),
                None => (false, segments),
            };
            let layout = Layout { origin, ..layout };
            let mut target = Target::new(out, layout, segments, (solver, turned));
            if traced {
                walk::<T, true, true>(rows, edges, band, &mut target);
            } else {
                walk::<T, true, false>(rows, edges, band, &mut target);
            }
        });
    };
    if rows == extent.height() {
        let mut trace = trace;
        paint(extent, origin, out, trace.as_mut());
        trace
    } else {
        let out =
            &mut out[(extent.rows.0 - origin.0) * stride..(extent.rows.1 - origin.0) * stride];
        let parts = out.par_chunks_mut(rows * stride).enumerate();
        parts.for_each(|(k, out)| {
            let band = band(extent, rows, k);
            paint(band, (band.rows.0, origin.1), out, None);
        });
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
            if kernel.radius() == 0 {
                let (first, last) = extent.rows;
                let rows = &upstream[first * width..last * width];
                match trace {
                    Some(trace) => trace::apply(&trace.segments, upstream, du, dv),
                    None => forces(outline, extent, rows, width, 0, du, dv),
                }
            } else {
                blur::with_buffers(|buffers: &mut Buffers<T>| {
                    kernel.adjoint(upstream, size, extent.rows, extent.columns, buffers);
                    let (canvas, stride) = (&buffers.canvas, extent.columns.1 - extent.columns.0);
                    match trace {
                        Some(trace) => trace::apply(&trace.segments, canvas, du, dv),
                        None => forces(outline, extent, canvas, stride, extent.columns.0, du, dv),
                    }
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
            let origin = (band.rows.0, first);
            let layout = Layout { stride, origin, background: Background::Near };
            let mut target = Target::<T>::new(&mut [], layout, segments, (solver, turned));
            walk::<T, false, true>(rows, edges, band, &mut target);
            trace::apply(segments, weights, du, dv);
        });
    };
    let rows = rows_of_band(extent);
    let height = extent.height();
    if rows == height {
        one(extent, weights, du, dv);
        return;
    }
    add_in_order(height.div_ceil(rows), [du, dv], |k, du, dv| {
        one(band(extent, rows, k), &weights[k * rows * stride..], du, dv);
    });
}

#[cfg(test)]
mod tests;
