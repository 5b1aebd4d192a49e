//! Which tiles the faces of visits reach, as lists: loops over them end where it can be foretold.

use multiversion::multiversion;

use super::faces::Block;
use super::real::LANES;
use super::visits::{MOST, Visit};

/// Tiles of a visit.
const WINDOW: usize = MOST * MOST;

/// A list is written in pieces of a visit, and ends anywhere in the last.
const ROOM: usize = (LANES + 1) * WINDOW;

/// Pairs of a record of a block and a tile of a visit.
#[derive(Debug)]
pub(super) struct List {
    record: [u8; ROOM],
    tile: [u8; ROOM],
    length: usize,
}

/// The tiles of visits.
#[derive(Debug)]
pub(super) struct Items {
    /// Tiles for which an edge alone gives the distance, edge after edge: the record of edge `k` of
    /// face `lane` is `16 k + lane`.
    pub(super) one: List,
    /// Other tiles: the record is the face.
    pub(super) all: List,
    /// Tiles in use within reach, of each visit.
    used: [u64; LANES],
    /// The place of the first tile among all, of each visit.
    first: [usize; LANES],
    /// The place of each tile of a visit from the first on.
    offset: [usize; WINDOW],
}

impl List {
    const fn new() -> Self {
        Self { record: [0; ROOM], tile: [0; ROOM], length: 0 }
    }

    /// Add the tiles that are the bits of a word.
    #[inline(always)]
    fn add(&mut self, record: u8, mut bits: u64) {
        while bits != 0 {
            self.record[self.length] = record;
            self.tile[self.length] = bits.trailing_zeros() as u8;
            self.length += 1;
            bits &= bits - 1;
        }
    }

    /// Record, and tile as `8 row + column`.
    #[inline(always)]
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, usize)> {
        let pairs = self.record[..self.length].iter().zip(&self.tile[..self.length]);
        pairs.map(|(&record, &tile)| (record as usize, tile as usize))
    }
}

impl Items {
    /// For tiles in rows of `stride`.
    pub(super) fn new(stride: usize) -> Self {
        let (used, first) = ([0; LANES], [0; LANES]);
        let offset = std::array::from_fn(|tile| (tile / MOST) * stride + tile % MOST);
        Self { one: List::new(), all: List::new(), used, first, offset }
    }

    /// List the tiles of visits that are to be `seen`, apart where one edge alone gives the distance.
    #[inline(always)]
    pub(super) fn find<R>(
        &mut self,
        visits: &[Visit],
        block: &Block<R>,
        seen: impl Fn(usize) -> u64,
    ) {
        self.set(visits);
        for (lane, used) in self.used.iter_mut().enumerate() {
            *used &= seen(lane);
        }
        list(self, Some(&block.near.one));
    }

    /// List the tiles of visits.
    #[inline(always)]
    pub(super) fn find_all(&mut self, visits: &[Visit]) {
        self.set(visits);
        list(self, None);
    }

    #[inline(always)]
    fn set(&mut self, visits: &[Visit]) {
        let stride = self.offset[MOST];
        self.used = [0; LANES];
        for ((visit, used), first) in visits.iter().zip(&mut self.used).zip(&mut self.first) {
            *used = visit.used;
            *first = usize::from(visit.row) * stride + usize::from(visit.column);
        }
    }

    /// The place of a visit's tile among all.
    #[inline(always)]
    pub(super) fn place(&self, record: usize, tile: usize) -> usize {
        self.first[record % LANES] + self.offset[tile % WINDOW]
    }

    /// One face after another, a word of bits by `add`.
    #[inline(always)]
    fn list(&mut self, one: Option<&[[u64; LANES]; 3]>, add: impl Fn(&mut List, u8, u64)) {
        (self.one.length, self.all.length) = (0, 0);
        let Some(one) = one else {
            for lane in 0..LANES {
                add(&mut self.all, lane as u8, self.used[lane]);
            }
            return;
        };
        for lane in 0..LANES {
            let mut rest = self.used[lane];
            for (k, one) in one.iter().enumerate() {
                add(&mut self.one, (LANES * k + lane) as u8, one[lane] & rest);
                rest &= !one[lane];
            }
            add(&mut self.all, lane as u8, rest);
        }
    }

    fn list_plain(&mut self, one: Option<&[[u64; LANES]; 3]>) {
        self.list(one, List::add);
    }
}

// A build for one processor that has these instructions leaves out the attributes that make it safe
// to call.
#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512vbmi2")))]
use self::avx512::list as list_wide;

#[cfg(all(target_arch = "x86_64", target_feature = "avx512vbmi2"))]
fn list_wide(items: &mut Items, one: Option<&[[u64; LANES]; 3]>) {
    items.list_plain(one);
}

/// A call of its own, for an instruction set of its own.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vbmi2+popcnt"))]
fn list(items: &mut Items, one: Option<&[[u64; LANES]; 3]>) {
    multiversion::target::match_target! {
        "x86_64+avx512vbmi2" => list_wide(items, one),
        _ => items.list_plain(one),
    }
}

#[cfg(all(target_arch = "x86_64", not(target_feature = "avx512vbmi2")))]
mod avx512 {
    use std::arch::x86_64::{
        __m512i, _mm_extract_epi64, _mm512_extracti32x4_epi32, _mm512_maskz_compress_epi8,
        _mm512_set_epi64, _mm512_set1_epi8,
    };

    use super::{Items, LANES, List, WINDOW};

    /// As [`Items::list_plain`], a word of bits at once.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt")]
    pub(super) fn list(items: &mut Items, one: Option<&[[u64; LANES]; 3]>) {
        items.list(one, |list, record, bits| add(list, record, bits));
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi2,popcnt")]
    fn add(list: &mut List, record: u8, bits: u64) {
        let eight = |k: i64| 0x0706_0504_0302_0100 + k * 0x0808_0808_0808_0808;
        let numbers = _mm512_set_epi64(
            eight(7),
            eight(6),
            eight(5),
            eight(4),
            eight(3),
            eight(2),
            eight(1),
            eight(0),
        );
        let end = list.length + WINDOW;
        let (Some(tile), Some(records)) =
            (list.tile.get_mut(list.length..end), list.record.get_mut(list.length..end))
        else {
            return;
        };
        store(_mm512_maskz_compress_epi8(bits, numbers), tile);
        store(_mm512_set1_epi8(record.cast_signed()), records);
        list.length += bits.count_ones() as usize;
    }

    /// One store.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn store(bytes: __m512i, to: &mut [u8]) {
        let parts = [
            _mm512_extracti32x4_epi32::<0>(bytes),
            _mm512_extracti32x4_epi32::<1>(bytes),
            _mm512_extracti32x4_epi32::<2>(bytes),
            _mm512_extracti32x4_epi32::<3>(bytes),
        ];
        for (part, to) in parts.into_iter().zip(to.chunks_exact_mut(16)) {
            to[..8].copy_from_slice(&_mm_extract_epi64::<0>(part).to_le_bytes());
            to[8..].copy_from_slice(&_mm_extract_epi64::<1>(part).to_le_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(list: &List) -> Vec<(usize, usize)> {
        list.iter().collect()
    }

    #[test]
    fn lists_are_the_same_on_every_instruction_set() {
        let mut state = 1_u64;
        let mut word = |density: u32| {
            (0..64).fold(0, |word, bit| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                word | u64::from((state >> 33) % 100 < u64::from(density)) << bit
            })
        };
        for density in [0, 3, 15, 60, 100] {
            let (mut wide, mut plain) = (Items::new(1), Items::new(1));
            wide.used = std::array::from_fn(|_| word(density));
            plain.used = wide.used;
            let one = [0; 3].map(|_: u64| std::array::from_fn(|_| word(30)));
            list(&mut wide, Some(&one));
            plain.list_plain(Some(&one));
            assert_eq!(pairs(&wide.one), pairs(&plain.one));
            assert_eq!(pairs(&wide.all), pairs(&plain.all));
            // Every tile once, with an edge that is to give its distance if there is one.
            let mut left = wide.used;
            for (record, tile) in wide.one.iter().chain(wide.all.iter()) {
                assert!(left[record % LANES] >> tile & 1 == 1);
                left[record % LANES] ^= 1 << tile;
            }
            assert_eq!(left, [0; LANES]);
            for (record, tile) in wide.one.iter() {
                assert!(one[record / LANES][record % LANES] >> tile & 1 == 1);
            }
            for (lane, tile) in wide.all.iter() {
                assert!(one.iter().all(|one| one[lane] >> tile & 1 == 0));
            }
        }
    }
}
