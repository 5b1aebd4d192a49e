//! The two floats that the kernels are written for.

use std::cell::RefCell;
use std::fmt::Debug;
use std::ops::{Add, Deref, DerefMut, Div, Mul, Neg, Sub};

use super::bands::Scratch;
use super::sums::{self, BlockSums, Totals};
use crate::raster::spare::Spare;

/// Pixels of a tile: 4 rows of 4.
pub(super) const LANES: usize = 16;

/// The bit of each pixel of a tile.
pub(super) const BIT: [u32; LANES] = {
    let mut bits = [0; LANES];
    let mut l = 0;
    while l < LANES {
        bits[l] = 1 << l;
        l += 1;
    }
    bits
};

/// A number for each pixel of a tile, where one load takes them from one line of the caches.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Lanes<R>(pub(super) [R; LANES]);

impl<R: Real> Lanes<R> {
    pub(super) const ZERO: Self = Self([R::ZERO; LANES]);
}

impl<R> Deref for Lanes<R> {
    type Target = [R; LANES];

    #[inline(always)]
    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<R> DerefMut for Lanes<R> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

/// `f32` or `f64`.
pub(super) trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Send
    + Sync
    + 'static
{
    /// Where its exponent is larger, a face is left out of the mask of a mesh with few faces...
    const REACH: f64;
    /// ... and of any mesh: `exp` of its negative is below the rounding of 1.
    const FURTHEST: f64;
    /// What a factor of the product is at least when it is taken out again. The pixel lies on
    /// the face then, and the product is too small to count.
    const LEAST_FACTOR: Self;
    /// Least value of the product: far below what counts, far above subnormal numbers.
    const LEAST_PRODUCT: Self;
    /// Where the product is below, the mask is 1 to the last digit, and its gradient 0.
    const FULL: Self;
    /// Two points closer than this are one.
    const SAME: Self;
    const ZERO: Self;
    const ONE: Self;

    fn of(value: f64) -> Self;
    fn wide(self) -> f64;
    fn abs(self) -> Self;
    fn sqrt(self) -> Self;
    /// The integer above, or 32 or more for anything that large; up to 1e-4 more than an integer is
    /// taken for it. For `0 <= self`.
    fn ceil_shift(self) -> u32;
    /// `self * b + c`, in one instruction where `FMA`.
    fn fused<const FMA: bool>(self, b: Self, c: Self) -> Self;
    /// `2^-self` for `self >= 0`, accurate to a few units of the last place of 1.
    fn exp2_negative<const FMA: bool>(self) -> Self;
    /// The number if the bit is 1, 0 if it is 0. Comparing the bits of one number would not become lanes.
    fn where_bit(self, bit: u32) -> Self;
    /// Sums over the lanes, in a fixed order.
    fn totals(edges: &BlockSums<Self>) -> Totals<Self>;
    fn with_scratch<O>(work: impl FnOnce(&mut Scratch<Self>) -> O) -> O;
    /// Memory of products that nobody needs any more.
    fn spare() -> &'static Spare<Lanes<Self>>;

    #[inline(always)]
    fn least(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn most(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
}

/// Adding it rounds to an integer, which is in the low bits then: 1.5 * 2^23 and 1.5 * 2^52.
const ROUND_SINGLE: f32 = 12_582_912.0;
pub(super) const ROUND_DOUBLE: f64 = 6_755_399_441_055_744.0;

thread_local! {
    static SINGLE: RefCell<Scratch<f32>> = RefCell::default();
    static DOUBLE: RefCell<Scratch<f64>> = RefCell::default();
}

static SPARE_SINGLE: Spare<Lanes<f32>> = Spare::new();
static SPARE_DOUBLE: Spare<Lanes<f64>> = Spare::new();

macro_rules! plain {
    ($scratch:ident, $spare:ident, $type:ty) => {
        const ZERO: Self = 0.0;
        const ONE: Self = 1.0;

        #[inline(always)]
        fn of(value: f64) -> Self {
            value as $type
        }
        #[inline(always)]
        fn wide(self) -> f64 {
            f64::from(self)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            self.abs()
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            self.sqrt()
        }
        #[inline(always)]
        fn fused<const FMA: bool>(self, b: Self, c: Self) -> Self {
            if FMA { self.mul_add(b, c) } else { self * b + c }
        }
        fn with_scratch<O>(work: impl FnOnce(&mut Scratch<Self>) -> O) -> O {
            $scratch.with_borrow_mut(work)
        }
        fn spare() -> &'static Spare<Lanes<Self>> {
            &$spare
        }
    };
}

impl Real for f32 {
    const REACH: f64 = 14.0;
    const FURTHEST: f64 = 17.5;
    const LEAST_FACTOR: Self = 1e-7;
    const LEAST_PRODUCT: Self = 1e-30;
    const FULL: Self = 1e-7;
    const SAME: Self = 1e-15;
    plain!(SINGLE, SPARE_SINGLE, f32);

    #[inline(always)]
    fn where_bit(self, bit: u32) -> Self {
        Self::from_bits(self.to_bits() & bit.wrapping_neg())
    }

    fn totals(edges: &BlockSums<Self>) -> Totals<Self> {
        sums::totals_single(edges)
    }

    #[inline(always)]
    fn ceil_shift(self) -> u32 {
        (self + 0.4999 + ROUND_SINGLE).to_bits().wrapping_sub(ROUND_SINGLE.to_bits())
    }

    /// `2^n 2^r`, `2^r` as a polynomial of relative error 3e-6 over `|r| <= 1/2`, which is 1 at 0: a
    /// tenth of what a mask may be off, however many faces a pixel meets.
    #[inline(always)]
    fn exp2_negative<const FMA: bool>(self) -> Self {
        let y = self.least(120.0);
        let shifted = ROUND_SINGLE - y;
        let r = (ROUND_SINGLE - shifted) - y;
        // In pairs: a shorter chain of operations that wait for one another.
        let square = r * r;
        let low = 0.693_124_2_f32.fused::<FMA>(r, 1.0);
        let high = 0.055_906_426_f32.fused::<FMA>(r, 0.240_240_99);
        let high = 0.009_582_854_f32.fused::<FMA>(square, high);
        let p = high.fused::<FMA>(square, low);
        Self::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
    }
}

impl Real for f64 {
    const REACH: f64 = 41.5;
    const FURTHEST: f64 = 41.5;
    const LEAST_FACTOR: Self = 1e-16;
    const LEAST_PRODUCT: Self = 1e-200;
    const FULL: Self = 1e-22;
    const SAME: Self = 1e-120;
    plain!(DOUBLE, SPARE_DOUBLE, f64);

    #[inline(always)]
    fn where_bit(self, bit: u32) -> Self {
        Self::from_bits(self.to_bits() & u64::from(bit).wrapping_neg())
    }

    fn totals(edges: &BlockSums<Self>) -> Totals<Self> {
        sums::totals(edges)
    }

    #[inline(always)]
    fn ceil_shift(self) -> u32 {
        (self.least(32.0) + 0.4999 + ROUND_DOUBLE).to_bits() as u32 & 63
    }

    /// `2^n 2^r`, `2^r` as its Taylor polynomial over `|r| <= 1/2`.
    #[inline(always)]
    fn exp2_negative<const FMA: bool>(self) -> Self {
        let y = self.least(860.0);
        let shifted = ROUND_DOUBLE - y;
        let r = (ROUND_DOUBLE - shifted) - y;
        let mut p = 1.369_148_885_390_412_8e-12;
        p = p.fused::<FMA>(r, 2.567_843_599_348_820_6e-11);
        p = p.fused::<FMA>(r, 4.445_538_271_870_811_6e-10);
        p = p.fused::<FMA>(r, 7.054_911_620_801_123e-9);
        p = p.fused::<FMA>(r, 1.017_808_600_923_97e-7);
        p = p.fused::<FMA>(r, 1.321_548_679_014_431e-6);
        p = p.fused::<FMA>(r, 1.525_273_380_405_984_1e-5);
        p = p.fused::<FMA>(r, 0.000_154_035_303_933_816_1);
        p = p.fused::<FMA>(r, 0.001_333_355_814_642_844_3);
        p = p.fused::<FMA>(r, 0.009_618_129_107_628_477);
        p = p.fused::<FMA>(r, 0.055_504_108_664_821_58);
        p = p.fused::<FMA>(r, 0.240_226_506_959_100_7);
        p = p.fused::<FMA>(r, std::f64::consts::LN_2);
        p = p.fused::<FMA>(r, 1.0);
        Self::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 52))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_accurate() {
        for k in 0..86_000 {
            let x = f64::from(k) * 1e-3;
            let exact = (-x).exp2();
            assert!((x.exp2_negative::<false>() / exact - 1.0).abs() < 1e-15, "{x}");
            let single = f64::from((x as f32).exp2_negative::<false>());
            let exact = (-f64::from(x as f32)).exp2();
            assert!((single / exact - 1.0).abs() < 3e-6, "{x}");
        }
        assert!(
            1e30_f32.exp2_negative::<false>() < 1e-30 && 1e300.exp2_negative::<false>() < 1e-200
        );
        assert!((0.0.exp2_negative::<false>() - 1.0).abs() < 1e-15);
    }
}
