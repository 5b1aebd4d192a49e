//! Silhouette losses that look further than a pixel, and their gradients.
//!
//! A loss compares a predicted mask `s` with a target `y`, both `(H, W)`; all four are symmetric in
//! the two, so that the gradient for the target is that of the swapped call. One image at a time,
//! so that it stays in the cache, images in parallel on rayon's current pool; nothing is added up
//! across images, so the number of threads changes nothing.
//!
//! * [`Loss::Box`] and [`Loss::Gaussian`]: the smooth silhouette loss of `DronePose` (Albanis et
//!   al., 2020): the mean over pixels of `y (g*(1-s) - g*s) + s (g*(1-y) - g*y)`. With `b = g*1` that
//!   is `(<b, y> + <s, h>) / N`, `h = b - 2 (g*y + g^T*y)`, and `h / N` is the gradient: one blur
//!   gives both.
//! * [`Loss::Tanimoto`]: the mean over widths of `1 - (<a,b> + e) / (<a,a> + <b,b> - <a,b> + e)`,
//!   `a = g*y`, `b = g*s`.
//! * [`Loss::Blurred`]: the mean over pixels of `(g*s - g*y)^2`.
//!
//! [`signed_distance`] is what an outline loss weighs pixels with.
//!
//! Errors of `f32` against exact arithmetic, for masks in `[0, 1]`: below 2e-6 for the values of
//! the losses, below 1e-5 of the largest entry for their gradients (see the tests). The column sums
//! of the box are `f64`, its row sums are trees; a Gaussian adds its taps up in the type of the
//! masks; sums over pixels are of that type within a lane of a row and `f64` beyond.

#![expect(
    clippy::inline_always,
    clippy::needless_range_loop,
    reason = "plain loops over lanes, compiled once for each instruction set: what is not inlined \
              there is compiled for none of them"
)]

mod boxes;
mod compare;
mod distance;
mod gaussian;
mod smooth;
#[cfg(test)]
mod tests;

use std::ops::{AddAssign, Sub};

use rayon::prelude::*;

pub use self::distance::signed_distance;
use self::gaussian::Taps;
use crate::error::{Error, Result};
pub use crate::raster::Size;
use crate::raster::{LARGEST_SIGMA, Pixel};

/// Most pixels that a kernel is wide.
pub const LARGEST_KERNEL: usize = 8191;

/// A pixel that the kernels compute with: `f32` or `f64`.
pub trait Sample: Pixel + Sub<Output = Self> + AddAssign {
    /// What one tap of a blur may be at most, as a share of the largest, to be left out.
    const NEGLIGIBLE: f64;

    /// `self * b + c`, in one instruction where `FMA`.
    #[must_use]
    fn fused<const FMA: bool>(self, b: Self, c: Self) -> Self;
}

impl Sample for f32 {
    const NEGLIGIBLE: f64 = 1e-10;

    #[inline(always)]
    fn fused<const FMA: bool>(self, b: Self, c: Self) -> Self {
        if FMA { self.mul_add(b, c) } else { self * b + c }
    }
}

impl Sample for f64 {
    const NEGLIGIBLE: f64 = 1e-20;

    #[inline(always)]
    fn fused<const FMA: bool>(self, b: Self, c: Self) -> Self {
        if FMA { self.mul_add(b, c) } else { self * b + c }
    }
}

/// Pixels of a row that are added up side by side.
const LANES: usize = 32;

/// A sum of products, over rows: in the type of the masks within a row, in `f64` beyond.
#[derive(Debug, Clone, Copy)]
struct Products([f64; LANES]);

impl Products {
    #[inline(always)]
    fn none() -> Self {
        Self([0.0; LANES])
    }

    /// Add `sum(a * b)` of a row, times `factor`.
    #[inline(always)]
    fn add<T: Sample, const FMA: bool>(&mut self, a: &[T], b: &[T], factor: f64) {
        let mut sums = [T::default(); LANES];
        let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
        for (a, b) in a.iter().zip(b) {
            for l in 0..LANES {
                sums[l] = a[l].fused::<FMA>(b[l], sums[l]);
            }
        }
        for (l, (&a, &b)) in a_rest.iter().zip(b_rest).enumerate() {
            sums[l] = a.fused::<FMA>(b, sums[l]);
        }
        for l in 0..LANES {
            self.0[l] += factor * sums[l].to_f64();
        }
    }

    #[inline(always)]
    fn total(self) -> f64 {
        self.0.iter().sum()
    }
}

/// A silhouette loss.
#[derive(Debug, Clone, PartialEq)]
pub enum Loss {
    /// Smooth, with a square window: the mean of its pixels inside the image.
    Box {
        /// Pixels a side, odd.
        size: usize,
    },
    /// Smooth, with a Gaussian window, normalised over all of it; what is outside the image is 0.
    Gaussian {
        /// Taps a side, odd.
        size: usize,
        /// Standard deviation in pixels.
        sigma: f64,
    },
    /// Tanimoto over blurs of several widths; 2 ceil(4 sigma) + 1 taps, 0 outside the image.
    Tanimoto {
        /// Standard deviations in pixels; 0 is no blur.
        sigmas: Vec<f64>,
        /// Added to both sides of the fraction.
        eps: f64,
    },
    /// Mean squared difference of the blurred masks; 2 ceil(4 sigma) + 1 taps, 0 outside the image.
    Blurred {
        /// Standard deviation in pixels; 0 is no blur.
        sigma: f64,
    },
}

/// What one image needs, made once for a batch.
enum Prepared<T> {
    Box(boxes::Window),
    Gaussian(Taps<T>),
    Tanimoto(Vec<Taps<T>>, f64),
    Blurred(Taps<T>),
}

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch<T> {
    boxes: boxes::Buffers<T>,
    gaussian: gaussian::Buffers<T>,
    row: Vec<T>,
    ones: [Vec<T>; 2],
    images: [Vec<T>; 3],
}

impl Loss {
    /// Refuses parameters out of range, by name.
    ///
    /// # Errors
    /// [`Error::Argument`]: `size`, `sigma`, `sigmas` or `eps`.
    pub fn check(&self) -> Result<()> {
        let odd = |size: usize| {
            if size % 2 == 1 && size <= LARGEST_KERNEL {
                return Ok(());
            }
            let message =
                format!("{size}; expected an odd number of pixels, 1 to {LARGEST_KERNEL}");
            Err(Error::argument("size", message))
        };
        let width = |name: &str, sigma: f64| {
            if (0.0..=LARGEST_SIGMA).contains(&sigma) {
                return Ok(());
            }
            Err(Error::argument(name, format!("{sigma}; expected 0 to {LARGEST_SIGMA} pixels")))
        };
        match self {
            Self::Box { size } => odd(*size),
            Self::Gaussian { size, sigma } => {
                odd(*size)?;
                width("sigma", *sigma)?;
                if *sigma > 0.0 || *size == 1 {
                    return Ok(());
                }
                Err(Error::argument("sigma", format!("{sigma}; expected a number above 0")))
            }
            Self::Tanimoto { sigmas, eps } => {
                if sigmas.is_empty() {
                    return Err(Error::argument("sigmas", "none; expected at least one"));
                }
                if !(eps.is_finite() && *eps > 0.0) {
                    let message = format!("{eps}; expected a finite number above 0");
                    return Err(Error::argument("eps", message));
                }
                sigmas.iter().try_for_each(|&sigma| width("sigmas", sigma))
            }
            Self::Blurred { sigma } => width("sigma", *sigma),
        }
    }

    fn prepared<T: Sample>(&self) -> Prepared<T> {
        match self {
            Self::Box { size } => Prepared::Box(boxes::Window::new(*size)),
            Self::Gaussian { size, sigma } => Prepared::Gaussian(Taps::new(*sigma, size / 2)),
            Self::Tanimoto { sigmas, eps } => {
                Prepared::Tanimoto(sigmas.iter().map(|&s| Taps::whole(s)).collect(), *eps)
            }
            Self::Blurred { sigma } => Prepared::Blurred(Taps::whole(*sigma)),
        }
    }

    /// The loss of each image into `values`, `(B,)`, and, if asked for, its gradient for the
    /// prediction into `gradient`, `(B, H, W)`; on rayon's current pool.
    ///
    /// # Errors
    /// As [`Loss::check`], and an image without pixels.
    ///
    /// # Panics
    /// If a slice is not `B` images of that size.
    pub fn evaluate<T: Sample>(
        &self,
        pred: &[T],
        target: &[T],
        size: Size,
        values: &mut [f64],
        gradient: Option<&mut [T]>,
    ) -> Result<()> {
        self.check()?;
        let pixels = size.pixels();
        if pixels == 0 {
            return Err(Error::argument("size", "an image without pixels"));
        }
        assert_eq!(pred.len(), values.len() * pixels, "expected (B, H, W)");
        assert_eq!(target.len(), pred.len(), "expected (B, H, W)");
        let prepared = self.prepared::<T>();
        let images = pred.par_chunks_exact(pixels).zip(target.par_chunks_exact(pixels));
        let images = images.zip(values);
        if let Some(gradient) = gradient {
            assert_eq!(gradient.len(), pred.len(), "expected (B, H, W)");
            images.zip(gradient.par_chunks_exact_mut(pixels)).for_each_init(
                Scratch::default,
                |scratch, (((pred, target), value), gradient)| {
                    *value = prepared.image([pred, target], size, Some(gradient), scratch);
                },
            );
        } else {
            images.for_each_init(Scratch::default, |scratch, ((pred, target), value)| {
                *value = prepared.image([pred, target], size, None, scratch);
            });
        }
        Ok(())
    }
}

impl<T: Sample> Prepared<T> {
    /// The loss of one image; `masks` are the prediction and the target.
    fn image(
        &self,
        masks: [&[T]; 2],
        size: Size,
        gradient: Option<&mut [T]>,
        scratch: &mut Scratch<T>,
    ) -> f64 {
        match self {
            Self::Box(window) => smooth::with_box(*window, masks, size, gradient, scratch),
            Self::Gaussian(taps) => smooth::with_gaussian(taps, masks, size, gradient, scratch),
            Self::Tanimoto(all, eps) => {
                compare::tanimoto(all, *eps, masks, size, gradient, scratch)
            }
            Self::Blurred(taps) => compare::blurred(taps, masks, size, gradient, scratch),
        }
    }
}

/// Multiply each image by its number: what carries the gradient of the losses back to the masks.
///
/// # Panics
/// If a slice is not as many images of `pixels` pixels.
pub fn scale<T: Sample>(images: &[T], factors: &[T], pixels: usize, out: &mut [T]) {
    assert_eq!(images.len(), factors.len() * pixels, "expected (B, H, W)");
    assert_eq!(out.len(), images.len(), "expected (B, H, W)");
    let pairs = out.par_chunks_exact_mut(pixels).zip(images.par_chunks_exact(pixels));
    pairs.zip(factors).for_each(|((out, image), &factor)| {
        for (out, &pixel) in out.iter_mut().zip(image) {
            *out = pixel * factor;
        }
    });
}
