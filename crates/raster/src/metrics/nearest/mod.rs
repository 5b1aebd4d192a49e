//! Which vertex of a fixed set is nearest to a point: built once per mesh, asked millions of times.
//!
//! Around the vertices lies a grid whose cells list every vertex that is nearest to *some* point
//! of the cell (`grid`), then a coarser and larger one, and for what neither answers a tree of
//! bounding boxes (`tree`). All three give the same vertex as comparing with every vertex, to
//! the last bit of the squared distance.

pub(crate) mod grid;
pub(crate) mod tree;

use glam::DVec3;

use self::grid::{Corners, Grid, Index};
use self::tree::Tree;
use super::vertices::{CountedBlock, counted};

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
        let (points, counts): (Vec<DVec3>, Vec<u32>) =
            order.iter().map(|&k| (points[k], counts[k])).unzip();
        let blocks = counted(&points, &counts);
        let points: Vec<[f64; 4]> =
            points.iter().zip(&counts).map(|(p, &n)| [p.x, p.y, p.z, f64::from(n)]).collect();
        let diagonal = (high - low).length();
        let near = (low - 0.08 * diagonal, high + 0.08 * diagonal);
        let far = (low - diagonal, high + diagonal);
        let grids = if points.len() <= SHORT {
            Grids::Short(Box::new(both(&points, near, far)))
        } else {
            Grids::Long(Box::new(both(&points, near, far)))
        };
        let tree = Tree::new(&points);
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

/// The near and the far grid, on a thread each. (Not in rayon's pool: a worker that waits there
/// may take up a task that asks for this very structure.)
fn both<I: Index>(points: &[[f64; 4]], near: Corners, far: Corners) -> [Grid<I>; 2] {
    if points.len() < 64 {
        return [Grid::new(points, near, grid::NEAR), Grid::new(points, far, grid::FAR)];
    }
    std::thread::scope(|scope| {
        let far_one = || Grid::new(points, far, grid::FAR);
        let other = std::thread::Builder::new().spawn_scoped(scope, far_one);
        let near = Grid::new(points, near, grid::NEAR);
        // A thread that could not be had, or did not end well: the work is done here.
        [near, other.ok().and_then(|t| t.join().ok()).unwrap_or_else(far_one)]
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::VertexSet;

    fn noise(seed: &mut u64) -> f64 {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn check<I: Index>(nearest: &NearestVertex, grids: &[Grid<I>; 2], q: [f64; 3]) {
        let points = &nearest.points[..];
        let all = points.iter().map(|p| squared_distance(p, q)).fold(f64::INFINITY, f64::min);
        let seed = squared_distance(&points[0], q);
        assert_eq!(nearest.tree.nearest(points, q, seed), all, "tree {q:?}");
        for grid in grids {
            let cell = grid.cell(q);
            if cell.more >= grid::OUTSIDE {
                continue;
            }
            let mut best = f64::INFINITY;
            for k in cell.slots {
                best = best.min(squared_distance(&points[k.at()], q));
            }
            if cell.more != 0 {
                best = grid.spilled(points, cell.more, q, best);
            }
            assert_eq!(best, all, "grid {q:?}");
        }
    }

    fn check_set(points: &[DVec3], queries: usize, seed: u64) {
        let set = VertexSet::new(points).expect("points");
        let nearest = set.nearest();
        let mut seed = seed;
        for k in 0..queries {
            let reach = [0.5, 1.0, 2.0, 5.0, 50.0][k % 5];
            let mut q = [(); 3].map(|()| noise(&mut seed) * reach);
            if k % 3 == 0 {
                // On a vertex, and on the border of a cell.
                let p = nearest.points[k % nearest.points.len()];
                q = [p[0], p[1], p[2]];
            }
            match &nearest.grids {
                Grids::Short(grids) => check(nearest, grids, q),
                Grids::Long(grids) => check(nearest, grids, q),
            }
        }
    }

    #[test]
    fn each_search_finds_the_nearest_to_the_last_bit() {
        let mut seed = 1;
        for n in [1, 2, 17, 400, 3000] {
            let points: Vec<DVec3> = (0..n)
                .map(|_| DVec3::new(noise(&mut seed), noise(&mut seed), 0.4 * noise(&mut seed)))
                .collect();
            check_set(&points, 500, seed);
        }
    }

    #[test]
    fn ties_and_spheres_are_no_trouble() {
        let lattice: Vec<DVec3> = (0..1000_u32)
            .map(|k| {
                DVec3::new(f64::from(k % 10), f64::from(k / 10 % 10), f64::from(k / 100)) * 0.1
            })
            .collect();
        check_set(&lattice, 1000, 2);
        // Every vertex is nearest to some point about the centre.
        let mut seed = 3;
        let sphere: Vec<DVec3> = (0..2000)
            .map(|_| DVec3::new(noise(&mut seed), noise(&mut seed), noise(&mut seed)).normalize())
            .collect();
        check_set(&sphere, 1000, 3);
        let line: Vec<DVec3> = (0..100).map(|k| DVec3::X * f64::from(k)).collect();
        check_set(&line, 1000, 4);
    }

    #[test]
    #[ignore = "some seconds; for the release build"]
    fn a_hundred_thousand_vertices_stay_small() {
        let mut seed = 5;
        for kind in 0..3 {
            let points: Vec<DVec3> = (0..100_000)
                .map(|_| {
                    let p = DVec3::new(noise(&mut seed), noise(&mut seed), noise(&mut seed));
                    match kind {
                        0 => p,
                        1 => p.normalize() * 0.999,
                        _ => DVec3::new(p.x, p.y, 0.1 * (3.0 * p.x).sin()),
                    }
                })
                .collect();
            let set = VertexSet::new(&points).expect("points");
            let bytes = set.nearest().bytes();
            assert!(bytes < 100_000_000, "{kind}: {bytes} bytes");
            check_set(&points, 200, seed);
        }
    }
}
