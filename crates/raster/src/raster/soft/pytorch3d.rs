//! The sigmoid mask as `PyTorch3D`'s `MeshRasterizer` and `SoftSilhouetteShader` compute it, in
//! `f64`.
//!
//! A face is left out if a corner is behind the camera (`z < 1e-8`) or if it has no area (twice the
//! area up to 1e-8 NDC^2), and at a pixel if the squared distance is `blur_radius` or more outside
//! of it; of the rest the `faces_per_pixel` nearest to the camera count, by the depth at the
//! barycentric coordinates, corrected for perspective and cut at the sides of the face. The
//! gradient treats all this as constant.

use std::cell::RefCell;

use multiversion::multiversion;

use super::real::{LANES, Real};
use crate::raster::{Model, Pixel, Pytorch3dCutoff, Screen, Size};

/// Side of the squares for which candidates are listed, in pixels.
const SQUARE: usize = 8;
/// The least depth, and the least area in NDC^2.
const EPSILON: f64 = 1e-8;

/// A face in NDC: x to the left, y up.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    corners: [[f64; 2]; 3],
    depth: [f64; 3],
    area: f64,
    low: [f64; 2],
    high: [f64; 2],
    index: u32,
}

/// Sixteen candidates; those beyond the last one are nowhere.
#[derive(Debug)]
struct Group {
    corners: [[[f64; LANES]; 2]; 3],
    depth: [[f64; LANES]; 3],
    area: [f64; LANES],
    low: [[f64; LANES]; 2],
    high: [[f64; LANES]; 2],
    index: [u32; LANES],
}

/// A face at a pixel.
#[derive(Debug, Clone, Copy)]
struct Hit {
    depth: f64,
    index: u32,
    /// Squared distance over sigma, positive inside.
    x: f64,
    /// The nearest point of the outline: from the pixel, its edge, and where on that.
    way: [f64; 2],
    edge: usize,
    s: f64,
}

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    all: Vec<Candidate>,
    strip: Vec<Candidate>,
    square: Vec<Group>,
    hits: Vec<Hit>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Draw the mask `(H, W)`; every pixel of `out` is written.
pub(in crate::raster) fn draw<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    cutoff: Pytorch3dCutoff,
    out: &mut [T],
) {
    out.fill(T::default());
    each_pixel(model, screen, size, sigma, cutoff, |at, hits| {
        let sum: f64 = hits.iter().map(|hit| softplus(hit.x)).sum();
        out[at] = T::from_f64(-(-sum).exp_m1());
    });
}

/// Add the gradient of `sum(upstream * mask)` for image points (pixels) to `du` and `dv`.
pub(in crate::raster) fn back<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    cutoff: Pytorch3dCutoff,
    upstream: &[T],
    [du, dv]: [&mut [f64]; 2],
) {
    let faces = screen.faces(model);
    let per_pixel = -2.0 / size.width.min(size.height) as f64;
    each_pixel(model, screen, size, sigma, cutoff, |at, hits| {
        let sum: f64 = hits.iter().map(|hit| softplus(hit.x)).sum();
        let left = upstream[at].to_f64() * (-sum).exp();
        for hit in hits {
            let sign = if hit.x > 0.0 { 1.0 } else { -1.0 };
            let weight = left / (1.0 + (-hit.x).exp()) * (sign * 2.0 * per_pixel / sigma);
            if weight == 0.0 {
                continue;
            }
            let face = &faces[hit.index as usize];
            let (a, b) = (face[hit.edge] as usize, face[(hit.edge + 1) % 3] as usize);
            for (axis, out) in [&mut *du, &mut *dv].into_iter().enumerate() {
                out[a] += weight * (1.0 - hit.s) * hit.way[axis];
                out[b] += weight * hit.s * hit.way[axis];
            }
        }
    });
}

/// `ln(1 + exp(x))`.
fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Call `work` with each pixel that has a face, and its faces.
fn each_pixel(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    cutoff: Pytorch3dCutoff,
    mut work: impl FnMut(usize, &[Hit]),
) {
    SCRATCH.with_borrow_mut(|scratch| {
        let Scratch { all, strip, square, hits } = scratch;
        let Size { height, width } = size;
        let (wide, tall, short) = (width as f64, height as f64, width.min(height) as f64);
        let margin = cutoff.blur_radius.sqrt();
        all.clear();
        for (index, face) in screen.faces(model).iter().enumerate() {
            let corners = face.map(|k| {
                let (u, v) = (screen.u[k as usize], screen.v[k as usize]);
                [(wide - 2.0 * u) / short, (tall - 2.0 * v) / short]
            });
            let depth = face.map(|k| screen.z[k as usize]);
            let area = edge(corners[2], corners[0], corners[1]);
            if depth.iter().any(|&z| z < EPSILON) || area.abs() <= EPSILON {
                continue;
            }
            let side = |axis: usize| {
                let [a, b, c] = corners.map(|p| p[axis]);
                (a.min(b).min(c) - margin, a.max(b).max(c) + margin)
            };
            let ((x0, x1), (y0, y1)) = (side(0), side(1));
            let (low, high) = ([x0, y0], [x1, y1]);
            all.push(Candidate { corners, depth, area, low, high, index: index as u32 });
        }
        let place = |axis: usize, pixel: usize| match axis {
            0 => (wide - (2 * pixel + 1) as f64) / short,
            _ => (tall - (2 * pixel + 1) as f64) / short,
        };
        let near = |axis: usize, first: usize, end: usize| {
            let (high, low) = (place(axis, first), place(axis, end - 1));
            move |face: &&Candidate| face.high[axis] >= low && face.low[axis] <= high
        };
        for top in (0..height).step_by(SQUARE) {
            let bottom = (top + SQUARE).min(height);
            strip.clear();
            strip.extend(all.iter().filter(near(1, top, bottom)));
            if strip.is_empty() {
                continue;
            }
            for left in (0..width).step_by(SQUARE) {
                let right = (left + SQUARE).min(width);
                square.clear();
                for (k, face) in strip.iter().filter(near(0, left, right)).enumerate() {
                    if k % LANES == 0 {
                        square.push(Group::EMPTY);
                    }
                    if let Some(group) = square.last_mut() {
                        group.set(k % LANES, face);
                    }
                }
                if square.is_empty() {
                    continue;
                }
                for row in top..bottom {
                    for column in left..right {
                        let pixel = [place(0, column), place(1, row)];
                        hits.clear();
                        for group in &*square {
                            meet(group, pixel, (sigma, cutoff.blur_radius), hits);
                        }
                        keep_nearest(hits, cutoff.faces_per_pixel);
                        if !hits.is_empty() {
                            work(row * width + column, hits);
                        }
                    }
                }
            }
        }
    });
}

/// Keep the `count` nearest to the camera, the first of equal ones.
fn keep_nearest(hits: &mut Vec<Hit>, count: usize) {
    if hits.len() > count {
        let nearer = |a: &Hit, b: &Hit| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index));
        hits.select_nth_unstable_by(count, nearer);
        hits.truncate(count);
    }
}

/// `(p - a) x (b - a)`.
#[inline(always)]
fn edge(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    (p[0] - a[0]) * (b[1] - a[1]) - (p[1] - a[1]) * (b[0] - a[0])
}

impl Group {
    const EMPTY: Self = Self {
        corners: [[[0.0; LANES]; 2]; 3],
        depth: [[1.0; LANES]; 3],
        area: [1.0; LANES],
        low: [[f64::INFINITY; LANES]; 2],
        high: [[f64::NEG_INFINITY; LANES]; 2],
        index: [0; LANES],
    };

    fn set(&mut self, l: usize, face: &Candidate) {
        for k in 0..3 {
            for axis in 0..2 {
                self.corners[k][axis][l] = face.corners[k][axis];
            }
            self.depth[k][l] = face.depth[k];
        }
        for axis in 0..2 {
            (self.low[axis][l], self.high[axis][l]) = (face.low[axis], face.high[axis]);
        }
        (self.area[l], self.index[l]) = (face.area, face.index);
    }
}

/// What is found out about a group at a pixel.
struct Found {
    counts: [bool; LANES],
    depth: [f64; LANES],
    x: [f64; LANES],
    way: [[f64; LANES]; 2],
    nearest: [f64; LANES],
    s: [f64; LANES],
}

/// Add the faces of a group that count at a pixel.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn meet(group: &Group, pixel: [f64; 2], (sigma, radius): (f64, f64), hits: &mut Vec<Hit>) {
    let none = [0.0; LANES];
    let mut found = Found {
        counts: [false; LANES],
        depth: none,
        x: none,
        way: [none; 2],
        nearest: none,
        s: none,
    };
    let mut any = false;
    for l in 0..LANES {
        let within = (group.low[0][l] <= pixel[0])
            & (pixel[0] <= group.high[0][l])
            & (group.low[1][l] <= pixel[1])
            & (pixel[1] <= group.high[1][l]);
        found.counts[l] = within;
        any |= within;
    }
    if !any {
        return;
    }
    for l in 0..LANES {
        let c = [0, 1, 2].map(|k| [group.corners[k][0][l], group.corners[k][1][l]]);
        let z = [0, 1, 2].map(|k| group.depth[k][l]);
        // In the order of the original: at a corner the depth has to be that of the corner exactly,
        // or the faces around it would not tie.
        let area = group.area[l] + EPSILON;
        let w0 = edge(pixel, c[1], c[2]) / area * z[1] * z[2];
        let w1 = edge(pixel, c[2], c[0]) / area * z[0] * z[2];
        let w2 = edge(pixel, c[0], c[1]) / area * z[0] * z[1];
        let sum = (w0 + w1 + w2).most(EPSILON);
        let (w0, w1, w2) = (w0 / sum, w1 / sum, w2 / sum);
        let inside = (w0 > 0.0) & (w1 > 0.0) & (w2 > 0.0);
        let (w0, w1, w2) = (w0.most(0.0), w1.most(0.0), w2.most(0.0));
        let sum = (w0 + w1 + w2).most(1e-5);
        let (w0, w1, w2) = (w0 / sum, w1 / sum, w2 / sum);
        let depth = w0 * z[0] + w1 * z[1] + w2 * z[2];
        let (q0, s0, d0) = towards(pixel, c[0], c[1]);
        let (q1, s1, d1) = towards(pixel, c[1], c[2]);
        let (q2, s2, d2) = towards(pixel, c[2], c[0]);
        let second = d1 < d0;
        let (q, s, squared) = if second { (q1, s1, d1) } else { (q0, s0, d0) };
        let third = d2 < squared;
        let nearest = if second { 1.0 } else { 0.0 };
        let nearest = if third { 2.0 } else { nearest };
        let squared = if third { d2 } else { squared };
        found.s[l] = if third { s2 } else { s };
        found.way[0][l] = if third { q2[0] } else { q[0] };
        found.way[1][l] = if third { q2[1] } else { q[1] };
        found.nearest[l] = nearest;
        found.counts[l] &= (inside | (squared < radius)) & (depth >= 0.0);
        found.depth[l] = depth;
        found.x[l] = if inside { squared } else { -squared } / sigma;
    }
    for l in 0..LANES {
        if found.counts[l] {
            hits.push(Hit {
                depth: found.depth[l],
                index: group.index[l],
                x: found.x[l],
                way: [found.way[0][l], found.way[1][l]],
                edge: found.nearest[l] as usize,
                s: found.s[l],
            });
        }
    }
}

/// The nearest point of an edge: from the pixel, where on the edge, and its squared distance.
#[inline(always)]
fn towards(pixel: [f64; 2], a: [f64; 2], b: [f64; 2]) -> ([f64; 2], f64, f64) {
    let d = [b[0] - a[0], b[1] - a[1]];
    let length = d[0] * d[0] + d[1] * d[1];
    let s = (pixel[0] - a[0]) * d[0] + (pixel[1] - a[1]) * d[1];
    let s = (s / if length > 0.0 { length } else { 1.0 }).most(0.0).least(1.0);
    let s = if length > 0.0 { s } else { 0.0 };
    let q = [a[0] + s * d[0] - pixel[0], a[1] + s * d[1] - pixel[1]];
    (q, s, q[0] * q[0] + q[1] * q[1])
}
