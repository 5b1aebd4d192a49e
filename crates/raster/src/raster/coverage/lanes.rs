//! Pixels with the same small number of pieces, eight at a time: a lane each.
//!
//! The pieces of a pixel are compared as [`pairs`](super::pairs) does, with the same answer to
//! every tie. Pixels that need more than that are handed back: where pieces run along each other,
//! a piece is horizontal, or is crossed by more than three others.

use pulp::{Simd, WithSimd};

use super::cell::Piece;
use super::register;

/// Pixels of a batch, and edges of a group: the widest register of `f64`.
pub(super) const WIDE: usize = 8;

/// A number for each.
pub(super) type Lanes = [f64; WIDE];

const ZERO: Lanes = [0.0; WIDE];

/// Which pixel, and the layers at its upper left corner.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Place {
    /// Its number.
    pub(super) pixel: u32,
    pub(super) row: u32,
    pub(super) column: u32,
    pub(super) layers: i32,
}

impl Place {
    /// So many columns to the right.
    #[inline(always)]
    pub(super) fn right(self, columns: u32, layers: i32) -> Self {
        let Self { pixel, row, column, .. } = self;
        Self { pixel: pixel + columns, row, column: column + columns, layers }
    }
}

/// Up to eight pixels of up to `N` pieces.
#[derive(Debug, Clone)]
pub(super) struct Batch<const N: usize> {
    pub(super) count: usize,
    pub(super) places: [Place; WIDE],
    /// How many pieces the pixels have, and the most that one of them has.
    pub(super) pieces: [usize; WIDE],
    pub(super) most: usize,
    pub(super) x0: [Lanes; N],
    pub(super) y0: [Lanes; N],
    pub(super) x1: [Lanes; N],
    pub(super) y1: [Lanes; N],
    pub(super) step: [Lanes; N],
    /// The flags of a piece in the low bits, its edge in those from [`EDGE`] on.
    pub(super) words: [[u64; WIDE]; N],
    pub(super) layers: Lanes,
}

/// Parts of a piece between crossings, at most; those beyond the last one are empty.
pub(super) const PARTS: usize = 4;

/// Where the edge is in a word.
const EDGE: u32 = 32;

/// Of up to so many pieces, the loops over them are unrolled.
pub(super) const UNROLLED: usize = 6;

/// The most pieces of a pixel.
pub(super) const MOST: usize = 16;

/// What is found out about a batch.
#[derive(Debug, Clone)]
pub(super) struct Solved {
    pub(super) area: Lanes,
    /// 1 where the pixel is not solved.
    pub(super) handed_back: Lanes,
    pub(super) pieces: [Shown; MOST],
}

/// What is visible of a piece in each of the pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shown {
    /// 1 where only the left side of the first part is covered, -1 where only the right one is.
    pub(super) first: Lanes,
    /// Visible height, positive where the uncovered side is the right one, and its sum weighted
    /// with where it is.
    pub(super) height: Lanes,
    pub(super) moment: Lanes,
}

impl Default for Solved {
    fn default() -> Self {
        Self { area: ZERO, handed_back: ZERO, pieces: [Shown::default(); MOST] }
    }
}

impl<const N: usize> Default for Batch<N> {
    fn default() -> Self {
        Self {
            count: 0,
            places: [Place::default(); WIDE],
            pieces: [0; WIDE],
            most: 0,
            x0: [ZERO; N],
            y0: [ZERO; N],
            x1: [ZERO; N],
            y1: [ZERO; N],
            step: [ZERO; N],
            words: [[0; WIDE]; N],
            layers: ZERO,
        }
    }
}

/// The kernel.
struct Solve<'a, const N: usize> {
    batch: &'a Batch<N>,
    solved: &'a mut Solved,
}

impl<const N: usize> WithSimd for Solve<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, s: S) {
        for k in 0..WIDE / S::F64_LANES {
            register::solve(s, self.batch, k, self.solved);
        }
    }
}

impl<const N: usize> Batch<N> {
    /// Take a pixel of up to `N` pieces; whether the batch is full.
    #[inline(always)]
    pub(super) fn push(&mut self, place: Place, pieces: &[Piece]) -> bool {
        let l = self.count % WIDE;
        self.places[l] = place;
        self.layers[l] = f64::from(place.layers);
        self.pieces[l] = pieces.len();
        if let (true, Some(pieces)) = (N <= UNROLLED, pieces.first_chunk::<N>()) {
            for i in 0..N {
                self.set(i, l, &pieces[i]);
            }
        } else {
            // Others may have more.
            for i in 0..N {
                self.step[i][l] = 0.0;
            }
            for (i, p) in pieces.iter().enumerate().take(N) {
                self.set(i, l, p);
            }
        }
        self.most = self.most.max(pieces.len());
        self.count = l + 1;
        self.count == WIDE
    }

    #[inline(always)]
    fn set(&mut self, i: usize, l: usize, p: &Piece) {
        (self.x0[i][l], self.y0[i][l]) = (p.x0, p.y0);
        (self.x1[i][l], self.y1[i][l]) = (p.x1, p.y1);
        self.step[i][l] = f64::from(p.step);
        self.words[i][l] = u64::from(p.edge) << EDGE | u64::from(p.flags);
    }

    /// How many pieces a pixel has.
    #[inline(always)]
    pub(super) fn count_of(&self, l: usize) -> usize {
        if N <= UNROLLED { N } else { self.pieces[l].min(N) }
    }

    /// The edge of a piece.
    #[inline(always)]
    pub(super) fn edge(&self, i: usize, l: usize) -> usize {
        (self.words[i][l] >> EDGE) as usize
    }

    /// Begin another batch.
    #[inline(always)]
    pub(super) fn clear(&mut self) {
        (self.count, self.most) = (0, 0);
    }

    /// A piece of a pixel.
    #[inline(always)]
    pub(super) fn piece(&self, i: usize, l: usize) -> Piece {
        Piece {
            x0: self.x0[i][l],
            y0: self.y0[i][l],
            x1: self.x1[i][l],
            y1: self.y1[i][l],
            step: self.step[i][l] as i32,
            edge: self.edge(i, l) as u32,
            flags: self.words[i][l] as u8,
        }
    }

    /// Covered areas, and what is visible of the pieces.
    pub(super) fn solve(&self, solved: &mut Solved) {
        super::ARCH.with(|arch| arch.dispatch(Solve { batch: self, solved }));
    }
}

#[cfg(test)]
mod tests {
    use super::super::cell::{LEFT_0, LEFT_1, RIGHT_0, RIGHT_1, TOP};
    use super::*;

    fn compare<const N: usize>(next: &mut impl FnMut() -> f64) {
        let mut batch = Batch::<N>::default();
        for k in 0..WIDE {
            let pieces: Vec<Piece> = (0..if N > UNROLLED { N - k % 3 } else { N })
                .map(|_| {
                    let (a, b) = (next(), next());
                    let sides = [TOP, LEFT_0, LEFT_1, RIGHT_0, RIGHT_1, 0];
                    Piece {
                        x0: next(),
                        y0: a.min(b),
                        x1: next(),
                        y1: a.max(b),
                        step: if next() < 0.5 { 1 } else { -1 },
                        edge: 7,
                        flags: sides[(next() * 6.0) as usize],
                    }
                })
                .collect();
            let layers = (next() * 3.0) as i32;
            assert_eq!(batch.push(Place { layers, ..Place::default() }, &pieces), k + 1 == WIDE);
            let again: Vec<_> = (0..batch.count_of(k)).map(|i| batch.piece(i, k)).collect();
            assert_eq!(format!("{again:?}"), format!("{pieces:?}"));
        }
        let (mut widest, mut scalar) = (Solved::default(), Solved::default());
        batch.solve(&mut widest);
        for k in 0..WIDE {
            register::solve(pulp::Scalar, &batch, k, &mut scalar);
        }
        assert_eq!(widest.area, scalar.area);
        assert_eq!(widest.handed_back, scalar.handed_back);
        for i in 0..batch.most {
            assert_eq!(widest.pieces[i].first, scalar.pieces[i].first);
            assert_eq!(widest.pieces[i].height, scalar.pieces[i].height);
            assert_eq!(widest.pieces[i].moment, scalar.pieces[i].moment);
        }
    }

    #[test]
    fn every_width_of_register_gives_the_same_bits() {
        let mut seed = 11_u64;
        let mut next = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        for _ in 0..50 {
            compare::<1>(&mut next);
            compare::<2>(&mut next);
            compare::<4>(&mut next);
            compare::<6>(&mut next);
            compare::<8>(&mut next);
            compare::<16>(&mut next);
        }
    }
}
