//! What is visible of the pieces in a rectangle, from comparing each with each.
//!
//! Two pieces are compared at the upper and the lower end of the heights they share: either one is
//! left of the other all the way, or they cross once. The layers on the left of a piece at its
//! upper end are those of the left side plus the steps of the pieces further left, and change where
//! a piece crosses it. A piece is visible where there is a layer on one of its sides only, and the
//! covered area is the sum of what lies left of the visible pieces, with the right-hand side of
//! the rectangle as one more.
//!
//! Every comparison has one answer, whichever of the two asks, and so has every end of a piece that
//! lies exactly on another: it counts as right of it, or left, where the piece goes on through the
//! left side. Pieces that run along each other closer than a
//! sliver could still be ordered in a circle; such rectangles are left to the plain solver.

use pulp::{Simd, WithSimd};

use super::cell::{LEFT_0, LEFT_1, Piece, RIGHT_0, RIGHT_1, Rectangle, SLIVER, TOP};

/// The largest number of pieces.
pub(super) const MOST: usize = 16;

/// The widest register, in numbers.
const WIDEST: usize = 8;

type Lanes = [f64; MOST];

/// The pieces of a rectangle, one a lane, and what is found out about them.
#[derive(Debug, Clone)]
pub(super) struct Pairs {
    count: usize,
    x0: Lanes,
    y0: Lanes,
    x1: Lanes,
    y1: Lanes,
    step: Lanes,
    slope: Lanes,
    /// Where the layers at the left side change, and by how much.
    left_y: Lanes,
    left_step: Lanes,
    /// 1 where the upper (lower) end counts as right of a piece that it lies on, -1 where as left.
    upper: Lanes,
    lower: Lanes,
    /// Layers on the left, at the upper end.
    layers: Lanes,
    /// How many pieces cross it.
    crossed: Lanes,
    /// For each other piece: by how much it changes the layers where it crosses, 0 if it does not.
    change: [Lanes; MOST],
}

impl Default for Pairs {
    fn default() -> Self {
        let zero = [0.0; MOST];
        Self {
            count: 0,
            x0: zero,
            y0: zero,
            x1: zero,
            y1: zero,
            step: zero,
            slope: zero,
            left_y: zero,
            left_step: zero,
            upper: zero,
            lower: zero,
            layers: zero,
            crossed: zero,
            change: [zero; MOST],
        }
    }
}

/// Where layers change along a line, in order.
#[derive(Debug, Clone, Default)]
pub(super) struct Events {
    list: [(f64, f64); MOST],
    count: usize,
}

impl Events {
    /// Where pieces come in (`first`) and go out (`last`) through a side.
    #[inline(always)]
    fn through(&mut self, pieces: &[Piece], first: u8, last: u8, sign: f64) -> &Self {
        self.count = 0;
        for p in pieces {
            // At most one of the two: an edge meets a vertical line once.
            if p.flags & first != 0 {
                self.add(p.y0, sign * f64::from(p.step));
            } else if p.flags & last != 0 {
                self.add(p.y1, -sign * f64::from(p.step));
            }
        }
        self
    }

    #[inline(always)]
    fn add(&mut self, y: f64, change: f64) {
        let mut k = self.count;
        while k > 0 && y < self.list[k - 1].0 {
            self.list[k] = self.list[k - 1];
            k -= 1;
        }
        self.list[k] = (y, change);
        self.count += 1;
    }

    fn iter(&self) -> impl Iterator<Item = (f64, f64)> {
        self.list[..self.count].iter().copied()
    }
}

impl Pairs {
    /// Covered area of a rectangle with at most [`MOST`] pieces, `layers` being their number just
    /// outside its upper left corner. `visible` is called with each piece, the height over which it
    /// is visible (positive if the uncovered side is the right one) and the middle of that; a piece
    /// may come more than once. `events` is a buffer. `None` if pieces are too close to each other to tell.
    #[inline(always)]
    pub(super) fn solve(
        &mut self,
        rectangle: Rectangle,
        pieces: &[Piece],
        layers: i32,
        events: &mut Events,
        mut visible: impl FnMut(&Piece, f64, f64),
    ) -> Option<f64> {
        self.load(pieces);
        let clear =
            super::ARCH.with(|arch| arch.dispatch(Compare { pairs: self, layers: layers.into() }));
        if !clear {
            return None;
        }
        let Rectangle { left, right, top, bottom } = rectangle;
        let (mut at_right, mut sides) = (f64::from(layers), 0);
        for p in pieces {
            sides |= p.flags;
            at_right += if p.flags & TOP == 0 { 0.0 } else { f64::from(p.step) };
        }
        let mut area = if sides & (RIGHT_0 | RIGHT_1) != 0 {
            right * side(rectangle, at_right, events.through(pieces, RIGHT_0, RIGHT_1, 1.0))
        } else if at_right > 0.0 {
            right * (bottom - top)
        } else {
            0.0
        };
        if left != 0.0 {
            let events = events.through(pieces, LEFT_0, LEFT_1, -1.0);
            area -= left * side(rectangle, f64::from(layers), events);
        }
        for (i, p) in pieces.iter().enumerate() {
            if self.crossed[i] == 0.0 {
                let shown = shown(self.layers[i], self.step[i]);
                if shown != 0.0 {
                    let height = shown * (p.y1 - p.y0);
                    area += height * 0.5 * (p.x0 + p.x1);
                    visible(p, height, 0.5 * (p.y0 + p.y1));
                }
            } else {
                area += self.in_parts(i, p, events, &mut visible);
            }
        }
        Some(area)
    }

    #[inline(always)]
    fn load(&mut self, pieces: &[Piece]) {
        self.count = pieces.len();
        for (k, p) in pieces.iter().enumerate() {
            (self.x0[k], self.y0[k], self.x1[k], self.y1[k]) = (p.x0, p.y0, p.x1, p.y1);
            let step = f64::from(p.step);
            self.step[k] = step;
            // Above a piece through the left side is its right (its left) hand side.
            self.left_y[k] = if p.flags & LEFT_0 == 0 { p.y1 } else { p.y0 };
            (self.left_step[k], self.upper[k], self.lower[k]) = match p.flags & (LEFT_0 | LEFT_1) {
                0 => (0.0, 1.0, 1.0),
                LEFT_1 => (step, 1.0, -1.0),
                _ => (-step, -1.0, 1.0),
            };
        }
        for k in self.count..self.count.next_multiple_of(WIDEST) {
            (self.x0[k], self.y0[k], self.x1[k], self.y1[k]) = (0.0, 0.0, 0.0, 0.0);
            (self.step[k], self.left_step[k]) = (0.0, 0.0);
        }
    }

    /// A piece that others cross: the area to the left of what is visible.
    fn in_parts(
        &self,
        i: usize,
        p: &Piece,
        events: &mut Events,
        visible: &mut impl FnMut(&Piece, f64, f64),
    ) -> f64 {
        events.count = 0;
        for (j, change) in self.change[..self.count].iter().enumerate() {
            if change[i] != 0.0 {
                events.add(self.crossing(i, j), change[i]);
            }
        }
        let (mut area, mut layers, mut from) = (0.0, self.layers[i], p.y0);
        let mut part = |layers: f64, from: f64, to: f64| {
            let shown = shown(layers, self.step[i]);
            if shown != 0.0 && to > from {
                let (height, middle) = (shown * (to - from), 0.5 * (from + to));
                area += height * (p.x0 + (middle - p.y0) * self.slope[i]);
                visible(p, height, middle);
            }
        };
        for (y, change) in events.iter() {
            part(layers, from, y);
            layers += change;
            from = y;
        }
        part(layers, from, p.y1);
        area
    }

    /// The height at which two pieces cross.
    #[inline(always)]
    fn crossing(&self, i: usize, j: usize) -> f64 {
        let high = if self.y0[i] > self.y0[j] { self.y0[i] } else { self.y0[j] };
        let low = if self.y1[i] < self.y1[j] { self.y1[i] } else { self.y1[j] };
        let x = |k: usize, y: f64| self.x0[k] + (y - self.y0[k]) * self.slope[k];
        let (top, bottom) = (x(i, high) - x(j, high), x(i, low) - x(j, low));
        let apart = top - bottom;
        let part = if apart == 0.0 { 0.0 } else { (top / apart).clamp(0.0, 1.0) };
        high + (low - high) * part
    }
}

/// 1 if only the left side of a piece is covered, -1 if only the right one is.
#[inline(always)]
fn shown(layers: f64, step: f64) -> f64 {
    f64::from(i8::from(layers > 0.0) - i8::from(layers + step > 0.0))
}

/// How much of a vertical side is covered, with so many layers at its upper end.
#[inline(always)]
fn side(Rectangle { top, bottom, .. }: Rectangle, mut layers: f64, events: &Events) -> f64 {
    let (mut covered, mut from) = (0.0, top);
    for (y, change) in events.iter() {
        covered += if layers > 0.0 { y - from } else { 0.0 };
        layers += change;
        from = y;
    }
    covered + if layers > 0.0 { bottom - from } else { 0.0 }
}

/// The kernel; false if two pieces are too close to each other.
struct Compare<'a> {
    pairs: &'a mut Pairs,
    layers: f64,
}

impl WithSimd for Compare<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let groups = self.pairs.count.div_ceil(S::F64_LANES);
        for group in 0..groups {
            self.pairs.slopes(simd, group);
        }
        (0..groups).all(|group| self.pairs.compare(simd, group, self.layers))
    }
}

impl Pairs {
    #[inline(always)]
    fn slopes<S: Simd>(&mut self, s: S, group: usize) {
        let load = |lanes: &Lanes| S::as_simd_f64s(lanes).0[group];
        let zero = s.splat_f64s(0.0);
        let height = s.sub_f64s(load(&self.y1), load(&self.y0));
        let width = s.sub_f64s(load(&self.x1), load(&self.x0));
        let tall = s.greater_than_f64s(height, zero);
        let slope = s.div_f64s(width, s.select_f64s(tall, height, s.splat_f64s(1.0)));
        S::as_mut_simd_f64s(&mut self.slope).0[group] = s.select_f64s(tall, slope, zero);
    }

    /// Compare a register of pieces with all.
    #[inline(always)]
    fn compare<S: Simd>(&mut self, s: S, group: usize, layers: f64) -> bool {
        let load = |lanes: &Lanes| S::as_simd_f64s(lanes).0[group];
        let zero = s.splat_f64s(0.0);
        let (x0, y0) = (load(&self.x0), load(&self.y0));
        let (x1, y1) = (load(&self.x1), load(&self.y1));
        let (upper, lower) = (load(&self.upper), load(&self.lower));
        let slope = load(&self.slope);
        let sliver = s.splat_f64s(SLIVER);
        let (mut layers, mut crossed) = (s.splat_f64s(layers), zero);
        let mut clear = zero;
        for j in 0..self.count {
            let (ax, ay) = (s.splat_f64s(self.x0[j]), s.splat_f64s(self.y0[j]));
            let (bx, by) = (s.splat_f64s(self.x1[j]), s.splat_f64s(self.y1[j]));
            let (step, steep) = (s.splat_f64s(self.step[j]), s.splat_f64s(self.slope[j]));
            let left_y = s.splat_f64s(self.left_y[j]);
            let entered = s.less_than_or_equal_f64s(left_y, y0);
            let left_step = s.splat_f64s(self.left_step[j]);
            layers = s.add_f64s(layers, s.select_f64s(entered, left_step, zero));
            if self.y0[j] == self.y1[j] {
                // A level piece, with its steps above and below.
                let x = s.add_f64s(x0, s.mul_f64s(s.sub_f64s(ay, y0), slope));
                let inside = s.and_m64s(s.less_than_f64s(y0, ay), s.less_than_f64s(ay, y1));
                let across = s.and_m64s(s.less_than_f64s(ax, x), s.less_than_or_equal_f64s(x, bx));
                let cross = s.and_m64s(inside, across);
                let change = s.select_f64s(cross, s.neg_f64s(step), zero);
                S::as_mut_simd_f64s(&mut self.change[j]).0[group] = change;
                crossed = s.max_f64s(crossed, s.abs_f64s(change));
                continue;
            }
            let (high, low) = (s.max_f64s(y0, ay), s.min_f64s(y1, by));
            let top = s.sub_f64s(
                s.add_f64s(x0, s.mul_f64s(s.sub_f64s(high, y0), slope)),
                s.add_f64s(ax, s.mul_f64s(s.sub_f64s(high, ay), steep)),
            );
            // The lower ends exactly as they are.
            let here = s.add_f64s(x0, s.mul_f64s(s.sub_f64s(low, y0), slope));
            let there = s.add_f64s(ax, s.mul_f64s(s.sub_f64s(low, ay), steep));
            let ends_here = s.less_than_or_equal_f64s(y1, by);
            let ends_there = s.less_than_or_equal_f64s(by, y1);
            let bottom = s
                .sub_f64s(s.select_f64s(ends_here, x1, here), s.select_f64s(ends_there, bx, there));
            // An end on the other piece; with a common end, the other ends decide.
            let (first, last) = (s.splat_f64s(-self.upper[j]), s.splat_f64s(-self.lower[j]));
            let tied_top = s.select_f64s(s.greater_than_f64s(y0, ay), upper, first);
            let tied_top = s.select_f64s(s.equal_f64s(y0, ay), bottom, tied_top);
            let tied_bottom = s.select_f64s(s.less_than_f64s(y1, by), lower, last);
            let tied_bottom = s.select_f64s(s.equal_f64s(y1, by), top, tied_bottom);
            let at_top = s.select_f64s(s.equal_f64s(top, zero), tied_top, top);
            let at_bottom = s.select_f64s(s.equal_f64s(bottom, zero), tied_bottom, bottom);
            let right_at_top = s.greater_than_f64s(at_top, zero);
            let right_at_bottom = s.greater_than_f64s(at_bottom, zero);
            let both = s.less_than_f64s(high, low);
            let spans = s.and_m64s(s.less_than_or_equal_f64s(ay, y0), s.less_than_f64s(y0, by));
            let passed = s.and_m64s(spans, right_at_top);
            layers = s.add_f64s(layers, s.select_f64s(passed, step, zero));
            let cross = s.and_m64s(both, s.xor_m64s(right_at_top, right_at_bottom));
            let change = s.select_f64s(right_at_top, s.neg_f64s(step), step);
            let change = s.select_f64s(cross, change, zero);
            S::as_mut_simd_f64s(&mut self.change[j]).0[group] = change;
            crossed = s.max_f64s(crossed, s.abs_f64s(change));
            let apart = s.max_f64s(s.abs_f64s(top), s.abs_f64s(bottom));
            let close = s.and_m64s(both, s.less_than_f64s(apart, sliver));
            // Of each piece, one is close: itself.
            clear = s.add_f64s(clear, s.select_f64s(close, s.splat_f64s(1.0), zero));
        }
        S::as_mut_simd_f64s(&mut self.layers).0[group] = layers;
        S::as_mut_simd_f64s(&mut self.crossed).0[group] = crossed;
        s.reduce_max_f64s(clear) <= 1.0
    }
}
