//! ADD-S (also ADI), the mean distance to the nearest model point, for symmetric objects
//! (Hinterstoisser et al., ACCV 2012).

use glam::DVec3;

use super::motion::{Motion, Moved, turn_minus_one};
use super::nearest::grid::{Grid, Images, Index, OUTSIDE, TILE};
use super::nearest::{Grids, NearestVertex, squared_distance};
use super::vertices::{Block, LANES, VertexSet};
use crate::pose::Pose;

/// Mean over all model points, moved by the true pose, of the distance to the nearest model point
/// moved by the estimated pose, in metres.
///
/// That is the direction of BOP, YCB-Video and GDR-Net; it is not symmetric in the two poses. The
/// nearest point is exactly that, and the distance good to about 1e-16 of the model's size;
/// exactly 0 for equal poses. The structure that finds it is built on first use
/// ([`VertexSet::nearest`]).
#[must_use]
pub fn adds(set: &VertexSet, est: &Pose, gt: &Pose) -> f64 {
    // A point of the true pose in the model frame of the estimate.
    match Motion::between(set, gt, est) {
        Motion::Far(distance) => distance,
        Motion::Near(moved) => {
            let nearest = set.nearest();
            let map = Map::new(&moved);
            let sum = match &nearest.grids {
                Grids::Short(grids) => sum_short(nearest, grids, &map),
                Grids::Long(grids) => sum_long(nearest, grids, &map),
            };
            sum / set.total() as f64 * set.unit
        }
    }
}

/// `q = p + (A p + d)`, with exact zeros in `A` and `d` for equal poses.
struct Map {
    rows: [[f64; 4]; 3],
}

impl Map {
    fn new(moved: &Moved) -> Self {
        let column = |axis| turn_minus_one(moved.v, moved.w, axis).to_array();
        let (x, y, z) = (column(DVec3::X), column(DVec3::Y), column(DVec3::Z));
        let d = moved.d.to_array();
        Self { rows: std::array::from_fn(|k| [x[k], y[k], z[k], d[k]]) }
    }
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn sum_short(nearest: &NearestVertex, grids: &[Grid<u16>; 2], map: &Map) -> f64 {
    sum(nearest, grids, map)
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn sum_long(nearest: &NearestVertex, grids: &[Grid<u32>; 2], map: &Map) -> f64 {
    sum(nearest, grids, map)
}

/// Sum over all points of the distance to the nearest.
#[inline(always)]
fn sum<I: Index>(nearest: &NearestVertex, [near, far]: &[Grid<I>; 2], map: &Map) -> f64 {
    let points = &nearest.points[..];
    let mut q = Images { x: [0.0; TILE], y: [0.0; TILE], z: [0.0; TILE] };
    let mut position = [0_u32; TILE];
    let mut square = [0.0; TILE];
    let mut open = [(0_u16, 0_u32); TILE];
    let mut lanes = [0.0; LANES];
    for (tile, points_of_tile) in nearest.blocks.chunks(TILE / LANES).zip(points.chunks(TILE)) {
        for (b, block) in tile.iter().enumerate() {
            image(map, &block.points, &mut q, b * LANES);
            near.positions(&q, b * LANES, &mut position);
        }
        let mut opens = 0;
        let size = points_of_tile.len();
        for k in 0..size {
            let cell = near.at(position[k]);
            let at = [q.x[k], q.y[k], q.z[k]];
            let mut best = f64::INFINITY;
            for s in cell.slots {
                let d = squared_distance(&points[s.at()], at);
                best = if d < best { d } else { best };
            }
            square[k] = best;
            open[opens] = (k as u16, cell.more);
            opens += usize::from(cell.more != 0);
        }
        for &(k, more) in &open[..opens] {
            let k = usize::from(k);
            let at = [q.x[k], q.y[k], q.z[k]];
            square[k] = if more < OUTSIDE {
                near.spilled(points, more, at, square[k])
            } else {
                elsewhere(nearest, far, at, &points_of_tile[k])
            };
        }
        for (b, block) in tile.iter().enumerate() {
            for l in 0..LANES {
                lanes[l] += square[b * LANES + l].sqrt() * block.count[l];
            }
        }
    }
    lanes.iter().sum()
}

/// The images of sixteen points.
#[inline(always)]
fn image(map: &Map, block: &Block, q: &mut Images, at: usize) {
    let [a, b, c] = &map.rows;
    let Block { x, y, z } = block;
    let qx = &mut q.x[at..at + LANES];
    let qy = &mut q.y[at..at + LANES];
    let qz = &mut q.z[at..at + LANES];
    for l in 0..LANES {
        qx[l] = x[l] + (a[0] * x[l] + a[1] * y[l] + a[2] * z[l] + a[3]);
        qy[l] = y[l] + (b[0] * x[l] + b[1] * y[l] + b[2] * z[l] + b[3]);
        qz[l] = z[l] + (c[0] * x[l] + c[1] * y[l] + c[2] * z[l] + c[3]);
    }
}

/// The least squared distance from a point that is outside of the near grid.
#[inline(never)]
fn elsewhere<I: Index>(
    nearest: &NearestVertex,
    far: &Grid<I>,
    q: [f64; 3],
    seed: &[f64; 4],
) -> f64 {
    let points = &nearest.points[..];
    let cell = far.cell(q);
    if cell.more < OUTSIDE {
        let mut best = f64::INFINITY;
        for s in cell.slots {
            let d = squared_distance(&points[s.at()], q);
            best = if d < best { d } else { best };
        }
        return if cell.more == 0 { best } else { far.spilled(points, cell.more, q, best) };
    }
    nearest.tree.nearest(points, q, squared_distance(seed, q))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::metrics::oracle::{self, close};

    fn slow(points: &[DVec3], est: &Pose, gt: &Pose) -> f64 {
        let there: Vec<DVec3> = points.iter().map(|p| est.transform_point(*p)).collect();
        let nearest = |p: &DVec3| {
            let q = gt.transform_point(*p);
            there.iter().map(|e| e.distance_squared(q)).fold(f64::INFINITY, f64::min).sqrt()
        };
        points.iter().map(nearest).sum::<f64>() / points.len() as f64
    }

    proptest! {
        #[test]
        fn equals_the_comparison_of_all_pairs((points, est, gt) in oracle::scene()) {
            let set = VertexSet::new(&points).expect("points");
            prop_assert!(close(adds(&set, &est, &gt), slow(&points, &est, &gt), 2e-15));
            prop_assert_eq!(adds(&set, &gt, &gt), 0.0);
        }
    }

    #[test]
    fn flat_long_and_single_models_work() {
        let line: Vec<DVec3> = (0..50).map(|k| DVec3::X * f64::from(k)).collect();
        let plane: Vec<DVec3> =
            (0..64).map(|k| DVec3::new(f64::from(k % 8), f64::from(k / 8), 0.0)).collect();
        let gt = Pose::new(glam::DQuat::IDENTITY, DVec3::Z * 100.0);
        let turn = glam::DQuat::from_rotation_y(0.3);
        for points in [line, plane, vec![DVec3::ONE], vec![DVec3::ZERO; 3]] {
            let set = VertexSet::new(&points).expect("points");
            for shift in [0.0, 0.4, 30.0, 1e6] {
                let est = Pose::new(turn, DVec3::new(shift, -shift, 100.0));
                let expected = slow(&points, &est, &gt);
                assert!(close(adds(&set, &est, &gt), expected, 1e-13), "{shift}");
            }
        }
    }

    #[test]
    fn the_way_goes_from_the_true_pose_to_the_estimate() {
        // Two points far apart against one: from the pair both distances count.
        let set = VertexSet::new(&[DVec3::ZERO, DVec3::X]).expect("points");
        let est = Pose::new(glam::DQuat::from_rotation_z(1.0), DVec3::ZERO);
        let far = 2.0 * 0.5_f64.sin();
        assert!((adds(&set, &est, &Pose::IDENTITY) - 0.5 * far).abs() < 1e-15);
    }

    #[test]
    fn extreme_numbers_make_no_nan() {
        let all = [0.0, 5e-324, 1e-200, 1.0, 1e200, f64::MAX];
        for a in all {
            let points = [DVec3::new(a, 0.0, -a), DVec3::new(-a, a / 3.0, 0.0), DVec3::ZERO];
            let set = VertexSet::new(&points).expect("points");
            for t in all {
                let est = Pose::new(glam::DQuat::from_rotation_x(0.5), DVec3::new(t, -t, t / 7.0));
                let value = adds(&set, &est, &Pose::IDENTITY);
                assert!(value >= 0.0, "{a} {t}: {value}");
            }
        }
    }
}
