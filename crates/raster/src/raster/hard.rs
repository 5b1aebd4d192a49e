//! The point-sampled mask: 1 where the centre of a pixel is inside a projected triangle, its border
//! included, 0 elsewhere. Its gradient is zero almost everywhere, and taken as zero.
//!
//! Each net edge leaves, in each row whose centre line it crosses, its step of layers at the first
//! centre to the right of it, in a table of `i32` for bands of rows (up to 4 MiB, or one row, a
//! thread) and a bit that says so. The bits of a row then lead from one change to the next.

use std::cell::RefCell;
use std::ops::Range;

use multiversion::multiversion;

use super::outline::{Extent, Faces, Net, NetEdge, Outline};
use super::{Background, Beside, Model, Pixel, Screen, Size};

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    outline: Outline,
    /// Net edges that cross the centre line of a row.
    crossings: Vec<Crossing>,
    /// Net edges that may run exactly through a centre.
    borders: Vec<NetEdge>,
    table: Table,
    /// Pixels whose centre is on an edge.
    on_edge: Vec<usize>,
}

/// A net edge, and the rows whose centre line it crosses: known before the edge is looked up, so
/// that a wrong guess at their number costs little.
#[derive(Debug, Clone, Copy, Default)]
struct Crossing {
    edge: u32,
    first: u32,
    after: u32,
}

/// Changes of layers in a band of rows. All 0 between bands.
#[derive(Debug, Default)]
struct Table {
    /// For each column of each row, between the centre before and this one.
    change: Vec<i32>,
    /// For each column of each row, one bit: whether an edge is there.
    touched: Vec<u64>,
}

/// Distance in pixels up to which a centre is on an edge.
const ON_EDGE: f64 = 1e-10;

/// Columns of all rows of a band, unless one row has more.
const BAND: usize = 1 << 20;

/// Edges between two parts of the mask that are cleared.
const STEP: usize = 4;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// The nearest whole number, even if there are two, for up to 31 bits.
#[inline(always)]
fn nearest(x: f64) -> (f64, i32) {
    const SHIFT: f64 = 1.5 * (1_u64 << 52) as f64; // leaves no room for digits after the point
    let shifted = x + SHIFT;
    (shifted - SHIFT, shifted.to_bits() as i32)
}

/// The first whole number from `x` on, between 0 and `n`.
#[inline(always)]
fn first_from(x: f64, n: usize) -> usize {
    let n = n as f64;
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < n { x } else { n };
    let (rounded, whole) = nearest(x);
    (whole + i32::from(rounded < x)) as usize
}

/// Draw the mask; every pixel of `out` is written.
pub fn draw<T: Pixel>(model: &Model, screen: &Screen, size: Size, out: &mut [T]) {
    draw_over(model, screen, size, (out, Background::Near));
}

/// As [`draw`].
pub(super) fn draw_over<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    (out, background): (&mut [T], Background),
) {
    let mut mask = Mask { out: Beside::new(background, out, T::default()), width: size.width };
    SCRATCH.with_borrow_mut(|scratch| {
        sweep(scratch, (model, screen, Faces::All), size, &mut mask);
        let (out, one) = (mask.out.finish(), T::from_f64(1.0));
        for &pixel in &scratch.on_edge {
            out[pixel] = one;
        }
        for e in &scratch.borders {
            border(e, size, out);
        }
    });
}

/// Call `cover` for each run of pixels of a row that are inside of a triangle of such faces: with the
/// row, and the columns. A centre exactly on a border is on either side of it; whether there may be
/// one.
pub(super) fn runs(
    model: &Model,
    screen: &Screen,
    faces: Faces,
    size: Size,
    cover: impl FnMut(usize, Range<usize>),
) -> bool {
    SCRATCH.with_borrow_mut(|scratch| {
        sweep(scratch, (model, screen, faces), size, &mut Runs(cover));
        !(scratch.on_edge.is_empty() && scratch.borders.is_empty())
    })
}

/// What a sweep does with its runs.
trait Paint {
    /// So many steps are to come.
    fn pace(&mut self, _steps: usize) {}
    /// A step before the first run.
    fn step(&mut self) {}
    /// The first run is next.
    fn finish(&mut self) {}
    /// A run of pixels of a row.
    fn cover(&mut self, row: usize, columns: Range<usize>);
}

struct Runs<F>(F);

impl<F: FnMut(usize, Range<usize>)> Paint for Runs<F> {
    #[inline(always)]
    fn cover(&mut self, row: usize, columns: Range<usize>) {
        self.0(row, columns);
    }
}

/// A mask that is cleared during the steps.
struct Mask<'a, T> {
    out: Beside<'a, T>,
    width: usize,
}

impl<T: Pixel> Paint for Mask<'_, T> {
    fn pace(&mut self, steps: usize) {
        self.out.pace(steps);
    }

    #[inline(always)]
    fn step(&mut self) {
        self.out.step();
    }

    fn finish(&mut self) {
        self.out.finish();
    }

    #[inline(always)]
    fn cover(&mut self, row: usize, columns: Range<usize>) {
        let start = row * self.width;
        self.out.finish()[start + columns.start..start + columns.end].fill(T::from_f64(1.0));
    }
}

/// As [`Scratch::sweep`]: bits are shifted and counted in one instruction where there is one.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
fn sweep<P: Paint>(
    scratch: &mut Scratch,
    shape: (&Model, &Screen, Faces),
    size: Size,
    paint: &mut P,
) {
    scratch.sweep(shape, size, paint);
}

impl Scratch {
    /// As [`runs`], and leave what has to do with borders.
    #[inline(always)]
    fn sweep(
        &mut self,
        (model, screen, faces): (&Model, &Screen, Faces),
        size: Size,
        paint: &mut impl Paint,
    ) {
        let Self { outline, crossings, borders, table, on_edge } = self;
        let net = outline.choose(model, screen, 0.0, faces);
        borders.clear();
        on_edge.clear();
        let reach = sort(&net, size, (crossings, borders), paint);
        paint.pace(crossings.len().div_ceil(STEP));
        let (top, bottom) = reach.rows;
        let (left, right) = reach.columns;
        let words = (right - left) / 64 + 1; // a bit for the column after the last one, too
        let rows = (BAND / (64 * words)).max(1);
        for first in (top..bottom).step_by(rows) {
            let band = Extent { rows: (first, (first + rows).min(bottom)), ..reach };
            table.grow(words * (band.rows.1 - first));
            for crossings in crossings.chunks(STEP) {
                for c in crossings {
                    let e = net.edge(c.edge as usize);
                    if first == top && e.x0 == e.x1 {
                        borders.push(e);
                    }
                    table.mark(&e, c, &band, size.width, on_edge);
                }
                paint.step();
            }
            paint.finish();
            let changes = table.change.chunks_exact_mut(64 * words);
            let touched = table.touched.chunks_exact_mut(words);
            for ((row, change), touched) in (first..band.rows.1).zip(changes).zip(touched) {
                take(change, touched, |columns| {
                    paint.cover(row, left + columns.start..left + columns.end);
                });
            }
        }
    }
}

/// Sort out the net edges that cross the centre line of a row, and those that may run through a
/// centre though they cross none; the part of the image that the net edges reach.
#[inline(always)]
fn sort(
    net: &Net,
    size: Size,
    (crossings, borders): (&mut Vec<Crossing>, &mut Vec<NetEdge>),
    paint: &mut impl Paint,
) -> Extent {
    let Size { height, width } = size;
    // Every edge is written, and stays if it crosses a line.
    crossings.resize(net.count() + 1, Crossing::default());
    let mut count = 0;
    let (mut top, mut bottom) = (height, 0);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    paint.pace(2 * net.count().div_ceil(STEP)); // the other half is for what follows
    for k in 0..net.count() {
        if k % STEP == 0 {
            paint.step();
        }
        let [a, b] = net.ends(k);
        let (upper, lower) = (if a.1 < b.1 { a.1 } else { b.1 }, if a.1 < b.1 { b.1 } else { a.1 });
        for (x, _) in [a, b] {
            low = if x < low { x } else { low };
            high = if x > high { x } else { high };
        }
        let (first, after) = (first_from(upper - 0.5, height), first_from(lower - 0.5, height));
        crossings[count] = Crossing { edge: k as u32, first: first as u32, after: after as u32 };
        count += usize::from(first < after);
        (top, bottom) = (top.min(first), bottom.max(after));
        if nearest(lower - 0.5).0 == lower - 0.5 {
            borders.push(net.edge(k));
        }
    }
    crossings.truncate(count);
    let (left, right) = (first_from(low - 1.0, width), first_from(high, width));
    Extent { rows: (top, bottom), columns: (left, right.max(left)) }
}

impl Table {
    fn grow(&mut self, words: usize) {
        if self.touched.len() < words {
            self.touched.resize(words, 0);
            self.change.resize(64 * words, 0);
        }
    }

    /// Leave the steps of an edge in a band of rows.
    #[inline(always)]
    fn mark(
        &mut self,
        e: &NetEdge,
        rows: &Crossing,
        band: &Extent,
        width: usize,
        on_edge: &mut Vec<usize>,
    ) {
        let ((top, bottom), (left, right)) = (band.rows, band.columns);
        let words = (right - left) / 64 + 1;
        for row in (rows.first as usize).max(top)..(rows.after as usize).min(bottom) {
            let x = e.x_at(row as f64 + 0.5) - 0.5;
            let at = first_from(x, right).saturating_sub(left);
            let line = (row - top) * words;
            self.change[64 * line + at] += e.step;
            self.touched[line + at / 64] |= 1 << (at % 64);
            // A centre on the edge, but for rounding.
            let (centre, column) = nearest(x);
            if (x - centre).abs() < ON_EDGE && (0.0..width as f64).contains(&centre) {
                on_edge.push(row * width + column as usize);
            }
        }
    }
}

/// Call `cover` where in a row there are layers, and clear its changes.
#[inline(always)]
fn take(change: &mut [i32], touched: &mut [u64], mut cover: impl FnMut(Range<usize>)) {
    let (mut layers, mut from) = (0, 0);
    for (word, bits) in touched.iter_mut().enumerate() {
        let mut bits = std::mem::take(bits);
        while bits != 0 {
            let column = 64 * word + bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let before = layers;
            layers += std::mem::take(&mut change[column]);
            if before <= 0 && layers > 0 {
                from = column;
            } else if before > 0 && layers <= 0 {
                cover(from..column);
            }
        }
    }
    // Net edges are closed: behind the last one there are no layers.
}

/// Centres exactly on a net edge: on one side of it there is a triangle.
fn border<T: Pixel>(e: &NetEdge, size: Size, out: &mut [T]) {
    let one = T::from_f64(1.0);
    let on_grid = |x: f64| (x - 0.5).fract() == 0.0;
    let Size { height, width } = size;
    if e.x0 == e.x1 && e.y0 == e.y1 {
        return;
    }
    let upright = e.x0 == e.x1 && on_grid(e.x0);
    let level = e.y0 == e.y1 && on_grid(e.y0);
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
    } else if on_grid(e.y1) && on_grid(e.x1) {
        let within = |x: f64, n: usize| x > 0.0 && x < n as f64;
        if within(e.x1, width) && within(e.y1, height) {
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
