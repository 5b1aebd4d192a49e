//! Planes of the faces in the model frame: the side of its plane that the camera is on says which
//! way round a face appears in the image, without its image points.
//!
//! For camera points `q = R p + t` of a face, `det(q_a, q_b, q_c) = det(R) (p_a . n) + w . n` with
//! the normal `n = (p_b - p_a) x (p_c - p_a)` and `w = cof(R)^T t`, for any matrix `R`. In front of
//! the camera it has the sign of the area of the projected face.

use multiversion::multiversion;

use super::View;

/// For each face the normal, as long as twice its area, and the place of the plane along it.
#[derive(Debug, Clone, Default)]
pub(super) struct Planes {
    normal: [Vec<f64>; 3],
    offset: Vec<f64>,
    /// Largest distance from the origin along each axis, over all vertices.
    reach: [f64; 3],
}

impl Planes {
    pub(super) fn new(axes: [&[f64]; 3], faces: &[[u32; 3]]) -> Self {
        let mut planes = Self {
            reach: axes.map(|axis| axis.iter().fold(0.0, |reach, c| c.abs().max(reach))),
            ..Self::default()
        };
        for buffer in planes.normal.iter_mut().chain([&mut planes.offset]) {
            buffer.reserve_exact(faces.len());
        }
        for face in faces {
            let [a, b, c] = face.map(|k| axes.map(|axis| axis[k as usize]));
            let (e, f): ([f64; 3], [f64; 3]) =
                (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
            let n = cross(e, f);
            for (buffer, n) in planes.normal.iter_mut().zip(n) {
                buffer.push(n);
            }
            planes.offset.push(a[0] * n[0] + a[1] * n[1] + a[2] * n[2]);
        }
        planes
    }

    /// Which way round each face appears, 1 or -1; 0 where rounding leaves it open. Image points
    /// are those of [`Screen::project`](super::Screen::project), moved by `shift`.
    pub(super) fn signs(&self, facing: &Facing, shift: f64, signs: &mut Vec<u8>) {
        signs.resize(self.offset.len(), 0);
        let [x, y, z] = &self.normal;
        signs_of([x, y, z, &self.offset], facing.weights, facing.doubt(shift), signs);
    }

    /// Whether the normal of each face points away from the camera's image plane, along z: 1 or -1;
    /// 0 where rounding leaves it open for the camera points of [`Screen`](super::Screen).
    pub(super) fn leanings(&self, facing: &Facing, leanings: &mut Vec<u8>) {
        leanings.resize(self.offset.len(), 0);
        let [x, y, z] = &self.normal;
        signs_of([x, y, z, &self.offset], facing.along, facing.level, leanings);
    }
}

/// A view as the planes see it, none of whose points is cut off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Facing {
    /// For the normal, `cof(R)^T t`, and for the offset, `det(R)`.
    weights: [f64; 4],
    /// The same for the normal's part along z, `cof(R)`'s last row and 0.
    along: [f64; 4],
    /// Bound of the rounding errors of the planes.
    error: f64,
    /// The same of the normal's part along z.
    level: f64,
    /// The largest image coordinate, and more: `bound + shift` times the unit roundoff, times 16,
    /// is what image coordinates can be wrong by.
    bound: f64,
    /// Largest product of the depths of three points over the product of the focal lengths.
    scale: f64,
}

impl Facing {
    /// Of a view in which the smallest depth is `low`, above 0.
    pub(super) fn new(planes: &Planes, view: &View, low: f64) -> Self {
        let View { rotation: r, translation: t, camera: k } = view;
        let cofactors = [cross(r[1], r[2]), cross(r[2], r[0]), cross(r[0], r[1])];
        let [cx, cy, cz] = cofactors;
        let w = |j: usize| cx[j] * t[0] + cy[j] * t[1] + cz[j] * t[2];
        let det = r[0][0] * cx[0] + r[0][1] * cx[1] + r[0][2] * cx[2];
        let largest =
            |c: &[f64]| c.iter().fold(0.0_f64, |m, c| if c.abs() <= m { m } else { c.abs() });
        let (m, p, t_max) = (largest(r.as_flattened()), largest(&planes.reach), largest(t));
        // What the terms of a coordinate in the camera frame add up to.
        let terms = |i: usize| {
            let moved = (0..3).map(|j| r[i][j].abs() * planes.reach[j]);
            moved.sum::<f64>() + t[i].abs()
        };
        let sum = largest(&[terms(0), terms(1), terms(2)]);
        let roundoff = f64::EPSILON / 2.0;
        // Counted one rounding after another: at most 1920 and 288; and what underflow loses.
        let bound = |error: f64| {
            if sum < 1e15 && m < 1e15 { error * roundoff + 1e-250 } else { f64::INFINITY }
        };
        Self {
            weights: [w(0), w(1), w(2), det],
            along: [cz[0], cz[1], cz[2], 0.0],
            error: bound(2500.0 * (m * p).powi(2) * (m * p + t_max)),
            // At most 5 for a coordinate, of two products of differences.
            level: bound(512.0 * sum.powi(2)),
            bound: (k.fx + k.fy + k.skew.abs()) * (sum / low).powi(2) + k.cx.abs() + k.cy.abs(),
            scale: 512.0 * roundoff * sum.powi(3) / (k.fx * k.fy),
        }
    }

    /// Nearer to 0 than this, the sign of a plane may not be that of the area in the image.
    fn doubt(&self, shift: f64) -> f64 {
        self.error + self.scale * (self.bound + shift).powi(2)
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn signs_of(planes: [&[f64]; 4], weights: [f64; 4], doubt: f64, signs: &mut [u8]) {
    let [x, y, z, offset] = planes;
    let [wx, wy, wz, det] = weights;
    for ((((sign, x), y), z), offset) in signs.iter_mut().zip(x).zip(y).zip(z).zip(offset) {
        let volume = wx * x + wy * y + wz * z + det * offset;
        *sign = u8::from(volume > doubt).wrapping_sub(u8::from(volume < -doubt));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::raster::{Model, Screen};

    #[test]
    fn a_sign_that_is_given_is_that_of_the_area_in_the_image() {
        let mut seed = 1_u64;
        let mut next = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let (mut given, mut open, mut level) = (0, 0, 0);
        for round in 0..400 {
            let (sin, cos) = (3.0 * next()).sin_cos();
            let view = View {
                rotation: [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
                translation: [next(), next(), 1.8 + next()],
                camera: Intrinsics::new(300.0, 200.0 + next(), 50.0, 40.0).expect("valid"),
            };
            let [tx, ty, tz] = view.translation;
            let eye = [-cos * tx - sin * ty, sin * tx - cos * ty, -tz];
            let mut vertices: Vec<[f64; 3]> = (0..60).map(|_| [next(), next(), next()]).collect();
            let mut faces: Vec<[u32; 3]> =
                (0..200).map(|_| std::array::from_fn(|_| ((next() + 0.5) * 60.0) as u32)).collect();
            // Seen from their edge, but for rounding.
            for k in (0..20).step_by(3) {
                let (s, t) = (next(), next());
                let along = |j: usize| vertices[k][j] - eye[j];
                let across = |j: usize| vertices[k + 1][j] - vertices[k][j];
                vertices[k + 2] =
                    std::array::from_fn(|j| vertices[k][j] + 0.1 * s * along(j) + t * across(j));
                faces.push([k as u32, k as u32 + 1, k as u32 + 2]);
            }
            // Upright: the rotation is about z.
            vertices[59] = [vertices[58][0], vertices[58][1], next()];
            faces.push([57, 58, 59]);
            let model = Model::new(&vertices, &faces).expect("valid");
            let shift = f64::from(round % 7);
            let mut screen = Screen::default();
            screen.project(&model, &view, 1e-3).expect("drawn");
            let Some(facing) = screen.facing() else { continue };
            let mut signs = Vec::new();
            model.planes().signs(facing, shift, &mut signs);
            for (sign, face) in signs.iter().zip(&faces) {
                let [a, b, c] =
                    face.map(|k| [screen.u[k as usize] + shift, screen.v[k as usize] + shift]);
                let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
                match sign {
                    0 => open += 1,
                    1 => assert!(area > 0.0),
                    _ => assert!(area < 0.0),
                }
                given += usize::from(*sign != 0);
            }
            model.planes().leanings(facing, &mut signs);
            for (leaning, face) in signs.iter().zip(&faces) {
                match leaning {
                    0 => level += 1,
                    1 => assert!(!screen.is_front(*face)),
                    _ => assert!(screen.is_front(*face)),
                }
            }
        }
        assert!(given > 10 * open && open > 0, "{given} given, {open} open");
        assert!(given > 10 * level && level > 0, "{given} given, {level} level");
    }
}
