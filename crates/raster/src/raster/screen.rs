//! A model under a view: points in the camera frame and in the image, cut at the near plane.

mod chain;

use foldhash::fast::FixedState;
use hashbrown::HashMap;
use pulp::{Arch, Simd, WithSimd};

pub use self::chain::ViewGradient;
use super::Model;
use super::planes::Facing;
use crate::camera::Intrinsics;
use crate::error::{Error, Result};

/// The largest coordinate in the camera frame that is drawn, in metres.
const LARGEST_IN_CAMERA: f64 = 1e12;

/// The largest focal length, principal point or skew, in pixels.
const LARGEST_INTRINSIC: f64 = 1e9;

/// A pose and a camera. `rotation` may be any finite matrix: gradients are those of a free 3x3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// `R` of `cam_from_model`, row by row.
    pub rotation: [[f64; 3]; 3],
    /// `t` of `cam_from_model`, in metres.
    pub translation: [f64; 3],
    /// The camera, in pixels, with pixel centres at `+ 0.5`.
    pub camera: Intrinsics,
}

impl View {
    /// Refuses what cannot be drawn, by name; `row` is the place in the batch.
    ///
    /// # Errors
    /// [`Error::Argument`]: an entry that is not finite, a focal length that is not positive, an
    /// intrinsic above 1e9 pixels.
    pub fn check(&self, row: usize) -> Result<()> {
        if let Some(bad) = self.rotation.as_flattened().iter().find(|c| !c.is_finite()) {
            return Err(Error::argument(
                format!("R[{row}]"),
                format!("found {bad}, expected finite numbers"),
            ));
        }
        if let Some(bad) = self.translation.iter().find(|c| !c.is_finite()) {
            return Err(Error::argument(
                format!("t[{row}]"),
                format!("found {bad}, expected finite numbers"),
            ));
        }
        let k = &self.camera;
        for (name, value) in [("fx", k.fx), ("fy", k.fy)] {
            if !(value > 0.0 && value <= LARGEST_INTRINSIC) {
                let message = format!(
                    "{name} is {value}; expected a focal length above 0 and up to 1e9 pixels"
                );
                return Err(Error::argument("K", message));
            }
        }
        for (name, value) in [("cx", k.cx), ("cy", k.cy), ("skew", k.skew)] {
            if value.is_nan() || value.abs() > LARGEST_INTRINSIC {
                return Err(Error::argument(
                    "K",
                    format!("{name} is {value}; expected at most 1e9 pixels"),
                ));
            }
        }
        Ok(())
    }
}

/// A point where an edge meets the near plane: `a + s (b - a)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    /// The end of the edge in front of the plane.
    pub a: u32,
    /// The end behind it.
    pub b: u32,
    /// Where between them.
    pub s: f64,
}

/// A model under a view. The arrays hold the model's vertices, then the [cuts](Self::cuts).
///
/// Image points of vertices nearer than the near plane are finite and without meaning; no face of
/// [`faces`](Self::faces) names them.
#[derive(Debug, Clone, Default)]
pub struct Screen {
    /// Image points in pixels.
    pub u: Vec<f64>,
    /// See `u`.
    pub v: Vec<f64>,
    /// Points in the camera frame, in metres.
    pub x: Vec<f64>,
    /// See `x`.
    pub y: Vec<f64>,
    /// See `x`.
    pub z: Vec<f64>,
    /// The points added at the near plane.
    pub cuts: Vec<Cut>,
    cut_faces: Vec<[u32; 3]>,
    parents: Vec<u32>,
    vertices: usize,
    clipped: bool,
    facing: Option<Facing>,
}

impl Screen {
    /// Transform, project and clip; the buffers are used again.
    ///
    /// # Errors
    /// [`Error::Argument`] if a point lies further than 1e12 m away.
    pub fn project(&mut self, model: &Model, view: &View, near: f64) -> Result<()> {
        let n = model.vertex_count();
        for axis in [&mut self.u, &mut self.v, &mut self.x, &mut self.y, &mut self.z] {
            axis.resize(n, 0.0);
        }
        self.vertices = n;
        let (low, within) = ARCH.with(|arch| {
            arch.dispatch(Transform {
                model: [&model.x, &model.y, &model.z],
                view,
                near,
                out: [&mut self.x, &mut self.y, &mut self.z, &mut self.u, &mut self.v],
            })
        });
        if !within {
            return Err(Error::argument("R, t", "a vertex is further than 1e12 m from the camera"));
        }
        self.clipped = low < near;
        self.facing = (!self.clipped).then(|| Facing::new(model.planes(), view, low));
        if self.clipped {
            self.clip(model, view, near);
        } else {
            self.cuts.clear();
        }
        Ok(())
    }

    /// Whether the near plane cut something away. If not, faces are those of the model.
    #[must_use]
    pub fn is_clipped(&self) -> bool {
        self.clipped
    }

    /// The view as the planes of the model see it, unless the near plane cut something away.
    pub(super) fn facing(&self) -> Option<&Facing> {
        self.facing.as_ref()
    }

    /// The faces in front of the near plane.
    #[must_use]
    pub fn faces<'a>(&'a self, model: &'a Model) -> &'a [[u32; 3]] {
        if self.clipped { &self.cut_faces } else { model.faces() }
    }

    /// Whether the normal of a face, its corners in order, does not point along z, away from the camera's
    /// image plane: `n_z >= 0` in a camera frame with y up that looks along -z, as Kaolin has it.
    #[inline(always)]
    pub(super) fn is_front(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = face.map(|k| [self.x[k as usize], -self.y[k as usize]]);
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) >= 0.0
    }

    /// The face of the model that a face of the screen is a part of.
    #[must_use]
    pub fn parent(&self, face: usize) -> usize {
        if self.clipped { self.parents[face] as usize } else { face }
    }

    /// Number of image points, cuts included.
    #[must_use]
    pub fn points(&self) -> usize {
        self.u.len()
    }

    /// Cut the triangles at `z = near` (Sutherland & Hodgman, CACM 1974). The two faces of an edge
    /// share the new point.
    fn clip(&mut self, model: &Model, view: &View, near: f64) {
        let (z, mut made) = (&self.z, HashMap::<(u32, u32), u32, FixedState>::default());
        self.cuts.clear();
        self.cut_faces.clear();
        self.parents.clear();
        let inside = |k: u32| z[k as usize] >= near;
        for (f, face) in model.faces().iter().enumerate() {
            let mut polygon = [0_u32; 4];
            let mut corners = 0;
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                if inside(a) {
                    polygon[corners] = a;
                    corners += 1;
                }
                if inside(a) != inside(b) {
                    let (a, b) = if inside(a) { (a, b) } else { (b, a) };
                    let next = (self.vertices + self.cuts.len()) as u32;
                    let point = *made.entry((a, b)).or_insert(next);
                    if point == next {
                        let (za, zb) = (z[a as usize], z[b as usize]);
                        self.cuts.push(Cut { a, b, s: (near - za) / (zb - za) });
                    }
                    polygon[corners] = point;
                    corners += 1;
                }
            }
            for k in 2..corners {
                self.cut_faces.push([polygon[0], polygon[k - 1], polygon[k]]);
                self.parents.push(f as u32);
            }
        }
        let k = &view.camera;
        for cut in &self.cuts {
            let (a, b) = (cut.a as usize, cut.b as usize);
            let x = self.x[a] + cut.s * (self.x[b] - self.x[a]);
            let y = self.y[a] + cut.s * (self.y[b] - self.y[a]);
            self.x.push(x);
            self.y.push(y);
            self.z.push(near);
            self.u.push((k.fx * x + k.skew * y) / near + k.cx);
            self.v.push(k.fy * y / near + k.cy);
        }
    }
}

thread_local! {
    static ARCH: Arch = Arch::new();
}

/// The most lanes of any instruction set.
const LANES: usize = 8;

/// Camera and image points `x, y, z, u, v` of all vertices; the smallest depth, and whether all
/// vertices are within [`LARGEST_IN_CAMERA`].
struct Transform<'a> {
    model: [&'a [f64]; 3],
    view: &'a View,
    near: f64,
    out: [&'a mut [f64]; 5],
}

/// The numbers of a view in all lanes.
struct Lanes<S: Simd> {
    rotation: [[S::f64s; 3]; 3],
    translation: [S::f64s; 3],
    camera: [S::f64s; 5],
    near: S::f64s,
    limit: S::f64s,
    one: S::f64s,
}

impl<S: Simd> Lanes<S> {
    /// `x, y, z, u, v`, and where the point is not within [`LARGEST_IN_CAMERA`], 1.
    #[inline(always)]
    fn point(&self, simd: S, p: [S::f64s; 3], beyond: S::f64s) -> ([S::f64s; 5], S::f64s) {
        let [x, y, z] = [self.axis(simd, p, 0), self.axis(simd, p, 1), self.axis(simd, p, 2)];
        let far = simd.add_f64s(simd.abs_f64s(x), simd.abs_f64s(y));
        let far = simd.add_f64s(far, simd.abs_f64s(z));
        let within = simd.less_than_or_equal_f64s(far, self.limit);
        let beyond = simd.select_f64s(within, beyond, self.one);
        let inverse = simd.div_f64s(self.one, simd.max_f64s(z, self.near));
        let [fx, fy, skew, cx, cy] = self.camera;
        let u = simd.add_f64s(simd.mul_f64s(fx, x), simd.mul_f64s(skew, y));
        let u = simd.add_f64s(simd.mul_f64s(u, inverse), cx);
        let v = simd.add_f64s(simd.mul_f64s(simd.mul_f64s(fy, y), inverse), cy);
        ([x, y, z, u, v], beyond)
    }

    #[inline(always)]
    fn axis(&self, simd: S, p: [S::f64s; 3], k: usize) -> S::f64s {
        let row = &self.rotation[k];
        let sum = simd.add_f64s(simd.mul_f64s(row[0], p[0]), simd.mul_f64s(row[1], p[1]));
        let sum = simd.add_f64s(sum, simd.mul_f64s(row[2], p[2]));
        simd.add_f64s(sum, self.translation[k])
    }
}

impl WithSimd for Transform<'_> {
    type Output = (f64, bool);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f64, bool) {
        let Self { model: [mx, my, mz], view, near, out: [x, y, z, u, v] } = self;
        let (r, t, k) = (&view.rotation, &view.translation, &view.camera);
        let mut lanes = Lanes::<S> {
            rotation: [[simd.splat_f64s(0.0); 3]; 3],
            translation: [simd.splat_f64s(0.0); 3],
            camera: [simd.splat_f64s(0.0); 5],
            near: simd.splat_f64s(near),
            limit: simd.splat_f64s(LARGEST_IN_CAMERA),
            one: simd.splat_f64s(1.0),
        };
        for i in 0..3 {
            for j in 0..3 {
                lanes.rotation[i][j] = simd.splat_f64s(r[i][j]);
            }
            lanes.translation[i] = simd.splat_f64s(t[i]);
        }
        for (i, value) in [k.fx, k.fy, k.skew, k.cx, k.cy].into_iter().enumerate() {
            lanes.camera[i] = simd.splat_f64s(value);
        }
        let mut low = simd.splat_f64s(f64::INFINITY);
        let mut beyond = simd.splat_f64s(0.0);
        let ((mx, ends_x), (my, ends_y), (mz, ends_z)) =
            (S::as_simd_f64s(mx), S::as_simd_f64s(my), S::as_simd_f64s(mz));
        let ((x, end_x), (y, end_y), (z, end_z)) =
            (S::as_mut_simd_f64s(x), S::as_mut_simd_f64s(y), S::as_mut_simd_f64s(z));
        let ((u, end_u), (v, end_v)) = (S::as_mut_simd_f64s(u), S::as_mut_simd_f64s(v));
        let points = mx.iter().zip(my).zip(mz);
        let places = x.iter_mut().zip(y).zip(z).zip(u).zip(v);
        for (((mx, my), mz), ((((x, y), z), u), v)) in points.zip(places) {
            ([*x, *y, *z, *u, *v], beyond) = lanes.point(simd, [*mx, *my, *mz], beyond);
            low = simd.min_f64s(*z, low);
        }
        if !ends_x.is_empty() {
            // What is left over, filled up with its first point.
            let mut fill = [ends_x, ends_y, ends_z].map(|ends| [ends[0]; LANES]);
            for (lane, ends) in fill.iter_mut().zip([ends_x, ends_y, ends_z]) {
                lane[..ends.len()].copy_from_slice(ends);
            }
            let [a, b, c] = &fill;
            let p = [S::as_simd_f64s(a).0[0], S::as_simd_f64s(b).0[0], S::as_simd_f64s(c).0[0]];
            let out;
            (out, beyond) = lanes.point(simd, p, beyond);
            low = simd.min_f64s(out[2], low);
            simd.partial_store_f64s(end_x, out[0]);
            simd.partial_store_f64s(end_y, out[1]);
            simd.partial_store_f64s(end_z, out[2]);
            simd.partial_store_f64s(end_u, out[3]);
            simd.partial_store_f64s(end_v, out[4]);
        }
        (simd.reduce_min_f64s(low), simd.reduce_max_f64s(beyond) == 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let (s, c) = (0.6, 0.8);
        View {
            rotation: [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
            translation: [0.1, -0.2, 1.1],
            camera: Intrinsics {
                skew: 1.5,
                ..Intrinsics::new(50.0, 60.0, 16.0, 12.0).expect("valid")
            },
        }
    }

    fn model() -> Model {
        let v = [[0.5, 0.1, -0.3], [-0.4, 0.6, 0.2], [0.2, -0.7, 0.4], [0.1, 0.2, -2.0]];
        Model::new(&v, &[[0, 1, 2], [0, 2, 3], [1, 3, 2], [0, 3, 1]]).expect("valid")
    }

    fn weighted_sum(screen: &Screen) -> f64 {
        (0..screen.points())
            .filter(|&k| k >= 4 || screen.z[k] >= 0.5)
            .map(|k| (0.3 + k as f64) * screen.u[k] - (1.0 + (k * k) as f64) * screen.v[k])
            .sum()
    }

    #[test]
    fn the_pull_back_is_the_derivative_across_the_near_plane_too() {
        let (model, view, near) = (model(), view(), 0.5);
        let mut screen = Screen::default();
        screen.project(&model, &view, near).expect("drawn");
        assert!(screen.is_clipped() && screen.cuts.len() == 3);
        let n = screen.points();
        let seen = |k: usize| k >= 4 || screen.z[k] >= near;
        let du: Vec<f64> = (0..n).map(|k| if seen(k) { 0.3 + k as f64 } else { 0.0 }).collect();
        let dv: Vec<f64> =
            (0..n).map(|k| if seen(k) { -1.0 - (k * k) as f64 } else { 0.0 }).collect();
        let mut gradient = ViewGradient::default();
        let mut vertices = vec![0.0; 12];
        screen.pull_back(&model, &view, &du, &dv, &mut gradient, Some(&mut vertices));
        let value = |view: &View, model: &Model| {
            let mut screen = Screen::default();
            screen.project(model, view, near).expect("drawn");
            weighted_sum(&screen)
        };
        let h = 1e-6;
        let check = |analytic: f64, plus: f64, minus: f64| {
            let numeric = (plus - minus) / (2.0 * h);
            assert!(
                (analytic - numeric).abs() < 1e-4 * (1.0 + numeric.abs()),
                "{analytic} {numeric}"
            );
        };
        for row in 0..3 {
            let moved = |d: f64| {
                let mut v = view;
                v.translation[row] += d;
                value(&v, &model)
            };
            check(gradient.translation[row], moved(h), moved(-h));
            for column in 0..3 {
                let turned = |d: f64| {
                    let mut v = view;
                    v.rotation[row][column] += d;
                    value(&v, &model)
                };
                check(gradient.rotation[row][column], turned(h), turned(-h));
            }
        }
        let zoomed = |d: f64| {
            let mut v = view;
            v.camera.fx += d;
            value(&v, &model)
        };
        check(gradient.camera[0][0], zoomed(h), zoomed(-h));
        for k in 0..12 {
            let bent = |d: f64| {
                let mut points: Vec<[f64; 3]> = (0..4).map(|k| model.vertex(k)).collect();
                points[k / 3][k % 3] += d;
                value(&view, &Model::new(&points, model.faces()).expect("valid"))
            };
            check(vertices[k], bent(h), bent(-h));
        }
    }

    #[test]
    fn a_model_behind_the_camera_has_no_faces_left() {
        let mut screen = Screen::default();
        let behind = View { translation: [0.0, 0.0, -5.0], ..view() };
        screen.project(&model(), &behind, 0.1).expect("drawn");
        assert!(screen.faces(&model()).is_empty() && screen.points() == 4);
    }
}
