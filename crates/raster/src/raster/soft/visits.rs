//! Which faces come near tiles in use, from the bounds of their corners alone.

use multiversion::multiversion;

use super::real::{LANES, ROUND_DOUBLE, Real};
use super::tiles::{Rectangle, SIDE, Tiles, Units};
use crate::raster::{Screen, Size};

/// Where the pixels that an image point reaches begin and end: first column, first row, and the column
/// and the row after the last, these two negative: the bounds of a face are the least ones of its
/// corners.
pub(super) type Bounds = [i32; 4];

/// The bounds of a face from those of the image points, written at once where they are kept.
#[inline(always)]
pub(super) fn of_face<T: Copy + Ord>(bounds: &[[T; 4]], face: [u32; 3], out: &mut [T; 4]) {
    let [a, b, c] = face.map(|k| &bounds[k as usize]);
    for k in 0..4 {
        out[k] = a[k].min(b[k]).min(c[k]);
    }
}

/// A face and up to 8x8 tiles within its bounds.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Visit {
    /// Those in use, at least one: bit `8 row + column`. Bounds that hold no pixel may still lie in a tile.
    pub(super) used: u64,
    pub(super) face: u32,
    /// The first of them.
    pub(super) column: u16,
    pub(super) row: u16,
}

/// Tiles of a visit in a row and in a column.
pub(super) const MOST: usize = 8;

/// [`Bounds`] in tiles of a rectangle.
type Tiled = [i16; 4];

/// The visits of the faces of an image.
#[derive(Debug, Default)]
pub(super) struct Visits {
    /// Of each image point.
    bounds: Vec<Tiled>,
    visits: Vec<Visit>,
}

/// The first so many of eight tiles in a row, in each of eight rows, and all tiles of the first so many
/// rows.
const FIRST: [[u64; MOST + 1]; 2] = {
    let mut first = [[0; MOST + 1]; 2];
    let mut n = 1;
    while n <= MOST {
        first[0][n] = 0x0101_0101_0101_0101 * (0xFF >> (MOST - n));
        first[1][n] = u64::MAX >> (64 - MOST * n);
        n += 1;
    }
    first
};

impl Visits {
    /// Call `work` with those to the tiles in use, in the order of the faces, some at a time; `bounds`
    /// are those of the image points.
    pub(super) fn each<R: Real>(
        &mut self,
        tiles: &mut Tiles<R>,
        faces: &[[u32; 3]],
        bounds: &[Bounds],
        mut work: impl FnMut(&mut Tiles<R>, &[Visit]),
    ) {
        into_tiles(&tiles.rectangle, bounds, &mut self.bounds);
        let mut first = 0;
        while first < faces.len() {
            let found = find(tiles, faces, &self.bounds, &mut first, &mut self.visits);
            work(tiles, &self.visits[..found]);
        }
    }
}

/// So many visits are enough to begin to work on them. Each of sixteen faces may visit all tiles
/// besides.
const ENOUGH: usize = 2048;

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
fn into_tiles(rectangle: &Rectangle, bounds: &[Bounds], out: &mut Vec<Tiled>) {
    let [first, count] = [rectangle.first, rectangle.count].map(|n| n.map(|n| n as i32));
    let origin = [first[0], first[1], -first[0], -first[1]];
    let (low, high) = ([0, 0, -count[0], -count[1]], [count[0], count[1], 0, 0]);
    out.resize(bounds.len(), [0; 4]);
    for (out, bounds) in out.iter_mut().zip(bounds) {
        for k in 0..4 {
            // Rounded down, which for the negative ones is away from the first.
            let tile = (bounds[k] >> SIDE.trailing_zeros()) - origin[k];
            out[k] = tile.max(low[k]).min(high[k]) as i16;
        }
    }
}

/// Write visits of the faces from `first` on to the front of `visits`; how many they are. The next
/// ones begin with face `first` then.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
fn find<R: Real>(
    tiles: &Tiles<R>,
    faces: &[[u32; 3]],
    bounds: &[Tiled],
    first: &mut usize,
    visits: &mut Vec<Visit>,
) -> usize {
    let mut found = 0;
    for faces in faces[*first..].chunks(LANES) {
        if found >= ENOUGH {
            break;
        }
        let mut of_faces = [[0; 4]; LANES];
        for (out, face) in of_faces.iter_mut().zip(faces) {
            of_face(bounds, *face, out);
        }
        if visits.len() < found + LANES {
            visits.resize(2 * (found + LANES), Visit::default());
        }
        for (lane, bounds) in of_faces[..faces.len()].iter().enumerate() {
            let face = (*first + lane) as u32;
            let [column, row, right, bottom] = *bounds;
            let count = [-right - column, -bottom - row].map(|n| n.max(0) as usize);
            if count[0].max(count[1]) > MOST {
                found = many(tiles, (face, [column, row].map(|n| n as u16), count), found, visits);
                continue;
            }
            let visit = Visit { used: 0, face, column: column as u16, row: row as u16 };
            let used = tiles.used(visit.column.into(), visit.row.into());
            let used = used & FIRST[0][count[0]] & FIRST[1][count[1]];
            visits[found] = Visit { used, ..visit };
            found += usize::from(used != 0);
        }
        *first += faces.len();
    }
    found
}

/// As [`find`], of a face with more tiles than a visit has; room for the next ones is left. A call of
/// its own, for these are rare and `find` is short of registers.
#[cold]
#[inline(never)]
fn many<R: Real>(
    tiles: &Tiles<R>,
    (face, first, count): (u32, [u16; 2], [usize; 2]),
    mut found: usize,
    visits: &mut Vec<Visit>,
) -> usize {
    for down in (0..count[1]).step_by(MOST) {
        for across in (0..count[0]).step_by(MOST) {
            let (column, row) = (first[0] + across as u16, first[1] + down as u16);
            let used = tiles.used(column.into(), row.into())
                & FIRST[0][(count[0] - across).min(MOST)]
                & FIRST[1][(count[1] - down).min(MOST)];
            visits[found] = Visit { used, face, column, row };
            found += usize::from(used != 0);
            if visits.len() < found + LANES {
                visits.resize(2 * (found + LANES), Visit::default());
            }
        }
    }
    found
}

/// More than rounding, in pixels.
const MARGIN: f64 = 1e-3;

/// The bounds of the image points within reach of the units.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn reach(screen: &Screen, size: Size, units: &Units, bounds: &mut Vec<Bounds>) {
    let sides = [size.width as f64, size.height as f64];
    let reach = [0, 1].map(|axis| units.reach / units.scale[axis] + MARGIN);
    bounds.resize(screen.u.len(), [0; 4]);
    let points = screen.u.chunks(LANES).zip(screen.v.chunks(LANES));
    for ((u, v), bounds) in points.zip(bounds.chunks_mut(LANES)) {
        let mut place = [[0.0; LANES]; 2];
        place[0][..u.len()].copy_from_slice(u);
        place[1][..v.len()].copy_from_slice(v);
        let mut lanes = [[0; LANES]; 4];
        for axis in 0..2 {
            for l in 0..LANES {
                let at = place[axis][l] - 0.5;
                lanes[axis][l] = first_from(at - reach[axis], sides[axis]);
                lanes[axis + 2][l] = -first_from(at + reach[axis], sides[axis]);
            }
        }
        for (l, bounds) in bounds.iter_mut().enumerate() {
            *bounds = [lanes[0][l], lanes[1][l], lanes[2][l], lanes[3][l]];
        }
    }
}

/// The first whole number from `x` on, between 0 and `n`, but for rounding.
#[inline(always)]
fn first_from(x: f64, n: f64) -> i32 {
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < n { x } else { n };
    (x + 0.499_999 + ROUND_DOUBLE).to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::super::real::Lanes;
    use super::*;

    fn noise(seed: u64) -> impl FnMut(u64) -> usize {
        let mut state = seed;
        move |n| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 33) % n) as usize
        }
    }

    #[test]
    fn every_tile_in_use_within_bounds_is_visited_once_in_the_order_of_the_faces() {
        for seed in 0..60 {
            let mut next = noise(seed);
            let count = [1 + next(30), 1 + next(40)];
            let first = [next(5), next(5)];
            let mut tiles = Tiles::<f32>::default();
            tiles.rectangle = Rectangle { first, count };
            let share = [1, 3, 30][next(3)];
            tiles.values = (0..count[0] * count[1])
                .map(|_| Lanes([if next(share) == 0 { 1.0 } else { 0.0 }; LANES]))
                .collect();
            tiles.mark();
            // Points within a few pixels of the image, or far outside of it.
            let sides = [0, 1].map(|axis| (SIDE * (first[axis] + count[axis])) as i32);
            let bounds: Vec<Bounds> = (0..50)
                .map(|_| {
                    let [x, y] = sides.map(|side| next(side as u64 + 40) as i32 - 20);
                    let reach = 1 + next(20) as i32;
                    [x - reach, y - reach, -(x + reach), -(y + reach)]
                })
                .collect();
            // More of them than are visited at a time.
            let faces: Vec<[u32; 3]> =
                (0..3000).map(|_| std::array::from_fn(|_| next(50) as u32)).collect();

            let mut visits = Visits::default();
            let (mut found, mut parts) = (Vec::new(), 0);
            visits.each(&mut tiles, &faces, &bounds, |_, visits| {
                parts += 1;
                for visit in visits {
                    assert!(visit.used != 0);
                    for bit in (0..64).filter(|bit| visit.used >> bit & 1 == 1) {
                        let (column, row) = (bit % MOST, bit / MOST);
                        let column = usize::from(visit.column) + column;
                        found.push((visit.face, usize::from(visit.row) + row, column));
                    }
                }
            });
            assert!(found.is_sorted_by_key(|tile| tile.0) && parts > 0);
            found.sort_unstable();

            let mut expected = Vec::new();
            for (face, corners) in faces.iter().enumerate() {
                let mut of = [0; 4];
                of_face(&bounds, *corners, &mut of);
                let [left, top, right, bottom] = of;
                for (at, value) in tiles.values.iter().enumerate() {
                    let (row, column) = (at / count[0], at % count[0]);
                    let [x, y] =
                        [first[0] + column, first[1] + row].map(|tile| (SIDE * tile) as i32);
                    let side = SIDE as i32;
                    let meets = left < x + side && -right > x && top < y + side && -bottom > y;
                    if meets && value[0] > 0.0 {
                        expected.push((face as u32, row, column));
                    }
                }
            }
            assert!(found == expected, "{seed}: {} of {}", found.len(), expected.len());
        }
    }
}
