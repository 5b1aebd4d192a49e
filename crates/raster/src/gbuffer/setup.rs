//! Faces ready to be drawn: those that can hold the centre of a pixel, as edge functions and an
//! affine function for the nearness `1/z`.
//!
//! The corners of a face begin with the first by its image point and go round one way. So faces over
//! the same three points have the same numbers, whatever their winding, and the lowest index wins
//! exactly.

use multiversion::multiversion;

use super::Surface;
use crate::error::Result;
use crate::raster::{Screen, Size, View};

/// Faces that are set up together.
const LANES: usize = 64;

/// A face in the image. Corner 0 is the first by `(u, v)`; 1 and 2 follow so that the signed area
/// is positive.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Record {
    /// Corners in samples (pixels times the samples along a side).
    pub(super) u: [f64; 3],
    pub(super) v: [f64; 3],
    /// `1/z` is `nearness[0] + nearness[1] e1 + nearness[2] e2` with the edge functions opposite
    /// to the corners 1 and 2.
    pub(super) nearness: [f64; 3],
    /// Smallest and largest `1/z` of the corners.
    pub(super) range: [f64; 2],
    /// First column and the one after the last.
    pub(super) columns: [i32; 2],
    /// 1 + the place of the face among the faces of all screens.
    pub(super) id: u32,
}

impl Record {
    /// `1/z` at a point of the image, if the closed triangle holds it.
    pub(super) fn at(&self, u: f64, v: f64) -> Option<f64> {
        let d = [0, 1, 2].map(|k| [self.u[k] - u, self.v[k] - v]);
        let e = [edge(d[1], d[2]), edge(d[2], d[0]), edge(d[0], d[1])];
        if e.iter().any(|&e| e < 0.0) {
            return None;
        }
        let [base, d1, d2] = self.nearness;
        Some((base + e[1] * d1 + e[2] * d2).clamp(self.range[0], self.range[1]))
    }
}

/// Twice the signed area of `(0, a, b)`; exactly the negative of that of `(0, b, a)`, and so a
/// point on the edge of two faces is in at least one of them.
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

/// One image, projected and set up. Buffers are used again.
#[derive(Debug, Default)]
pub(super) struct Prepared {
    /// A screen for each surface (and more, from images with more surfaces).
    pub(super) screens: Vec<Screen>,
    /// Where the faces of each surface start, counted over all.
    pub(super) starts: Vec<u32>,
    pub(super) records: Vec<Record>,
    /// First row and the one after the last of each record.
    pub(super) rows: Vec<[i32; 2]>,
    points: Vec<[f64; 3]>,
}

impl Prepared {
    /// Project and set up the surfaces of an image; `size` in samples, `scale` of them along the
    /// side of a pixel.
    pub(super) fn prepare(
        &mut self,
        surfaces: &[Surface<'_>],
        views: &[View],
        near: f64,
        (size, scale, keep): (Size, f64, Keep),
    ) -> Result<()> {
        self.records.clear();
        self.rows.clear();
        self.starts.clear();
        if self.screens.len() < surfaces.len() {
            self.screens.resize_with(surfaces.len(), Screen::default);
        }
        let mut start = 0;
        for ((surface, view), screen) in surfaces.iter().zip(views).zip(&mut self.screens) {
            screen.project(surface.model, view, near)?;
            let Screen { u, v, z, .. } = &*screen;
            self.points.clear();
            let points = u.iter().zip(v).zip(z);
            self.points.extend(points.map(|((u, v), z)| [u * scale, v * scale, 1.0 / z]));
            let faces = screen.faces(surface.model);
            let out = (&mut self.records, &mut self.rows);
            set_up(&self.points, faces, start, (size, keep), out);
            self.starts.push(start);
            start += faces.len() as u32;
        }
        Ok(())
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

/// Corners of faces, one array a number.
struct Corners {
    u: [[f64; LANES]; 3],
    v: [[f64; LANES]; 3],
    w: [[f64; LANES]; 3],
    area: [f64; LANES],
    columns: [[f64; LANES]; 2],
    rows: [[f64; LANES]; 2],
    kept: [bool; LANES],
}

impl Corners {
    const EMPTY: Self = Self {
        u: [[0.0; LANES]; 3],
        v: [[0.0; LANES]; 3],
        w: [[0.0; LANES]; 3],
        area: [0.0; LANES],
        columns: [[0.0; LANES]; 2],
        rows: [[0.0; LANES]; 2],
        kept: [false; LANES],
    };

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

    /// Area, with corners 1 and 2 exchanged where it would be negative.
    #[inline(always)]
    fn orient(&mut self) {
        for k in 0..LANES {
            let (b, c) = (1, 2);
            let area = (self.u[b][k] - self.u[0][k]) * (self.v[c][k] - self.v[0][k])
                - (self.v[b][k] - self.v[0][k]) * (self.u[c][k] - self.u[0][k]);
            let swap = area < 0.0;
            let (ub, uc) = (self.u[b][k], self.u[c][k]);
            let (vb, vc) = (self.v[b][k], self.v[c][k]);
            let (wb, wc) = (self.w[b][k], self.w[c][k]);
            (self.u[b][k], self.u[c][k]) = if swap { (uc, ub) } else { (ub, uc) };
            (self.v[b][k], self.v[c][k]) = if swap { (vc, vb) } else { (vb, vc) };
            (self.w[b][k], self.w[c][k]) = if swap { (wc, wb) } else { (wb, wc) };
            self.area[k] = area.abs();
        }
    }

    /// Columns and rows, and which faces are left; before the corners are oriented.
    #[inline(always)]
    fn bound(&mut self, size: Size, keep: Keep) {
        let (width, height) = (size.width as f64, size.height as f64);
        let shift = if keep == Keep::Centres { 0.5 } else { 0.0 };
        for k in 0..LANES {
            // Corner 0 is the first by u.
            let (low_u, b, c) = (self.u[0][k], self.u[1][k], self.u[2][k]);
            let high_u = if b > c { b } else { c };
            let (low_v, high_v) = {
                let [a, b, c] = [self.v[0][k], self.v[1][k], self.v[2][k]];
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                (if c < low { c } else { low }, if c > high { c } else { high })
            };
            let first = |low: f64| match keep {
                Keep::Centres => (low - shift).ceil(),
                Keep::Touched => low.floor(),
            };
            let at_most = |x: f64, end: f64| if x < end { x } else { end };
            let at_least_0 = |x: f64| if x > 0.0 { x } else { 0.0 };
            self.columns[0][k] = at_least_0(first(low_u));
            self.columns[1][k] = at_most((high_u - shift).floor() + 1.0, width);
            self.rows[0][k] = at_least_0(first(low_v));
            self.rows[1][k] = at_most((high_v - shift).floor() + 1.0, height);
        }
    }

    /// Leave out faces without area, without a sample in their box, and those with one sample in
    /// their box but not inside them.
    #[inline(always)]
    fn choose(&mut self, keep: Keep) {
        for k in 0..LANES {
            let (width, height) =
                (self.columns[1][k] - self.columns[0][k], self.rows[1][k] - self.rows[0][k]);
            let (u, v) = (self.columns[0][k] + 0.5, self.rows[0][k] + 0.5);
            let a = [self.u[0][k] - u, self.v[0][k] - v];
            let b = [self.u[1][k] - u, self.v[1][k] - v];
            let c = [self.u[2][k] - u, self.v[2][k] - v];
            let inside = (edge(b, c) >= 0.0) & (edge(c, a) >= 0.0) & (edge(a, b) >= 0.0);
            let several = (width > 1.0) | (height > 1.0) | (keep == Keep::Touched);
            self.kept[k] =
                (self.area[k] > 0.0) & (width > 0.0) & (height > 0.0) & (inside | several);
        }
    }
}

/// Append the faces that are left after `start` earlier ones.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn set_up(
    points: &[[f64; 3]],
    faces: &[[u32; 3]],
    start: u32,
    (size, keep): (Size, Keep),
    (records, rows): (&mut Vec<Record>, &mut Vec<[i32; 2]>),
) {
    let mut corners = Corners::EMPTY;
    let mut first = start + 1;
    for faces in faces.chunks(LANES) {
        for (k, face) in faces.iter().enumerate() {
            for c in 0..3 {
                let [u, v, w] = points[face[c] as usize];
                corners.u[c][k] = u;
                corners.v[c][k] = v;
                corners.w[c][k] = w;
            }
        }
        corners.sort(0, 1);
        corners.sort(0, 2);
        corners.bound(size, keep);
        corners.orient();
        corners.choose(keep);
        for k in 0..faces.len() {
            if !corners.kept[k] {
                continue;
            }
            let (u, v, w) = (&corners.u, &corners.v, &corners.w);
            let [a, b, c] = [w[0][k], w[1][k], w[2][k]];
            let per_area = 1.0 / corners.area[k];
            records.push(Record {
                u: [u[0][k], u[1][k], u[2][k]],
                v: [v[0][k], v[1][k], v[2][k]],
                nearness: [a, (b - a) * per_area, (c - a) * per_area],
                range: [a.min(b).min(c), a.max(b).max(c)],
                columns: [corners.columns[0][k] as i32, corners.columns[1][k] as i32],
                id: first + k as u32,
            });
            rows.push([corners.rows[0][k] as i32, corners.rows[1][k] as i32]);
        }
        first += faces.len() as u32;
    }
}
