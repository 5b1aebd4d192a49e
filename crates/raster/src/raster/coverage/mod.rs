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

use std::cell::RefCell;
use std::thread::LocalKey;

use rayon::prelude::*;

use self::cell::{Piece, Rectangle, single, transposed};
use self::rows::{Rows, Visitor};
use self::solver::{Sink, Solver};
use super::blur::{self, Kernel};
use super::outline::{Extent, NetEdge, Outline};
use super::{Model, Pixel, Screen, Size};

/// Buffers for a band of rows.
#[derive(Debug, Default)]
struct Worker {
    rows: Rows,
    solver: Solver,
    turned: Vec<Piece>,
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
    lend(&OUTLINE, |outline| {
        let kernel = Kernel::new(sigma);
        let (height, width) = kernel.padded(size);
        outline.find(model, screen, kernel.radius() as f64, height as f64, width as f64);
        let Some(extent) = outline.extent(height, width) else {
            out.fill(T::default());
            return;
        };
        if kernel.radius() == 0 {
            let (first, last) = extent.rows;
            out[..first * width].fill(T::default());
            out[last * width..].fill(T::default());
            areas(outline, extent, &mut out[first * width..last * width], width, 0);
            return;
        }
        blur::with_canvas(|canvas: &mut Vec<T>| {
            let (n, m) = (extent.rows.1 - extent.rows.0, extent.columns.1 - extent.columns.0);
            canvas.clear();
            canvas.resize(n * m, T::default());
            areas(outline, extent, canvas, m, extent.columns.0);
            kernel.forward(canvas, extent.rows, extent.columns, size, out);
        });
    });
}

/// The areas of the rows of an extent, from column `first` on, `stride` pixels a row.
fn areas<T: Pixel>(outline: &Outline, extent: Extent, out: &mut [T], stride: usize, first: usize) {
    let one = |band: Extent, out: &mut [T]| {
        lend(&WORKER, |worker| {
            let canvas = Canvas { out, stride, origin: (band.rows.0, first), extent: band };
            let mut painter = Painter { canvas, solver: &mut worker.solver };
            worker.rows.walk(&outline.edges, band, &mut painter);
        });
    };
    let rows = rows_of_band(extent);
    if rows == extent.rows.1 - extent.rows.0 {
        one(extent, out);
    } else {
        let parts = out.par_chunks_mut(rows * stride).enumerate();
        parts.for_each(|(k, out)| one(band(extent, rows, k), out));
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
    lend(&OUTLINE, |outline| {
        let kernel = Kernel::new(sigma);
        let (height, width) = kernel.padded(size);
        outline.find(model, screen, kernel.radius() as f64, height as f64, width as f64);
        let Some(extent) = outline.extent(height, width) else { return };
        if kernel.radius() == 0 {
            forces(outline, extent, upstream, width, (0, 0), du, dv);
        } else {
            blur::with_canvas(|canvas: &mut Vec<T>| {
                kernel.adjoint(upstream, size, extent.rows, extent.columns, canvas);
                let stride = extent.columns.1 - extent.columns.0;
                let origin = (extent.rows.0, extent.columns.0);
                forces(outline, extent, canvas, stride, origin, du, dv);
            });
        }
        outline.share(model, du);
        outline.share(model, dv);
    });
}

/// The gradient for image points from the one for areas, whose first pixel is `origin`.
fn forces<T: Pixel>(
    outline: &Outline,
    extent: Extent,
    weights: &[T],
    stride: usize,
    origin: (usize, usize),
    du: &mut [f64],
    dv: &mut [f64],
) {
    let edges = &outline.edges[..];
    let one = |band: Extent, du: &mut [f64], dv: &mut [f64]| {
        lend(&WORKER, |worker| {
            let Worker { rows, solver, turned } = worker;
            let forces = Forces { edges, du, dv };
            let mut collector = Collector { weights, stride, origin, solver, turned, forces };
            rows.walk(edges, band, &mut collector);
        });
    };
    let rows = rows_of_band(extent);
    let height = extent.rows.1 - extent.rows.0;
    if rows == height {
        one(extent, du, dv);
        return;
    }
    let parts: Vec<_> = (0..height.div_ceil(rows))
        .into_par_iter()
        .map(|k| {
            let (mut du, mut dv) = (vec![0.0; du.len()], vec![0.0; dv.len()]);
            one(band(extent, rows, k), &mut du, &mut dv);
            (du, dv)
        })
        .collect();
    for (part_u, part_v) in parts {
        for (sum, part) in du.iter_mut().zip(part_u).chain(dv.iter_mut().zip(part_v)) {
            *sum += part;
        }
    }
}

/// Writes areas.
struct Painter<'a, T> {
    canvas: Canvas<'a, T>,
    solver: &'a mut Solver,
}

/// Where areas go.
struct Canvas<'a, T> {
    out: &'a mut [T],
    stride: usize,
    /// Row and column of the first pixel.
    origin: (usize, usize),
    extent: Extent,
}

impl<T: Pixel> Canvas<'_, T> {
    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> usize {
        (row - self.origin.0) * self.stride + column - self.origin.1
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
    fn edge(&mut self, _edge: u32, _height: f64, _moment: f64) {}
}

impl<T: Pixel> Visitor for Painter<'_, T> {
    fn row(&mut self, row: usize) {
        // What lies beside the extent.
        let at = self.canvas.at(row, self.canvas.origin.1);
        let (left, right) = self.canvas.extent.columns;
        let line = &mut self.canvas.out[at..at + self.canvas.stride];
        line[..left - self.canvas.origin.1].fill(T::default());
        line[right - self.canvas.origin.1..].fill(T::default());
    }

    fn plain(&mut self, row: usize, from: usize, to: usize, covered: bool) {
        let (from, to) = (self.canvas.at(row, from), self.canvas.at(row, to));
        let value = if covered { T::from_f64(1.0) } else { T::default() };
        self.canvas.out[from..to].fill(value);
    }

    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32) {
        let area = if let [piece] = pieces {
            single(piece, layers).0
        } else {
            let mut sum = Sum(0.0);
            self.solver.solve(UNIT, pieces, layers, &mut sum);
            sum.0
        };
        let at = self.canvas.at(row, column);
        self.canvas.out[at] = T::from_f64(area.clamp(0.0, 1.0));
    }
}

/// Adds up the gradient: by a sweep down, and for (nearly) level edges by one to the right.
struct Collector<'a, T> {
    /// The gradient for areas.
    weights: &'a [T],
    stride: usize,
    /// Row and column of the first weight.
    origin: (usize, usize),
    solver: &'a mut Solver,
    turned: &'a mut Vec<Piece>,
    forces: Forces<'a>,
}

/// The gradient for image points so far.
struct Forces<'a> {
    edges: &'a [NetEdge],
    du: &'a mut [f64],
    dv: &'a mut [f64],
}

/// A pixel, and the gradient for its area.
#[derive(Debug, Clone, Copy)]
struct Site {
    weight: f64,
    row: f64,
    column: f64,
}

impl Forces<'_> {
    /// The stretch of an edge in one pixel: its extent downwards and to the right, with the sign of
    /// its outer side, and the mean of where it is between the ends of the edge.
    #[inline(always)]
    fn push(&mut self, e: &NetEdge, u: f64, v: f64, along_u: f64, along_v: f64) {
        let (from, to) = (e.from as usize, e.to as usize);
        self.du[from] += u - along_u;
        self.dv[from] += v - along_v;
        self.du[to] += along_u;
        self.dv[to] += along_v;
    }
}

/// Results of the sweep down.
struct Down<'a, 'b>(&'a mut Forces<'b>, Site);

impl Sink for Down<'_, '_> {
    #[inline(always)]
    fn area(&mut self, _area: f64) {}

    #[inline(always)]
    fn edge(&mut self, edge: u32, height: f64, moment: f64) {
        let e = self.0.edges[edge as usize];
        if e.is_steep() {
            let site = self.1;
            let whole = 1.0 / (e.y1 - e.y0);
            let (sum, along) =
                (site.weight * height, site.weight * (moment + (site.row - e.y0) * height) * whole);
            self.0.push(&e, sum, -e.slope * sum, along, -e.slope * along);
        }
    }
}

/// Results of the sweep to the right: its right-hand side is below.
struct Right<'a, 'b>(&'a mut Forces<'b>, Site);

impl Sink for Right<'_, '_> {
    #[inline(always)]
    fn area(&mut self, _area: f64) {}

    #[inline(always)]
    fn edge(&mut self, edge: u32, width: f64, moment: f64) {
        let e = self.0.edges[edge as usize];
        if !e.is_steep() {
            let site = self.1;
            let whole = 1.0 / (e.x1 - e.x0);
            let slope = (e.y1 - e.y0) * whole;
            let (sum, along) = (
                site.weight * width,
                site.weight * (moment + (site.column - e.x0) * width) * whole,
            );
            self.0.push(&e, -slope * sum, sum, -slope * along, along);
        }
    }
}

impl<T: Pixel> Visitor for Collector<'_, T> {
    fn row(&mut self, _row: usize) {}

    fn plain(&mut self, _row: usize, _from: usize, _to: usize, _covered: bool) {}

    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32) {
        let at = (row - self.origin.0) * self.stride + column - self.origin.1;
        let weight = self.weights[at].to_f64();
        if weight == 0.0 {
            return;
        }
        let site = Site { weight, row: row as f64, column: column as f64 };
        let edges = self.forces.edges;
        if let [p] = pieces {
            if let (_, Some(ahead)) = single(p, layers) {
                let e = &edges[p.edge as usize];
                let weight = if ahead { weight } else { -weight };
                let along = if e.is_steep() {
                    (0.5 * (p.y0 + p.y1) + site.row - e.y0) / (e.y1 - e.y0)
                } else {
                    (0.5 * (p.x0 + p.x1) + site.column - e.x0) / (e.x1 - e.x0)
                };
                let (u, v) = (weight * (p.y1 - p.y0), -weight * (p.x1 - p.x0));
                self.forces.push(e, u, v, along * u, along * v);
            }
            return;
        }
        let steep = |p: &Piece| edges[p.edge as usize].is_steep();
        if pieces.iter().any(steep) {
            self.solver.solve(UNIT, pieces, layers, &mut Down(&mut self.forces, site));
        }
        if !pieces.iter().all(steep) {
            transposed(pieces, self.turned);
            self.solver.solve(UNIT, self.turned, layers, &mut Right(&mut self.forces, site));
        }
    }
}

#[cfg(test)]
mod tests;
