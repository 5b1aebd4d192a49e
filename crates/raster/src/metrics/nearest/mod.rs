//! Which vertex of a fixed set is nearest to a point: built once per mesh, asked millions of times.
//!
//! Around the vertices lies a grid whose cells list every vertex that is nearest to *some* point
//! of the cell ([`grid`]), then a coarser and larger one, and for what neither answers a tree of
//! bounding boxes ([`tree`]). All three give the same vertex as comparing with every vertex, to
//! the last bit of the squared distance.

pub(crate) mod grid;
pub(crate) mod tree;

use glam::DVec3;

use self::grid::Grid;
use self::tree::Tree;
use super::vertices::{Block, CountedBlock, LANES};

/// Number of distinct vertices up to which cells hold 16-bit indices.
const SHORT: usize = 1 << 16;

/// Index structure over the distinct vertices of a [`super::VertexSet`].
#[derive(Debug)]
pub struct NearestVertex {
    /// Distinct vertices along a space-filling curve, in the set's inner units, with how often
    /// each occurs.
    pub(crate) points: Vec<[f64; 4]>,
    /// The same, sixteen at a time.
    pub(crate) blocks: Vec<CountedBlock>,
    pub(crate) grids: Grids,
    pub(crate) tree: Tree,
}

/// The two grids, with indices as wide as the number of vertices asks for.
#[derive(Debug)]
pub(crate) enum Grids {
    Short(Box<[Grid<u16>; 2]>),
    Long(Box<[Grid<u32>; 2]>),
}

impl NearestVertex {
    /// From distinct points and their numbers of occurrences.
    pub(crate) fn new(points: &[DVec3], counts: &[u32]) -> Self {
        let (low, high) = points
            .iter()
            .fold((points[0], points[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        let mut order: Vec<usize> = (0..points.len()).collect();
        let size = (high - low).max_element().max(f64::MIN_POSITIVE);
        order.sort_by_cached_key(|&k| curve((points[k] - low) / size));
        let points: Vec<[f64; 4]> = order
            .iter()
            .map(|&k| {
                let p = points[k];
                [p.x, p.y, p.z, f64::from(counts[k])]
            })
            .collect();
        let diagonal = (high - low).length();
        let near = (low - 0.08 * diagonal, high + 0.08 * diagonal);
        let far = (low - diagonal, high + diagonal);
        let grids = if points.len() <= SHORT {
            Grids::Short(Box::new([
                Grid::new(&points, near, grid::NEAR),
                Grid::new(&points, far, grid::FAR),
            ]))
        } else {
            Grids::Long(Box::new([
                Grid::new(&points, near, grid::NEAR),
                Grid::new(&points, far, grid::FAR),
            ]))
        };
        let tree = Tree::new(&points);
        let blocks = points
            .chunks(LANES)
            .map(|chunk| {
                let at = |l: usize, k: usize| chunk[l.min(chunk.len() - 1)][k];
                CountedBlock {
                    points: Block {
                        x: std::array::from_fn(|l| at(l, 0)),
                        y: std::array::from_fn(|l| at(l, 1)),
                        z: std::array::from_fn(|l| at(l, 2)),
                    },
                    count: std::array::from_fn(|l| chunk.get(l).map_or(0.0, |p| p[3])),
                }
            })
            .collect();
        Self { points, blocks, grids, tree }
    }

    /// Memory held, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let grids = match &self.grids {
            Grids::Short(grids) => grids.iter().map(Grid::bytes).sum::<usize>(),
            Grids::Long(grids) => grids.iter().map(Grid::bytes).sum::<usize>(),
        };
        grids + self.tree.bytes() + self.points.len() * size_of::<[f64; 4]>()
    }
}

/// Squared distance, in the one order of operations that all searches use.
#[inline(always)]
pub(crate) fn squared_distance(p: &[f64; 4], q: [f64; 3]) -> f64 {
    let (x, y, z) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
    x * x + y * y + z * z
}

/// Position on the Morton curve of a point of the unit cube.
fn curve(p: DVec3) -> u64 {
    let spread = |c: f64| {
        let mut bits = (c * 2_097_151.0) as u64 & 0x1f_ffff;
        for (shift, mask) in [
            (32, 0x001f_0000_0000_ffff),
            (16, 0x001f_0000_ff00_00ff),
            (8, 0x100f_00f0_0f00_f00f),
            (4, 0x10c3_0c30_c30c_30c3),
            (2, 0x1249_2492_4924_9249),
        ] {
            bits = (bits | (bits << shift)) & mask;
        }
        bits
    };
    spread(p.x) | (spread(p.y) << 1) | (spread(p.z) << 2)
}
