//! Soft masks over all faces, exactly: DIB-R's and `SoftRas`'s share everything but a formula.
//!
//! With `d_f` the distance of a pixel centre to face `f`, the mask is `1 - prod_f (1 - p_f)`:
//!
//! - DIB-R: `p = exp(-delta d^2)`, and the mask is 1 inside of a face. `d` is measured in Kaolin's
//!   NDC, in which the image is 2 wide and 2 high whatever its sides.
//! - sigmoid: `p = 1 / (1 + exp(d^2 / sigma))`, with `-d^2` inside, `d` being the distance to the
//!   outline of the face, in `PyTorch3D`'s NDC, where the shorter side is 2. Faces without area
//!   have no inside and are left out.
//!
//! The image is cut into tiles of 4x4 pixels, a lane each. Faces are measured in widths, so that
//! `d^2` is the exponent itself, from an origin of their own, because single precision would lose
//! thin differences of large coordinates. A tile is in use as long as a pixel of it is not known
//! to be covered; every face visits those tiles in use that its bounding box reaches (see `visits` and
//! [`Profile::reach`]), up to 8x8 at a time. Where one edge alone gives the distance to a face all over
//! a tile, it alone is measured (see `nearest`). Sixteen visits list their tiles first (see `items`),
//! and are measured in loops over the lists, which end where processors foresee it. The product is all that is kept,
//! so memory is that of the image, and the gradient measures again: `dS/dp_k` is the product over
//! the others, taken as the whole one divided by the very factor that went into it, which was kept
//! away from 0.
//!
//! In single precision, faces end where `p` is below 8e-7 at every pixel of a tile, or below 2.5e-8 if
//! they are dense: what many of them leave out adds up. Spheres of up to 330,000 faces are within
//! 3e-5 of the exact mask. Over a mesh of 5,013 small faces and 64 views the masks are within
//! 2.5e-5 of the exact ones, and gradients for vertices within 1.6e-4 (DIB-R) and 6.7e-4 (sigmoid)
//! of their largest entry. Where a width is below 1/300 of half the image, rounding would count,
//! and double precision is used instead.

#![expect(
    clippy::inline_always,
    clippy::needless_bitwise_bool,
    clippy::needless_range_loop,
    reason = "lanes: a function that is not inlined loses the instruction set of its caller"
)]

mod bands;
mod faces;
mod items;
mod kaolin;
mod kernel;
mod nearest;
pub(super) mod pytorch3d;
mod real;
mod sums;
#[cfg(test)]
mod tests;
mod tiles;
mod visits;

use self::bands::Product;
use self::real::Real;
use self::tiles::Units;
use super::trace::Trace;
use super::{Background, KaolinCutoff, Mode, Model, Pixel, Screen, Size, dibr};

/// The product that a mask is made of, for its gradient.
#[derive(Debug, Clone)]
pub(super) struct Kept {
    of: (Profile, usize, Size),
    values: Values,
}

#[derive(Debug, Clone)]
enum Values {
    Single(Product<f32>),
    Double(Product<f64>),
}

impl Drop for Kept {
    fn drop(&mut self) {
        match &mut self.values {
            Values::Single(values) => f32::spare().give(std::mem::take(values)),
            Values::Double(values) => f64::spare().give(std::mem::take(values)),
        }
    }
}

impl Kept {
    pub(super) fn bytes(&self) -> usize {
        match &self.values {
            Values::Single(values) => size_of_val(values.as_slice()),
            Values::Double(values) => size_of_val(values.as_slice()),
        }
    }

    pub(super) fn is_of(&self, model: &Model, size: Size, mode: Mode) -> bool {
        let profile = match mode {
            Mode::Dibr { delta, cutoff } => dibr::profile(delta, cutoff),
            Mode::Sigmoid { sigma, cutoff: None } => Profile::Sigmoid(sigma),
            _ => return false,
        };
        self.of == (profile, model.vertex_count(), size)
    }
}

/// Masks that are drawn in tiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Profile {
    /// DIB-R with this `delta`.
    Dibr(f64),
    /// The same as Kaolin has it.
    Kaolin(f64, KaolinCutoff),
    /// `SoftRas` with this `sigma`.
    Sigmoid(f64),
}

/// What faces out of reach may add to a mask of single precision.
const MOST_LEFT_OUT: f64 = 2e-5;

/// Single precision would be too coarse for widths below this part of the image.
const FINEST_SINGLE: f64 = 1.0 / 300.0;

impl Profile {
    /// Widths in a pixel, per axis.
    fn scale(self, size: Size) -> [f64; 2] {
        let sides = [size.width, size.height].map(|side| side as f64);
        match self {
            Self::Dibr(delta) | Self::Kaolin(delta, _) => {
                sides.map(|side| 2.0 / side * delta.sqrt())
            }
            Self::Sigmoid(sigma) => [2.0 / (sides[0].min(sides[1]) * sigma.sqrt()); 2],
        }
    }

    /// How far a face reaches as an exponent, where `faces` share a box of so many pixels.
    ///
    /// What is left out of a mask beside them is about `pi / 2` times the faces on a square of the
    /// profile's width, times `exp` of minus this; eight times that where they are denser.
    fn reach<R: Real>(self, size: Size, faces: usize, sides: [f64; 2]) -> f64 {
        let scale = self.scale(size);
        let area = (sides[0] * scale[0] + 2.0) * (sides[1] * scale[1] + 2.0);
        let density = 4.0 * std::f64::consts::PI * faces as f64 / area;
        (density / MOST_LEFT_OUT).ln().clamp(R::REACH, R::FURTHEST)
    }

    /// How far a face reaches, or its box.
    fn widest(self, reach: f64) -> f64 {
        match self {
            Self::Kaolin(delta, cutoff) => cutoff.boxlen.powi(2) * delta,
            _ => reach,
        }
    }

    /// Whether single precision will do for a mask of `T`.
    fn is_single<T>(self, size: Size) -> bool {
        let units = Units::new(size, self.scale(size), 0.0);
        size_of::<T>() == size_of::<f32>() && units.extent() * FINEST_SINGLE <= 1.0
    }

    /// Draw the mask `(H, W)`; every pixel of `out` is written. With `traced`, what the gradient
    /// needs of it, where the tiles are not too many.
    pub(super) fn draw<T: Pixel>(
        self,
        model: &Model,
        screen: &Screen,
        size: Size,
        out: (&mut [T], Background),
        traced: bool,
    ) -> Option<Trace> {
        let values = if self.is_single::<T>(size) {
            bands::draw(self, (model, screen), size, out, traced).map(Values::Single)
        } else {
            bands::draw(self, (model, screen), size, out, traced).map(Values::Double)
        };
        let vertices = model.vertex_count();
        values.map(|values| Trace::Product(Kept { of: (self, vertices, size), values }))
    }

    /// Add the gradient of `sum(upstream * mask)` for image points (pixels) to `du` and `dv`; `kept`
    /// is what [`draw`](Self::draw) returned for the same screen.
    pub(super) fn back<T: Pixel>(
        self,
        kept: Option<&Kept>,
        model: &Model,
        screen: &Screen,
        size: Size,
        upstream: &[T],
        out: [&mut [f64]; 2],
    ) {
        let values = kept.map(|kept| &kept.values);
        if self.is_single::<T>(size) {
            let values = match values {
                Some(Values::Single(values)) => Some(&values[..]),
                _ => None,
            };
            bands::back::<f32, T>(self, values, (model, screen), size, upstream, out);
        } else {
            let values = match values {
                Some(Values::Double(values)) => Some(&values[..]),
                _ => None,
            };
            bands::back::<f64, T>(self, values, (model, screen), size, upstream, out);
        }
    }
}

/// The bounding box of the drawn points in pixels, low and high; `None` without faces.
fn bounds(model: &Model, screen: &Screen) -> Option<([f64; 2], [f64; 2])> {
    if screen.faces(model).is_empty() {
        return None;
    }
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut add = |k: usize| {
        let point = [screen.u[k], screen.v[k]];
        for axis in 0..2 {
            low[axis] = if point[axis] < low[axis] { point[axis] } else { low[axis] };
            high[axis] = if point[axis] > high[axis] { point[axis] } else { high[axis] };
        }
    };
    if screen.is_clipped() {
        screen.faces(model).iter().flatten().for_each(|&k| add(k as usize));
    } else {
        (0..screen.points()).for_each(&mut add);
    }
    Some((low, high))
}
