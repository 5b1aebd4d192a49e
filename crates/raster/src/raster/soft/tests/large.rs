//! Images that are shared out in bands.

use super::*;
use crate::raster::{Batch, Wanted};
use crate::threads;

const SIZE: Size = Size { height: 530, width: 510 };

#[test]
fn bands_are_those_of_the_definition() {
    for (seed, spread) in [(1, 1.0), (2, 3.0)] {
        let scene = soup(seed, SIZE, spread);
        for mode in EXACT {
            let exact = oracle(&scene, mode);
            let double = difference(&scene.draw::<f64>(mode), &exact);
            let single = difference(&scene.draw::<f32>(mode), &exact);
            assert!(double < 1e-11 && single < 2e-5, "{seed} {mode:?}: {double}, {single}");
        }
    }
}

#[test]
fn gradients_of_bands_are_those_of_the_mask() {
    let scene = soup(4, SIZE, 1.0);
    // Smooth, so that the sums over pixels do not cancel.
    let upstream: Vec<f64> = (0..SIZE.pixels())
        .map(|k| f64::from(((k / SIZE.width) as f32 / 90.0).sin() + 0.5))
        .collect();
    for mode in [EXACT[1], EXACT[3]] {
        let value = |scene: &Scene| -> f64 {
            scene.draw::<f64>(mode).iter().zip(&upstream).map(|(s, u)| s * u).sum()
        };
        let gradient = scene.back::<f64>(mode, &upstream);
        let (scale, step) = (largest(&gradient), 1e-5);
        for point in [1, 8, 13, 16] {
            for axis in 0..2 {
                let mut moved = [scene.clone(), scene.clone()];
                moved[0].points[point][axis] += step;
                moved[1].points[point][axis] -= step;
                let numeric = (value(&moved[0]) - value(&moved[1])) / (2.0 * step);
                let analytic = gradient[axis * scene.points.len() + point];
                let error = (numeric - analytic).abs();
                assert!(error < 1e-5 * scale, "{mode:?} {point}: {numeric} {analytic} of {scale}");
            }
        }
    }
}

#[test]
fn bands_have_the_same_bits_for_any_number_of_threads() {
    let scene = soup(3, SIZE, 1.2);
    let points: Vec<[f64; 3]> = scene.points.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let model = Model::new(&points, &scene.faces).expect("a model");
    let camera = Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("a camera");
    let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let view = |shift: f64| View { rotation, translation: [shift, -shift, 1.0], camera };
    let views = [view(0.0), view(3.3), view(-40.0)];
    let pixels = views.len() * SIZE.pixels();
    let upstream: Vec<f32> =
        (0..pixels).map(|k| ((k * 7919) % 1000) as f32 / 500.0 - 1.0).collect();
    let others = [0.0, 1.5].map(|sigma| Mode::Coverage { sigma });
    for mode in EXACT.into_iter().chain(others).chain([Mode::Hard]) {
        let batch = Batch { models: &[&model], views: &views, size: SIZE, mode, near: None };
        let wanted = Wanted { vertices: true };
        let all = [1, 2, 7].map(|count| {
            threads::install(count, || {
                let mut mask = vec![9.0_f32; pixels];
                let traces = batch.draw_traced(&mut mask).expect("drawn");
                let kept = batch.gradients_of(&traces, &upstream, wanted).expect("drawn");
                let again = batch.gradients(&upstream, wanted).expect("drawn");
                assert!(mask.iter().any(|&value| value > 0.5));
                assert!(traces.bytes() > 0 || !EXACT.contains(&mode));
                assert_eq!(again.vertices[0].iter().any(|g| *g != 0.0), mode != Mode::Hard);
                assert_eq!((&again.views, &again.vertices), (&kept.views, &kept.vertices));
                (mask, kept.views, kept.vertices)
            })
            .expect("a pool")
        });
        assert!(all[0] == all[1] && all[0] == all[2], "{mode:?}");
    }
}
