//! Pixels solved in the lanes of a register: see [`lanes`](super::lanes).

use pulp::Simd;

use super::cell::{LEFT_0, LEFT_1, LEVEL, RIGHT_0, RIGHT_1, SLIVER, TOP};
use super::lanes::{Batch, Lanes, PARTS, Solved, UNROLLED};

/// Covered areas of the pixels of register `k`, and what is visible of their pieces.
#[expect(
    clippy::too_many_lines,
    reason = "cut in parts, its values leave the registers: 4 % slower"
)]
#[inline(always)]
pub(super) fn solve<S: Simd, const N: usize>(
    s: S,
    batch: &Batch<N>,
    k: usize,
    solved: &mut Solved,
) {
    let load = |lanes: &Lanes| S::as_simd_f64s(lanes).0[k];
    let zero = s.splat_f64s(0.0);
    let (one, half) = (s.splat_f64s(1.0), s.splat_f64s(0.5));
    let when = |yes, value| s.select_f64s(yes, value, zero);
    let nothing = [zero; N];
    let n = if N <= UNROLLED { N } else { batch.most.min(N) };
    let parts = PARTS.min(N);
    let (mut x0, mut y0, mut x1, mut y1) = (nothing, nothing, nothing, nothing);
    let (mut step, mut slope, mut upper, mut lower) = (nothing, nothing, nothing, nothing);
    let (mut left_y, mut left_step) = (nothing, nothing);
    let (mut right_y, mut right_step) = ([one; N], nothing);
    let start = load(&batch.layers);
    let mut at_right = start;
    // How often something is wrong.
    let mut wrong = zero;
    for i in 0..n {
        (x0[i], y0[i]) = (load(&batch.x0[i]), load(&batch.y0[i]));
        (x1[i], y1[i]) = (load(&batch.x1[i]), load(&batch.y1[i]));
        step[i] = load(&batch.step[i]);
        // What is missing changes nothing: upright and outside, each at a place of its own.
        let missing = s.equal_f64s(step[i], zero);
        if N > UNROLLED {
            let aside = s.splat_f64s(2.0 + i as f64);
            (x0[i], y0[i]) =
                (s.select_f64s(missing, aside, x0[i]), s.select_f64s(missing, zero, y0[i]));
            (x1[i], y1[i]) =
                (s.select_f64s(missing, aside, x1[i]), s.select_f64s(missing, one, y1[i]));
        }
        let flags = S::as_simd_u64s(&batch.words[i]).0[k];
        let has = |flag: u8| {
            let flag = s.splat_u64s(u64::from(flag));
            let set = s.equal_u64s(s.and_u64s(flags, flag), flag);
            if N > UNROLLED { s.and_m64s(set, s.not_m64s(missing)) } else { set }
        };
        let back = s.neg_f64s(step[i]);
        let height = s.sub_f64s(y1[i], y0[i]);
        let tall = s.greater_than_f64s(height, zero);
        let width = s.sub_f64s(x1[i], x0[i]);
        slope[i] = s.div_f64s(width, s.select_f64s(tall, height, one));
        // Above a piece through the left side is its right (its left) hand side.
        let (inwards, outwards) = (has(LEFT_0), has(LEFT_1));
        left_y[i] = s.select_f64s(inwards, y0[i], y1[i]);
        left_step[i] = s.select_f64s(inwards, back, when(outwards, step[i]));
        upper[i] = s.select_f64s(inwards, s.neg_f64s(one), one);
        lower[i] = s.select_f64s(outwards, s.neg_f64s(one), one);
        let (inwards, outwards) = (has(RIGHT_0), has(RIGHT_1));
        right_y[i] = s.select_f64s(inwards, y0[i], s.select_f64s(outwards, y1[i], one));
        right_step[i] = s.select_f64s(inwards, step[i], when(outwards, back));
        at_right = s.add_f64s(at_right, when(has(TOP), step[i]));
        wrong = s.add_f64s(wrong, when(has(LEVEL), one));
        wrong = s.add_f64s(wrong, s.select_f64s(tall, zero, one));
    }
    // Layers on the left of the upper end, the crossings' heights and changes, in order.
    let mut layers = [start; N];
    let (mut at, mut change) = ([y1; PARTS - 1], [nothing; PARTS - 1]);
    let mut crossings = nothing;
    for i in 0..n {
        for j in 0..n {
            let entered = s.less_than_or_equal_f64s(left_y[j], y0[i]);
            layers[i] = s.add_f64s(layers[i], when(entered, left_step[j]));
        }
    }
    for i in 0..n {
        for j in i + 1..n {
            let (high, low) = (s.max_f64s(y0[i], y0[j]), s.min_f64s(y1[i], y1[j]));
            let x = |k: usize, y| s.add_f64s(x0[k], s.mul_f64s(s.sub_f64s(y, y0[k]), slope[k]));
            let top = s.sub_f64s(x(i, high), x(j, high));
            let i_ends = s.less_than_or_equal_f64s(y1[i], y1[j]);
            let j_ends = s.less_than_or_equal_f64s(y1[j], y1[i]);
            let here = s.select_f64s(i_ends, x1[i], x(i, low));
            let there = s.select_f64s(j_ends, x1[j], x(j, low));
            let bottom = s.sub_f64s(here, there);
            // An end on the other piece; with a common end, the other ends decide.
            let (same_top, same_bottom) = (s.equal_f64s(y0[i], y0[j]), s.equal_f64s(y1[i], y1[j]));
            let later = s.greater_than_f64s(y0[i], y0[j]);
            let tied = s.select_f64s(later, upper[i], s.neg_f64s(upper[j]));
            let tied = s.select_f64s(same_top, bottom, tied);
            let at_top = s.select_f64s(s.equal_f64s(top, zero), tied, top);
            let sooner = s.less_than_f64s(y1[i], y1[j]);
            let tied = s.select_f64s(sooner, lower[i], s.neg_f64s(lower[j]));
            let tied = s.select_f64s(same_bottom, top, tied);
            let at_bottom = s.select_f64s(s.equal_f64s(bottom, zero), tied, bottom);
            // Whether one is right of the other.
            let i_top = s.greater_than_f64s(at_top, zero);
            let i_bottom = s.greater_than_f64s(at_bottom, zero);
            let j_top = s.less_than_f64s(at_top, zero);
            let j_bottom = s.less_than_f64s(at_bottom, zero);
            let i_begins =
                s.and_m64s(s.less_than_or_equal_f64s(y0[j], y0[i]), s.less_than_f64s(y0[i], y1[j]));
            let j_begins =
                s.and_m64s(s.less_than_or_equal_f64s(y0[i], y0[j]), s.less_than_f64s(y0[j], y1[i]));
            layers[i] = s.add_f64s(layers[i], when(s.and_m64s(i_begins, i_top), step[j]));
            layers[j] = s.add_f64s(layers[j], when(s.and_m64s(j_begins, j_top), step[i]));
            let both = s.less_than_f64s(high, low);
            let i_cross = s.and_m64s(both, s.xor_m64s(i_top, i_bottom));
            let j_cross = s.and_m64s(both, s.xor_m64s(j_top, j_bottom));
            let apart = s.sub_f64s(top, bottom);
            let apart = s.select_f64s(s.equal_f64s(apart, zero), one, apart);
            let part = s.max_f64s(s.min_f64s(s.div_f64s(top, apart), one), zero);
            let y_cross = s.add_f64s(high, s.mul_f64s(s.sub_f64s(low, high), part));
            let away = |right, step| s.select_f64s(right, s.neg_f64s(step), step);
            for (k, cross, change_k) in
                [(i, i_cross, away(i_top, step[j])), (j, j_cross, away(j_top, step[i]))]
            {
                for m in (0..parts - 1).rev() {
                    let here = s.and_m64s(cross, s.less_than_f64s(y_cross, at[m][k]));
                    let y = s.select_f64s(here, y_cross, at[m][k]);
                    let after = s.select_f64s(here, change_k, change[m][k]);
                    (at[m][k], change[m][k]) = (y, after);
                    if m > 0 {
                        let before = s.and_m64s(cross, s.less_than_f64s(y_cross, at[m - 1][k]));
                        at[m][k] = s.select_f64s(before, at[m - 1][k], y);
                        change[m][k] = s.select_f64s(before, change[m - 1][k], after);
                    }
                }
                crossings[k] = s.add_f64s(crossings[k], when(cross, one));
            }
            let widest = s.max_f64s(s.abs_f64s(top), s.abs_f64s(bottom));
            let close = s.and_m64s(both, s.less_than_f64s(widest, s.splat_f64s(SLIVER)));
            wrong = s.add_f64s(wrong, when(close, one));
        }
    }
    let store = |lanes: &mut Lanes, value| S::as_mut_simd_f64s(lanes).0[k] = value;
    let mut area = covered_side(s, at_right, &right_y[..n], &right_step[..n]);
    for i in 0..n {
        let many = s.greater_than_f64s(crossings[i], s.splat_f64s((PARTS - 1) as f64));
        wrong = s.add_f64s(wrong, when(many, one));
        let whole = s.mul_f64s(half, s.add_f64s(x0[i], x1[i]));
        let cut = s.greater_than_f64s(crossings[i], zero);
        let (mut left, mut from) = (layers[i], y0[i]);
        let out = &mut solved.pieces[i];
        let (mut visible, mut moment) = (zero, zero);
        for k in 0..parts {
            let to = if k + 1 < parts { at[k][i] } else { y1[i] };
            let covered = |layers| when(s.greater_than_f64s(layers, zero), one);
            let shown = s.sub_f64s(covered(left), covered(s.add_f64s(left, step[i])));
            let height = s.mul_f64s(shown, s.sub_f64s(to, from));
            let middle = s.mul_f64s(half, s.add_f64s(from, to));
            let x = s.add_f64s(x0[i], s.mul_f64s(s.sub_f64s(middle, y0[i]), slope[i]));
            let x = if k == 0 { s.select_f64s(cut, x, whole) } else { x };
            area = s.add_f64s(area, s.mul_f64s(height, x));
            if N == 1 {
                store(&mut out.first, shown);
            }
            visible = s.add_f64s(visible, height);
            moment = s.add_f64s(moment, s.mul_f64s(height, middle));
            if k + 1 < parts {
                (left, from) = (s.add_f64s(left, change[k][i]), to);
            }
        }
        store(&mut out.height, visible);
        store(&mut out.moment, moment);
    }
    store(&mut solved.area, area);
    store(&mut solved.handed_back, wrong);
}

/// How much of the right side of a pixel is covered, with `layers` at its upper end and a step at
/// each of some heights.
#[inline(always)]
fn covered_side<S: Simd>(s: S, layers: S::f64s, y: &[S::f64s], step: &[S::f64s]) -> S::f64s {
    let (zero, one) = (s.splat_f64s(0.0), s.splat_f64s(1.0));
    let when = |yes, value| s.select_f64s(yes, value, zero);
    let mut first = one;
    for i in 0..y.len() {
        first = s.min_f64s(first, y[i]);
    }
    let mut covered = when(s.greater_than_f64s(layers, zero), first);
    for i in 0..y.len() {
        // From this height to the next one; of equal ones, the last counts.
        let (mut behind, mut next) = (s.add_f64s(layers, step[i]), one);
        for j in 0..y.len() {
            if j == i {
                continue;
            }
            let before = if j < i {
                s.less_than_or_equal_f64s(y[j], y[i])
            } else {
                s.less_than_f64s(y[j], y[i])
            };
            behind = s.add_f64s(behind, when(before, step[j]));
            next = s.select_f64s(before, next, s.min_f64s(next, y[j]));
        }
        let shown = s.sub_f64s(next, y[i]);
        covered = s.add_f64s(covered, when(s.greater_than_f64s(behind, zero), shown));
    }
    covered
}
