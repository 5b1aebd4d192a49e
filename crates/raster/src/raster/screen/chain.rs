//! From the gradient for image points to that for the pose and the camera, by the chain rule, with
//! eight points side by side: the same sums in the same order on every instruction set.

use pulp::{Simd, WithSimd};

use super::super::Model;
use super::{ARCH, Cut, LANES, Screen, View};

/// Sums over points: five of the camera, three of the translation, nine of the rotation.
const SUMS: usize = 17;

/// Derivatives of a number with respect to a view.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ViewGradient {
    /// `dL/dR`, `R` as a free matrix, row by row.
    pub rotation: [[f64; 3]; 3],
    /// `dL/dt`.
    pub translation: [f64; 3],
    /// `dL/dK`, row by row; zero outside `fx, skew, cx, fy, cy`.
    pub camera: [[f64; 3]; 3],
}

impl Screen {
    /// Carry the gradient for image points on to the view and, where asked for, to the model's
    /// vertices (`(V, 3)`, interleaved, added to).
    ///
    /// # Panics
    /// If the slices are not of [`points`](Self::points) numbers, or are shorter than `3 V`.
    pub fn pull_back(
        &self,
        model: &Model,
        view: &View,
        du: &[f64],
        dv: &[f64],
        out: &mut ViewGradient,
        vertices: Option<&mut [f64]>,
    ) {
        assert_eq!([du.len(), dv.len()], [self.points(); 2], "du, dv: one for each point");
        if self.clipped {
            self.pull_back_cut(model, view, [du, dv], out, vertices);
            return;
        }
        let points = Points {
            model: [&model.x, &model.y, &model.z],
            camera: [&self.x, &self.y, &self.z],
            gradient: [du, dv],
        };
        points.pull_back(view, out);
        let Some(vertices) = vertices else { return };
        for (v, (&gu, &gv)) in du.iter().zip(dv).enumerate() {
            if gu != 0.0 || gv != 0.0 {
                add_to_vertex(view, self.force(view, v, [gu, gv]), vertices, v);
            }
        }
    }

    /// Of a view in which faces are cut at the near plane; points of no face have no gradient.
    fn pull_back_cut(
        &self,
        model: &Model,
        view: &View,
        [du, dv]: [&[f64]; 2],
        out: &mut ViewGradient,
        mut vertices: Option<&mut [f64]>,
    ) {
        let mut on_vertex = |v: usize, g: [f64; 3], out: &mut ViewGradient| {
            let p = model.vertex(v);
            for row in 0..3 {
                out.translation[row] += g[row];
                for column in 0..3 {
                    out.rotation[row][column] += g[row] * p[column];
                }
            }
            if let Some(vertices) = vertices.as_deref_mut() {
                add_to_vertex(view, g, vertices, v);
            }
        };
        for (point, (&gu, &gv)) in du.iter().zip(dv).enumerate() {
            if gu == 0.0 && gv == 0.0 {
                continue;
            }
            let (xn, yn) = (self.x[point] / self.z[point], self.y[point] / self.z[point]);
            out.camera[0][0] += gu * xn;
            out.camera[0][1] += gu * yn;
            out.camera[0][2] += gu;
            out.camera[1][1] += gv * yn;
            out.camera[1][2] += gv;
            let [gx, gy, gz] = self.force(view, point, [gu, gv]);
            if point < self.vertices {
                on_vertex(point, [gx, gy, gz], out);
            } else {
                // z stays on the plane: what is lost there comes back through s.
                let Cut { a, b, s } = self.cuts[point - self.vertices];
                let (a, b) = (a as usize, b as usize);
                let ds = gx * (self.x[b] - self.x[a]) + gy * (self.y[b] - self.y[a]);
                let per_depth = ds / (self.z[b] - self.z[a]);
                on_vertex(a, [(1.0 - s) * gx, (1.0 - s) * gy, (s - 1.0) * per_depth], out);
                on_vertex(b, [s * gx, s * gy, -s * per_depth], out);
            }
        }
    }

    /// The gradient for a point in the camera frame.
    fn force(&self, view: &View, point: usize, [gu, gv]: [f64; 2]) -> [f64; 3] {
        let k = &view.camera;
        let inverse = 1.0 / self.z[point];
        let (gx, gy) = (k.fx * gu * inverse, (k.skew * gu + k.fy * gv) * inverse);
        [gx, gy, -(gx * (self.x[point] * inverse) + gy * (self.y[point] * inverse))]
    }
}

/// Add the gradient for a point in the camera frame to that for its vertex.
fn add_to_vertex(view: &View, g: [f64; 3], vertices: &mut [f64], v: usize) {
    let r = &view.rotation;
    for column in 0..3 {
        vertices[3 * v + column] += r[0][column] * g[0] + r[1][column] * g[1] + r[2][column] * g[2];
    }
}

/// Coordinates and gradients of points, one array each, of one length.
#[derive(Debug, Clone, Copy)]
struct Points<'a> {
    /// In the model frame.
    model: [&'a [f64]; 3],
    /// In the camera frame, in front of the camera.
    camera: [&'a [f64]; 3],
    /// For the image points.
    gradient: [&'a [f64]; 2],
}

impl Points<'_> {
    /// Add the gradient for the view.
    fn pull_back(self, view: &View, out: &mut ViewGradient) {
        let mut sums = [[0.0; LANES]; SUMS];
        ARCH.with(|arch| arch.dispatch(Wide { points: self, view, sums: &mut sums }));
        let count = self.gradient[0].len();
        for k in count / LANES * LANES..count {
            let at = |axis: &[f64]| axis[k];
            let (gradient, camera) = (self.gradient.map(at), self.camera.map(at));
            let terms = terms(pulp::Scalar, view, gradient, camera, self.model.map(at));
            for (sum, term) in sums.iter_mut().zip(terms) {
                sum[k % LANES] += term;
            }
        }
        let [fx, skew, cx, fy, cy, tx, ty, tz, rotation @ ..] =
            sums.map(|lanes| lanes.iter().sum::<f64>());
        let rows = [[fx, skew, cx], [0.0, fy, cy]];
        let places = out.camera.as_flattened_mut().iter_mut().chain(&mut out.translation);
        let places = places.chain(out.rotation.as_flattened_mut());
        let sums = rows.into_iter().chain([[0.0; 3], [tx, ty, tz]]).flatten().chain(rotation);
        for (place, sum) in places.zip(sums) {
            *place += sum;
        }
    }
}

/// What a point adds to each sum.
#[inline(always)]
fn terms<S: Simd>(
    s: S,
    view: &View,
    [gu, gv]: [S::f64s; 2],
    [x, y, z]: [S::f64s; 3],
    model: [S::f64s; 3],
) -> [S::f64s; SUMS] {
    let k = &view.camera;
    let inverse = s.div_f64s(s.splat_f64s(1.0), z);
    let (xn, yn) = (s.mul_f64s(x, inverse), s.mul_f64s(y, inverse));
    let gx = s.mul_f64s(s.mul_f64s(s.splat_f64s(k.fx), gu), inverse);
    let (skewed, own) = (s.mul_f64s(s.splat_f64s(k.skew), gu), s.mul_f64s(s.splat_f64s(k.fy), gv));
    let gy = s.mul_f64s(s.add_f64s(skewed, own), inverse);
    let gz = s.neg_f64s(s.add_f64s(s.mul_f64s(gx, xn), s.mul_f64s(gy, yn)));
    let [a, b, c] = model;
    let by = |g| [s.mul_f64s(g, a), s.mul_f64s(g, b), s.mul_f64s(g, c)];
    let ([rx, ry, rz], [ux, uy, uz], [fx, fy, fz]) = (by(gx), by(gy), by(gz));
    let (by_xn, by_yn) = (s.mul_f64s(gu, xn), s.mul_f64s(gu, yn));
    let own = s.mul_f64s(gv, yn);
    [by_xn, by_yn, gu, own, gv, gx, gy, gz, rx, ry, rz, ux, uy, uz, fx, fy, fz]
}

/// All points but the last few.
struct Wide<'a> {
    points: Points<'a>,
    view: &'a View,
    sums: &'a mut [[f64; LANES]; SUMS],
}

impl WithSimd for Wide<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, s: S) {
        let Self { points, view, sums } = self;
        let parts = LANES / S::F64_LANES;
        let count = points.gradient[0].len() / LANES * LANES;
        let ([gu, gv], [x, y, z], [a, b, c]) = (
            points.gradient.map(|axis| S::as_simd_f64s(&axis[..count]).0),
            points.camera.map(|axis| S::as_simd_f64s(&axis[..count]).0),
            points.model.map(|axis| S::as_simd_f64s(&axis[..count]).0),
        );
        for part in 0..parts {
            let mut found = [s.splat_f64s(0.0); SUMS];
            for k in (part..count / S::F64_LANES).step_by(parts) {
                let terms = terms(s, view, [gu[k], gv[k]], [x[k], y[k], z[k]], [a[k], b[k], c[k]]);
                for i in 0..SUMS {
                    found[i] = s.add_f64s(found[i], terms[i]);
                }
            }
            for i in 0..SUMS {
                S::as_mut_simd_f64s(&mut sums[i]).0[part] = found[i];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::camera::Intrinsics;

    proptest! {
        #[test]
        fn every_width_of_register_gives_the_same_bits(
            points in prop::collection::vec(prop::array::uniform8(-1.0..1.0_f64), 0..40),
            skew in -1.0..1.0_f64,
        ) {
            let axis = |k: usize| points.iter().map(|p| p[k]).collect::<Vec<_>>();
            let [a, b, c, x, y, z, gu, gv] = [0, 1, 2, 3, 4, 5, 6, 7].map(axis);
            let z: Vec<f64> = z.iter().map(|z| z + 1.5).collect();
            let points = Points { model: [&a, &b, &c], camera: [&x, &y, &z], gradient: [&gu, &gv] };
            let view = View {
                rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                translation: [0.0; 3],
                camera: Intrinsics { skew, ..Intrinsics::new(50.0, 60.0, 16.0, 12.0).expect("valid") },
            };
            let (mut widest, mut scalar) = ([[0.0; LANES]; SUMS], [[0.0; LANES]; SUMS]);
            ARCH.with(|arch| arch.dispatch(Wide { points, view: &view, sums: &mut widest }));
            pulp::Scalar.vectorize(Wide { points, view: &view, sums: &mut scalar });
            prop_assert_eq!(widest, scalar);
            let mut found = ViewGradient::default();
            points.pull_back(&view, &mut found);
            let mut slow = ViewGradient::default();
            for k in 0..x.len() {
                let (xn, yn, k_) = (x[k] / z[k], y[k] / z[k], &view.camera);
                let g = [k_.fx * gu[k] / z[k], (k_.skew * gu[k] + k_.fy * gv[k]) / z[k]];
                let g = [g[0], g[1], -g[0] * xn - g[1] * yn];
                for (row, g) in g.into_iter().enumerate() {
                    slow.translation[row] += g;
                    for (column, p) in [a[k], b[k], c[k]].into_iter().enumerate() {
                        slow.rotation[row][column] += g * p;
                    }
                }
                for (place, term) in [(0, gu[k] * xn), (1, gu[k] * yn), (2, gu[k]), (4, gv[k] * yn), (5, gv[k])] {
                    slow.camera.as_flattened_mut()[place] += term;
                }
            }
            let all = |g: &ViewGradient| {
                [g.rotation.as_flattened(), &g.translation, g.camera.as_flattened()].concat()
            };
            for (found, slow) in all(&found).iter().zip(all(&slow)) {
                prop_assert!((found - slow).abs() < 1e-9, "{found}, {slow}");
            }
        }
    }
}
