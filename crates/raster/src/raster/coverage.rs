//! The area of the union of the projected triangles inside each pixel.

use super::{Model, Pixel, Screen, Size};

/// Draw the mask; every pixel of `out` is written.
pub fn draw<T: Pixel>(_model: &Model, _screen: &Screen, _size: Size, _sigma: f64, out: &mut [T]) {
    out.fill(T::default());
}

/// Add the gradient of `sum(upstream * mask)` for image points to `du` and `dv`.
pub fn back<T: Pixel>(
    _model: &Model,
    _screen: &Screen,
    _size: Size,
    _sigma: f64,
    _upstream: &[T],
    _du: &mut [f64],
    _dv: &mut [f64],
) {
}
