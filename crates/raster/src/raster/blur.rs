//! A separable Gaussian of 2 r + 1 taps, r = ceil(4 sigma), and its adjoint.
//!
//! The taps are `exp(-k^2 / (2 sigma^2))`, divided by their sum. Forward, the image is the middle of
//! a canvas that is wider by r on every side, so that the border of the image changes nothing.

use std::any::Any;
use std::cell::RefCell;

use multiversion::multiversion;
use rayon::prelude::*;

use super::{Pixel, Size};

/// The taps; one tap is no blur.
#[derive(Debug, Clone)]
pub(super) struct Kernel {
    sigma: f64,
    taps: Vec<f64>,
}

/// What a blur works with.
#[derive(Debug, Default)]
pub(super) struct Buffers<T> {
    /// The part of the canvas that is not 0, row by row.
    pub(super) canvas: Vec<T>,
    taps: Vec<T>,
    line: Vec<T>,
}

thread_local! {
    static KERNEL: RefCell<Kernel> = const { RefCell::new(Kernel { sigma: 0.0, taps: Vec::new() }) };
    static BUFFERS: RefCell<[Option<Box<dyn Any>>; 2]> = const { RefCell::new([None, None]) };
}

/// Lend the buffers of this thread.
pub(super) fn with_buffers<T: Pixel, R>(work: impl FnOnce(&mut Buffers<T>) -> R) -> R {
    let slot = usize::from(size_of::<T>() == 8);
    let kept = BUFFERS.with_borrow_mut(|c| c[slot].take());
    let mut buffers: Box<Buffers<T>> = kept.and_then(|c| c.downcast().ok()).unwrap_or_default();
    let out = work(&mut buffers);
    BUFFERS.with_borrow_mut(|c| c[slot] = Some(buffers));
    out
}

/// Lend this thread's kernel, made for a standard deviation in pixels; 0 is no blur.
pub(super) fn with_kernel<R>(sigma: f64, work: impl FnOnce(&Kernel) -> R) -> R {
    // Taken out meanwhile: a thread that waits for bands may be given another image.
    let mut kernel = KERNEL.replace(Kernel { sigma: 0.0, taps: Vec::new() });
    kernel.set(sigma);
    let out = work(&kernel);
    KERNEL.set(kernel);
    out
}

impl Kernel {
    /// The kernel for a standard deviation in pixels; 0 is no blur.
    fn set(&mut self, sigma: f64) {
        if self.sigma == sigma && !self.taps.is_empty() {
            return;
        }
        self.sigma = sigma;
        self.taps.clear();
        if sigma <= 0.0 {
            self.taps.push(1.0);
            return;
        }
        let radius = (4.0 * sigma).ceil();
        let place = (0..=2 * radius as usize).map(|k| k as f64 - radius);
        self.taps.extend(place.map(|x| (-x * x / (2.0 * sigma * sigma)).exp()));
        let sum: f64 = self.taps.iter().sum();
        self.taps.iter_mut().for_each(|tap| *tap /= sum);
    }

    /// Pixels on either side.
    pub(super) fn radius(&self) -> usize {
        self.taps.len() / 2
    }

    /// Height and width of the canvas of an image.
    pub(super) fn padded(&self, size: Size) -> (usize, usize) {
        (size.height + 2 * self.radius(), size.width + 2 * self.radius())
    }

    /// The image `out` from the part `rows` x `columns` (half open) of its canvas; the rest of the
    /// canvas is 0, and so is the image before.
    pub(super) fn forward<T: Pixel>(
        &self,
        Buffers { canvas, taps, line }: &mut Buffers<T>,
        rows: (usize, usize),
        columns: (usize, usize),
        size: Size,
        out: &mut [T],
    ) {
        let r = self.radius();
        taps.clear();
        taps.extend(self.taps.iter().map(|&t| T::from_f64(t)));
        let width = columns.1 - columns.0;
        // Image row i takes canvas rows i to i + 2 r; likewise columns.
        let (head, last) = (rows.0.saturating_sub(2 * r), rows.1.min(size.height));
        let out = &mut out[head.min(last) * size.width..last * size.width];
        each_row(out, size.width, (line, width + 2 * r), |i, out, line| {
            let i = head + i;
            let middle = &mut line[r..r + width];
            middle.fill(T::default());
            for (k, &tap) in taps.iter().enumerate() {
                if (rows.0..rows.1).contains(&(i + k)) {
                    let from = (i + k - rows.0) * width;
                    add_scaled(middle, &canvas[from..from + width], tap);
                }
            }
            let first = columns.0.saturating_sub(2 * r);
            let end = columns.1.min(size.width);
            let target = &mut out[first..end.max(first)];
            for (l, &tap) in taps.iter().enumerate() {
                // Image column j takes canvas column j + l, that is line[j + l - columns.0 + r].
                let begin = columns.0.saturating_sub(l).max(first);
                let stop = (columns.1 - l.min(columns.1)).min(end);
                if begin < stop {
                    let from = begin + l - columns.0 + r;
                    add_scaled(
                        &mut target[begin - first..stop - first],
                        &line[from..from + stop - begin],
                        tap,
                    );
                }
            }
        });
    }

    /// The gradient for the part `rows` x `columns` of the canvas from the one for the image.
    pub(super) fn adjoint<T: Pixel>(
        &self,
        upstream: &[T],
        size: Size,
        rows: (usize, usize),
        columns: (usize, usize),
        Buffers { canvas, taps, line }: &mut Buffers<T>,
    ) {
        let r = self.radius();
        taps.clear();
        taps.extend(self.taps.iter().map(|&t| T::from_f64(t)));
        let width = columns.1 - columns.0;
        canvas.clear();
        canvas.resize((rows.1 - rows.0) * width, T::default());
        // Canvas column c gives to image columns c - 2 r to c.
        let first = columns.0.saturating_sub(2 * r).min(size.width);
        let end = columns.1.min(size.width).max(first);
        each_row(canvas, width, (line, end - first), |i, target, line| {
            let i = rows.0 + i;
            line.fill(T::default());
            for (k, &tap) in taps.iter().enumerate() {
                if i >= k && i - k < size.height {
                    let from = (i - k) * size.width;
                    add_scaled(line, &upstream[from + first..from + end], tap);
                }
            }
            for (l, &tap) in taps.iter().enumerate() {
                // Canvas column c takes image column c - l.
                let begin = columns.0.max(first + l);
                let stop = columns.1.min(end + l);
                if begin < stop {
                    let from = begin - l - first;
                    add_scaled(
                        &mut target[begin - columns.0..stop - columns.0],
                        &line[from..from + stop - begin],
                        tap,
                    );
                }
            }
        });
    }
}

/// Parts of images with more pixels than this are shared out.
const LARGE: usize = 1 << 18;

/// Rows that a thread takes at once.
const BAND: usize = 32;

/// Work on each row with a line of zeros or of what the row before left, of so many numbers.
fn each_row<T: Pixel>(
    rows: &mut [T],
    width: usize,
    (line, length): (&mut Vec<T>, usize),
    work: impl Fn(usize, &mut [T], &mut [T]) + Sync,
) {
    if rows.len() <= LARGE {
        line.clear();
        line.resize(length, T::default());
        rows.chunks_exact_mut(width).enumerate().for_each(|(i, row)| work(i, row, line));
        return;
    }
    rows.par_chunks_mut(BAND * width).enumerate().for_each_init(
        || vec![T::default(); length],
        |line, (band, rows)| {
            let rows = rows.chunks_exact_mut(width).enumerate();
            rows.for_each(|(i, row)| work(BAND * band + i, row, line));
        },
    );
}

/// `to += tap * from`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn add_scaled<T: Pixel>(to: &mut [T], from: &[T], tap: T) {
    for (to, &from) in to.iter_mut().zip(from) {
        *to = *to + tap * from;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize) -> Vec<f64> {
        (0..n).map(|k| ((k * 7919 + 13) % 101) as f64 / 101.0 - 0.4).collect()
    }

    /// The definition: every tap of every pixel.
    fn slow(kernel: &Kernel, canvas: &[f64], size: Size) -> Vec<f64> {
        let (_, width) = kernel.padded(size);
        let mut out = vec![0.0; size.pixels()];
        for i in 0..size.height {
            for j in 0..size.width {
                for (k, a) in kernel.taps.iter().enumerate() {
                    for (l, b) in kernel.taps.iter().enumerate() {
                        out[i * size.width + j] += a * b * canvas[(i + k) * width + j + l];
                    }
                }
            }
        }
        out
    }

    #[test]
    fn a_part_of_the_canvas_is_blurred_as_the_whole_and_the_adjoint_is_one() {
        let (small, large) = (Size { height: 9, width: 13 }, Size { height: 480, width: 560 });
        assert!(large.pixels() > LARGE);
        for (size, sigma) in [(small, 0.4), (small, 1.0), (small, 2.5), (large, 0.7)] {
            let mut kernel = Kernel { sigma: 0.0, taps: Vec::new() };
            kernel.set(sigma);
            let mut buffers = Buffers::default();
            let (height, width) = kernel.padded(size);
            for (rows, columns) in [
                ((0, height), (0, width)),
                ((2, 5), (3, 4)),
                ((height - 1, height), (width - 2, width)),
            ] {
                let part = noise((rows.1 - rows.0) * (columns.1 - columns.0));
                let mut canvas = vec![0.0; height * width];
                for i in rows.0..rows.1 {
                    for j in columns.0..columns.1 {
                        canvas[i * width + j] =
                            part[(i - rows.0) * (columns.1 - columns.0) + j - columns.0];
                    }
                }
                let mut out = vec![0.0; size.pixels()];
                buffers.canvas.clone_from(&part);
                kernel.forward(&mut buffers, rows, columns, size, &mut out);
                for (a, b) in out.iter().zip(slow(&kernel, &canvas, size)) {
                    assert!((a - b).abs() < 1e-14, "{a} {b}");
                }
                let upstream = noise(size.pixels());
                kernel.adjoint(&upstream, size, rows, columns, &mut buffers);
                let back = &buffers.canvas;
                let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                let error = (dot(&out, &upstream) - dot(&part, back)).abs();
                assert!(error < 1e-14 * part.len().max(100) as f64, "{error}");
            }
        }
    }
}
