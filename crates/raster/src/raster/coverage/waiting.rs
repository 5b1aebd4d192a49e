//! The pixels to solve of some rows, by the number of their pieces.

use super::cell::Piece;
use super::lanes::{MOST, Place};

/// A pixel to solve.
#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    pub(super) place: Place,
    /// Its pieces, by their places.
    pub(super) first: u32,
    pub(super) count: u32,
}

impl Waiting {
    #[inline(always)]
    pub(super) fn of<'a>(&self, pieces: &'a [Piece]) -> &'a [Piece] {
        &pieces[self.first as usize..(self.first + self.count) as usize]
    }
}

/// A list for each size of a batch, and one for pixels that are solved one by one: of one to six
/// pieces, up to eight, up to [`MOST`], and more.
pub(super) type Lists = [Vec<Waiting>; 9];

/// The list of a pixel with so many pieces.
#[inline(always)]
pub(super) fn list_of(lists: &mut Lists, pieces: u32) -> &mut Vec<Waiting> {
    const LIST: [u8; MOST + 2] = {
        let mut table = [8; MOST + 2];
        let mut pieces = 0;
        while pieces <= MOST {
            table[pieces] = match pieces {
                0..=6 => pieces.saturating_sub(1) as u8,
                7 | 8 => 6,
                _ => 7,
            };
            pieces += 1;
        }
        table
    };
    &mut lists[usize::from(LIST[(pieces as usize).min(MOST + 1)])]
}
