//! The point-sampled mask: 1 where the centre of a pixel is inside a projected triangle, its border
//! included, 0 elsewhere. Its gradient is zero almost everywhere, and taken as zero.

use std::cell::RefCell;

use super::order::RowOrder;
use super::outline::Outline;
use super::{Model, Pixel, Screen, Size};

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    outline: Outline,
    order: RowOrder,
    /// For each column: change of layers between the centre before and this one.
    change: Vec<i32>,
    /// Columns whose centre is on an edge.
    touched: Vec<usize>,
}

/// Distance in pixels up to which a centre is on an edge.
const ON_EDGE: f64 = 1e-10;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Draw the mask; every pixel of `out` is written.
pub fn draw<T: Pixel>(model: &Model, screen: &Screen, size: Size, out: &mut [T]) {
    SCRATCH.with_borrow_mut(|scratch| {
        let Scratch { outline, order, change, touched } = scratch;
        let Size { height, width } = size;
        outline.find(model, screen, 0.0, height as f64, width as f64);
        let Some(extent) = outline.extent(height, width) else {
            out.fill(T::default());
            return;
        };
        let edges = &outline.edges;
        let (first, last) = extent.rows;
        out[..first * width].fill(T::default());
        out[last * width..].fill(T::default());
        order.begin(edges, first, last);
        let (c0, c1) = extent.columns;
        change.clear();
        change.resize(c1 - c0 + 1, 0);
        // The first column whose centre is at x or to the right of it, counted from c0.
        let column = |x: f64| {
            let c = (x - 0.5 - c0 as f64).ceil();
            if c <= 0.0 { 0 } else { (c as usize).min(c1 - c0) }
        };
        let one = T::from_f64(1.0);
        for row in first..last {
            order.enter(row - first);
            let line = &mut out[row * width..(row + 1) * width];
            let (centre, bottom) = (row as f64 + 0.5, (row + 1) as f64);
            order.active.retain(|&id| {
                let e = &edges[id as usize];
                if e.y0 <= centre && centre < e.y1 {
                    let x = e.x_at(centre);
                    let at = column(x);
                    change[at] += e.step;
                    // A centre on the edge, but for rounding.
                    let nearest = (x - 0.5).round();
                    if (x - 0.5 - nearest).abs() < ON_EDGE
                        && (c0 as f64..c1 as f64).contains(&nearest)
                    {
                        touched.push(nearest as usize);
                    }
                }
                e.y1 >= bottom
            });
            let mut layers = 0;
            line[..c0].fill(T::default());
            line[c1..].fill(T::default());
            for (pixel, change) in line[c0..c1].iter_mut().zip(change.iter_mut()) {
                layers += std::mem::take(change);
                *pixel = if layers > 0 { one } else { T::default() };
            }
            change[c1 - c0] = 0;
            for column in touched.drain(..) {
                line[column] = one;
            }
        }
        borders(edges, size, out);
    });
}

/// Centres exactly on a net edge: on one side of it there is a triangle.
fn borders<T: Pixel>(edges: &[super::outline::NetEdge], size: Size, out: &mut [T]) {
    let one = T::from_f64(1.0);
    let on_grid = |x: f64| (x - 0.5).fract() == 0.0;
    let Size { height, width } = size;
    for e in edges {
        let upright = e.x0 == e.x1 && on_grid(e.x0);
        let level = e.y0 == e.y1 && on_grid(e.y0);
        let lower_end = on_grid(e.y1) && on_grid(e.x1);
        if !(upright || level || lower_end) {
            continue;
        }
        let first = |x: f64| ((x - 0.5).ceil().max(0.0)) as usize;
        let after = |x: f64, n: usize| (x + 0.5).floor().clamp(0.0, n as f64) as usize;
        let (low, high) = if e.x0 < e.x1 { (e.x0, e.x1) } else { (e.x1, e.x0) };
        if upright || level {
            for row in first(e.y0)..after(e.y1, height) {
                let columns = first(low)..after(high, width);
                if !columns.is_empty() {
                    out[row * width..][columns].fill(one);
                }
            }
        } else if e.x1 > 0.0 && e.y1 > 0.0 && e.x1 < width as f64 && e.y1 < height as f64 {
            out[e.y1 as usize * width + e.x1 as usize] = one;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::raster::View;

    /// Closed triangles, one centre at a time.
    fn slow(points: &[[f64; 2]], faces: &[[u32; 3]], size: Size) -> Vec<f64> {
        let inside = |x: f64, y: f64| {
            faces.iter().any(|f| {
                let p = f.map(|k| points[k as usize]);
                let side = |a: [f64; 2], b: [f64; 2], x: f64, y: f64| {
                    (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
                };
                let s = [side(p[0], p[1], x, y), side(p[1], p[2], x, y), side(p[2], p[0], x, y)];
                side(p[0], p[1], p[2][0], p[2][1]) != 0.0
                    && (s.iter().all(|s| *s >= 0.0) || s.iter().all(|s| *s <= 0.0))
            })
        };
        (0..size.pixels())
            .map(|k| {
                f64::from(inside((k % size.width) as f64 + 0.5, (k / size.width) as f64 + 0.5))
            })
            .collect()
    }

    #[test]
    fn centres_inside_and_on_the_border_are_covered() {
        let size = Size { height: 7, width: 9 };
        let mut seed = 3_u64;
        let mut next = |n: u64| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) % n
        };
        for round in 0..300 {
            // Halves and quarters: many centres are exactly on an edge or at a corner.
            let points: Vec<[f64; 2]> = (0..8)
                .map(|_| [next(48) as f64 / 4.0 - 1.5, next(40) as f64 / 4.0 - 1.5])
                .collect();
            let faces: Vec<[u32; 3]> =
                (0..=round % 5).map(|_| [next(8) as u32, next(8) as u32, next(8) as u32]).collect();
            let vertices: Vec<[f64; 3]> = points.iter().map(|p| [p[0], p[1], 0.0]).collect();
            let model = Model::new(&vertices, &faces).expect("valid");
            let view = View {
                rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                translation: [0.0, 0.0, 1.0],
                camera: Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("valid"),
            };
            let mut screen = Screen::default();
            screen.project(&model, &view, 1e-3).expect("drawn");
            let mut out = vec![f64::NAN; size.pixels()];
            draw(&model, &screen, size, &mut out);
            let expected = slow(&points, &faces, size);
            for (k, (a, b)) in out.iter().zip(&expected).enumerate() {
                assert!(
                    (a - b).abs() < 0.5,
                    "round {round}, pixel {k}: {a}, expected {b}\n{points:?}\n{faces:?}"
                );
            }
        }
    }
}
