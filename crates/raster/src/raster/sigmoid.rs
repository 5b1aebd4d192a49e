//! The mask of `SoftRas` (Liu et al., ICCV 2019) and `PyTorch3D`, over all faces.
//!
//! `1 - prod_f (1 - 1 / (1 + exp(x_f)))` with `x_f = d_f^2 / sigma` outside of the projected
//! triangle and `-d_f^2 / sigma` inside, `d_f` being the distance to its outline in `PyTorch3D`'s
//! NDC, in which the shorter side of the image is 2. Triangles without area count nothing.
//!
//! Without cut-offs the mask is exact (see `soft`) and so is its gradient. With [`Pytorch3dCutoff`]
//! it is that of `PyTorch3D`'s `SoftSilhouetteShader`: see `soft::pytorch3d`. Masks with cut-offs
//! are computed in `f64`.

use super::soft::{Profile, pytorch3d};
use super::{Background, Model, Pixel, Pytorch3dCutoff, Screen, Size};

/// Draw the mask `(H, W)`; every pixel of `out` is written.
pub fn draw<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    cutoff: Option<Pytorch3dCutoff>,
    out: &mut [T],
) {
    if let Some(cutoff) = cutoff {
        pytorch3d::draw(model, screen, size, sigma, cutoff, out);
    } else {
        let out = (out, Background::Near);
        drop(Profile::Sigmoid(sigma).draw(model, screen, size, out, false));
    }
}

/// Add the gradient of `sum(upstream * mask)` for image points (pixels) to `du` and `dv`.
#[expect(clippy::too_many_arguments, reason = "two outputs")]
pub fn back<T: Pixel>(
    model: &Model,
    screen: &Screen,
    size: Size,
    sigma: f64,
    cutoff: Option<Pytorch3dCutoff>,
    upstream: &[T],
    du: &mut [f64],
    dv: &mut [f64],
) {
    match cutoff {
        Some(cutoff) => pytorch3d::back(model, screen, size, sigma, cutoff, upstream, [du, dv]),
        None => Profile::Sigmoid(sigma).back(None, model, screen, size, upstream, [du, dv]),
    }
}
