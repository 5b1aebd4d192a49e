//! The area of the union of the projected triangles inside each pixel, and its gradient.
//!
//! `S = g_sigma * A`, where `A_ij` is the area of the union inside pixel `(i, j)` and `g` a
//! separable Gaussian. The mask depends on the union only: not on the order of the faces, their
//! winding, duplicates or how a surface is cut into triangles; the sum of the mask is the area of
//! the union. The gradient is the boundary integral of Reynolds' transport theorem: where a
//! stretch of outline of length `l` moves outwards by `d`, its pixel gains the area `l d`.
//! Crossings of edges need no derivative of their own (they move along the outline).
//!
//! The area inside a pixel is exact up to rounding in `f64`, for every input: see [`rows`] and
//! [`cell`].

mod cell;
mod rows;

use std::cell::RefCell;

use self::cell::{Cell, Piece, Rectangle, Stretch, transposed};
use self::rows::{Rows, Visitor};
use super::blur::{self, Kernel};
use super::outline::{Extent, NetEdge, Outline};
use super::{Model, Pixel, Screen, Size};

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    outline: Outline,
    rows: Rows,
    cell: Cell,
    steep: Vec<Stretch>,
    turned: Vec<Piece>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

const UNIT: Rectangle = Rectangle { left: 0.0, right: 1.0, top: 0.0, bottom: 1.0 };

/// Draw the mask; every pixel of `out` is written. `sigma` in pixels.
pub fn draw<T: Pixel>(model: &Model, screen: &Screen, size: Size, sigma: f64, out: &mut [T]) {
    SCRATCH.with_borrow_mut(|scratch| {
        let Scratch { outline, rows, cell, .. } = scratch;
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
            let mut painter = Painter { out, stride: width, extent, whole: true, cell };
            rows.walk(&outline.edges, extent, &mut painter);
            return;
        }
        blur::with_canvas(|canvas: &mut Vec<T>| {
            let (n, m) = (extent.rows.1 - extent.rows.0, extent.columns.1 - extent.columns.0);
            canvas.clear();
            canvas.resize(n * m, T::default());
            let mut painter = Painter { out: canvas, stride: m, extent, whole: false, cell };
            rows.walk(&outline.edges, extent, &mut painter);
            kernel.forward(canvas, extent.rows, extent.columns, size, out);
        });
    });
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
    SCRATCH.with_borrow_mut(|scratch| {
        let Scratch { outline, rows, cell, steep, turned } = scratch;
        let kernel = Kernel::new(sigma);
        let (height, width) = kernel.padded(size);
        outline.find(model, screen, kernel.radius() as f64, height as f64, width as f64);
        let Some(extent) = outline.extent(height, width) else { return };
        let mut collect = |weights: &[T], stride: usize, origin: (usize, usize)| {
            let edges = &outline.edges[..];
            let mut collector =
                Collector { weights, stride, origin, edges, cell, steep, turned, du, dv };
            rows.walk(edges, extent, &mut collector);
        };
        if kernel.radius() == 0 {
            collect(upstream, width, (0, 0));
        } else {
            blur::with_canvas(|canvas: &mut Vec<T>| {
                kernel.adjoint(upstream, size, extent.rows, extent.columns, canvas);
                let stride = extent.columns.1 - extent.columns.0;
                collect(canvas, stride, (extent.rows.0, extent.columns.0));
            });
        }
        outline.share(model, du);
        outline.share(model, dv);
    });
}

/// Writes areas.
struct Painter<'a, T> {
    out: &'a mut [T],
    stride: usize,
    extent: Extent,
    /// Whether `out` is the whole canvas, or the extent only.
    whole: bool,
    cell: &'a mut Cell,
}

impl<T: Pixel> Painter<'_, T> {
    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> usize {
        if self.whole {
            row * self.stride + column
        } else {
            (row - self.extent.rows.0) * self.stride + column - self.extent.columns.0
        }
    }
}

impl<T: Pixel> Visitor for Painter<'_, T> {
    fn row(&mut self, row: usize) {
        if self.whole {
            let (c0, c1) = self.extent.columns;
            let row = &mut self.out[row * self.stride..(row + 1) * self.stride];
            row[..c0].fill(T::default());
            row[c1..].fill(T::default());
        }
    }

    fn plain(&mut self, row: usize, from: usize, to: usize, covered: bool) {
        let (from, to) = (self.at(row, from), self.at(row, to));
        self.out[from..to].fill(if covered { T::from_f64(1.0) } else { T::default() });
    }

    fn pixel(&mut self, row: usize, column: usize, pieces: &[Piece], layers: i32) {
        let area = self.cell.solve(UNIT, pieces, layers, &mut None);
        let at = self.at(row, column);
        self.out[at] = T::from_f64(area.clamp(0.0, 1.0));
    }
}

/// Adds up the gradient.
struct Collector<'a, T> {
    /// The gradient for areas.
    weights: &'a [T],
    stride: usize,
    /// Row and column of the first weight.
    origin: (usize, usize),
    edges: &'a [NetEdge],
    cell: &'a mut Cell,
    steep: &'a mut Vec<Stretch>,
    turned: &'a mut Vec<Piece>,
    du: &'a mut [f64],
    dv: &'a mut [f64],
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
        // Steep edges by the sweep down, flat ones by the sweep to the right: each along the axis
        // on which its ends are far apart.
        let steep = |e: &NetEdge| e.y1 - e.y0 >= (e.x1 - e.x0).abs();
        let edge = |p: &Piece| &self.edges[p.edge as usize];
        if pieces.iter().any(|p| steep(edge(p))) {
            self.steep.clear();
            self.cell.solve(UNIT, pieces, layers, &mut Some(self.steep));
            for s in self.steep.iter() {
                let e = &self.edges[s.edge as usize];
                if !steep(e) {
                    continue;
                }
                let length = s.to - s.from;
                let across = if s.ahead { weight * length } else { -weight * length };
                let along = (0.5 * (s.from + s.to) + row as f64 - e.y0) / (e.y1 - e.y0);
                push(self.du, self.dv, e, along, across, -e.slope * across);
            }
        }
        if pieces.iter().any(|p| !steep(edge(p))) {
            transposed(pieces, self.turned);
            self.steep.clear();
            self.cell.solve(UNIT, self.turned, layers, &mut Some(self.steep));
            for s in self.steep.iter() {
                let e = &self.edges[s.edge as usize];
                if steep(e) {
                    continue;
                }
                let length = s.to - s.from;
                let down = if s.ahead { weight * length } else { -weight * length };
                let along = (0.5 * (s.from + s.to) + column as f64 - e.x0) / (e.x1 - e.x0);
                let slope = (e.y1 - e.y0) / (e.x1 - e.x0);
                push(self.du, self.dv, e, along, -slope * down, down);
            }
        }
    }
}

/// Share a force between the ends of an edge.
#[inline(always)]
fn push(du: &mut [f64], dv: &mut [f64], e: &NetEdge, along: f64, u: f64, v: f64) {
    let along = along.clamp(0.0, 1.0);
    let (from, to) = (e.from as usize, e.to as usize);
    du[from] += (1.0 - along) * u;
    dv[from] += (1.0 - along) * v;
    du[to] += along * u;
    dv[to] += along * v;
}

#[cfg(test)]
mod tests;
