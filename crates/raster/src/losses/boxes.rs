//! The mean over the part of a square window that is inside the image, and its adjoint.
//!
//! With `B` the sum over the window and `D` the number of its pixels in the image, a product of one
//! number for the row and one for the column, the mean is `D^-1 B` and its adjoint `B D^-1`.
//!
//! Down the columns the sums run, in `f64`, so that what is taken away again leaves 1e-16 of
//! itself; along the rows they are put together from sums of 1, 2, 4, ... pixels, which vectorises
//! and rounds as little as a tree does.

use super::{Sample, Size};

/// The size of a window.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    size: usize,
}

/// What a pass works with.
#[derive(Debug, Default)]
pub(super) struct Buffers<T> {
    /// Running sums of the columns: plain, and of rows divided by their `D`.
    sums: [Vec<f64>; 2],
    /// One over the number of the window's columns in the image, for each column.
    share: Vec<f64>,
    /// A row of column sums, with the window's reach on either side, which stays 0.
    line: Vec<T>,
    powers: [Vec<T>; 2],
    /// The mean of a row, and the adjoint.
    means: [Vec<T>; 2],
}

impl Window {
    /// An odd number of pixels a side.
    pub(super) fn new(size: usize) -> Self {
        Self { size }
    }

    fn radius(self) -> usize {
        self.size / 2
    }

    /// How many of the pixels around the one at `place` are in the image of `length` pixels.
    #[inline(always)]
    fn count(self, place: usize, length: usize) -> f64 {
        let first = place.saturating_sub(self.radius());
        ((place + self.radius() + 1).min(length) - first) as f64
    }

    /// Hand row after row of the mean and of the adjoint to `each`.
    #[inline(always)]
    pub(super) fn rows<T: Sample>(
        self,
        image: &[T],
        size: Size,
        buffers: &mut Buffers<T>,
        mut each: impl FnMut(usize, &[T], &[T]),
    ) {
        let (r, Size { height, width }) = (self.radius(), size);
        let Buffers { sums, share, line, powers, means } = buffers;
        for sums in &mut *sums {
            sums.clear();
            sums.resize(width, 0.0);
        }
        share.clear();
        share.extend((0..width).map(|j| 1.0 / self.count(j, width)));
        line.clear();
        line.resize(width + 2 * r, T::default());
        for row in powers.iter_mut() {
            row.clear();
            row.resize(width + 2 * r, T::default());
        }
        for row in means.iter_mut() {
            row.clear();
            row.resize(width, T::default());
        }
        let [plain, weighed] = sums;
        let [mean, adjoint] = means;
        let row = |i: usize| (&image[i * width..(i + 1) * width], 1.0 / self.count(i, height));
        for i in 0..r.min(height) {
            let (new, weight) = row(i);
            add(plain, weighed, new, weight);
        }
        for i in 0..height {
            let (enters, leaves) = (i + r < height, i > r);
            match (enters, leaves) {
                (true, true) => exchange(plain, weighed, row(i + r), row(i - r - 1)),
                (true, false) => add(plain, weighed, row(i + r).0, row(i + r).1),
                (false, true) => add(plain, weighed, row(i - r - 1).0, -row(i - r - 1).1),
                (false, false) => {}
            }
            let weight = 1.0 / self.count(i, height);
            for (line, &sum) in line[r..r + width].iter_mut().zip(&*plain) {
                *line = T::from_f64(sum * weight);
            }
            self.along(line, powers, mean);
            for (mean, &share) in mean.iter_mut().zip(&*share) {
                *mean = *mean * T::from_f64(share);
            }
            for ((line, &sum), &share) in line[r..r + width].iter_mut().zip(&*weighed).zip(&*share)
            {
                *line = T::from_f64(sum * share);
            }
            self.along(line, powers, adjoint);
            each(i, mean, adjoint);
        }
    }

    /// The sum of `size` neighbours from each place of a line on.
    #[inline(always)]
    fn along<T: Sample>(self, line: &[T], [one, other]: &mut [Vec<T>; 2], out: &mut [T]) {
        let width = out.len();
        out.copy_from_slice(&line[..width]);
        // `powers` holds the sums of `power` neighbours; `done` neighbours are in `out`.
        let (mut power, mut done, mut length) = (1, 1, line.len());
        let (mut from, mut to) = (one, other);
        while 2 * power <= self.size {
            let source = if power == 1 { line } else { &from[..] };
            length -= power;
            let (first, second) = (&source[..length], &source[power..power + length]);
            for ((sum, &a), &b) in to[..length].iter_mut().zip(first).zip(second) {
                *sum = a + b;
            }
            power *= 2;
            std::mem::swap(&mut from, &mut to);
            if self.size & power != 0 {
                for (out, &sum) in out.iter_mut().zip(&from[done..done + width]) {
                    *out += sum;
                }
                done += power;
            }
        }
    }
}

/// A row more in the sums; a negative weight takes it out of both.
#[inline(always)]
fn add<T: Sample>(plain: &mut [f64], weighed: &mut [f64], row: &[T], weight: f64) {
    let sign = weight.signum();
    for ((plain, weighed), &pixel) in plain.iter_mut().zip(weighed).zip(row) {
        *plain += sign * pixel.to_f64();
        *weighed += weight * pixel.to_f64();
    }
}

/// One row more in the sums and one less.
#[inline(always)]
fn exchange<T: Sample>(
    plain: &mut [f64],
    weighed: &mut [f64],
    (new, gain): (&[T], f64),
    (old, loss): (&[T], f64),
) {
    let pixels = new.iter().zip(old);
    for ((plain, weighed), (&new, &old)) in plain.iter_mut().zip(weighed).zip(pixels) {
        let (new, old) = (new.to_f64(), old.to_f64());
        *plain += new - old;
        *weighed += gain * new - loss * old;
    }
}
