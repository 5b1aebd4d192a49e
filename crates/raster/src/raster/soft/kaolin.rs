//! DIB-R's mask as Kaolin 0.1 computes it (`kaolin.graphics.dib_renderer`), in `f64`.
//!
//! - A pixel is 1 if a face whose normal has `n_z >= 0` in Kaolin's camera frame (y up, looking
//!   down -z) holds its centre, half-open at the bounding box.
//! - Any other multiplies, in the order of their index, the first `knum` faces, of either winding,
//!   whose bounding box grown by `boxlen` holds its centre.
//!
//! Expressions follow the original so that the same faces are counted; coordinates are multiplied
//! by 1000 as `DIBRenderer` does. The gradient treats boxes, counts and the pixels inside as
//! constant, as the original's does.

use std::cell::RefCell;

use crate::raster::{KaolinCutoff, Model, Pixel, Screen, Size};

/// What `DIBRenderer` multiplies coordinates by.
const MULTIPLIER: f64 = 1000.0;
/// Added to denominators, in multiplied units.
const EPSILON: f64 = 1e-15;
/// Faces at this depth (metres, down -z) or beyond are not drawn.
const DEEPEST: f64 = -1000.0;
/// Keeps factors and products away from 0.
const LEAST_FACTOR: f64 = 1e-60;
const LEAST_PRODUCT: f64 = 1e-200;

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    /// The product so far; 0 inside.
    left: Vec<f64>,
    /// Faces met.
    met: Vec<usize>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Draw the mask `(H, W)`; every pixel of `out` is written.
pub(in crate::raster) fn draw<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    delta: f64,
    cutoff: KaolinCutoff,
    out: &mut [T],
) {
    SCRATCH.with_borrow_mut(|scratch| {
        products(scratch, model, screen, size, delta, cutoff);
        for (pixel, left) in out.iter_mut().zip(&scratch.left) {
            *pixel = T::from_f64(1.0 - left);
        }
    });
}

/// Add the gradient of `sum(upstream * mask)` for image points (pixels) to `du` and `dv`.
pub(in crate::raster) fn back<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    delta: f64,
    cutoff: KaolinCutoff,
    upstream: &[T],
    [du, dv]: [&mut [f64]; 2],
) {
    SCRATCH.with_borrow_mut(|scratch| {
        products(scratch, model, screen, size, delta, cutoff);
        let Scratch { left, met } = scratch;
        met.fill(0);
        let scale = [2.0 / size.width as f64, -2.0 / size.height as f64];
        let grid = Grid::new(size);
        for face in screen.faces(model) {
            let corners = grid.corners(screen, face);
            grid.visit(&corners, cutoff.boxlen * MULTIPLIER, |at, pixel| {
                if left[at] == 0.0 || met[at] == cutoff.knum {
                    return;
                }
                met[at] += 1;
                let up = upstream[at].to_f64();
                let near = nearest(&corners, pixel);
                let p = probability(near.squared, delta);
                let others = left[at] / (1.0 - p).max(LEAST_FACTOR);
                let weight = -up * others * p * (delta / MULTIPLIER);
                if weight == 0.0 {
                    return;
                }
                for (corner, share) in [(near.from, 1.0 - near.s), (near.to, near.s)] {
                    let point = face[corner] as usize;
                    for (axis, out) in [&mut *du, &mut *dv].into_iter().enumerate() {
                        let way = (near.point[axis] - pixel[axis]) / MULTIPLIER;
                        out[point] += weight * MULTIPLIER * 2.0 * share * way * scale[axis];
                    }
                }
            });
        }
    });
}

/// Leave the products in `left`: 0 inside of a face.
fn products(
    scratch: &mut Scratch,
    model: &Model,
    screen: &Screen,
    size: Size,
    delta: f64,
    cutoff: KaolinCutoff,
) {
    let Scratch { left, met } = scratch;
    left.clear();
    left.resize(size.pixels(), 1.0);
    met.clear();
    met.resize(size.pixels(), 0);
    let grid = Grid::new(size);
    for face in screen.faces(model) {
        if !is_front(screen, face) {
            continue;
        }
        let corners = grid.corners(screen, face);
        let depth = face.map(|k| -screen.z[k as usize]);
        grid.visit(&corners, 0.0, |at, pixel| {
            if holds(&corners, &depth, pixel) {
                left[at] = 0.0;
            }
        });
    }
    for face in screen.faces(model) {
        let corners = grid.corners(screen, face);
        grid.visit(&corners, cutoff.boxlen * MULTIPLIER, |at, pixel| {
            if left[at] == 0.0 || met[at] == cutoff.knum {
                return;
            }
            met[at] += 1;
            let p = probability(nearest(&corners, pixel).squared, delta);
            left[at] = (left[at] * (1.0 - p).max(LEAST_FACTOR)).max(LEAST_PRODUCT);
        });
    }
}

fn probability(squared: f64, delta: f64) -> f64 {
    (-delta * squared / (MULTIPLIER * MULTIPLIER)).exp()
}

/// Whether `n_z >= 0` in Kaolin's camera frame.
fn is_front(screen: &Screen, face: &[u32; 3]) -> bool {
    let [a, b, c] = face.map(|k| (screen.x[k as usize], -screen.y[k as usize]));
    (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0) >= 0.0
}

/// Whether a face holds a pixel, at a depth that is drawn.
fn holds(corners: &[[f64; 2]; 3], depth: &[f64; 3], [x, y]: [f64; 2]) -> bool {
    let [[ax, ay], [bx, by], [cx, cy]] = *corners;
    let (m, p, n, q) = (bx - ax, by - ay, cx - ax, cy - ay);
    let k = m * q - n * p + EPSILON;
    let w1 = ((x - ax) * q - n * (y - ay)) / k;
    let w2 = (m * (y - ay) - (x - ax) * p) / k;
    let w0 = 1.0 - w1 - w2;
    let z = w0 * depth[0] + w1 * depth[1] + w2 * depth[2];
    !(w0 < 0.0 || w1 < 0.0 || w2 < 0.0) && z > DEEPEST
}

/// The nearest point of a face's outline.
struct Nearest {
    squared: f64,
    point: [f64; 2],
    /// Corners of its edge, and where it is between them.
    from: usize,
    to: usize,
    s: f64,
}

/// The original's choice among three edges and three corners, the former first.
fn nearest(corners: &[[f64; 2]; 3], [x, y]: [f64; 2]) -> Nearest {
    let far = 4.0 * MULTIPLIER * MULTIPLIER;
    let mut best = Nearest { squared: f64::INFINITY, point: corners[0], from: 0, to: 0, s: 0.0 };
    for k in 0..3 {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let e = [b[0] - a[0], b[1] - a[1]];
        let length = e[0] * e[0] + e[1] * e[1] + EPSILON;
        let up = e[0] * (a[1] - y) - e[1] * (a[0] - x);
        let (p, q, r) = (e[1], -e[0], b[0] * a[1] - a[0] * b[1]);
        let foot =
            [(q * q * x - p * q * y - p * r) / length, (p * p * y - p * q * x - q * r) / length];
        let beyond =
            (foot[0] - a[0]) * (foot[0] - b[0]) + (foot[1] - a[1]) * (foot[1] - b[1]) > 0.0;
        let squared = if beyond { far } else { up * up / length };
        if squared < best.squared {
            let s = if beyond {
                0.0 // a constant distance: see below
            } else {
                ((x - a[0]) * e[0] + (y - a[1]) * e[1]) / length
            };
            // So far away nothing is left of the probability; the pixel itself has no gradient.
            let point = if beyond { [x, y] } else { [a[0] + s * e[0], a[1] + s * e[1]] };
            best = Nearest { squared, point, from: k, to: (k + 1) % 3, s };
        }
    }
    for (k, c) in corners.iter().enumerate() {
        let squared = (x - c[0]) * (x - c[0]) + (y - c[1]) * (y - c[1]);
        if squared < best.squared {
            best = Nearest { squared, point: *c, from: k, to: k, s: 0.0 };
        }
    }
    best
}

/// Pixel centres in multiplied NDC: x to the right, y up.
struct Grid {
    size: Size,
}

impl Grid {
    fn new(size: Size) -> Self {
        Self { size }
    }

    fn corners(&self, screen: &Screen, face: &[u32; 3]) -> [[f64; 2]; 3] {
        let [width, height] = [self.size.width, self.size.height].map(|side| side as f64);
        face.map(|k| {
            let (u, v) = (screen.u[k as usize], screen.v[k as usize]);
            [(u * (2.0 / width) - 1.0) * MULTIPLIER, (v * (-2.0 / height) + 1.0) * MULTIPLIER]
        })
    }

    /// Call `work` with every pixel in the half-open bounding box grown by `margin`.
    fn visit(&self, corners: &[[f64; 2]; 3], margin: f64, mut work: impl FnMut(usize, [f64; 2])) {
        let Size { height, width } = self.size;
        let range = |axis: usize| {
            let [a, b, c] = corners.map(|p| p[axis]);
            (a.min(b).min(c) - margin, a.max(b).max(c) + margin)
        };
        let ((left, right), (low, high)) = (range(0), range(1));
        // Wide of the box by a pixel or two; the comparisons decide.
        let pixel = |ndc: f64, side: usize| {
            ((ndc / MULTIPLIER + 1.0) * 0.5 * side as f64).clamp(0.0, side as f64)
        };
        let columns =
            (pixel(left, width) - 2.0) as usize..(pixel(right, width) as usize + 2).min(width);
        let rows =
            (pixel(-high, height) - 2.0) as usize..(pixel(-low, height) as usize + 2).min(height);
        let (wide, tall) = (width as f64, height as f64);
        for row in rows {
            let y = MULTIPLIER / tall * (tall - 2.0 * row as f64 - 1.0);
            if !(y >= low && y < high) {
                continue;
            }
            for column in columns.clone() {
                let x = MULTIPLIER / wide * (2.0 * column as f64 + 1.0 - wide);
                if x >= left && x < right {
                    work(row * width + column, [x, y]);
                }
            }
        }
    }
}
