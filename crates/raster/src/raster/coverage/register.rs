//! Pixels solved in the lanes of a register: see [`lanes`](super::lanes).

use pulp::Simd;

use super::cell::{LEFT_0, LEFT_1, LEVEL, RIGHT_0, RIGHT_1, SLIVER, TOP};
use super::lanes::{Batch, Lanes, PARTS, Solved, UNROLLED};

/// The pieces of some pixels, and what follows from each alone.
pub(super) struct Register<S: Simd, const N: usize> {
    s: S,
    /// How many pieces are looked at.
    n: usize,
    x0: [S::f64s; N],
    y0: [S::f64s; N],
    x1: [S::f64s; N],
    y1: [S::f64s; N],
    step: [S::f64s; N],
    slope: [S::f64s; N],
    /// Where the layers at the left side change, and by how much; the same of the right side.
    left_y: [S::f64s; N],
    left_step: [S::f64s; N],
    right_y: [S::f64s; N],
    right_step: [S::f64s; N],
    /// 1 where the upper (lower) end counts as right of a piece that it lies on, -1 where as left.
    upper: [S::f64s; N],
    lower: [S::f64s; N],
    /// Layers at the upper left and the upper right corner.
    at_left: S::f64s,
    at_right: S::f64s,
    /// How often something is wrong.
    wrong: S::f64s,
}

/// What follows from comparing pieces.
struct Compared<F, const N: usize> {
    /// Layers on the left, at the upper end.
    layers: [F; N],
    /// Heights of the crossings, in order, and by how much each changes the layers.
    at: [[F; N]; PARTS - 1],
    change: [[F; N]; PARTS - 1],
    /// How many crossings there are.
    count: [F; N],
}

impl<S: Simd, const N: usize> Register<S, N> {
    /// Parts of a piece: no more than there are pieces to cross it, and one.
    const PARTS: usize = if N < PARTS { N } else { PARTS };

    #[inline(always)]
    pub(super) fn load(s: S, batch: &Batch<N>, k: usize) -> Self {
        let load = |lanes: &Lanes| S::as_simd_f64s(lanes).0[k];
        let (zero, one) = (s.splat_f64s(0.0), s.splat_f64s(1.0));
        let nothing = [zero; N];
        let at_left = load(&batch.layers);
        let mut all = Self {
            s,
            n: if N <= UNROLLED { N } else { batch.most.min(N) },
            x0: nothing,
            y0: nothing,
            x1: nothing,
            y1: nothing,
            step: nothing,
            slope: nothing,
            left_y: nothing,
            left_step: nothing,
            right_y: [one; N],
            right_step: nothing,
            upper: nothing,
            lower: nothing,
            at_left,
            at_right: at_left,
            wrong: zero,
        };
        for i in 0..all.n {
            all.load_piece(batch, i, k);
        }
        all
    }

    #[inline(always)]
    fn load_piece(&mut self, batch: &Batch<N>, i: usize, k: usize) {
        let s = self.s;
        let load = |lanes: &Lanes| S::as_simd_f64s(lanes).0[k];
        let (zero, one) = (s.splat_f64s(0.0), s.splat_f64s(1.0));
        let when = |yes, value| s.select_f64s(yes, value, zero);
        let (mut x0, mut y0) = (load(&batch.x0[i]), load(&batch.y0[i]));
        let (mut x1, mut y1) = (load(&batch.x1[i]), load(&batch.y1[i]));
        let step = load(&batch.step[i]);
        // What is missing changes nothing: upright and outside, each at a place of its own.
        let missing = s.equal_f64s(step, zero);
        if N > UNROLLED {
            let aside = s.splat_f64s(2.0 + i as f64);
            (x0, y0) = (s.select_f64s(missing, aside, x0), s.select_f64s(missing, zero, y0));
            (x1, y1) = (s.select_f64s(missing, aside, x1), s.select_f64s(missing, one, y1));
        }
        let flags = S::as_simd_u64s(&batch.words[i]).0[k];
        let has = |flag: u8| {
            let flag = s.splat_u64s(u64::from(flag));
            let set = s.equal_u64s(s.and_u64s(flags, flag), flag);
            if N > UNROLLED { s.and_m64s(set, s.not_m64s(missing)) } else { set }
        };
        let back = s.neg_f64s(step);
        let height = s.sub_f64s(y1, y0);
        let tall = s.greater_than_f64s(height, zero);
        let slope = s.div_f64s(s.sub_f64s(x1, x0), s.select_f64s(tall, height, one));
        // Above a piece through the left side is its right (its left) hand side.
        let (inwards, outwards) = (has(LEFT_0), has(LEFT_1));
        self.left_y[i] = s.select_f64s(inwards, y0, y1);
        self.left_step[i] = s.select_f64s(inwards, back, when(outwards, step));
        self.upper[i] = s.select_f64s(inwards, s.neg_f64s(one), one);
        self.lower[i] = s.select_f64s(outwards, s.neg_f64s(one), one);
        let (inwards, outwards) = (has(RIGHT_0), has(RIGHT_1));
        self.right_y[i] = s.select_f64s(inwards, y0, s.select_f64s(outwards, y1, one));
        self.right_step[i] = s.select_f64s(inwards, step, when(outwards, back));
        self.at_right = s.add_f64s(self.at_right, when(has(TOP), step));
        self.wrong = s.add_f64s(self.wrong, when(has(LEVEL), one));
        self.wrong = s.add_f64s(self.wrong, s.select_f64s(tall, zero, one));
        (self.x0[i], self.y0[i], self.x1[i], self.y1[i]) = (x0, y0, x1, y1);
        (self.step[i], self.slope[i]) = (step, slope);
    }

    /// Covered areas, and what is visible of the pieces.
    #[inline(always)]
    pub(super) fn solve(mut self, solved: &mut Solved, k: usize) {
        let s = self.s;
        let zero = s.splat_f64s(0.0);
        let mut found = Compared {
            layers: [self.at_left; N],
            at: [self.y1; PARTS - 1],
            change: [[zero; N]; PARTS - 1],
            count: [zero; N],
        };
        for i in 0..self.n {
            for j in 0..self.n {
                let entered = s.less_than_or_equal_f64s(self.left_y[j], self.y0[i]);
                let step = s.select_f64s(entered, self.left_step[j], zero);
                found.layers[i] = s.add_f64s(found.layers[i], step);
            }
        }
        for i in 0..self.n {
            for j in i + 1..self.n {
                self.compare(i, j, &mut found);
            }
        }
        self.sum(&found, solved, k);
    }

    /// Where a piece is at a height.
    #[inline(always)]
    fn x(&self, i: usize, y: S::f64s) -> S::f64s {
        let s = self.s;
        s.add_f64s(self.x0[i], s.mul_f64s(s.sub_f64s(y, self.y0[i]), self.slope[i]))
    }

    #[inline(always)]
    fn compare(&mut self, i: usize, j: usize, found: &mut Compared<S::f64s, N>) {
        let (s, y0, y1) = (self.s, &self.y0, &self.y1);
        let (zero, one) = (s.splat_f64s(0.0), s.splat_f64s(1.0));
        let when = |yes, value| s.select_f64s(yes, value, zero);
        let (high, low) = (s.max_f64s(y0[i], y0[j]), s.min_f64s(y1[i], y1[j]));
        let top = s.sub_f64s(self.x(i, high), self.x(j, high));
        let i_ends = s.less_than_or_equal_f64s(y1[i], y1[j]);
        let j_ends = s.less_than_or_equal_f64s(y1[j], y1[i]);
        let here = s.select_f64s(i_ends, self.x1[i], self.x(i, low));
        let there = s.select_f64s(j_ends, self.x1[j], self.x(j, low));
        let bottom = s.sub_f64s(here, there);
        // An end on the other piece; with a common end, the other ends decide.
        let later = s.greater_than_f64s(y0[i], y0[j]);
        let tied = s.select_f64s(later, self.upper[i], s.neg_f64s(self.upper[j]));
        let tied = s.select_f64s(s.equal_f64s(y0[i], y0[j]), bottom, tied);
        let at_top = s.select_f64s(s.equal_f64s(top, zero), tied, top);
        let sooner = s.less_than_f64s(y1[i], y1[j]);
        let tied = s.select_f64s(sooner, self.lower[i], s.neg_f64s(self.lower[j]));
        let tied = s.select_f64s(s.equal_f64s(y1[i], y1[j]), top, tied);
        let at_bottom = s.select_f64s(s.equal_f64s(bottom, zero), tied, bottom);
        // Whether one is right of the other.
        let (i_top, i_bottom) =
            (s.greater_than_f64s(at_top, zero), s.greater_than_f64s(at_bottom, zero));
        let (j_top, j_bottom) = (s.less_than_f64s(at_top, zero), s.less_than_f64s(at_bottom, zero));
        let begins = |i: usize, j: usize| {
            let after = s.less_than_or_equal_f64s(y0[j], y0[i]);
            s.and_m64s(after, s.less_than_f64s(y0[i], y1[j]))
        };
        let i_step = when(s.and_m64s(begins(i, j), i_top), self.step[j]);
        let j_step = when(s.and_m64s(begins(j, i), j_top), self.step[i]);
        found.layers[i] = s.add_f64s(found.layers[i], i_step);
        found.layers[j] = s.add_f64s(found.layers[j], j_step);
        let both = s.less_than_f64s(high, low);
        let i_cross = s.and_m64s(both, s.xor_m64s(i_top, i_bottom));
        let j_cross = s.and_m64s(both, s.xor_m64s(j_top, j_bottom));
        let apart = s.sub_f64s(top, bottom);
        let apart = s.select_f64s(s.equal_f64s(apart, zero), one, apart);
        let part = s.max_f64s(s.min_f64s(s.div_f64s(top, apart), one), zero);
        let y = s.add_f64s(high, s.mul_f64s(s.sub_f64s(low, high), part));
        let away = |right, step| s.select_f64s(right, s.neg_f64s(step), step);
        found.cross::<S>(s, i, i_cross, y, away(i_top, self.step[j]), Self::PARTS - 1);
        found.cross::<S>(s, j, j_cross, y, away(j_top, self.step[i]), Self::PARTS - 1);
        let widest = s.max_f64s(s.abs_f64s(top), s.abs_f64s(bottom));
        let close = s.and_m64s(both, s.less_than_f64s(widest, s.splat_f64s(SLIVER)));
        self.wrong = s.add_f64s(self.wrong, when(close, one));
    }

    #[inline(always)]
    fn sum(&self, found: &Compared<S::f64s, N>, solved: &mut Solved, k: usize) {
        let (s, n) = (self.s, self.n);
        let zero = s.splat_f64s(0.0);
        let (one, half) = (s.splat_f64s(1.0), s.splat_f64s(0.5));
        let when = |yes, value| s.select_f64s(yes, value, zero);
        let store = |lanes: &mut Lanes, value| S::as_mut_simd_f64s(lanes).0[k] = value;
        let mut wrong = self.wrong;
        let mut area = covered_side(s, self.at_right, &self.right_y[..n], &self.right_step[..n]);
        for i in 0..n {
            let many = s.greater_than_f64s(found.count[i], s.splat_f64s((PARTS - 1) as f64));
            wrong = s.add_f64s(wrong, when(many, one));
            let whole = s.mul_f64s(half, s.add_f64s(self.x0[i], self.x1[i]));
            let cut = s.greater_than_f64s(found.count[i], zero);
            let (mut left, mut from) = (found.layers[i], self.y0[i]);
            let out = &mut solved.pieces[i];
            for part in 0..Self::PARTS {
                let last = part + 1 == Self::PARTS;
                let to = if last { self.y1[i] } else { found.at[part][i] };
                let covered = |layers| when(s.greater_than_f64s(layers, zero), one);
                let shown = s.sub_f64s(covered(left), covered(s.add_f64s(left, self.step[i])));
                let height = s.mul_f64s(shown, s.sub_f64s(to, from));
                let middle = s.mul_f64s(half, s.add_f64s(from, to));
                let x = self.x(i, middle);
                let x = if part == 0 { s.select_f64s(cut, x, whole) } else { x };
                area = s.add_f64s(area, s.mul_f64s(height, x));
                if N == 1 {
                    store(&mut out.first, shown);
                }
                store(&mut out.heights[part], height);
                store(&mut out.middles[part], middle);
                if !last {
                    (left, from) = (s.add_f64s(left, found.change[part][i]), to);
                }
            }
        }
        store(&mut solved.area, area);
        store(&mut solved.handed_back, wrong);
    }
}

impl<F: Copy, const N: usize> Compared<F, N> {
    /// Piece `i` is crossed where `cross`, at the height `y`: put it among the others.
    #[inline(always)]
    fn cross<S: Simd<f64s = F>>(
        &mut self,
        s: S,
        i: usize,
        cross: S::m64s,
        y: F,
        change: F,
        most: usize,
    ) {
        for m in (0..most).rev() {
            let here = s.and_m64s(cross, s.less_than_f64s(y, self.at[m][i]));
            let at = s.select_f64s(here, y, self.at[m][i]);
            let by = s.select_f64s(here, change, self.change[m][i]);
            (self.at[m][i], self.change[m][i]) = (at, by);
            if m > 0 {
                let before = s.and_m64s(cross, s.less_than_f64s(y, self.at[m - 1][i]));
                self.at[m][i] = s.select_f64s(before, self.at[m - 1][i], at);
                self.change[m][i] = s.select_f64s(before, self.change[m - 1][i], by);
            }
        }
        let once = s.select_f64s(cross, s.splat_f64s(1.0), s.splat_f64s(0.0));
        self.count[i] = s.add_f64s(self.count[i], once);
    }
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
