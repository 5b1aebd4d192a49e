//! DIB-R's soft mask (Chen et al., `NeurIPS` 2019), over all faces.
//!
//! 1 at pixels whose centre is inside of a projected triangle, elsewhere `1 - prod_f (1 - exp(-delta
//! d_f^2))` with the distance `d_f` to the triangle in Kaolin's NDC, the image being 2 wide and 2
//! high. A triangle without area is a segment or a point. Both windings count.
//!
//! Without cut-offs the mask is exact (see `soft`) and so is its gradient. With [`KaolinCutoff`]
//! it is that of Kaolin 0.1: see `soft::kaolin`. Masks with cut-offs are computed in `f64`.

use super::soft::{Profile, kaolin};
use super::{Background, KaolinCutoff, Model, Pixel, Screen, Size};

/// Draw the mask `(H, W)`; every pixel of `out` is written.
pub fn draw<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    delta: f64,
    cutoff: Option<KaolinCutoff>,
    out: &mut [T],
) {
    if let Some(cutoff) = cutoff {
        kaolin::draw(model, screen, size, delta, cutoff, out);
    } else {
        let out = (out, Background::Near);
        drop(Profile::Dibr(delta).draw(model, screen, size, out, false));
    }
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
    match cutoff {
        Some(cutoff) => kaolin::back(model, screen, size, delta, cutoff, upstream, [du, dv]),
        None => Profile::Dibr(delta).back(None, model, screen, size, upstream, [du, dv]),
    }
}
