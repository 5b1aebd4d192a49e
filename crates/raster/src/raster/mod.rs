//! Silhouettes of a mesh under poses, and their gradients.
//!
//! The pipeline, one image at a time, images in parallel:
//!
//! 1. [`Model`]: vertices, faces and the edges they share, made once for a mesh.
//! 2. [`Screen`]: the model under a [`View`]: camera and image points, triangles cut at the near
//!    plane.
//! 3. A mode turns the screen into a mask `(H, W)`: [`coverage`], [`hard`], `dibr`, `sigmoid`.
//! 4. Backward, the mode turns the upstream gradient into one for image points, and
//!    [`Screen::pull_back`] carries that on to vertices, `R`, `t` and the intrinsics.
//!
//! Image points `(u, v)` are in pixels: the image is the rectangle `[0, W] x [0, H]`, the centre of
//! row `i`, column `j` is `(j + 0.5, i + 0.5)`. Everything is computed in `f64`, whatever the type
//! of the mask, except where a mode's module says so.

#![expect(
    clippy::inline_always,
    clippy::needless_range_loop,
    reason = "plain loops over lanes and axes, compiled once for each instruction set: what is not \
              inlined there is compiled for none of them"
)]
#![expect(clippy::float_cmp, reason = "an end of an edge is the same point or another one")]
#![expect(clippy::cast_possible_wrap, reason = "columns of an image, far below 2^31")]

mod background;
mod batch;
mod blur;
pub mod coverage;
pub mod dibr;
pub mod hard;
mod model;
mod order;
mod outline;
mod planes;
mod screen;
pub mod sigmoid;
mod soft;
mod spare;
mod topology;
mod trace;

use rayon::prelude::*;

pub(crate) use self::background::{Background, Beside, Plain};
pub use self::batch::{Batch, Gradients, Traces, Wanted};
pub use self::model::Model;
pub use self::screen::{Cut, Screen, View, ViewGradient};
pub use self::topology::{Edge, Topology};
use self::trace::Trace;
use crate::error::{Error, Result};

/// Distance in metres to the near plane where the caller names none.
pub const DEFAULT_NEAR: f64 = 1e-3;

/// How a silhouette is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mode {
    /// The area of the union of the projected triangles inside each pixel, exactly, then a
    /// Gaussian of `sigma` pixels (0: none).
    Coverage {
        /// Standard deviation in pixels.
        sigma: f64,
    },
    /// 1 where the centre of the pixel is inside a projected triangle, 0 elsewhere.
    Hard,
    /// DIB-R's soft mask (Chen et al., `NeurIPS` 2019), over all faces.
    Dibr {
        /// Inverse squared width in Kaolin's NDC: `p = exp(-delta d^2)`.
        delta: f64,
        /// Kaolin's cut-offs, for parity; `None` is exact.
        cutoff: Option<KaolinCutoff>,
    },
    /// The mask of SoftRas (Liu et al., ICCV 2019) and `PyTorch3D`, over all faces.
    Sigmoid {
        /// Squared width in `PyTorch3D`'s NDC: `p = sigmoid(d^2 / sigma)`.
        sigma: f64,
        /// `PyTorch3D`'s cut-offs, for parity; `None` is exact.
        cutoff: Option<Pytorch3dCutoff>,
    },
}

/// What Kaolin's rasteriser leaves out (`kaolin.graphics.dib_renderer`, version 0.1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KaolinCutoff {
    /// A face reaches so far beyond its bounding box, in NDC.
    pub boxlen: f64,
    /// At most so many faces a pixel, in the order of their index.
    pub knum: usize,
}

/// What `PyTorch3D`'s `MeshRasterizer` leaves out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pytorch3dCutoff {
    /// Squared distance in NDC at which a face ends.
    pub blur_radius: f64,
    /// At most so many faces a pixel, those nearest to the camera.
    pub faces_per_pixel: usize,
}

/// A pixel of a mask: `f32` or `f64`.
pub trait Pixel:
    Copy
    + Default
    + PartialEq
    + Send
    + Sync
    + std::fmt::Debug
    + std::ops::Add<Output = Self>
    + std::ops::Mul<Output = Self>
    + Plain
    + 'static
{
    /// Rounded to the type.
    fn from_f64(value: f64) -> Self;
    /// As `f64`, exactly.
    fn to_f64(self) -> f64;
}

impl Pixel for f32 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Pixel for f64 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
}

/// Rows and columns of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Size {
    /// Number of pixels.
    #[must_use]
    pub fn pixels(self) -> usize {
        self.height * self.width
    }
}

/// The largest `sigma` in pixels: a wider blur is a smaller image.
pub const LARGEST_SIGMA: f64 = 1000.0;

impl Mode {
    /// Refuses parameters out of range, by name.
    ///
    /// # Errors
    /// [`Error::Argument`]: `sigma`, `delta`, `sigma_ndc`, `boxlen`, `knum`, `blur_radius` or
    /// `faces_per_pixel`.
    pub fn check(&self) -> Result<()> {
        let positive = |name: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                return Ok(());
            }
            Err(Error::argument(name, format!("{value}; expected a finite number above 0")))
        };
        let counted = |name: &str, value: usize| match value {
            0 => Err(Error::argument(name, "0; expected at least 1")),
            _ => Ok(()),
        };
        match *self {
            Self::Hard => Ok(()),
            Self::Coverage { sigma } if (0.0..=LARGEST_SIGMA).contains(&sigma) => Ok(()),
            Self::Coverage { sigma } => {
                let message = format!("{sigma}; expected 0 to {LARGEST_SIGMA} pixels");
                Err(Error::argument("sigma", message))
            }
            Self::Dibr { delta, cutoff } => {
                positive("delta", delta)?;
                cutoff.map_or(Ok(()), |c| {
                    positive("boxlen", c.boxlen)?;
                    counted("knum", c.knum)
                })
            }
            Self::Sigmoid { sigma, cutoff } => {
                positive("sigma_ndc", sigma)?;
                cutoff.map_or(Ok(()), |c| {
                    positive("blur_radius", c.blur_radius)?;
                    counted("faces_per_pixel", c.faces_per_pixel)
                })
            }
        }
    }

    /// The mask of a screen into `out`, `(H, W)`, and how its background is to be written; every
    /// pixel is written. With `traced`, the outline
    /// if the mode has one to keep.
    fn draw<T: Pixel>(
        &self,
        model: &Model,
        screen: &Screen,
        size: Size,
        out: (&mut [T], Background),
        traced: bool,
    ) -> Option<Trace> {
        match *self {
            Self::Coverage { sigma } => {
                return coverage::draw_traced(model, screen, size, sigma, out, traced)
                    .map(Trace::Outline);
            }
            Self::Dibr { delta, cutoff } => {
                return dibr::profile(delta, cutoff).draw(model, screen, size, out, traced);
            }
            Self::Sigmoid { sigma, cutoff: None } => {
                return soft::Profile::Sigmoid(sigma).draw(model, screen, size, out, traced);
            }
            Self::Hard => hard::draw_over(model, screen, size, out),
            Self::Sigmoid { sigma, cutoff } => {
                sigmoid::draw(model, screen, size, sigma, cutoff, out.0);
            }
        }
        None
    }

    /// Add the gradient of `sum(upstream * mask)` for image points to `du` and `dv`; `trace` is what
    /// [`draw`](Self::draw) returned for the same screen.
    fn back<T: Pixel>(
        &self,
        model: &Model,
        screen: &Screen,
        size: Size,
        upstream: &[T],
        trace: Option<&Trace>,
        [du, dv]: [&mut [f64]; 2],
    ) {
        let outline = trace.and_then(Trace::outline);
        let product = trace.and_then(Trace::product);
        match *self {
            Self::Coverage { sigma } => {
                coverage::back_of(outline, model, screen, size, sigma, upstream, [du, dv]);
            }
            Self::Hard => {} // piecewise constant
            Self::Dibr { delta, cutoff } => {
                let profile = dibr::profile(delta, cutoff);
                profile.back(product, model, screen, size, upstream, [du, dv]);
            }
            Self::Sigmoid { sigma, cutoff: None } => {
                soft::Profile::Sigmoid(sigma).back(
                    product,
                    model,
                    screen,
                    size,
                    upstream,
                    [du, dv],
                );
            }
            Self::Sigmoid { sigma, cutoff } => {
                sigmoid::back(model, screen, size, sigma, cutoff, upstream, du, dv);
            }
        }
    }
}

/// Gradients of so many parts of an image, side by side, then added to `du` and `dv` in order.
fn add_in_order(
    parts: usize,
    [du, dv]: [&mut [f64]; 2],
    one: impl Fn(usize, &mut [f64], &mut [f64]) + Sync,
) {
    let points = du.len();
    let found: Vec<_> = (0..parts)
        .into_par_iter()
        .map(|k| {
            let (mut du, mut dv) = (vec![0.0; points], vec![0.0; points]);
            one(k, &mut du, &mut dv);
            (du, dv)
        })
        .collect();
    for (part_u, part_v) in found {
        for (sum, part) in du.iter_mut().zip(part_u).chain(dv.iter_mut().zip(part_v)) {
            *sum += part;
        }
    }
}
