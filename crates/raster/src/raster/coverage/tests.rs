//! Against the definition: sample points, finite differences, areas known in closed form.

use proptest::prelude::*;

use super::*;
use crate::camera::Intrinsics;
use crate::raster::View;

/// Image points as given: a camera at unit distance with unit focal length.
fn flat_view() -> View {
    View {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0, 0.0, 1.0],
        camera: Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("valid"),
    }
}

fn flat(points: &[[f64; 2]], faces: &[[u32; 3]]) -> (Model, Screen) {
    let vertices: Vec<[f64; 3]> = points.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let model = Model::new(&vertices, faces).expect("valid");
    let mut screen = Screen::default();
    screen.project(&model, &flat_view(), 1e-3).expect("drawn");
    (model, screen)
}

fn mask(points: &[[f64; 2]], faces: &[[u32; 3]], size: Size, sigma: f64) -> Vec<f64> {
    let (model, screen) = flat(points, faces);
    let mut out = vec![f64::NAN; size.pixels()];
    draw(&model, &screen, size, sigma, &mut out);
    out
}

/// Fraction of `n x n` samples of each pixel that lie in a triangle.
fn sampled(points: &[[f64; 2]], faces: &[[u32; 3]], size: Size, n: usize) -> Vec<f64> {
    let inside = |x: f64, y: f64| {
        faces.iter().any(|f| {
            let p = f.map(|k| points[k as usize]);
            let side =
                |a: [f64; 2], b: [f64; 2]| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
            let s = [side(p[0], p[1]), side(p[1], p[2]), side(p[2], p[0])];
            s.iter().all(|s| *s > 0.0) || s.iter().all(|s| *s < 0.0)
        })
    };
    let at = |k: usize| (k as f64 + 0.5) / n as f64;
    let mut out = Vec::new();
    for i in 0..size.height {
        for j in 0..size.width {
            let hits =
                (0..n * n).filter(|k| inside(j as f64 + at(k % n), i as f64 + at(k / n))).count();
            out.push(hits as f64 / (n * n) as f64);
        }
    }
    out
}

const SMALL: Size = Size { height: 6, width: 8 };

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= tolerance, "pixel {k}: {a} and {b}");
    }
}

#[test]
fn a_square_on_the_grid_and_one_off_it() {
    let faces = [[0, 1, 2], [0, 2, 3]];
    let on = [[1.0, 1.0], [4.0, 1.0], [4.0, 3.0], [1.0, 3.0]];
    let got = mask(&on, &faces, SMALL, 0.0);
    for i in 0..6 {
        for j in 0..8 {
            let expected = f64::from((1..4).contains(&j) && (1..3).contains(&i));
            assert!((got[i * 8 + j] - expected).abs() < 1e-15, "{i} {j}");
        }
    }
    let off = on.map(|p| [p[0] + 0.25, p[1] + 0.5]);
    let got = mask(&off, &faces, SMALL, 0.0);
    assert_close(&got[8..14], &[0.0, 0.375, 0.5, 0.5, 0.125, 0.0], 1e-15);
    assert_close(&got[16..22], &[0.0, 0.75, 1.0, 1.0, 0.25, 0.0], 1e-15);
}

#[test]
fn an_object_larger_than_the_image_covers_it() {
    let big = [[-100.0, -200.0], [300.0, -200.0], [-100.0, 250.0]];
    let got = mask(&big, &[[0, 1, 2]], SMALL, 0.0);
    assert_close(&got, &vec![1.0; 48], 1e-12);
    let got = mask(&big, &[[0, 2, 1]], SMALL, 1.5);
    assert_close(&got, &vec![1.0; 48], 1e-9);
    let left = [[-100.0, -200.0], [2.5, -200.0], [2.5, 250.0], [-100.0, 250.0]];
    let got = mask(&left, &[[0, 1, 2], [0, 2, 3]], SMALL, 0.0);
    assert_close(&got[..8], &[1.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0], 1e-12);
    let right = left.map(|p| [5.0 - p[0], p[1]]);
    let got = mask(&right, &[[0, 1, 2], [0, 2, 3]], SMALL, 0.0);
    assert_close(&got[..8], &[0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0], 1e-12);
}

fn soup() -> impl Strategy<Value = (Vec<[f64; 2]>, Vec<[u32; 3]>)> {
    // A grid of quarters makes coincident points, collinear edges and zero areas common.
    let coordinate = prop_oneof![-2.0..10.0, (-8..40_i32).prop_map(|k| f64::from(k) / 4.0)];
    let points = prop::collection::vec([coordinate.clone(), coordinate], 3..14);
    let faces = prop::collection::vec([0..14_u32, 0..14_u32, 0..14_u32], 1..10);
    (points, faces).prop_map(|(points, faces)| {
        let n = points.len() as u32;
        let faces = faces.into_iter().map(|f| f.map(|k| k % n)).collect();
        (points, faces)
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn images_of_any_width_are_drawn_whole(
        width in 1..70_usize,
        height in 1..9_usize,
        (points, faces) in soup(),
        stretch in 1.0..12.0,
    ) {
        let points: Vec<_> = points.iter().map(|p| [p[0] * stretch, p[1]]).collect();
        let size = Size { height, width };
        let got = mask(&points, &faces, size, 0.0);
        for (k, (a, b)) in got.iter().zip(&sampled(&points, &faces, size, 16)).enumerate() {
            prop_assert!((a - b).abs() < 0.17, "pixel {k}: {a}, sampled {b}");
        }
    }

    #[test]
    fn any_soup_is_what_samples_say((points, faces) in soup()) {
        let got = mask(&points, &faces, SMALL, 0.0);
        let expected = sampled(&points, &faces, SMALL, 24);
        for (k, (a, b)) in got.iter().zip(&expected).enumerate() {
            prop_assert!((a - b).abs() < 0.12, "pixel {k}: {a}, sampled {b}");
        }
        let (a, b): (f64, f64) = (got.iter().sum(), expected.iter().sum());
        prop_assert!((a - b).abs() < 0.35, "sums {a} and {b}");
    }

    #[test]
    fn only_the_union_counts((points, faces) in soup(), shift in 0..9_usize) {
        let got = mask(&points, &faces, SMALL, 0.0);
        let mut other: Vec<[u32; 3]> = faces.iter().rev().map(|f| [f[1], f[2], f[0]]).collect();
        other[0].swap(0, 1);
        other.push(faces[shift % faces.len()]);
        other.push([faces[0][2], faces[0][1], faces[0][0]]);
        assert_close(&mask(&points, &other, SMALL, 0.0), &got, 1e-12);
        // Every face in four.
        let mut finer = points.clone();
        let mut quarters = Vec::new();
        for f in &faces {
            let mut middle = |a: u32, b: u32| {
                let (p, q) = (finer[a as usize], finer[b as usize]);
                finer.push([0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])]);
                finer.len() as u32 - 1
            };
            let [a, b, c] = *f;
            let (x, y, z) = (middle(a, b), middle(b, c), middle(c, a));
            quarters.extend([[a, x, z], [b, y, x], [c, z, y], [x, y, z]]);
        }
        assert_close(&mask(&finer, &quarters, SMALL, 0.0), &got, 1e-9);
    }

    #[test]
    fn whole_pixels_move_the_image((points, faces) in soup()) {
        let got = mask(&points, &faces, SMALL, 0.0);
        let moved: Vec<[f64; 2]> = points.iter().map(|p| [p[0] + 3.0, p[1] + 2.0]).collect();
        let other = mask(&moved, &faces, Size { height: 8, width: 11 }, 0.0);
        for i in 0..6 {
            assert_close(&other[(i + 2) * 11 + 3..][..8], &got[i * 8..][..8], 1e-12);
        }
    }

    #[test]
    fn splitting_a_pixel_changes_nothing(
        (points, faces) in soup(),
        times in prop_oneof![Just(1), Just(2), Just(40)],
    ) {
        // The whole soup inside one pixel, and the same large.
        let tiny: Vec<[f64; 2]> =
            points.iter().map(|p| [1.0 + (p[0] + 2.0) / 16.0, 1.0 + (p[1] + 2.0) / 16.0]).collect();
        let many: Vec<[u32; 3]> = faces.iter().cycle().take(times * faces.len()).copied().collect();
        let large: Vec<[f64; 2]> = points.iter().map(|p| [p[0] + 2.0, p[1] + 2.0]).collect();
        let whole: f64 =
            mask(&large, &faces, Size { height: 16, width: 16 }, 0.0).iter().sum();
        let got = mask(&tiny, &many, Size { height: 3, width: 3 }, 0.0);
        prop_assert!((got[4] - whole / 256.0).abs() < 1e-9, "{} {}", got[4], whole / 256.0);
    }
}

fn random(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1_u64 << 53) as f64
}

#[test]
fn the_gradient_is_the_central_difference() {
    let mut seed = 7;
    for round in 0..30 {
        let n = 3 + round % 9;
        let points: Vec<[f64; 2]> = (0..n)
            .map(|_| [random(&mut seed) * 11.0 - 1.5, random(&mut seed) * 9.0 - 1.5])
            .collect();
        let faces: Vec<[u32; 3]> = (0..=round / 3)
            .map(|_| std::array::from_fn(|_| (random(&mut seed) * n as f64) as u32))
            .collect();
        let upstream: Vec<f64> = (0..48).map(|_| random(&mut seed) - 0.5).collect();
        for sigma in [0.0, 0.8] {
            let (model, screen) = flat(&points, &faces);
            let (mut du, mut dv) = (vec![0.0; n], vec![0.0; n]);
            back(&model, &screen, SMALL, sigma, &upstream, &mut du, &mut dv);
            let value = |points: &[[f64; 2]]| -> f64 {
                mask(points, &faces, SMALL, sigma).iter().zip(&upstream).map(|(a, b)| a * b).sum()
            };
            let h = 1e-6;
            for k in 0..n {
                for (axis, got) in [(0, du[k]), (1, dv[k])] {
                    let moved = |d: f64| {
                        let mut p = points.clone();
                        p[k][axis] += d;
                        value(&p)
                    };
                    let expected = (moved(h) - moved(-h)) / (2.0 * h);
                    assert!(
                        (got - expected).abs() < 2e-6,
                        "round {round}, sigma {sigma}, vertex {k}, axis {axis}: {got}, {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn an_upright_square_feels_its_level_edges() {
    let faces = [[0, 1, 2], [0, 2, 3]];
    let points = [[1.25, 1.5], [4.25, 1.5], [4.25, 3.5], [1.25, 3.5]];
    let (model, screen) = flat(&points, &faces);
    let (mut du, mut dv) = (vec![0.0; 4], vec![0.0; 4]);
    back(&model, &screen, SMALL, 0.0, &[1.0_f64; 48], &mut du, &mut dv);
    // The area is width times height: each corner holds half of two sides.
    assert_close(&du, &[-1.0, 1.0, 1.0, -1.0], 1e-12);
    assert_close(&dv, &[-1.5, -1.5, 1.5, 1.5], 1e-12);
}

#[test]
fn bands_and_threads_change_no_bit() {
    let mut seed = 5;
    let points: Vec<[f64; 2]> =
        (0..60).map(|_| [random(&mut seed) * 700.0 - 50.0, random(&mut seed) * 600.0]).collect();
    let faces: Vec<[u32; 3]> = (0..20).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    let size = Size { height: 560, width: 640 };
    let (model, screen) = flat(&points, &faces);
    let upstream: Vec<f64> = (0..size.pixels()).map(|_| random(&mut seed) - 0.5).collect();
    let of = |threads: usize| {
        crate::threads::install(threads, || {
            let mut out = vec![f64::NAN; size.pixels()];
            draw(&model, &screen, size, 0.0, &mut out);
            let (mut du, mut dv) = (vec![0.0; 60], vec![0.0; 60]);
            back(&model, &screen, size, 0.0, &upstream, &mut du, &mut dv);
            (out, du, dv)
        })
        .expect("started")
    };
    let one = of(1);
    assert_eq!(one, of(2));
    assert_eq!(one, of(7));
    // The same in one piece: a smaller image has a single band.
    let top = Size { height: 300, width: 640 };
    let mut out = vec![f64::NAN; top.pixels()];
    draw(&model, &screen, top, 0.0, &mut out);
    assert_close(&out, &one.0[..top.pixels()], 1e-12);
}

#[test]
fn a_kept_outline_gives_the_same_gradient() {
    use crate::raster::{Batch, Mode, Wanted};
    let mut seed = 5;
    let vertices: Vec<[f64; 3]> = (0..30)
        .map(|_| std::array::from_fn(|k| random(&mut seed) + if k == 2 { 0.0 } else { -0.5 }))
        .collect();
    let faces: Vec<[u32; 3]> =
        (0..40).map(|_| std::array::from_fn(|_| (random(&mut seed) * 30.0) as u32)).collect();
    let model = Model::new(&vertices, &faces).expect("valid");
    // In front of the camera, cut by the near plane, and behind it.
    let views: Vec<View> = [1.0, -0.4, -3.0]
        .map(|z| View { translation: [0.1, 0.0, z], ..flat_view() })
        .map(|v| View { camera: Intrinsics::new(20.0, 21.0, 12.0, 9.0).expect("valid"), ..v })
        .to_vec();
    let size = Size { height: 18, width: 24 };
    let upstream: Vec<f32> =
        (0..3 * size.pixels()).map(|_| random(&mut seed) as f32 - 0.5).collect();
    for sigma in [0.0, 1.2] {
        let mode = Mode::Coverage { sigma };
        let batch = Batch { models: &[&model], views: &views, size, mode, near: Some(0.05) };
        let (mut plain, mut traced) = (vec![0.0_f32; upstream.len()], vec![9.0; upstream.len()]);
        batch.draw(&mut plain).expect("drawn");
        let traces = batch.draw_traced(&mut traced).expect("drawn");
        assert_eq!(plain, traced);
        assert!(traces.bytes() > 0);
        let wanted = Wanted { vertices: true };
        let again = batch.gradients(&upstream, wanted).expect("drawn");
        let kept = batch.gradients_of(&traces, &upstream, wanted).expect("drawn");
        assert_eq!(again.views, kept.views);
        assert_eq!(again.vertices, kept.vertices);
        let other = Batch { mode: Mode::Coverage { sigma: 2.0 }, ..batch };
        let refused = other.gradients_of(&traces, &upstream, wanted).expect_err("refused");
        assert!(refused.to_string().contains("traces"), "{refused}");
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    fn areas<S: pulp::Simd>(s: S, outline: &Outline, extent: Extent, size: Size) -> Vec<f64> {
        let mut worker = Worker::default();
        let Worker { rows, solver, turned, segments } = &mut worker;
        let mut out = vec![f64::NAN; size.pixels()];
        let layout = Layout { stride: size.width, origin: (0, 0), background: Background::Near };
        let mut target = Target::new(&mut out, layout, segments, (solver, turned));
        rows::walk_on(s, rows, &outline.edges, extent, &mut target);
        out
    }
    let mut seed = 3;
    let points: Vec<[f64; 2]> = (0..90)
        .map(|_| [random(&mut seed) * 80.0 - 10.0, random(&mut seed) * 50.0 - 5.0])
        .collect();
    let faces: Vec<[u32; 3]> = (0..30).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    let size = Size { height: 40, width: 61 };
    let (model, screen) = flat(&points, &faces);
    let mut outline = Outline::default();
    outline.find(&model, &screen, 0.0, 40.0, 61.0);
    let extent = outline.extent(40, 61).expect("seen");
    let expected = mask(&points, &faces, size, 0.0);
    assert_eq!(areas(pulp::Scalar, &outline, extent, size), expected);
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = pulp::x86::V3::try_new() {
        assert_eq!(areas(avx2, &outline, extent, size), expected);
    }
}
