//! How much of each pixel the surfaces cover, from `n x n` samples a pixel.

use rayon::prelude::*;

use super::{Scenes, band};
use crate::error::{Error, Result};
use crate::raster::Pixel;

/// The largest number of samples along a side of a pixel.
pub const LARGEST_SAMPLES: usize = 16;

/// Whose share is counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Share {
    /// That of all surfaces together: `(B, H, W)`.
    #[default]
    All,
    /// That of each surface, of what is seen of it: `(B, H, W, M)`.
    Each,
}

/// Draw the share of the samples of each pixel at which something is seen, 0 to 1, into `out`.
///
/// The samples are the centres of `samples x samples` equal squares in the pixel. Memory beyond
/// `out` is that of a band of rows for each thread.
///
/// # Errors
/// As [`Scenes::check`], and [`Error::Argument`] for `samples` outside 1 to [`LARGEST_SAMPLES`].
///
/// # Panics
/// If `out` has another length.
pub fn draw<T: Pixel>(
    scenes: &Scenes<'_>,
    samples: usize,
    share: Share,
    out: &mut [T],
) -> Result<()> {
    scenes.check()?;
    if !(1..=LARGEST_SAMPLES).contains(&samples) {
        let message = format!("{samples}; expected 1 to {LARGEST_SAMPLES} along a side");
        return Err(Error::argument("samples", message));
    }
    let count = scenes.surfaces.len();
    let channels = if share == Share::Each { count } else { 1 };
    let pixels = scenes.size.pixels();
    assert_eq!(out.len(), scenes.images() * pixels * channels, "out: (B, H, W[, M])");
    let all = (samples * samples) as f64;
    let images = out.par_chunks_exact_mut(pixels * channels);
    images.enumerate().try_for_each(|(image, out)| {
        let set_up = scenes.image(image, samples);
        let rows = band::band_rows(set_up.size, samples);
        let of = |fine: usize| fine / (samples * samples) * channels;
        let cut = |out, fine| <[T]>::split_at_mut(out, of(fine));
        band::draw(&set_up, rows, out, cut, |band, _, piece| {
            let width = scenes.size.width * channels;
            for (row, out) in piece.chunks_exact_mut(width).enumerate() {
                out.fill(T::default());
                for row in row * samples..(row + 1) * samples {
                    if !band.dirty.rows.contains(&row) {
                        continue;
                    }
                    let (_, ids) = band.row(row);
                    for column in band.dirty.columns.clone().filter(|&c| ids[c] != 0) {
                        let channel = match share {
                            Share::All => 0,
                            Share::Each => band.prepared.find(ids[column]).0,
                        };
                        let out = &mut out[column / samples * channels + channel];
                        // Counts are whole numbers, exact in either type.
                        *out = T::from_f64(out.to_f64() + 1.0);
                    }
                }
                for share in out {
                    *share = T::from_f64(share.to_f64() / all);
                }
            }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::gbuffer::Surface;
    use crate::raster::{Model, Size, View};

    fn square(low: f64, high: f64, z: f64) -> Model {
        let v =
            [[low, low], [high, low], [high, high], [low, high]].map(|[x, y]| [x * z, y * z, z]);
        Model::new(&v, &[[0, 1, 2], [0, 2, 3]]).expect("valid")
    }

    const SIZE: Size = Size { height: 5, width: 6 };

    fn draw_both(models: &[Model], samples: usize) -> (Vec<f64>, Vec<f64>) {
        let camera = Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("valid");
        let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let views = vec![View { rotation, translation: [0.0; 3], camera }; models.len()];
        let surfaces: Vec<_> = models.iter().map(Surface::new).collect();
        let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
        let (mut all, mut each) = (vec![7.0; 30], vec![7.0; 30 * models.len()]);
        draw(&scenes, samples, Share::All, &mut all).expect("drawn");
        draw(&scenes, samples, Share::Each, &mut each).expect("drawn");
        (all, each)
    }

    #[test]
    fn a_square_covers_its_area() {
        for samples in [1, 2, 3, 4, 7, 16] {
            let (all, _) = draw_both(&[square(1.0, 3.5, 2.0)], samples);
            // Samples of the half pixel: those with a centre at or before the middle.
            let n = samples as f64;
            let half = (0..samples).filter(|&k| (k as f64 + 0.5) / n <= 0.5).count() as f64 / n;
            for (k, &got) in all.iter().enumerate() {
                let share = |p: usize| match p {
                    1 | 2 => 1.0,
                    3 => half,
                    _ => 0.0,
                };
                let expected = share(k / 6) * share(k % 6);
                assert!((got - expected).abs() < 1e-15, "{samples} {k}: {got} {expected}");
            }
        }
    }

    #[test]
    fn what_is_seen_of_each_surface_adds_up() {
        let models = [square(0.3, 2.7, 2.0), square(1.1, 4.6, 1.0), square(0.0, 1.0, 3.0)];
        let (all, each) = draw_both(&models, 8);
        for (all, each) in all.iter().zip(each.chunks_exact(3)) {
            assert!((each.iter().sum::<f64>() - all).abs() < 1e-15);
        }
        // Pixel (2, 2): the near square covers it, the far one not at all.
        assert_eq!(each[(2 * 6 + 2) * 3..][..3], [0.0, 1.0, 0.0]);
        assert!(each[2] > 0.0 && each[0] > 0.0, "{:?}", &each[..3]);
    }

    #[test]
    fn odd_numbers_of_samples_are_refused() {
        let model = square(0.0, 1.0, 1.0);
        let surfaces = [Surface::new(&model)];
        let scenes = Scenes { surfaces: &surfaces, views: &[], size: SIZE, near: None };
        for bad in [0, 17] {
            let error = draw::<f32>(&scenes, bad, Share::All, &mut []).expect_err("refused");
            assert!(error.to_string().starts_with("samples:"));
        }
    }
}
