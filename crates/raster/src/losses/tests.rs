//! The kernels against their definitions, one pixel after another.

use super::*;
use crate::threads::install;

fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) + 1;
    let mut next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    (0..n).map(|_| next()).collect()
}

/// A soft disc on noise-free ground, so that parts of the image are exactly 0.
fn disc(size: Size, y: f64, x: f64, radius: f64) -> Vec<f64> {
    let mut out = vec![0.0; size.pixels()];
    for i in 0..size.height {
        for j in 0..size.width {
            let d = (i as f64 + 0.5 - y).hypot(j as f64 + 0.5 - x);
            out[i * size.width + j] = (radius + 0.5 - d).clamp(0.0, 1.0);
        }
    }
    out
}

/// Weights of the pixels `q` in the blur at pixel `p`, along one axis.
type Weights = Vec<Vec<f64>>;

fn mean_weights(size: usize, length: usize) -> Weights {
    let r = size / 2;
    let near = |p: usize, q: usize| p.abs_diff(q) <= r;
    let one = |p| {
        let count = (0..length).filter(|&q| near(p, q)).count() as f64;
        (0..length).map(|q| if near(p, q) { 1.0 / count } else { 0.0 }).collect()
    };
    (0..length).map(one).collect()
}

fn gauss_weights(sigma: f64, radius: usize, length: usize) -> Weights {
    let tap = |x: usize| {
        if x == 0 { 1.0 } else { (-((x * x) as f64) / (2.0 * sigma * sigma)).exp() }
    };
    let sum: f64 = 1.0 + 2.0 * (1..=radius).map(tap).sum::<f64>();
    let one = |p: usize| {
        let weight = |q: usize| p.abs_diff(q);
        (0..length).map(|q| if weight(q) <= radius { tap(weight(q)) / sum } else { 0.0 }).collect()
    };
    (0..length).map(one).collect()
}

fn transposed(w: &Weights) -> Weights {
    (0..w.len()).map(|p| (0..w.len()).map(|q| w[q][p]).collect()).collect()
}

fn blur([down, across]: [&Weights; 2], image: &[f64], size: Size) -> Vec<f64> {
    let Size { height, width } = size;
    let mut half = vec![0.0; size.pixels()];
    for p in 0..height {
        for q in 0..height {
            for j in 0..width {
                half[p * width + j] += down[p][q] * image[q * width + j];
            }
        }
    }
    let mut out = vec![0.0; size.pixels()];
    for i in 0..height {
        for p in 0..width {
            for q in 0..width {
                out[i * width + p] += across[p][q] * half[i * width + q];
            }
        }
    }
    out
}

fn dot_of(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Value and gradient by the definition.
fn slow(loss: &Loss, s: &[f64], y: &[f64], size: Size) -> (f64, Vec<f64>) {
    let n = size.pixels() as f64;
    let whole = |sigma: f64| {
        let r = (4.0 * sigma).ceil() as usize;
        [gauss_weights(sigma, r, size.height), gauss_weights(sigma, r, size.width)]
    };
    let smooth = |[down, across]: [Weights; 2]| {
        let g = |m: &[f64]| blur([&down, &across], m, size);
        let back = |m: &[f64]| blur([&transposed(&down), &transposed(&across)], m, size);
        let (b, gs, gy) = (g(&vec![1.0; s.len()]), g(s), g(y));
        let value = (0..s.len())
            .map(|k| y[k] * (b[k] - 2.0 * gs[k]) + s[k] * (b[k] - 2.0 * gy[k]))
            .sum::<f64>();
        let gty = back(y);
        let slope = (0..s.len()).map(|k| (b[k] - 2.0 * gy[k] - 2.0 * gty[k]) / n).collect();
        (value / n, slope)
    };
    match loss {
        Loss::Box { size: k } => {
            smooth([mean_weights(*k, size.height), mean_weights(*k, size.width)])
        }
        Loss::Gaussian { size: k, sigma } => smooth([
            gauss_weights(*sigma, k / 2, size.height),
            gauss_weights(*sigma, k / 2, size.width),
        ]),
        Loss::Tanimoto { sigmas, eps } => {
            let (mut value, mut slope) = (0.0, vec![0.0; s.len()]);
            let share = 1.0 / sigmas.len() as f64;
            for &sigma in sigmas {
                let [down, across] = whole(sigma);
                let (a, b) = (blur([&down, &across], y, size), blur([&down, &across], s, size));
                let i = dot_of(&a, &b) + eps;
                let d = dot_of(&a, &a) + dot_of(&b, &b) - dot_of(&a, &b) + eps;
                value += share * (1.0 - i / d);
                let each: Vec<f64> = (0..s.len())
                    .map(|k| -share * (a[k] * d - i * (2.0 * b[k] - a[k])) / (d * d))
                    .collect();
                let each = blur([&down, &across], &each, size);
                slope.iter_mut().zip(each).for_each(|(s, e)| *s += e);
            }
            (value, slope)
        }
        Loss::Blurred { sigma } => {
            let [down, across] = whole(*sigma);
            let gap: Vec<f64> = s.iter().zip(y).map(|(s, y)| s - y).collect();
            let e = blur([&down, &across], &gap, size);
            let back = blur([&down, &across], &e, size);
            (dot_of(&e, &e) / n, back.iter().map(|v| 2.0 * v / n).collect())
        }
    }
}

fn losses() -> Vec<Loss> {
    let tanimoto = |sigmas: &[f64]| Loss::Tanimoto { sigmas: sigmas.to_vec(), eps: 1e-7 };
    vec![
        Loss::Box { size: 1 },
        Loss::Box { size: 3 },
        Loss::Box { size: 25 },
        Loss::Box { size: 49 },
        Loss::Box { size: 79 },
        Loss::Gaussian { size: 1, sigma: 1.0 },
        Loss::Gaussian { size: 35, sigma: 35.0 / 6.0 },
        Loss::Gaussian { size: 69, sigma: 11.5 },
        Loss::Gaussian { size: 69, sigma: 1.5 },
        tanimoto(&[0.0]),
        tanimoto(&[0.0, 2.0, 6.0, 18.0]),
        Loss::Blurred { sigma: 0.0 },
        Loss::Blurred { sigma: 3.0 },
    ]
}

/// Images that are smaller and larger than the windows and the stretches of lanes.
fn cases() -> Vec<(Size, Vec<f64>, Vec<f64>)> {
    let sized = |height, width| Size { height, width };
    let mut all = Vec::new();
    for (k, size) in [(1, 1), (1, 40), (7, 5), (50, 31), (61, 97)].into_iter().enumerate() {
        let size = sized(size.0, size.1);
        let n = size.pixels();
        all.push((size, noise(n, 2 * k as u64), noise(n, 2 * k as u64 + 1)));
    }
    let size = sized(90, 130);
    all.push((size, disc(size, 40.0, 50.0, 9.0), disc(size, 44.2, 57.5, 11.0)));
    all.push((size, disc(size, 2.0, 120.0, 9.0), disc(size, 80.0, 3.0, 5.0)));
    all.push((size, disc(size, 30.0, 60.0, 9.0), vec![0.0; size.pixels()]));
    all
}

fn run<T: Sample>(loss: &Loss, s: &[T], y: &[T], size: Size) -> (Vec<f64>, Vec<T>) {
    let mut values = vec![0.0; s.len() / size.pixels()];
    let mut slope = vec![T::from_f64(7.0); s.len()];
    loss.evaluate(s, y, size, &mut values, Some(&mut slope)).expect("good parameters");
    let mut again = values.clone();
    loss.evaluate(s, y, size, &mut again, None).expect("good parameters");
    assert_eq!(values, again, "the value does not depend on the gradient being asked for");
    (values, slope)
}

#[test]
fn values_and_gradients_are_those_of_the_definition() {
    for (size, s, y) in cases() {
        for loss in losses() {
            let (value, slope) = slow(&loss, &s, &y, size);
            let largest = slope.iter().fold(1e-300, |m: f64, v| m.max(v.abs()));
            let (values, found) = run(&loss, &s, &y, size);
            assert!((values[0] - value).abs() < 1e-12, "{loss:?} {size:?} {} {value}", values[0]);
            for (a, b) in found.iter().zip(&slope) {
                assert!((a - b).abs() < 1e-11 * largest, "{loss:?} {size:?} {a} {b}");
            }
            let single = |m: &[f64]| m.iter().map(|&v| v as f32).collect::<Vec<_>>();
            let (s32, y32) = (single(&s), single(&y));
            let wide = |m: &[f32]| m.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
            let (value, slope) = slow(&loss, &wide(&s32), &wide(&y32), size);
            let (values, found) = run(&loss, &s32, &y32, size);
            assert!((values[0] - value).abs() < 2e-6, "{loss:?} {size:?} {} {value}", values[0]);
            for (&a, b) in found.iter().zip(&slope) {
                let a = f64::from(a);
                assert!((a - b).abs() < 1e-5 * largest, "{loss:?} {size:?} {a} {b}");
            }
        }
    }
}

#[test]
fn rows_of_the_box_are_a_mean_and_its_adjoint() {
    let size = Size { height: 33, width: 41 };
    let (a, b) = (noise(size.pixels(), 5), noise(size.pixels(), 6));
    for k in [1, 5, 25, 39, 79] {
        let window = boxes::Window::new(k);
        let both = |image: &[f64]| {
            let (mut mean, mut adjoint) = (Vec::new(), Vec::new());
            window.rows(image, size, &mut boxes::Buffers::default(), |_, m, t| {
                mean.extend_from_slice(m);
                adjoint.extend_from_slice(t);
            });
            (mean, adjoint)
        };
        let ones = both(&vec![1.0; size.pixels()]).0;
        assert!(ones.iter().all(|v| (v - 1.0).abs() < 1e-14));
        let (left, right) = (dot_of(&both(&a).0, &b), dot_of(&a, &both(&b).1));
        assert!((left - right).abs() < 1e-11 * left.abs(), "{k}: {left} {right}");
    }
}

#[test]
fn equal_masks_have_no_tanimoto_loss_and_no_gradient() {
    let size = Size { height: 60, width: 70 };
    let mask: Vec<f32> = disc(size, 20.0, 30.0, 9.0).iter().map(|&v| v as f32).collect();
    let loss = Loss::Tanimoto { sigmas: vec![0.0, 2.0, 6.0], eps: 1e-7 };
    let (values, slope) = run(&loss, &mask, &mask, size);
    assert_eq!(values, [0.0]);
    assert!(slope.iter().all(|&v| v == 0.0));
}

#[test]
fn threads_change_no_bit() {
    let size = Size { height: 40, width: 90 };
    let (s, y) = (noise(9 * size.pixels(), 1), noise(9 * size.pixels(), 2));
    for loss in losses() {
        let one = install(1, || run(&loss, &s, &y, size)).expect("startable");
        for threads in [2, 7] {
            assert_eq!(one, install(threads, || run(&loss, &s, &y, size)).expect("startable"));
        }
    }
}

#[test]
fn parameters_out_of_range_are_refused_by_name() {
    for (loss, name) in [
        (Loss::Box { size: 48 }, "size"),
        (Loss::Box { size: 0 }, "size"),
        (Loss::Gaussian { size: 9, sigma: 0.0 }, "sigma"),
        (Loss::Gaussian { size: 9, sigma: f64::NAN }, "sigma"),
        (Loss::Tanimoto { sigmas: vec![], eps: 1e-7 }, "sigmas"),
        (Loss::Tanimoto { sigmas: vec![-1.0], eps: 1e-7 }, "sigmas"),
        (Loss::Tanimoto { sigmas: vec![1.0], eps: 0.0 }, "eps"),
        (Loss::Blurred { sigma: 1e9 }, "sigma"),
    ] {
        let message = loss.check().expect_err("out of range").to_string();
        assert!(message.starts_with(&format!("{name}: ")), "{message}");
    }
    let empty = Loss::Box { size: 3 }.evaluate::<f32>(
        &[],
        &[],
        Size { height: 0, width: 4 },
        &mut [0.0],
        None,
    );
    assert!(empty.is_err());
}

/// Every pair of pixels.
fn slow_distance(mask: &[f64], size: Size) -> Vec<f64> {
    let at = |k: usize| ((k / size.width) as f64, (k % size.width) as f64);
    let one = |k: usize| {
        let inside = mask[k] > 0.5;
        let squared = (0..mask.len())
            .filter(|&q| (mask[q] > 0.5) != inside)
            .map(|q| (at(k).0 - at(q).0).powi(2) + (at(k).1 - at(q).1).powi(2))
            .fold(f64::INFINITY, f64::min);
        if squared.is_infinite() {
            return 0.0;
        }
        let distance = squared.sqrt() - 0.5;
        if distance < 1.0 && mask[k] > 0.0 && mask[k] < 1.0 {
            return 0.5 - mask[k];
        }
        if inside { -distance } else { distance }
    };
    (0..mask.len()).map(one).collect()
}

#[test]
fn distances_are_those_to_the_nearest_pixel_of_the_other_side() {
    let mut masks = cases();
    let size = Size { height: 12, width: 15 };
    for (k, share) in [0.02, 0.1, 0.9, 0.99].into_iter().enumerate() {
        let dots = noise(size.pixels(), 90 + k as u64);
        let dots: Vec<f64> = dots.iter().map(|&v| f64::from(u8::from(v < share))).collect();
        masks.push((size, dots.clone(), dots));
    }
    masks.push((size, vec![1.0; size.pixels()], vec![0.0; size.pixels()]));
    for (size, a, b) in masks {
        for mask in [a, b] {
            let mut found = vec![7.0; mask.len()];
            signed_distance(&mask, size, &mut found);
            for (found, expected) in found.iter().zip(slow_distance(&mask, size)) {
                assert!((found - expected).abs() < 1e-12, "{size:?} {found} {expected}");
            }
        }
    }
}

#[test]
fn images_are_scaled_one_by_one() {
    let mut out = [0.0_f32; 6];
    scale(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &[2.0, -1.0], 3, &mut out);
    assert!(out.iter().eq(&[2.0, 4.0, 6.0, -4.0, -5.0, -6.0]));
}
