//! The soft masks against loops over all faces and all pixels, written from the definitions.

mod cutoffs;
mod large;

use proptest::prelude::*;

use crate::camera::Intrinsics;
use crate::raster::{
    KaolinCutoff, Mode, Model, Pixel, Pytorch3dCutoff, Screen, Size, View, dibr, sigmoid,
};

/// Numbers in 0..1, always the same.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// A model whose vertices are image points `(u, v)` and depths: under [`view`] they come out as
/// they are, so that a test moves image points by moving vertices.
#[derive(Debug, Clone)]
struct Scene {
    points: Vec<[f64; 3]>,
    faces: Vec<[u32; 3]>,
    size: Size,
}

impl Scene {
    fn model(&self) -> Model {
        Model::new(&self.points.iter().map(|_| [0.0; 3]).collect::<Vec<_>>(), &self.faces)
            .and_then(|model| {
                // Distinct vertices, so that only equal image points are welded.
                let place: Vec<[f64; 3]> =
                    self.points.iter().map(|p| p.map(|c| c.clamp(-1e9, 1e9))).collect();
                model.with_vertices(&place)
            })
            .expect("a model")
    }

    /// The image points themselves, with depth as the third number.
    fn screen(&self) -> Screen {
        let axis = |k: usize| self.points.iter().map(|p| p[k]).collect::<Vec<_>>();
        let mut screen = Screen::default();
        let view = View {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, 3e9],
            camera: Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("a camera"),
        };
        screen.project(&self.model(), &view, 1e-3).expect("in front");
        (screen.u, screen.v, screen.z) = (axis(0), axis(1), axis(2));
        let pairs = |p: &[f64], z: &[f64]| p.iter().zip(z).map(|(p, z)| p * z).collect();
        screen.x = pairs(&screen.u, &screen.z);
        screen.y = pairs(&screen.v, &screen.z);
        screen
    }

    fn draw<T: Pixel>(&self, mode: Mode) -> Vec<f64> {
        let mut out = vec![T::from_f64(7.0); self.size.pixels()];
        let (model, screen, size) = (self.model(), self.screen(), self.size);
        match mode {
            Mode::Dibr { delta, cutoff } => {
                dibr::draw(&model, &screen, size, delta, cutoff, &mut out);
            }
            Mode::Sigmoid { sigma, cutoff } => {
                sigmoid::draw(&model, &screen, size, sigma, cutoff, &mut out);
            }
            _ => panic!("another module's"),
        }
        out.into_iter().map(Pixel::to_f64).collect()
    }

    /// Gradients for all `u`, then all `v`.
    fn back<T: Pixel>(&self, mode: Mode, upstream: &[f64]) -> Vec<f64> {
        let upstream: Vec<T> = upstream.iter().map(|&up| T::from_f64(up)).collect();
        let (model, screen, size) = (self.model(), self.screen(), self.size);
        let mut du = vec![0.0; screen.points()];
        let mut dv = du.clone();
        let (a, b) = (&mut du[..], &mut dv[..]);
        match mode {
            Mode::Dibr { delta, cutoff } => {
                dibr::back(&model, &screen, size, delta, cutoff, &upstream, a, b);
            }
            Mode::Sigmoid { sigma, cutoff } => {
                sigmoid::back(&model, &screen, size, sigma, cutoff, &upstream, a, b);
            }
            _ => panic!("another module's"),
        }
        du.extend(dv);
        du
    }

    fn upstream(&self) -> Vec<f64> {
        let mut noise = Noise(99);
        (0..self.size.pixels()).map(|_| f64::from((2.0 * noise.next() - 1.0) as f32)).collect()
    }
}

/// Crossing triangles in and around the image, one of them doubled, one turned over, and three
/// without area.
fn soup(seed: u64, size: Size, spread: f64) -> Scene {
    let mut noise = Noise(seed);
    let [width, height] = [size.width as f64, size.height as f64];
    let mut points: Vec<[f64; 3]> = (0..18)
        .map(|_| {
            let at = |side: f64, x: f64| side * (0.5 + spread * (x - 0.5));
            [at(width, noise.next()), at(height, noise.next()), 1.0 + noise.next()]
        })
        .collect();
    points.push(points[3]);
    let mut faces: Vec<[u32; 3]> = (0..6).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    faces.extend([[0, 1, 2], [5, 4, 3], [6, 6, 9], [7, 7, 7], [18, 3, 10], [0, 4, 10]]);
    Scene { points, faces, size }
}

const SIZES: [Size; 3] = [
    Size { height: 24, width: 32 },
    Size { height: 19, width: 13 },
    Size { height: 41, width: 70 },
];

fn scenes() -> impl Iterator<Item = Scene> {
    (0..12).map(|k| soup(k, SIZES[k as usize % 3], [0.7, 1.0, 2.5, 30.0][k as usize % 4]))
}

fn cross(o: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
}

/// Squared distance to a segment.
fn segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let d = [b[0] - a[0], b[1] - a[1]];
    let length = d[0] * d[0] + d[1] * d[1];
    let s = (p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1];
    let s = if length > 0.0 { (s / length).clamp(0.0, 1.0) } else { 0.0 };
    (a[0] + s * d[0] - p[0]).powi(2) + (a[1] + s * d[1] - p[1]).powi(2)
}

/// Squared distance to the outline, whether inside (closed), and twice the area.
fn triangle(p: [f64; 2], t: [[f64; 2]; 3]) -> (f64, bool, f64) {
    let squared = (0..3).map(|k| segment(p, t[k], t[(k + 1) % 3])).fold(f64::INFINITY, f64::min);
    let sides: Vec<f64> = (0..3).map(|k| cross(t[k], t[(k + 1) % 3], p)).collect();
    let area = cross(t[0], t[1], t[2]);
    let square = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let flat = area.abs() <= 1e-12 * (square(t[0], t[1]) + square(t[0], t[2]));
    let area = if flat { 0.0 } else { area };
    let inside = sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0);
    (squared, inside && area != 0.0, area)
}

/// The exact masks by definition.
fn oracle(scene: &Scene, mode: Mode) -> Vec<f64> {
    let Size { height, width } = scene.size;
    let [w, h] = [width as f64, height as f64];
    let ndc = |p: [f64; 2]| match mode {
        Mode::Dibr { .. } => [2.0 * p[0] / w - 1.0, 1.0 - 2.0 * p[1] / h],
        _ => [(w - 2.0 * p[0]) / w.min(h), (h - 2.0 * p[1]) / w.min(h)],
    };
    let mut out = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let p = ndc([column as f64 + 0.5, row as f64 + 0.5]);
            let mut left = 1.0;
            for face in &scene.faces {
                let corner = |k: usize| scene.points[face[k] as usize];
                let t = [0, 1, 2].map(|k| ndc([corner(k)[0], corner(k)[1]]));
                let (squared, inside, area) = triangle(p, t);
                left *= match mode {
                    Mode::Dibr { .. } if inside => 0.0,
                    Mode::Dibr { delta, .. } => -(-delta * squared).exp_m1(),
                    Mode::Sigmoid { sigma, .. } if area != 0.0 => {
                        let x = if inside { squared } else { -squared } / sigma;
                        1.0 / (1.0 + x.exp())
                    }
                    _ => 1.0,
                };
            }
            out.push(1.0 - left);
        }
    }
    out
}

const EXACT: [Mode; 4] = [
    Mode::Dibr { delta: 7000.0, cutoff: None },
    Mode::Dibr { delta: 150.0, cutoff: None },
    Mode::Sigmoid { sigma: 1e-4, cutoff: None },
    Mode::Sigmoid { sigma: 1e-2, cutoff: None },
];

fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, |m, d| if d <= m { m } else { d })
}

fn largest(a: &[f64]) -> f64 {
    a.iter().fold(1e-30, |m, x| x.abs().max(m))
}

#[test]
fn exact_masks_are_those_of_the_definition() {
    for (k, scene) in scenes().enumerate() {
        for mode in EXACT {
            let exact = oracle(&scene, mode);
            let double = difference(&scene.draw::<f64>(mode), &exact);
            assert!(double < 1e-11, "scene {k} {mode:?}: {double}");
            let single = difference(&scene.draw::<f32>(mode), &exact);
            assert!(single < 2e-5, "scene {k} {mode:?}: {single}");
        }
    }
}

#[test]
fn single_precision_will_do_for_any_number_of_faces() {
    let size = Size { height: 40, width: 50 };
    for cells in [10, 40, 160] {
        // Two triangles a cell, on a square of ten pixels.
        let point = |k: usize| 20.3 + 10.0 * k as f64 / cells as f64;
        let points = (0..(cells + 1) * (cells + 1))
            .map(|k| [point(k % (cells + 1)), point(k / (cells + 1)) - 5.0, 1.0])
            .collect();
        let faces = (0..cells * cells).flat_map(|k| {
            let at = |x: usize, y: usize| ((k / cells + y) * (cells + 1) + k % cells + x) as u32;
            [[at(0, 0), at(1, 0), at(0, 1)], [at(1, 1), at(0, 1), at(1, 0)]]
        });
        let scene = Scene { points, faces: faces.collect(), size };
        for mode in
            [Mode::Dibr { delta: 300.0, cutoff: None }, Mode::Sigmoid { sigma: 3e-3, cutoff: None }]
        {
            let error = difference(&scene.draw::<f32>(mode), &scene.draw::<f64>(mode));
            assert!(error < 5e-5, "{cells} {mode:?}: {error}");
        }
    }
}

#[test]
fn faces_smaller_than_their_digits_keep_their_shape() {
    let size = Size { height: 19, width: 25 };
    for (tiny, turn) in [(1e-5, 0.1), (1e-8, 0.8), (1e-11, 2.0), (1e-12, 4.0)] {
        let corner = |k: f64| {
            let (sin, cos) = (turn + 2.1 * k).sin_cos();
            [14.909_519 + tiny * cos, 4.596_29 + tiny * sin, 1.0]
        };
        let points = vec![corner(0.0), corner(1.0), corner(2.0)];
        let scene = Scene { points, faces: vec![[0, 1, 2]], size };
        for mode in EXACT {
            let error = difference(&scene.draw::<f32>(mode), &oracle(&scene, mode));
            assert!(error < 2e-5, "{tiny} {mode:?}: {error}");
        }
    }
}

#[test]
fn thin_widths_are_drawn_in_double_precision() {
    // The last is drawn in single precision, just.
    for (delta, tolerance) in [(3e7, 1e-6), (6.3e4, 1e-6), (6.2e4, 5e-5)] {
        let mode = Mode::Dibr { delta, cutoff: None };
        for scene in scenes() {
            let error = difference(&scene.draw::<f32>(mode), &oracle(&scene, mode));
            assert!(error < tolerance, "delta {delta}: {error}");
        }
    }
}

#[test]
fn exact_gradients_are_those_of_the_mask() {
    for (k, scene) in scenes().enumerate() {
        let upstream = scene.upstream();
        for mode in EXACT {
            let value = |scene: &Scene| -> f64 {
                scene.draw::<f64>(mode).iter().zip(&upstream).map(|(s, u)| s * u).sum()
            };
            let gradient = scene.back::<f64>(mode, &upstream);
            let scale = largest(&gradient);
            let count = scene.points.len();
            let step = 1e-6;
            // The corners of faces without area, or of the pair that coincides, have two sides.
            for point in [1, 2, 8, 11, 12, 13, 14, 15, 16, 17] {
                for axis in 0..2 {
                    let mut moved = [scene.clone(), scene.clone()];
                    moved[0].points[point][axis] += step;
                    moved[1].points[point][axis] -= step;
                    let numeric = (value(&moved[0]) - value(&moved[1])) / (2.0 * step);
                    let analytic = gradient[axis * count + point];
                    assert!(
                        (numeric - analytic).abs() < 2e-6 * scale.max(0.1),
                        "scene {k} {mode:?} point {point}: {numeric} {analytic} of {scale}"
                    );
                }
            }
            // Of two corners at one place either may be the nearest.
            let merged = |gradient: &[f64]| {
                let mut merged = gradient.to_vec();
                for axis in 0..2 {
                    merged[axis * count + 3] += merged[axis * count + 18];
                    merged[axis * count + 18] = 0.0;
                }
                merged
            };
            let single = scene.back::<f32>(mode, &upstream);
            let error = difference(&merged(&single), &merged(&gradient));
            assert!(error < 3e-4 * scale, "scene {k} {mode:?}: {error} of {scale}");
        }
    }
}

#[test]
fn the_first_bits_do_not_depend_on_what_was_drawn_before() {
    let (scene, other) = (soup(5, SIZES[1], 1.0), soup(6, SIZES[2], 2.0));
    for mode in EXACT {
        let (mask, gradient) =
            (scene.draw::<f32>(mode), scene.back::<f32>(mode, &scene.upstream()));
        other.draw::<f32>(mode);
        other.back::<f32>(mode, &other.upstream());
        assert_eq!(scene.draw::<f32>(mode), mask);
        assert_eq!(scene.back::<f32>(mode, &scene.upstream()), gradient);
    }
}

#[test]
fn a_mask_without_faces_near_is_zero() {
    let mut scene = soup(1, SIZES[0], 0.1);
    for p in &mut scene.points {
        p[0] += 500.0;
    }
    for mode in EXACT {
        assert!(
            scene.draw::<f32>(Mode::Dibr { delta: 7000.0, cutoff: None }).iter().all(|&s| s == 0.0)
        );
        let gradient = scene.back::<f64>(mode, &scene.upstream());
        assert!(gradient.iter().all(|g| g.abs() < 1e-12));
    }
}

#[test]
fn large_upstream_gradients_do_not_overflow() {
    let scene = soup(3, SIZES[0], 0.7);
    let upstream: Vec<f64> = scene.upstream().iter().map(|u| u * 1e38).collect();
    for mode in EXACT {
        let gradient = scene.back::<f32>(mode, &upstream);
        assert!(gradient.iter().all(|g| g.is_finite()) && largest(&gradient) > 1e36);
    }
}

/// Coordinates that hurt: pixel centres, borders, equal and huge ones.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -40.0..60.0_f64,
        3 => (-4_i32..30).prop_map(|k| f64::from(k) + 0.5),
        2 => (-4_i32..30).prop_map(f64::from),
        1 => prop_oneof![Just(1e9), Just(-1e9), Just(1e30), Just(-1e30), Just(1e-300), Just(1e5)],
    ]
}

proptest! {
    #[test]
    fn masks_and_gradients_are_finite(
        points in prop::collection::vec((coordinate(), coordinate(), 1e-3..5.0_f64), 4..9),
        picks in prop::collection::vec((0_u32..1000, 0_u32..1000, 0_u32..1000), 1..24),
        delta in prop_oneof![Just(7000.0), Just(1e-6), Just(1e12), 1.0..1e5_f64],
        cut in any::<bool>(),
    ) {
        let n = points.len() as u32;
        let scene = Scene {
            points: points.iter().map(|&(u, v, z)| [u, v, z]).collect(),
            faces: picks.iter().map(|&(a, b, c)| [a % n, b % n, c % n]).collect(),
            size: Size { height: 10, width: 14 },
        };
        let kaolin = KaolinCutoff { boxlen: 0.3, knum: 3 };
        let pytorch3d = Pytorch3dCutoff { blur_radius: 10.0 / delta, faces_per_pixel: 3 };
        let upstream = scene.upstream();
        for mode in [
            Mode::Dibr { delta, cutoff: cut.then_some(kaolin) },
            Mode::Sigmoid { sigma: 1.0 / delta, cutoff: cut.then_some(pytorch3d) },
        ] {
            for mask in [scene.draw::<f32>(mode), scene.draw::<f64>(mode)] {
                prop_assert!(mask.iter().all(|s| (0.0..=1.0 + 1e-6).contains(s)), "{mode:?} {mask:?}");
            }
            let (single, double) =
                (scene.back::<f32>(mode, &upstream), scene.back::<f64>(mode, &upstream));
            prop_assert!(single.iter().chain(&double).all(|g| g.is_finite()), "{mode:?} {single:?} {double:?}");
        }
    }

    #[test]
    fn exact_masks_of_awkward_triangles_are_those_of_the_definition(
        points in prop::collection::vec((-40.0..60.0_f64, -40.0..60.0_f64), 4..9),
        snap in any::<bool>(),
        picks in prop::collection::vec((0_u32..1000, 0_u32..1000, 0_u32..1000), 1..12),
    ) {
        let n = points.len() as u32;
        let at = |c: f64| if snap { c.round() + 0.5 } else { c };
        let scene = Scene {
            points: points.iter().map(|&(u, v)| [at(u), at(v), 1.0]).collect(),
            faces: picks.iter().map(|&(a, b, c)| [a % n, b % n, c % n]).collect(),
            size: Size { height: 10, width: 14 },
        };
        for mode in EXACT {
            let exact = oracle(&scene, mode);
            prop_assert!(difference(&scene.draw::<f64>(mode), &exact) < 1e-9);
            prop_assert!(difference(&scene.draw::<f32>(mode), &exact) < 5e-5);
        }
    }
}

#[test]
fn a_kept_product_gives_the_same_gradient() {
    use crate::raster::{Batch, Wanted};
    let size = Size { height: 18, width: 24 };
    let scene = soup(3, size, 4.0);
    let points: Vec<[f64; 3]> = scene.points.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let model = Model::new(&points, &scene.faces).expect("a model");
    let camera = Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("a camera");
    let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let views = [View { rotation, translation: [0.0, 0.0, 1.0], camera }];
    let upstream: Vec<f32> =
        (0..size.pixels()).map(|k| ((k * 7919) % 1000) as f32 / 500.0 - 1.0).collect();
    let wide: Vec<f64> = upstream.iter().map(|&x| f64::from(x)).collect();
    for mode in
        [Mode::Dibr { delta: 700.0, cutoff: None }, Mode::Sigmoid { sigma: 1e-3, cutoff: None }]
    {
        let batch = Batch { models: &[&model], views: &views, size, mode, near: None };
        let wanted = Wanted { vertices: true };
        let (mut plain, mut traced) = (vec![0.0_f32; upstream.len()], vec![9.0; upstream.len()]);
        batch.draw(&mut plain).expect("drawn");
        let traces = batch.draw_traced(&mut traced).expect("drawn");
        assert_eq!(plain, traced);
        assert!(traces.bytes() > 0);
        let again = batch.gradients(&upstream, wanted).expect("drawn");
        let kept = batch.gradients_of(&traces, &upstream, wanted).expect("drawn");
        assert!(again.vertices[0].iter().any(|g| *g != 0.0));
        assert_eq!((again.views, again.vertices), (kept.views, kept.vertices));
        // A product in single precision is not that of a mask in double precision.
        let again = batch.gradients(&wide, wanted).expect("drawn");
        let kept = batch.gradients_of(&traces, &wide, wanted).expect("drawn");
        assert_eq!(again.views, kept.views);
        let other = Batch { mode: Mode::Dibr { delta: 7.0, cutoff: None }, ..batch };
        let refused = other.gradients_of(&traces, &upstream, wanted).expect_err("refused");
        assert!(refused.to_string().contains("traces"), "{refused}");
    }
}

#[test]
fn masks_of_small_triangles_are_those_of_the_definition() {
    let (size, mut noise) = (Size { height: 24, width: 32 }, Noise(11));
    for k in 0..2000 {
        let length = [0.1, 0.6, 3.0, 9.0][k % 4];
        let corner = [6.0 + 20.0 * noise.next(), 5.0 + 14.0 * noise.next()];
        let points = (0..3)
            .map(|_| {
                let [u, v] = corner;
                [u + length * (noise.next() - 0.5), v + length * (noise.next() - 0.5), 1.0]
            })
            .collect();
        let scene = Scene { points, faces: vec![[0, 1, 2]], size };
        let delta = [1e3, 7e3][k / 4 % 2];
        for mode in
            [Mode::Dibr { delta, cutoff: None }, Mode::Sigmoid { sigma: 1.0 / delta, cutoff: None }]
        {
            let exact = oracle(&scene, mode);
            let double = difference(&scene.draw::<f64>(mode), &exact);
            let single = difference(&scene.draw::<f32>(mode), &exact);
            assert!(double < 1e-11 && single < 2e-5, "{k} {mode:?}: {double}, {single}");
        }
    }
}
