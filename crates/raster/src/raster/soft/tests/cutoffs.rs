//! Masks with the cut-offs of the originals.

use super::{Noise, SIZES, Scene, cross, difference, largest, triangle};
use crate::raster::{KaolinCutoff, Mode, Pytorch3dCutoff, Size};

/// Kaolin 0.1's mask by its description.
fn kaolin(scene: &Scene, delta: f64, cutoff: KaolinCutoff) -> Vec<f64> {
    let Size { height, width } = scene.size;
    let [w, h] = [width as f64, height as f64];
    let mut out = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let p = [(2.0 * column as f64 + 1.0) / w - 1.0, (h - 2.0 * row as f64 - 1.0) / h];
            let (mut left, mut met, mut covered) = (1.0, 0, false);
            for face in &scene.faces {
                let t = face.map(|k| {
                    let [u, v, _] = scene.points[k as usize];
                    [2.0 * u / w - 1.0, 1.0 - 2.0 * v / h]
                });
                let camera = face.map(|k| {
                    let [u, v, z] = scene.points[k as usize];
                    [u * z, -v * z]
                });
                let within = |margin: f64| {
                    (0..2).all(|axis| {
                        let [a, b, c] = t.map(|p| p[axis]);
                        p[axis] >= a.min(b).min(c) - margin && p[axis] < a.max(b).max(c) + margin
                    })
                };
                let front = cross(camera[0], camera[1], camera[2]) >= 0.0;
                let (squared, inside, _) = triangle(p, t);
                covered |= front && within(0.0) && inside;
                if within(cutoff.boxlen) && met < cutoff.knum {
                    met += 1;
                    left *= 1.0 - (-delta * squared).exp();
                }
            }
            out.push(if covered { 1.0 } else { 1.0 - left });
        }
    }
    out
}

/// `PyTorch3D`'s mask by its description.
fn pytorch3d(scene: &Scene, sigma: f64, cutoff: Pytorch3dCutoff) -> Vec<f64> {
    let Size { height, width } = scene.size;
    let [w, h] = [width as f64, height as f64];
    let ndc = |u: f64, v: f64| [(w - 2.0 * u) / w.min(h), (h - 2.0 * v) / w.min(h)];
    let mut out = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let p = ndc(column as f64 + 0.5, row as f64 + 0.5);
            let mut kept = Vec::new();
            for (index, face) in scene.faces.iter().enumerate() {
                let t = face.map(|k| ndc(scene.points[k as usize][0], scene.points[k as usize][1]));
                let z = face.map(|k| scene.points[k as usize][2]);
                let area = cross(t[0], t[1], t[2]);
                if area.abs() <= 1e-8 {
                    continue;
                }
                let (squared, _, _) = triangle(p, t);
                let mut weights = [0, 1, 2].map(|k| {
                    let (a, b) = ((k + 1) % 3, (k + 2) % 3);
                    cross(p, t[a], t[b]) / area * z[a] * z[b]
                });
                let sum: f64 = weights.iter().sum();
                if sum <= 1e-6 {
                    return Vec::new(); // the clamp of the denominator is not modelled
                }
                let inside = weights.iter().all(|&w| w > 0.0);
                weights = weights.map(|w| w.max(0.0));
                let sum: f64 = weights.iter().sum();
                let depth: f64 = weights.iter().zip(z).map(|(w, z)| w / sum * z).sum();
                if inside || squared < cutoff.blur_radius {
                    let x = if inside { squared } else { -squared } / sigma;
                    kept.push((depth, index, 1.0 / (1.0 + x.exp())));
                }
            }
            kept.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let left: f64 = kept.iter().take(cutoff.faces_per_pixel).map(|k| k.2).product();
            out.push(1.0 - left);
        }
    }
    out
}

/// A strip of triangles that share no corner, in the image.
fn strip(seed: u64, size: Size) -> Scene {
    let mut noise = Noise(seed);
    let [width, height] = [size.width as f64, size.height as f64];
    let mut scene = Scene { points: Vec::new(), faces: Vec::new(), size };
    for k in 0..14 {
        let (x, y) = (width * (0.2 + 0.6 * noise.next()), height * (0.2 + 0.6 * noise.next()));
        for _ in 0..3 {
            let near = |c: f64, noise: &mut Noise| c + 8.0 * noise.next() - 4.0;
            let p = [near(x, &mut noise), near(y, &mut noise), 1.0 + 0.2 * noise.next()];
            scene.points.push(p);
        }
        scene.faces.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    scene
}

#[test]
fn masks_with_cutoffs_are_those_of_their_description() {
    for k in 0..12 {
        let scene = strip(k, SIZES[k as usize % 3]);
        for knum in [1, 3, 30] {
            let (delta, cutoff) = (700.0, KaolinCutoff { boxlen: 0.1, knum });
            let mode = Mode::Dibr { delta, cutoff: Some(cutoff) };
            let expected = kaolin(&scene, delta, cutoff);
            let double = difference(&scene.draw::<f64>(mode), &expected);
            let single = difference(&scene.draw::<f32>(mode), &expected);
            assert!(double < 1e-11 && single < 1e-5, "{k}, {cutoff:?}: {double}, {single}");
        }
        for faces_per_pixel in [1, 2, 50] {
            let (sigma, cutoff) = (1e-3, Pytorch3dCutoff { blur_radius: 7e-3, faces_per_pixel });
            let mode = Mode::Sigmoid { sigma, cutoff: Some(cutoff) };
            let expected = pytorch3d(&scene, sigma, cutoff);
            if expected.is_empty() {
                continue;
            }
            let error = difference(&scene.draw::<f64>(mode), &expected);
            assert!(error < 1e-3, "scene {k}, {cutoff:?}: {error}"); // 1e-8 is added to areas
        }
    }
}

/// Faces of either winding side by side and over each other, at many angles to the camera.
fn crowd(seed: u64, size: Size, faces: usize) -> Scene {
    let mut noise = Noise(seed);
    let [width, height] = [size.width as f64, size.height as f64];
    let mut scene = Scene { points: Vec::new(), faces: Vec::new(), size };
    for _ in 0..faces {
        let (x, y) = (width * noise.next(), height * noise.next());
        let far = 30.0 * noise.next().powi(4);
        for _ in 0..3 {
            let near = |c: f64, noise: &mut Noise| c + (3.0 + far) * (noise.next() - 0.5);
            let depth = 1.0 + 0.5 * noise.next();
            scene.points.push([near(x, &mut noise), near(y, &mut noise), depth]);
        }
        let first = scene.points.len() as u32 - 3;
        scene.faces.push([first, first + 1, first + 2]);
    }
    scene
}

#[test]
fn many_faces_with_cutoffs_are_those_of_their_description() {
    for (k, size) in SIZES.into_iter().enumerate() {
        // The last ones are more than are visited at a time.
        let scene = crowd(k as u64, size, [400, 400, 3000][k]);
        for knum in [5, 1000] {
            let (delta, cutoff) = (7000.0, KaolinCutoff { boxlen: 0.02, knum });
            let mode = Mode::Dibr { delta, cutoff: Some(cutoff) };
            let expected = kaolin(&scene, delta, cutoff);
            let double = difference(&scene.draw::<f64>(mode), &expected);
            let single = difference(&scene.draw::<f32>(mode), &expected);
            assert!(double < 1e-10 && single < 1e-4, "{k}, {knum}: {double}, {single}");
        }
    }
}

#[test]
fn boxes_may_be_wider_than_the_blur_and_the_image_large() {
    let size = Size { height: 330, width: 310 };
    for (k, boxlen, knum) in [(1, 0.02, 2), (2, 0.3, 2), (3, 5.0, 9)] {
        let (delta, cutoff) = (7000.0, KaolinCutoff { boxlen, knum });
        let mode = Mode::Dibr { delta, cutoff: Some(cutoff) };
        let scene = strip(k, size);
        let expected = kaolin(&scene, delta, cutoff);
        let double = difference(&scene.draw::<f64>(mode), &expected);
        let single = difference(&scene.draw::<f32>(mode), &expected);
        assert!(double < 1e-11 && single < 1e-5, "{cutoff:?}: {double}, {single}");
    }
}

#[test]
fn gradients_with_cutoffs_are_those_of_the_mask() {
    let modes = [
        Mode::Dibr { delta: 700.0, cutoff: Some(KaolinCutoff { boxlen: 0.1, knum: 3 }) },
        Mode::Dibr { delta: 700.0, cutoff: Some(KaolinCutoff { boxlen: 0.1, knum: 30 }) },
        Mode::Sigmoid {
            sigma: 1e-3,
            cutoff: Some(Pytorch3dCutoff { blur_radius: 7e-3, faces_per_pixel: 3 }),
        },
    ];
    for k in 0..6 {
        let scene = strip(k, SIZES[k as usize % 3]);
        let upstream = scene.upstream();
        for mode in modes {
            let value = |scene: &Scene| -> f64 {
                scene.draw::<f64>(mode).iter().zip(&upstream).map(|(s, u)| s * u).sum()
            };
            let gradient = scene.back::<f64>(mode, &upstream);
            let (scale, count, step) = (largest(&gradient), scene.points.len(), 1e-7);
            for point in 0..count {
                for axis in 0..2 {
                    let mut moved = [scene.clone(), scene.clone()];
                    moved[0].points[point][axis] += step;
                    moved[1].points[point][axis] -= step;
                    let numeric = (value(&moved[0]) - value(&moved[1])) / (2.0 * step);
                    let error = (numeric - gradient[axis * count + point]).abs();
                    assert!(error < 1e-5 * scale, "scene {k} {mode:?} {point}: {error} of {scale}");
                }
            }
        }
    }
}
