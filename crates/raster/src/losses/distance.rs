//! The signed distance of every pixel to the outline of a mask, exactly and in linear time.
//!
//! Felzenszwalb & Huttenlocher, "Distance Transforms of Sampled Functions", Theory of Computing 8
//! (2012): distances within each column first, then for each row the lower envelope of the parabolas
//! that stand on them.

use rayon::prelude::*;

use super::{Sample, Size};

/// Squared distance where there is no pixel to measure to; far above what any image has.
const NONE: f64 = 1e20;

/// Buffers of one thread.
#[derive(Debug, Default)]
struct Scratch {
    inside: Vec<bool>,
    /// Squared distance within the column to the next pixel inside, and outside.
    columns: [Vec<f64>; 2],
    envelope: Envelope,
    line: Vec<f64>,
}

/// The lowest of parabolas, and from where on each is.
#[derive(Debug, Default)]
struct Envelope {
    places: Vec<usize>,
    starts: Vec<f64>,
}

/// The distance in pixels from each pixel's centre to the outline of `target > 1/2`, negative
/// inside, into `out`; images of `(B, H, W)` in parallel.
///
/// It is the distance to the nearest centre on the other side, less the half pixel that the outline
/// is nearer; where the mask is neither 0 nor 1 in a pixel at the outline, `1/2 - target` is taken,
/// which is the distance to a straight outline along the grid. An image without outline has 0
/// everywhere.
///
/// # Panics
/// If the slices differ in length or are not images of that size.
pub fn signed_distance<T: Sample>(target: &[T], size: Size, out: &mut [T]) {
    assert_eq!(target.len(), out.len(), "expected (B, H, W)");
    let pixels = size.pixels().max(1);
    assert_eq!(target.len() % pixels, 0, "expected (B, H, W)");
    let images = target.par_chunks_exact(pixels).zip(out.par_chunks_exact_mut(pixels));
    images.for_each_init(Scratch::default, |scratch, (target, out)| {
        one(target, size, out, scratch);
    });
}

fn one<T: Sample>(target: &[T], size: Size, out: &mut [T], scratch: &mut Scratch) {
    let Scratch { inside, columns, envelope, line } = scratch;
    inside.clear();
    inside.extend(target.iter().map(|t| t.to_f64() > 0.5));
    if inside.iter().all(|&i| i == inside[0]) {
        out.fill(T::default());
        return;
    }
    for (side, distances) in columns.iter_mut().enumerate() {
        down_columns(inside, size, side == 0, distances);
    }
    line.clear();
    line.resize(size.width, 0.0);
    for i in 0..size.height {
        let row = i * size.width..(i + 1) * size.width;
        let (inside, target) = (&inside[row.clone()], &target[row.clone()]);
        let out = &mut out[row.clone()];
        envelope.of(&columns[0][row.clone()], line);
        for (out, &squared) in out.iter_mut().zip(&*line) {
            *out = T::from_f64(squared.sqrt() - 0.5);
        }
        let ends = (inside.iter().position(|&i| i), inside.iter().rposition(|&i| i));
        if let (Some(first), Some(last)) = ends {
            // The pixels next to them are outside, at distance 0: nothing further away is nearer.
            let span = first.saturating_sub(1)..(last + 2).min(size.width);
            let line = &mut line[span.clone()];
            envelope.of(&columns[1][row][span.clone()], line);
            for (j, &squared) in span.zip(&*line) {
                if inside[j] {
                    out[j] = T::from_f64(0.5 - squared.sqrt());
                }
            }
        }
        for (out, target) in out.iter_mut().zip(target) {
            let (distance, part) = (out.to_f64(), target.to_f64());
            if distance.abs() < 1.0 && part > 0.0 && part < 1.0 {
                *out = T::from_f64(0.5 - part);
            }
        }
    }
}

/// Squared distance of each pixel to the nearest one of its column that is (or is not) inside.
fn down_columns(inside: &[bool], size: Size, wanted: bool, out: &mut Vec<f64>) {
    let Size { height, width } = size;
    out.clear();
    out.resize(size.pixels(), NONE);
    // First as distances, down and up again.
    for i in 0..height {
        for j in 0..width {
            let k = i * width + j;
            let above = if i > 0 { out[k - width] + 1.0 } else { NONE };
            out[k] = if inside[k] == wanted { 0.0 } else { above };
        }
    }
    for i in (0..height.saturating_sub(1)).rev() {
        for j in 0..width {
            let k = i * width + j;
            out[k] = out[k].min(out[k + width] + 1.0);
        }
    }
    for distance in out {
        *distance = if *distance < NONE { *distance * *distance } else { NONE };
    }
}

impl Envelope {
    /// `min_q (p - q)^2 + heights[q]` for each p.
    fn of(&mut self, heights: &[f64], out: &mut [f64]) {
        let Self { places, starts } = self;
        places.clear();
        starts.clear();
        for (q, &height) in heights.iter().enumerate() {
            if height >= NONE {
                continue;
            }
            let mut start = f64::NEG_INFINITY;
            while let (Some(&top), Some(&from)) = (places.last(), starts.last()) {
                // Where the two parabolas cross.
                let (a, b) = (top as f64, q as f64);
                start = ((height + b * b) - (heights[top] + a * a)) / (2.0 * (b - a));
                if start > from {
                    break;
                }
                places.pop();
                starts.pop();
                start = f64::NEG_INFINITY;
            }
            places.push(q);
            starts.push(start);
        }
        let mut k = 0;
        for (p, out) in out.iter_mut().enumerate() {
            if places.is_empty() {
                *out = NONE;
                continue;
            }
            let place = p as f64;
            while k + 1 < places.len() && starts[k + 1] <= place {
                k += 1;
            }
            let gap = place - places[k] as f64;
            *out = gap * gap + heights[places[k]];
        }
    }
}
