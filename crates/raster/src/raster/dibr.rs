//! DIB-R's soft mask (Chen et al., `NeurIPS` 2019), over all faces.
//!
//! 1 at pixels whose centre is inside of a projected triangle, elsewhere `1 - prod_f (1 - exp(-delta
//! d_f^2))` with the distance `d_f` to the triangle in Kaolin's NDC, the image being 2 wide and 2
//! high. A triangle without area is a segment or a point. Both windings count.
//!
//! Without cut-offs the mask is exact (see `soft`) and so is its gradient. With [`KaolinCutoff`]
//! it is that of Kaolin 0.1: see `soft::kaolin`.

use super::soft::Profile;
use super::{Background, KaolinCutoff, Model, Pixel, Screen, Size};

/// What is drawn.
pub(super) fn profile(delta: f64, cutoff: Option<KaolinCutoff>) -> Profile {
    match cutoff {
        Some(cutoff) => Profile::Kaolin(delta, cutoff),
        None => Profile::Dibr(delta),
    }
}

/// Draw the mask `(H, W)`; every pixel of `out` is written.
pub fn draw<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    delta: f64,
    cutoff: Option<KaolinCutoff>,
    out: &mut [T],
) {
    drop(profile(delta, cutoff).draw(model, screen, size, (out, Background::Near), false));
}

/// Add the gradient of `sum(upstream * mask)` for image points (pixels) to `du` and `dv`.
#[expect(clippy::too_many_arguments, reason = "two outputs")]
pub fn back<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    delta: f64,
    cutoff: Option<KaolinCutoff>,
    upstream: &[T],
    du: &mut [f64],
    dv: &mut [f64],
) {
    profile(delta, cutoff).back(None, model, screen, size, upstream, [du, dv]);
}
