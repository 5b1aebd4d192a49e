//! The smooth silhouette loss, value and gradient from one blur of the target.

use multiversion::multiversion;

use super::boxes::Window;
use super::gaussian::Taps;
use super::{Products, Sample, Scratch, Size};

/// With a square window.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn with_box<T: Sample>(
    window: Window,
    masks: [&[T]; 2],
    size: Size,
    gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => boxed::<T, true>(window, masks, size, gradient, scratch),
        _ => boxed::<T, { crate::FUSED }>(window, masks, size, gradient, scratch),
    }
}

/// With a Gaussian window.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn with_gaussian<T: Sample>(
    taps: &Taps<T>,
    masks: [&[T]; 2],
    size: Size,
    gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => gaussian::<T, true>(taps, masks, size, gradient, scratch),
        _ => gaussian::<T, { crate::FUSED }>(taps, masks, size, gradient, scratch),
    }
}

#[inline(always)]
fn boxed<T: Sample, const FMA: bool>(
    window: Window,
    [pred, target]: [&[T]; 2],
    size: Size,
    mut gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    let (width, count) = (size.width, size.pixels() as f64);
    let (one, two, share) = (T::from_f64(1.0), T::from_f64(2.0), T::from_f64(1.0 / count));
    let Scratch { boxes, row: slope, ones: [ones, _], .. } = scratch;
    slope.clear();
    slope.resize(width, T::default());
    ones.clear();
    ones.resize(width, one);
    let mut total = Products::none();
    window.rows(
        target,
        size,
        boxes,
        #[inline(always)]
        |i, mean, adjoint| {
            for ((slope, &mean), &adjoint) in slope.iter_mut().zip(mean).zip(adjoint) {
                *slope = one - two * (mean + adjoint);
            }
            let row = i * width..(i + 1) * width;
            total.add::<T, FMA>(&pred[row.clone()], slope, 1.0);
            total.add::<T, FMA>(&target[row.clone()], ones, 1.0);
            if let Some(gradient) = gradient.as_deref_mut() {
                for (out, &slope) in gradient[row].iter_mut().zip(&*slope) {
                    *out = slope * share;
                }
            }
        },
    );
    total.total() / count
}

#[inline(always)]
fn gaussian<T: Sample, const FMA: bool>(
    taps: &Taps<T>,
    [pred, target]: [&[T]; 2],
    size: Size,
    mut gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    let (width, count) = (size.width, size.pixels() as f64);
    let (four, share) = (T::from_f64(4.0), T::from_f64(1.0 / count));
    let Scratch { gaussian, row: slope, ones: [across, down], .. } = scratch;
    slope.clear();
    slope.resize(width, T::default());
    taps.ones(width, across);
    taps.ones(size.height, down);
    let mut total = Products::none();
    taps.rows::<FMA>(
        target,
        size,
        gaussian,
        #[inline(always)]
        |i, blurred| {
            let row = i * width..(i + 1) * width;
            let down = down[i];
            for ((slope, &blurred), &across) in slope.iter_mut().zip(blurred).zip(&*across) {
                *slope = across * down - four * blurred;
            }
            total.add::<T, FMA>(&pred[row.clone()], slope, 1.0);
            total.add::<T, FMA>(&target[row.clone()], across, down.to_f64());
            if let Some(gradient) = gradient.as_deref_mut() {
                for (out, &slope) in gradient[row].iter_mut().zip(&*slope) {
                    *out = slope * share;
                }
            }
        },
    );
    total.total() / count
}
