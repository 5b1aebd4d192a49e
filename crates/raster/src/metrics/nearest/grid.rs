//! Cells that list every vertex which is nearest to some point of the cell.
//!
//! A vertex `p` is left out of a cell where another vertex `q` is nearer throughout. The points
//! nearer to `q` than to `p` are a half-space, so that is one comparison at the worst corner of
//! the cell. Cells are halved from the whole box downwards, each half filtering the list of the
//! whole; a top cell that still lists too many is divided into 8 or 64.

use glam::DVec3;

use super::squared_distance;
use crate::metrics::vertices::LANES;

/// Candidates a cell holds itself.
pub(crate) const SLOTS: usize = 6;

/// A cell with more candidates than this is left to the tree.
const MOST: usize = 96;

/// Some 64 top cells with more candidates than this, all together, are left to the tree.
const CROWD: usize = 4096;

/// After so many comparisons of vertices, about a second, the rest is left to the tree.
const WORK: usize = 600_000_000;

/// A `more` from here on leaves the query to others: that of the cell outside of the box.
pub(crate) const OUTSIDE: u32 = u32::MAX - 1;

/// The same, of a cell with too many candidates.
pub(crate) const TREE: u32 = u32::MAX;

/// Points per tile: their images and squared distances stay in the first-level cache.
pub(crate) const TILE: usize = 256;

/// The images of a tile's points.
pub(crate) struct Images {
    pub(crate) x: [f64; TILE],
    pub(crate) y: [f64; TILE],
    pub(crate) z: [f64; TILE],
}

/// Added to a number in `0..2^31`, leaves it rounded to an integer in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 * 2^52

/// Two opposite corners of a box.
pub(crate) type Corners = (DVec3, DVec3);

/// How fine a grid is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fineness {
    /// About how many top cells.
    cells: f64,
    /// A top cell with more candidates than this is divided.
    divide_above: usize,
    /// Entries of `spill` after which long lists are left to the tree.
    budget: usize,
}

/// For the box around the vertices.
pub(crate) const NEAR: Fineness = Fineness { cells: 16384.0, divide_above: 6, budget: 2_000_000 };

/// For the box three times as large.
pub(crate) const FAR: Fineness = Fineness { cells: 8192.0, divide_above: 6, budget: 1_000_000 };

/// A vertex index inside a cell.
pub(crate) trait Index: Copy + std::fmt::Debug + Send + Sync {
    fn of(k: u32) -> Self;
    fn at(self) -> usize;
}

impl Index for u16 {
    #[inline(always)]
    fn of(k: u32) -> Self {
        k as Self
    }
    #[inline(always)]
    fn at(self) -> usize {
        usize::from(self)
    }
}

impl Index for u32 {
    #[inline(always)]
    fn of(k: u32) -> Self {
        k
    }
    #[inline(always)]
    fn at(self) -> usize {
        self as usize
    }
}

/// Candidates of a cell: the first few, repeated to fill the slots, and where the others are
/// (their number, then they): 0 for none.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell<I> {
    pub(crate) slots: [I; SLOTS],
    pub(crate) more: u32,
}

/// A grid of cubic cells over a box.
#[derive(Debug)]
pub(crate) struct Grid<I> {
    /// Corner of the box, and finest cells per unit.
    pub(crate) low: [f64; 3],
    pub(crate) per_unit: f64,
    /// Number of finest cells along each axis, a multiple of 4.
    pub(crate) size: [u32; 3],
    /// For each top cell (4 x 4 x 4 finest): first cell, times 8, plus by how many bits to shift
    /// the position inside the top cell.
    pub(crate) top: Vec<u32>,
    pub(crate) cells: Vec<Cell<I>>,
    pub(crate) spill: Vec<I>,
}

impl<I: Index> Grid<I> {
    pub(crate) fn new(points: &[[f64; 4]], (low, high): Corners, fine: Fineness) -> Self {
        // Of very many vertices every cell of such a grid has several: more and shallower ones.
        let many = points.len() > 20_000;
        let fine = Fineness { cells: fine.cells * if many { 4.0 } else { 1.0 }, ..fine };
        let extent = (high - low).max(DVec3::splat(1e-9 * (high - low).max_element()));
        let extent = if extent.max_element() > 0.0 { extent } else { DVec3::ONE };
        let edge = (extent.x * extent.y * extent.z / fine.cells).cbrt();
        // A flat or long box has fewer cells across: never more than the number asked for.
        let edge = edge.max(extent.max_element() / fine.cells.sqrt());
        let tops = (extent / edge).to_array().map(|n| n.ceil().max(1.0) as u32);
        let mut builder = Builder {
            points,
            fine,
            low,
            edge,
            tops,
            margin: 1e-14 * (low.abs().max(high.abs())).length_squared(),
            shallow: many,
            work: 0,
            rivals: Vec::new(),
            grid: Self {
                low: low.to_array(),
                per_unit: 4.0 / edge,
                size: tops.map(|n| 4 * n),
                top: vec![6; tops.iter().map(|&n| n as usize).product()],
                cells: vec![Cell { slots: [I::of(0); SLOTS], more: TREE }],
                spill: vec![I::of(0)],
            },
        };
        let all: Vec<u32> = (0..points.len() as u32).collect();
        builder.halve([0; 3], tops, &all);
        let outside = builder.grid.cells.len() as u32;
        builder.grid.top.push(outside << 3 | 6);
        builder.grid.cells.push(Cell { slots: [I::of(0); SLOTS], more: OUTSIDE });
        builder.grid
    }

    pub(crate) fn bytes(&self) -> usize {
        self.top.len() * 4
            + self.cells.len() * size_of::<Cell<I>>()
            + self.spill.len() * size_of::<I>()
    }

    /// The cell around `q`, or that for the outside.
    #[inline(always)]
    pub(crate) fn cell(&self, q: [f64; 3]) -> &Cell<I> {
        let mut at = [0; 3];
        for k in 0..3 {
            let c = (q[k] - self.low[k]) * self.per_unit;
            if !(c >= 0.0 && c < f64::from(self.size[k])) {
                return &self.cells[self.cells.len() - 1];
            }
            at[k] = c as u32;
        }
        self.at(self.position(at))
    }

    /// Number of the top cell, times 64, plus the position in it.
    #[inline(always)]
    fn position(&self, [x, y, z]: [u32; 3]) -> u32 {
        let top = ((z >> 2) * (self.size[1] >> 2) + (y >> 2)) * (self.size[0] >> 2) + (x >> 2);
        let low = (x & 1) | ((y & 1) << 1) | ((z & 1) << 2);
        top << 6 | low | ((x & 2) << 2) | ((y & 2) << 3) | ((z & 2) << 4)
    }

    /// [`Grid::position`] of sixteen points.
    #[inline(always)]
    pub(crate) fn positions(&self, q: &Images, at: usize, position: &mut [u32; TILE]) {
        let qx = &q.x[at..at + LANES];
        let qy = &q.y[at..at + LANES];
        let qz = &q.z[at..at + LANES];
        let position = &mut position[at..at + LANES];
        let outside = (self.top.len() as u32 - 1) << 6;
        let size = self.size.map(f64::from);
        for l in 0..LANES {
            let (x, out_x) = self.rounded(qx[l], 0, size[0]);
            let (y, out_y) = self.rounded(qy[l], 1, size[1]);
            let (z, out_z) = self.rounded(qz[l], 2, size[2]);
            let inside = self.position([x, y, z]);
            position[l] = if out_x | out_y | out_z { outside } else { inside };
        }
    }

    /// Number of the finest cell along an axis, and whether it is outside.
    #[inline(always)]
    fn rounded(&self, c: f64, axis: usize, size: f64) -> (u32, bool) {
        let c = (c - self.low[axis]) * self.per_unit;
        let out = !(c >= 0.0 && c < size);
        // Minus a half and rounded to the nearest is rounded down, or at an integer perhaps one
        // less: the widening of the cells covers that.
        let last = size - 0.75;
        let c = if c < last { c } else { last };
        let c = if c > 0.0 { c } else { 0.0 };
        ((c - 0.5 + ROUND).to_bits() as u32, out)
    }

    /// The cell at a [`Grid::position`].
    #[inline(always)]
    pub(crate) fn at(&self, position: u32) -> &Cell<I> {
        let entry = self.top[(position >> 6) as usize];
        &self.cells[((entry >> 3) + ((position & 63) >> (entry & 7))) as usize]
    }

    /// The least squared distance from `q` to a candidate of `cell` beyond those in its slots.
    #[inline(always)]
    pub(crate) fn spilled(&self, points: &[[f64; 4]], more: u32, q: [f64; 3], best: f64) -> f64 {
        let start = more as usize + 1;
        let end = start + self.spill[more as usize].at();
        let mut best = best;
        for k in &self.spill[start..end] {
            let d = squared_distance(&points[k.at()], q);
            best = if d < best { d } else { best };
        }
        best
    }
}

struct Builder<'a, I> {
    points: &'a [[f64; 4]],
    fine: Fineness,
    low: DVec3,
    edge: f64,
    tops: [u32; 3],
    margin: f64,
    shallow: bool,
    /// Comparisons of vertices so far.
    work: usize,
    rivals: Vec<Rival>,
    grid: Grid<I>,
}

impl<I: Index> Builder<'_, I> {
    /// Fills the top cells from `from` to `to` with candidates among `list`.
    fn halve(&mut self, from: [u32; 3], to: [u32; 3], list: &[u32]) {
        let corner = |c: [u32; 3]| {
            self.low + DVec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])) * self.edge
        };
        let region = Region::new(corner(from), corner(to), self.margin);
        region.filter(self.points, list, &mut self.rivals);
        self.work += list.len();
        let list: Vec<u32> = self.rivals.iter().map(|r| r.k).collect();
        let size = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
        let hopeless = size.iter().product::<u32>() <= 64 && list.len() > CROWD;
        if hopeless || self.work > WORK {
            // The entries are those of the first cell, which leaves everything to the tree.
            return;
        }
        if size == [1; 3] {
            let entry = self.divide(region, &list);
            let top = (from[2] * self.tops[1] + from[1]) * self.tops[0] + from[0];
            self.grid.top[top as usize] = entry;
            return;
        }
        let axis = if size[0] >= size[1] && size[0] >= size[2] {
            0
        } else if size[1] >= size[2] {
            1
        } else {
            2
        };
        let middle = from[axis] + size[axis] / 2;
        let (mut first_to, mut second_from) = (to, from);
        first_to[axis] = middle;
        second_from[axis] = middle;
        self.halve(from, first_to, &list);
        self.halve(second_from, to, &list);
    }

    /// The cells of one top cell: one, 8 or 64.
    fn divide(&mut self, region: Region, list: &[u32]) -> u32 {
        let whole = region.candidates(self.points, list, &mut self.rivals);
        self.work += list.len() * whole.len() + 8 * whole.len() * whole.len();
        let first = self.grid.cells.len() as u32;
        if whole.len() <= self.fine.divide_above {
            self.store(&whole);
            return first << 3 | 6;
        }
        let eighths: Vec<(Region, Vec<u32>)> = (0..8)
            .map(|k| {
                let part = region.eighth(k);
                (part, part.candidates(self.points, &whole, &mut self.rivals))
            })
            .collect();
        let enough = |list: &Vec<u32>| list.len() <= self.fine.divide_above;
        if self.shallow || eighths.iter().all(|(_, list)| enough(list)) {
            for (_, list) in &eighths {
                self.store(list);
            }
            return first << 3 | 3;
        }
        for (part, list) in &eighths {
            for k in 0..8 {
                let list = part.eighth(k).candidates(self.points, list, &mut self.rivals);
                self.store(&list);
            }
        }
        first << 3
    }

    fn store(&mut self, list: &[u32]) {
        let slot = |k: usize| I::of(list[k.min(list.len() - 1)]);
        let more = if list.len() <= SLOTS {
            0
        } else if list.len() > MOST || self.grid.spill.len() > self.fine.budget {
            TREE
        } else {
            let at = self.grid.spill.len() as u32;
            self.grid.spill.push(I::of((list.len() - SLOTS) as u32));
            self.grid.spill.extend(list[SLOTS..].iter().map(|&k| I::of(k)));
            at
        };
        self.grid.cells.push(Cell { slots: std::array::from_fn(slot), more });
    }
}

/// A box, by its centre and half its size, a little widened for the rounding of positions.
#[derive(Clone, Copy)]
struct Region {
    centre: DVec3,
    half: DVec3,
    /// By how much (half a squared distance) a vertex has to be nearer to beat another.
    margin: f64,
}

impl Region {
    fn new(low: DVec3, high: DVec3, margin: f64) -> Self {
        let (centre, half) = ((low + high) * 0.5, (high - low) * (0.5 + 1e-7));
        Self { centre, half, margin }
    }

    /// Bit 0 of `k` is the half along x, bit 1 along y, bit 2 along z.
    fn eighth(self, k: u32) -> Self {
        let side = DVec3::new(
            f64::from(2 * (k & 1)) - 1.0,
            f64::from(k & 2) - 1.0,
            f64::from((k & 4) / 2) - 1.0,
        );
        let (centre, half) = (self.centre + side * self.half * 0.5, self.half * (0.5 + 1e-7));
        Self { centre, half, ..self }
    }

    /// A vertex as seen from the centre.
    #[inline(always)]
    fn rival(&self, points: &[[f64; 4]], k: u32) -> Rival {
        let p = &points[k as usize];
        let (x, y, z) = (p[0] - self.centre.x, p[1] - self.centre.y, p[2] - self.centre.z);
        Rival { k, rank: 0.5 * (x * x + y * y + z * z), x, y, z }
    }

    /// Whether `q` is nearer than `p` throughout, by more than rounding could matter.
    #[inline(always)]
    fn beats(&self, q: &Rival, p: &Rival) -> bool {
        let (x, y, z) = ((p.x - q.x).abs(), (p.y - q.y).abs(), (p.z - q.z).abs());
        let worst = x * self.half.x + y * self.half.y + z * self.half.z;
        p.rank - q.rank - worst > self.margin
    }

    /// Those that the vertex nearest to the centre does not beat.
    fn filter(&self, points: &[[f64; 4]], list: &[u32], rivals: &mut Vec<Rival>) {
        rivals.clear();
        rivals.extend(list.iter().map(|&k| self.rival(points, k)));
        let mut champion = rivals[0];
        for rival in &*rivals {
            if rival.rank < champion.rank {
                champion = *rival;
            }
        }
        rivals.retain(|p| !self.beats(&champion, p));
    }

    /// Those that no other beats, nearest to the centre first.
    fn candidates(&self, points: &[[f64; 4]], list: &[u32], rivals: &mut Vec<Rival>) -> Vec<u32> {
        self.filter(points, list, rivals);
        rivals.sort_unstable_by(|a, b| a.rank.total_cmp(&b.rank).then(a.k.cmp(&b.k)));
        let mut kept = 0;
        for at in 0..rivals.len() {
            let p = rivals[at];
            if !rivals[..kept].iter().any(|q| self.beats(q, &p)) {
                rivals[kept] = p;
                kept += 1;
            }
        }
        rivals[..kept].iter().map(|r| r.k).collect()
    }
}

/// A vertex in the competition for a region: relative to its centre, with half its squared
/// distance from there.
#[derive(Clone, Copy)]
struct Rival {
    k: u32,
    rank: f64,
    x: f64,
    y: f64,
    z: f64,
}
