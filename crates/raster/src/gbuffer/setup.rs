//! Faces ready to be drawn: those that can hold the centre of a pixel, as edge functions and an
//! affine function for the nearness `1/z`.
//!
//! The corners of a face are sorted by their image points. So faces over the same three points have
//! the same numbers, whatever their winding, and the lowest index wins exactly.

use multiversion::multiversion;

use super::Surface;
use crate::error::Result;
use crate::raster::{Screen, Size, View};

/// Faces that are set up together.
const LANES: usize = 64;

/// Faces whose records stay in the cache: up to 38 kB.
const GROUP: usize = 4 * LANES;

/// A face in the image. Its corners are sorted by `(u, v)`, and its edges go from the first to the
/// second, from the first to the third and from the second to the third.
///
/// With the ends sorted, the two faces of an edge compare the same two numbers at a point, so that
/// at least one of them holds it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Record {
    /// The first two corners in samples (pixels times the samples along a side).
    pub(super) u: [f64; 2],
    pub(super) v: [f64; 2],
    /// Along the edges, all three turned round where the corners go the other way: the face holds
    /// the points with `du (y - v) >= dv (x - u)` for each edge, from where it starts.
    pub(super) du: [f64; 3],
    pub(super) dv: [f64; 3],
    /// `1/z` at the first corner, and its change per column and per row.
    pub(super) nearness: [f64; 3],
    /// Smallest and largest `1/z` of the corners.
    pub(super) range: [f64; 2],
    /// First column and the one after the last.
    pub(super) columns: [i32; 2],
    /// First row and the one after the last.
    pub(super) rows: [i32; 2],
    /// 1 + the place of the face among the faces of all screens.
    pub(super) id: u32,
}

/// What a record compares at the samples of a column and of a row: the sample at both is in the
/// face where each of the first three numbers of the row is at least that of the column, and has
/// the sum of the fourth as its `1/z`, once that is clamped.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sides(pub(super) [f64; 4]);

impl Record {
    /// Those of the column at `x`.
    #[inline(always)]
    pub(super) fn column(&self, x: f64) -> Sides {
        let x = [x - self.u[0], x - self.u[1]];
        let [a, b, c] = self.dv;
        Sides([a * x[0], b * x[0], c * x[1], self.nearness[0] + self.nearness[1] * x[0]])
    }

    /// Those of the row at `y`.
    #[inline(always)]
    pub(super) fn row(&self, y: f64) -> Sides {
        let y = [y - self.v[0], y - self.v[1]];
        let [a, b, c] = self.du;
        Sides([a * y[0], b * y[0], c * y[1], self.nearness[2] * y[0]])
    }

    /// Whether the face holds the point, and its `1/z` there.
    #[inline(always)]
    pub(super) fn meet(&self, Sides(column): Sides, Sides(row): Sides) -> (bool, f64) {
        let inside = (row[0] >= column[0]) & (row[1] >= column[1]) & (row[2] >= column[2]);
        let w = column[3] + row[3];
        let w = if w > self.range[0] { w } else { self.range[0] };
        (inside, if w < self.range[1] { w } else { self.range[1] })
    }

    /// `1/z` at a point of the image, if the closed triangle holds it.
    pub(super) fn at(&self, u: f64, v: f64) -> Option<f64> {
        let (inside, w) = self.meet(self.column(u), self.row(v));
        inside.then_some(w)
    }
}

/// Twice the signed area of `(0, a, b)`; exactly the negative of that of `(0, b, a)`.
#[inline(always)]
pub(super) fn edge(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Which faces are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Keep {
    /// Those whose bounding box holds the centre of a sample; columns and rows are of centres.
    Centres,
    /// Those whose bounding box meets the image; columns and rows are of samples that they touch.
    Touched,
}

/// An image to set up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Image<'a> {
    pub(super) surfaces: &'a [Surface<'a>],
    /// One for each surface.
    pub(super) views: &'a [View],
    /// Distance to the near plane in metres.
    pub(super) near: f64,
    /// In samples.
    pub(super) size: Size,
    /// So many samples along the side of a pixel.
    pub(super) samples: usize,
}

/// One image, projected and set up. Buffers are used again.
#[derive(Debug, Default)]
pub(super) struct Prepared {
    /// A screen for each surface (and more, from images with more surfaces).
    pub(super) screens: Vec<Screen>,
    /// Where the faces of each surface start, counted over all.
    pub(super) starts: Vec<u32>,
    records: Vec<Record>,
    /// How many of the records are those of this image.
    used: usize,
    /// In samples, `1/z`, and nothing: corners are gathered in whole registers.
    points: Vec<[f64; 4]>,
    corners: Box<Corners>,
}

impl Prepared {
    /// Project and set up an image.
    pub(super) fn prepare(&mut self, image: &Image<'_>, keep: Keep) -> Result<()> {
        self.each(image, keep, |_| false)
    }

    /// As [`prepare`](Self::prepare), handing out some records at a time while they are in the cache.
    /// None are kept.
    pub(super) fn stream(
        &mut self,
        image: &Image<'_>,
        keep: Keep,
        mut work: impl FnMut(&[Record]),
    ) -> Result<()> {
        self.each(image, keep, |records| {
            work(records);
            true
        })
    }

    /// Project and set up; `taken` is given the records that are there, and says whether they may be
    /// forgotten.
    fn each(
        &mut self,
        image: &Image<'_>,
        keep: Keep,
        mut taken: impl FnMut(&[Record]) -> bool,
    ) -> Result<()> {
        let Image { surfaces, views, near, size, samples } = *image;
        self.used = 0;
        self.starts.clear();
        if self.screens.len() < surfaces.len() {
            self.screens.resize_with(surfaces.len(), Screen::default);
        }
        let mut start = 0;
        for ((surface, view), screen) in surfaces.iter().zip(views).zip(&mut self.screens) {
            screen.project(surface.model, view, near)?;
            place(screen, samples as f64, &mut self.points);
            self.starts.push(start);
            for faces in screen.faces(surface.model).chunks(GROUP) {
                let out = (&mut self.records, &mut self.used);
                set_up(&self.points, faces, start, (size, keep), &mut self.corners, out);
                start += faces.len() as u32;
                if taken(&self.records[..self.used]) {
                    self.used = 0;
                }
            }
        }
        Ok(())
    }

    /// The faces that are left.
    pub(super) fn records(&self) -> &[Record] {
        &self.records[..self.used]
    }

    /// Surface and face of its screen behind the id of a record.
    pub(super) fn find(&self, id: u32) -> (usize, usize) {
        let index = id - 1;
        // Surfaces without a visible face share their start with the next.
        let surface = match self.starts.len() {
            1 => 0,
            _ => self.starts.partition_point(|&start| start <= index) - 1,
        };
        (surface, (index - self.starts[surface]) as usize)
    }
}

/// Corners of faces and what follows from them, one array a number.
#[derive(Debug)]
struct Corners {
    u: [[f64; LANES]; 3],
    v: [[f64; LANES]; 3],
    w: [[f64; LANES]; 3],
    du: [[f64; LANES]; 3],
    dv: [[f64; LANES]; 3],
    nearness: [[f64; LANES]; 2],
    range: [[f64; LANES]; 2],
    columns: [[f64; LANES]; 2],
    rows: [[f64; LANES]; 2],
    /// The same as whole numbers: columns, rows.
    spans: [[i32; LANES]; 4],
    kept: [bool; LANES],
}

impl Default for Corners {
    fn default() -> Self {
        Self {
            u: [[0.0; LANES]; 3],
            v: [[0.0; LANES]; 3],
            w: [[0.0; LANES]; 3],
            du: [[0.0; LANES]; 3],
            dv: [[0.0; LANES]; 3],
            nearness: [[0.0; LANES]; 2],
            range: [[0.0; LANES]; 2],
            columns: [[0.0; LANES]; 2],
            rows: [[0.0; LANES]; 2],
            spans: [[0; LANES]; 4],
            kept: [false; LANES],
        }
    }
}

impl Corners {
    /// The corners of up to [`LANES`] faces.
    #[inline(always)]
    fn gather(&mut self, points: &[[f64; 4]], faces: &[[u32; 3]]) {
        let (fours, rest) = faces.as_chunks::<4>();
        for (four, faces) in fours.iter().enumerate() {
            for c in 0..3 {
                // Stored four at a time.
                let [p, q, r, s] = faces.map(|face| points[face[c] as usize]);
                for (axis, out) in [&mut self.u, &mut self.v, &mut self.w].into_iter().enumerate() {
                    out[c][4 * four..4 * four + 4]
                        .copy_from_slice(&[p[axis], q[axis], r[axis], s[axis]]);
                }
            }
        }
        for (k, face) in rest.iter().enumerate() {
            for c in 0..3 {
                let at = 4 * fours.len() + k;
                [self.u[c][at], self.v[c][at], self.w[c][at], _] = points[face[c] as usize];
            }
        }
    }

    /// Exchange two corners where `a` comes after `b`.
    #[expect(clippy::float_cmp, reason = "an order of exact places")]
    #[inline(always)]
    fn sort(&mut self, a: usize, b: usize) {
        for k in 0..LANES {
            let (ua, ub, va, vb) = (self.u[a][k], self.u[b][k], self.v[a][k], self.v[b][k]);
            let (wa, wb) = (self.w[a][k], self.w[b][k]);
            let swap = (ua > ub) | ((ua == ub) & (va > vb));
            (self.u[a][k], self.u[b][k]) = if swap { (ub, ua) } else { (ua, ub) };
            (self.v[a][k], self.v[b][k]) = if swap { (vb, va) } else { (va, vb) };
            (self.w[a][k], self.w[b][k]) = if swap { (wb, wa) } else { (wa, wb) };
        }
    }

    /// Columns and rows, and which faces have a sample in their box.
    #[inline(always)]
    fn bound(&mut self, size: Size, keep: Keep) {
        let (width, height) = (size.width as f64, size.height as f64);
        let at_most = |x: f64, end: f64| if x < end { x } else { end };
        let at_least = |x: f64, start: f64| if x > start { x } else { start };
        let shift = if keep == Keep::Centres { 0.5 } else { 0.0 };
        let first = |low: f64| match keep {
            Keep::Centres => at_least((low - shift).ceil(), 0.0),
            Keep::Touched => at_least(low.floor(), 0.0),
        };
        let after = |high: f64, end: f64| at_most((high - shift).floor() + 1.0, end);
        for k in 0..LANES {
            let [a, b, c] = [self.v[0][k], self.v[1][k], self.v[2][k]];
            let (low, high) = (at_most(at_most(a, b), c), at_least(at_least(a, b), c));
            self.columns[0][k] = first(self.u[0][k]);
            self.columns[1][k] = after(self.u[2][k], width);
            self.rows[0][k] = first(low);
            self.rows[1][k] = after(high, height);
            self.kept[k] =
                (self.columns[0][k] < self.columns[1][k]) & (self.rows[0][k] < self.rows[1][k]);
            self.spans[0][k] = whole(self.columns[0][k]);
            self.spans[1][k] = whole(self.columns[1][k]);
            self.spans[2][k] = whole(self.rows[0][k]);
            self.spans[3][k] = whole(self.rows[1][k]);
        }
    }

    /// Edges and `1/z`. Leaves out faces without area, and those with one sample in their box but
    /// not inside them.
    #[inline(always)]
    fn solve(&mut self, keep: Keep) {
        for k in 0..LANES {
            let u = [self.u[0][k], self.u[1][k], self.u[2][k]];
            let v = [self.v[0][k], self.v[1][k], self.v[2][k]];
            let w = [self.w[0][k], self.w[1][k], self.w[2][k]];
            let du = [u[1] - u[0], u[2] - u[0], u[2] - u[1]];
            let dv = [v[1] - v[0], v[2] - v[0], v[2] - v[1]];
            let area = du[0] * dv[1] - dv[0] * du[1];
            let turn = 1.0_f64.copysign(area);
            let (du, dv) = (
                [turn * du[0], -turn * du[1], turn * du[2]],
                [turn * dv[0], -turn * dv[1], turn * dv[2]],
            );
            let (x, y) = (self.columns[0][k] + 0.5, self.rows[0][k] + 0.5);
            let inside = (du[0] * (y - v[0]) >= dv[0] * (x - u[0]))
                & (du[1] * (y - v[0]) >= dv[1] * (x - u[0]))
                & (du[2] * (y - v[1]) >= dv[2] * (x - u[1]));
            let several = (self.columns[1][k] - self.columns[0][k] > 1.0)
                | (self.rows[1][k] - self.rows[0][k] > 1.0)
                | (keep == Keep::Touched);
            self.kept[k] &= (area.abs() > 0.0) & (inside | several);
            let per_area = 1.0 / area.abs();
            let (db, dc) = ((w[1] - w[0]) * per_area, (w[2] - w[0]) * per_area);
            self.nearness[0][k] = -(dv[1] * db) - dv[0] * dc;
            self.nearness[1][k] = du[1] * db + du[0] * dc;
            let at_most = |a: f64, b: f64| if a < b { a } else { b };
            let at_least = |a: f64, b: f64| if a > b { a } else { b };
            self.range[0][k] = at_most(at_most(w[0], w[1]), w[2]);
            self.range[1][k] = at_least(at_least(w[0], w[1]), w[2]);
            for edge in 0..3 {
                self.du[edge][k] = du[edge];
                self.dv[edge][k] = dv[edge];
            }
        }
    }

    /// Number by number: a whole record would be put together elsewhere and copied.
    #[inline(always)]
    fn write(&self, k: usize, id: u32, out: &mut Record) {
        for corner in 0..2 {
            out.u[corner] = self.u[corner][k];
            out.v[corner] = self.v[corner][k];
        }
        for edge in 0..3 {
            out.du[edge] = self.du[edge][k];
            out.dv[edge] = self.dv[edge][k];
        }
        out.nearness[0] = self.w[0][k];
        for side in 0..2 {
            out.nearness[1 + side] = self.nearness[side][k];
            out.range[side] = self.range[side][k];
            out.columns[side] = self.spans[side][k];
            out.rows[side] = self.spans[2 + side][k];
        }
        out.id = id;
    }
}

/// Whole numbers from 0 to 2^31: the low bits of what 2^52 is added to.
#[inline(always)]
fn whole(x: f64) -> i32 {
    (x + 4_503_599_627_370_496.0).to_bits() as i32
}

/// The points of a screen in samples, and `1/z`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn place(screen: &Screen, scale: f64, out: &mut Vec<[f64; 4]>) {
    let Screen { u, v, z, .. } = screen;
    out.resize(u.len(), [0.0; 4]);
    for (((out, u), v), z) in out.iter_mut().zip(u).zip(v).zip(z) {
        *out = [u * scale, v * scale, 1.0 / z, 0.0];
    }
}

/// Append those that are left after `start` earlier ones.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn set_up(
    points: &[[f64; 4]],
    faces: &[[u32; 3]],
    start: u32,
    (size, keep): (Size, Keep),
    corners: &mut Corners,
    (records, used): (&mut Vec<Record>, &mut usize),
) {
    let mut first = start + 1;
    for faces in faces.chunks(LANES) {
        corners.gather(points, faces);
        corners.sort(0, 1);
        corners.sort(1, 2);
        corners.sort(0, 1);
        corners.bound(size, keep);
        corners.solve(keep);
        let (mut kept, mut count) = ([0_u8; LANES], 0);
        for k in 0..faces.len() {
            kept[count % LANES] = k as u8;
            count += usize::from(corners.kept[k]);
        }
        if records.len() < *used + LANES {
            records.resize(2 * (*used + LANES), Record::default());
        }
        for (&k, out) in kept[..count].iter().zip(&mut records[*used..]) {
            corners.write(usize::from(k) % LANES, first + u32::from(k), out);
        }
        *used += count;
        first += faces.len() as u32;
    }
}
