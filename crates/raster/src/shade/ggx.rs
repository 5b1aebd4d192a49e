//! The GGX distribution of microfacets (Walter et al., "Microfacet Models for Refraction through
//! Rough Surfaces", EGSR 2007), with `alpha = roughness^2`.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// Entries of the table along each side.
const SIDE: usize = 32;

/// Directions that the integral of an entry is the mean over.
const SAMPLES: u32 = 256;

/// Scale and offset of the reflectance at normal incidence, by cosine (columns) and roughness.
static TABLE: LazyLock<Vec<[f32; 2]>> = LazyLock::new(|| {
    let at = |k: usize| (k as f64 + 0.5) / SIDE as f64;
    (0..SIDE * SIDE).map(|k| integral(at(k % SIDE), at(k / SIDE)).map(|x| x as f32)).collect()
});

/// Density of microfacets whose normal has this cosine with that of the surface.
pub(super) fn density(cosine: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let d = cosine * cosine * (a2 - 1.0) + 1.0;
    a2 / (PI * d * d)
}

/// The share of an even white light that is mirrored: `scale * F0 + offset`.
///
/// `cosine` is that between the normal and the direction to the camera, `F0` the reflectance at
/// normal incidence (second factor of the split sum, Karis 2013).
pub(super) fn scale_and_offset(cosine: f64, roughness: f64) -> [f32; 2] {
    let place = |x: f64| {
        let place = (x.clamp(0.0, 1.0) * SIDE as f64 - 0.5).clamp(0.0, (SIDE - 1) as f64);
        let first = (place as usize).min(SIDE - 2);
        (first, (place - first as f64) as f32)
    };
    let ((i, x), (j, y)) = (place(cosine), place(roughness));
    let row = |j: usize, c: usize| {
        let (a, b) = (TABLE[j * SIDE + i][c], TABLE[j * SIDE + i + 1][c]);
        a + x * (b - a)
    };
    [0, 1].map(|c| row(j, c) + y * (row(j + 1, c) - row(j, c)))
}

/// One entry of the table, by importance sampling of the microfacets.
fn integral(cosine: f64, roughness: f64) -> [f64; 2] {
    let alpha = (roughness * roughness).max(1e-4);
    let view = [(1.0 - cosine * cosine).sqrt(), 0.0, cosine];
    // Height-correlated Smith masking in its separable form for image-based light: k = alpha / 2.
    let k = alpha / 2.0;
    let mask = |c: f64| c / (c * (1.0 - k) + k);
    let mut sum = [0.0; 2];
    for sample in 0..SAMPLES {
        let x = (f64::from(sample) + 0.5) / f64::from(SAMPLES);
        let y = f64::from(sample.reverse_bits()) / 4_294_967_296.0;
        let up = ((1.0 - x) / (1.0 + (alpha * alpha - 1.0) * x)).sqrt();
        let (side, phi) = ((1.0 - up * up).max(0.0).sqrt(), 2.0 * PI * y);
        let half = [side * phi.cos(), side * phi.sin(), up];
        let along = view[0] * half[0] + view[2] * half[2];
        let light = 2.0 * along * half[2] - view[2];
        if light <= 0.0 || along <= 0.0 {
            continue;
        }
        let weight = mask(cosine) * mask(light) * along / (half[2] * cosine);
        let fresnel = (1.0 - along).powi(5);
        sum[0] += (1.0 - fresnel) * weight;
        sum[1] += fresnel * weight;
    }
    sum.map(|s| s / f64::from(SAMPLES))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_density_of_projected_facets_is_one() {
        for alpha in [0.05, 0.3, 1.0] {
            let n = 200_000;
            let sum: f64 = (0..n)
                .map(|k| {
                    let cosine = (f64::from(k) + 0.5) / f64::from(n);
                    2.0 * PI * density(cosine, alpha) * cosine / f64::from(n)
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-3, "{alpha}: {sum}");
        }
    }

    #[test]
    fn a_smooth_mirror_reflects_everything() {
        // F0 = 1: scale + offset; little is lost between facets of a smooth surface.
        let [scale, offset] = scale_and_offset(0.9, 0.05);
        assert!((scale + offset - 1.0).abs() < 0.02, "{scale} {offset}");
        // Schlick: at grazing angles everything is mirrored whatever F0.
        let [_, grazing] = scale_and_offset(0.03, 0.05);
        assert!(grazing > 0.6, "{grazing}");
        for k in 0..=20 {
            for r in 0..=20 {
                let [a, b] = scale_and_offset(f64::from(k) / 20.0, f64::from(r) / 20.0);
                assert!(a >= 0.0 && b >= 0.0 && a + b <= 1.02, "{k} {r}: {a} {b}");
            }
        }
    }
}
