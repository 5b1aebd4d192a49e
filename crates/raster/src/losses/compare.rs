//! Losses that compare the two masks after a blur of both.

use multiversion::multiversion;

use super::gaussian::{self, Taps};
use super::{Products, Sample, Scratch, Size};

/// Tanimoto over several widths.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn tanimoto<T: Sample>(
    widths: &[Taps<T>],
    eps: f64,
    masks: [&[T]; 2],
    size: Size,
    gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => all_widths::<T, true>(widths, eps, masks, size, gradient, scratch),
        _ => all_widths::<T, { crate::FUSED }>(widths, eps, masks, size, gradient, scratch),
    }
}

/// Mean squared difference.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn blurred<T: Sample>(
    taps: &Taps<T>,
    masks: [&[T]; 2],
    size: Size,
    gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => difference::<T, true>(taps, masks, size, gradient, scratch),
        _ => difference::<T, { crate::FUSED }>(taps, masks, size, gradient, scratch),
    }
}

/// With `Q = |a - b|^2` and `E = |a|^2 + |b|^2 - <a, b> + eps`, the loss of one width is `Q / E`, and
/// its derivative for `b` is `(2 (E - Q) (b - a) - Q a) / E^2`: both are exactly 0 where `a = b`.
#[inline(always)]
fn all_widths<T: Sample, const FMA: bool>(
    widths: &[Taps<T>],
    eps: f64,
    [pred, target]: [&[T]; 2],
    size: Size,
    mut gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    if let Some(gradient) = gradient.as_deref_mut() {
        gradient.fill(T::default());
    }
    let Scratch { gaussian, images: [a, b, slope], row, .. } = scratch;
    let share = 1.0 / widths.len() as f64;
    let mut loss = 0.0;
    for taps in widths {
        blur::<T, FMA>(taps, target, size, gaussian, a);
        blur::<T, FMA>(taps, pred, size, gaussian, b);
        row.clear();
        row.resize(size.width, T::default());
        let (mut gap, mut overlap) = (Products::none(), Products::none());
        for (a, b) in a.chunks_exact(size.width).zip(b.chunks_exact(size.width)) {
            for ((d, &a), &b) in row.iter_mut().zip(a).zip(b) {
                *d = a - b;
            }
            gap.add::<T, FMA>(row, row, 1.0);
            overlap.add::<T, FMA>(a, b, 1.0);
        }
        let (gap, overlap) = (gap.total(), overlap.total());
        // |a|^2 + |b|^2 = |a - b|^2 + 2 <a, b>.
        let whole = gap + overlap + eps;
        loss += share * gap / whole;
        let Some(gradient) = gradient.as_deref_mut() else { continue };
        let straight = T::from_f64(2.0 * share * (overlap + eps) / (whole * whole));
        let back = T::from_f64(-share * gap / (whole * whole));
        slope.clear();
        slope.extend(a.iter().zip(&*b).map(
            #[inline(always)]
            |(&a, &b)| straight * (b - a) + back * a,
        ));
        add_blurred::<T, FMA>(taps, slope, size, gaussian, gradient);
    }
    loss
}

#[inline(always)]
fn difference<T: Sample, const FMA: bool>(
    taps: &Taps<T>,
    [pred, target]: [&[T]; 2],
    size: Size,
    gradient: Option<&mut [T]>,
    scratch: &mut Scratch<T>,
) -> f64 {
    let Scratch { gaussian, images: [gap, blurred, _], .. } = scratch;
    gap.clear();
    gap.extend(pred.iter().zip(target).map(
        #[inline(always)]
        |(&s, &y)| s - y,
    ));
    blur::<T, FMA>(taps, gap, size, gaussian, blurred);
    let count = size.pixels() as f64;
    let mut total = Products::none();
    for row in blurred.chunks_exact(size.width) {
        total.add::<T, FMA>(row, row, 1.0);
    }
    if let Some(gradient) = gradient {
        let factor = T::from_f64(2.0 / count);
        for pixel in &mut *blurred {
            *pixel = *pixel * factor;
        }
        gradient.fill(T::default());
        add_blurred::<T, FMA>(taps, blurred, size, gaussian, gradient);
    }
    total.total() / count
}

#[inline(always)]
fn blur<T: Sample, const FMA: bool>(
    taps: &Taps<T>,
    image: &[T],
    size: Size,
    buffers: &mut gaussian::Buffers<T>,
    out: &mut Vec<T>,
) {
    out.clear();
    if taps.is_identity() {
        out.extend_from_slice(image);
    } else {
        taps.rows::<FMA>(
            image,
            size,
            buffers,
            #[inline(always)]
            |_, row| out.extend_from_slice(row),
        );
    }
}

#[inline(always)]
fn add_blurred<T: Sample, const FMA: bool>(
    taps: &Taps<T>,
    image: &[T],
    size: Size,
    buffers: &mut gaussian::Buffers<T>,
    out: &mut [T],
) {
    if taps.is_identity() {
        for (out, &pixel) in out.iter_mut().zip(image) {
            *out += pixel;
        }
        return;
    }
    taps.rows::<FMA>(
        image,
        size,
        buffers,
        #[inline(always)]
        |i, row| {
            for (out, &pixel) in out[i * size.width..(i + 1) * size.width].iter_mut().zip(row) {
                *out += pixel;
            }
        },
    );
}
