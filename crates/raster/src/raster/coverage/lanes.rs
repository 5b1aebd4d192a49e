//! The slabs of [`cell`](super::cell) for eight rectangles at once, one a lane, without branches.
//!
//! Nothing is sorted but the heights: the layers to the left of a piece are the steps of all pieces
//! whose middle is further left. A rectangle in which pieces cross comes back and is solved again in
//! bands between the crossings; one in which two outlines run closer together than a sliver is left
//! to the plain solver.

use pulp::{Arch, Simd, WithSimd};

use super::cell::{LEFT_0, LEFT_1, Piece, Rectangle, SLIVER};

/// Rectangles that are solved together.
pub(super) const LANES: usize = 8;

type Lane = [f64; LANES];

thread_local! {
    static ARCH: Arch = Arch::new();
}

/// Where a piece is that does not run through a slab.
const AWAY: f64 = 1e30;

/// Up to eight rectangles with at most `K` pieces each; `M` is `2 K`.
#[derive(Debug, Clone)]
pub(super) struct Lanes<const K: usize, const M: usize> {
    /// How many rectangles are waiting.
    pub(super) count: usize,
    pub(super) rectangles: [Rectangle; LANES],
    pub(super) layers: [i32; LANES],
    /// What the caller knows them by.
    pub(super) tags: [u32; LANES],
    pub(super) pieces: [[Piece; K]; LANES],
    pub(super) lengths: [usize; LANES],
    x0: [Lane; K],
    y0: [Lane; K],
    x1: [Lane; K],
    y1: [Lane; K],
    step: [Lane; K],
    left_y: [Lane; K],
    left_step: [Lane; K],
    left: Lane,
    right: Lane,
    top: Lane,
    bottom: Lane,
    at_corner: Lane,
}

/// What became of the rectangles.
#[derive(Debug, Clone)]
pub(super) struct Solved<const K: usize> {
    /// Covered area.
    pub(super) area: Lane,
    /// Below 0 where pieces cross inside a slab.
    pub(super) crossing: Lane,
    /// Below 0 where two outlines face each other closer than a sliver.
    pub(super) sliver: Lane,
    /// For each piece, the height of what is visible of it, positive if the uncovered side is the
    /// right one, and its first moment.
    pub(super) height: [Lane; K],
    pub(super) moment: [Lane; K],
}

impl<const K: usize, const M: usize> Default for Lanes<K, M> {
    fn default() -> Self {
        let zero = [[0.0; LANES]; K];
        Self {
            count: 0,
            rectangles: [Rectangle::default(); LANES],
            layers: [0; LANES],
            tags: [0; LANES],
            pieces: [[Piece::default(); K]; LANES],
            lengths: [0; LANES],
            x0: zero,
            y0: zero,
            x1: zero,
            y1: zero,
            step: zero,
            left_y: zero,
            left_step: zero,
            left: zero[0],
            right: zero[0],
            top: zero[0],
            bottom: zero[0],
            at_corner: zero[0],
        }
    }
}

impl<const K: usize, const M: usize> Lanes<K, M> {
    /// Add a rectangle with at most `K` pieces; whether that fills the lanes.
    #[inline]
    pub(super) fn push(
        &mut self,
        rectangle: Rectangle,
        pieces: &[Piece],
        layers: i32,
        tag: u32,
    ) -> bool {
        let l = self.count;
        self.rectangles[l] = rectangle;
        self.layers[l] = layers;
        self.tags[l] = tag;
        self.lengths[l] = pieces.len();
        (self.left[l], self.right[l]) = (rectangle.left, rectangle.right);
        (self.top[l], self.bottom[l]) = (rectangle.top, rectangle.bottom);
        self.at_corner[l] = f64::from(layers);
        for k in 0..K {
            let Some(p) = pieces.get(k) else {
                // Never in a slab: its lower end is above its upper one.
                (self.y0[k][l], self.y1[k][l]) = (rectangle.bottom, rectangle.top);
                (self.step[k][l], self.left_step[k][l]) = (0.0, 0.0);
                (self.x0[k][l], self.x1[k][l]) = (0.0, 0.0);
                continue;
            };
            self.pieces[l][k] = *p;
            (self.x0[k][l], self.y0[k][l]) = (p.x0, p.y0);
            (self.x1[k][l], self.y1[k][l]) = (p.x1, p.y1);
            let step = f64::from(p.step);
            self.step[k][l] = step;
            // Above a piece through the left side is its right (its left) hand side.
            let upper = p.flags & LEFT_0 != 0;
            let lower = p.flags & LEFT_1 != 0;
            self.left_y[k][l] = if upper { p.y0 } else { p.y1 };
            self.left_step[k][l] = if upper {
                -step
            } else if lower {
                step
            } else {
                0.0
            };
        }
        self.count += 1;
        self.count == LANES
    }

    /// Solve what is waiting; with `OUTLINE`, what is visible too.
    pub(super) fn solve<const OUTLINE: bool>(&mut self, out: &mut Solved<K>) {
        ARCH.with(|arch| arch.dispatch(Slabs::<K, M, OUTLINE> { lanes: self, out }));
    }
}

impl<const K: usize> Default for Solved<K> {
    fn default() -> Self {
        let zero = [[0.0; LANES]; K];
        Self { area: zero[0], crossing: zero[0], sliver: zero[0], height: zero, moment: zero }
    }
}

/// The kernel, and what it is called with.
struct Slabs<'a, const K: usize, const M: usize, const OUTLINE: bool> {
    lanes: &'a Lanes<K, M>,
    out: &'a mut Solved<K>,
}

/// What is known of a piece in a slab.
#[derive(Clone, Copy)]
struct InSlab<V> {
    top: V,
    bottom: V,
    middle: V,
    step: V,
}

impl<const K: usize, const M: usize, const OUTLINE: bool> WithSimd for Slabs<'_, K, M, OUTLINE> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let mut this = self;
        for group in 0..LANES / S::F64_LANES {
            this.group(simd, group);
        }
    }
}

impl<const K: usize, const M: usize, const OUTLINE: bool> Slabs<'_, K, M, OUTLINE> {
    /// As many lanes as the machine has in a register.
    #[expect(clippy::too_many_lines, reason = "one slab after the other, all in registers")]
    #[inline(always)]
    fn group<S: Simd>(&mut self, simd: S, group: usize) {
        let s = simd;
        let lanes = self.lanes;
        let load = |lane: &Lane| S::as_simd_f64s(lane).0[group];
        let zero = s.splat_f64s(0.0);
        let one = s.splat_f64s(1.0);
        let half = s.splat_f64s(0.5);
        let away = s.splat_f64s(AWAY);
        let near = s.splat_f64s(SLIVER);
        let (top, bottom) = (load(&lanes.top), load(&lanes.bottom));
        let mut heights = [zero; M];
        let mut slope = [zero; K];
        for k in 0..K {
            let (y0, y1) = (load(&lanes.y0[k]), load(&lanes.y1[k]));
            let height = s.sub_f64s(y1, y0);
            let height = s.select_f64s(s.greater_than_f64s(height, zero), height, one);
            slope[k] = s.div_f64s(s.sub_f64s(load(&lanes.x1[k]), load(&lanes.x0[k])), height);
            heights[2 * k] = s.max_f64s(s.min_f64s(y0, bottom), top);
            heights[2 * k + 1] = s.max_f64s(s.min_f64s(y1, bottom), top);
        }
        for i in 1..M {
            for j in (0..i).rev() {
                let (a, b) = (heights[j], heights[j + 1]);
                heights[j] = s.min_f64s(a, b);
                heights[j + 1] = s.max_f64s(a, b);
            }
        }
        let (left, right) = (load(&lanes.left), load(&lanes.right));
        let (mut area, mut crossing, mut sliver) = (zero, zero, zero);
        let (mut seen, mut moment) = ([zero; K], [zero; K]);
        let mut high = top;
        for k in 0..=M {
            let low = if k < M { heights[k] } else { bottom };
            let low = s.max_f64s(low, high);
            let height = s.sub_f64s(low, high);
            if s.reduce_max_f64s(height) <= 0.0 {
                continue;
            }
            let nothing = InSlab { top: zero, bottom: zero, middle: zero, step: zero };
            let mut pieces = [nothing; K];
            let mut at_left = load(&lanes.at_corner);
            for k in 0..K {
                let (x0, y0) = (load(&lanes.x0[k]), load(&lanes.y0[k]));
                let (x1, y1) = (load(&lanes.x1[k]), load(&lanes.y1[k]));
                let begun = s.less_than_or_equal_f64s(y0, high);
                let lasts = s.greater_than_or_equal_f64s(y1, low);
                let tall = s.greater_than_f64s(y1, y0);
                let active = s.and_m64s(s.and_m64s(begun, lasts), tall);
                let x = |y| s.add_f64s(x0, s.mul_f64s(s.sub_f64s(y, y0), slope[k]));
                let a = x(high);
                let ends = s.greater_than_or_equal_f64s(low, y1);
                let b = s.select_f64s(ends, x1, x(low));
                let middle = s.mul_f64s(half, s.add_f64s(a, b));
                pieces[k] = InSlab {
                    top: s.select_f64s(active, a, away),
                    bottom: s.select_f64s(active, b, away),
                    middle: s.select_f64s(active, middle, away),
                    step: s.select_f64s(active, load(&lanes.step[k]), zero),
                };
                let above = s.less_than_or_equal_f64s(load(&lanes.left_y[k]), high);
                let gained = s.select_f64s(above, load(&lanes.left_step[k]), zero);
                at_left = s.add_f64s(at_left, gained);
            }
            // Below 0 where pieces cross: their distances at the top and at the bottom differ in
            // sign.
            let mut product = zero;
            let mut before = [at_left; K];
            for i in 0..K {
                for j in 0..i {
                    let (a, b) = (pieces[j], pieces[i]);
                    // At the same place, the first comes first.
                    let swapped = s.less_than_f64s(b.middle, a.middle);
                    before[j] = s.add_f64s(before[j], s.select_f64s(swapped, b.step, zero));
                    before[i] = s.add_f64s(before[i], s.select_f64s(swapped, zero, a.step));
                    let top = s.sub_f64s(a.top, b.top);
                    let bottom = s.sub_f64s(a.bottom, b.bottom);
                    product = s.min_f64s(product, s.mul_f64s(top, bottom));
                }
            }
            let mut covered = zero;
            let mut at_right = at_left;
            let mut shown = [zero; K];
            for k in 0..K {
                let behind = s.add_f64s(before[k], pieces[k].step);
                let a = s.select_f64s(s.greater_than_f64s(before[k], zero), one, zero);
                let b = s.select_f64s(s.greater_than_f64s(behind, zero), one, zero);
                shown[k] = s.sub_f64s(a, b);
                // Far away nothing is shown: 0 times a large number.
                covered = s.add_f64s(covered, s.mul_f64s(shown[k], pieces[k].middle));
                at_right = s.add_f64s(at_right, pieces[k].step);
            }
            let begins = s.select_f64s(s.greater_than_f64s(at_left, zero), left, zero);
            let ends = s.select_f64s(s.greater_than_f64s(at_right, zero), right, zero);
            let covered = s.sub_f64s(s.add_f64s(covered, ends), begins);
            area = s.add_f64s(area, s.mul_f64s(covered, height));
            let real = s.greater_than_f64s(height, zero);
            if OUTLINE {
                let middle = s.mul_f64s(half, s.add_f64s(high, low));
                for k in 0..K {
                    let h = s.mul_f64s(shown[k], height);
                    seen[k] = s.add_f64s(seen[k], h);
                    moment[k] = s.add_f64s(moment[k], s.mul_f64s(h, middle));
                }
                for i in 0..K {
                    for j in 0..i {
                        let apart = s.abs_f64s(s.sub_f64s(pieces[i].middle, pieces[j].middle));
                        let close = s.less_than_f64s(apart, near);
                        let facing = s.mul_f64s(shown[i], shown[j]);
                        let close = s.and_m64s(close, real);
                        sliver = s.min_f64s(sliver, s.select_f64s(close, facing, zero));
                    }
                }
            }
            crossing = s.min_f64s(crossing, s.select_f64s(real, product, zero));
            high = low;
        }
        let store = |lane: &mut Lane, value| S::as_mut_simd_f64s(lane).0[group] = value;
        store(&mut self.out.area, area);
        store(&mut self.out.crossing, crossing);
        store(&mut self.out.sliver, sliver);
        if OUTLINE {
            for k in 0..K {
                store(&mut self.out.height[k], seen[k]);
                store(&mut self.out.moment[k], moment[k]);
            }
        }
    }
}
