//! Distances of corresponding image points: MSPD, the maximum symmetry-aware projection distance
//! (BOP 2019), and the mean projection error (Brachmann et al., CVPR 2016).

use super::add::mul_add;
use super::motion::Motion;
use super::mssd::after;
use super::vertices::{Block, CountedBlock, LANES, VertexSet};
use crate::camera::Intrinsics;
use crate::pose::Pose;

/// Image distances of a pair of poses, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProjectionErrors {
    /// Least over the symmetries (and the identity) of the greatest distance of corresponding
    /// image points.
    pub mspd: f64,
    /// Mean distance of corresponding image points over all model points, without symmetries.
    pub proj: f64,
}

/// MSPD and mean projection error in pixels, over *all* model points: unlike in space, the point
/// that moves most in the image need not be a vertex of the convex hull.
///
/// A model point at or behind the camera's plane (`z <= 0`) in either pose has no image: both
/// errors are then infinite. `symmetries` as in [`super::mssd::mssd`]. Both are exactly 0 for
/// equal poses, and good to about 1e-15 of the image points' distance from the principal point.
#[must_use]
pub fn projection_errors(
    set: &VertexSet,
    est: &Pose,
    gt: &Pose,
    symmetries: &[Pose],
    camera: &Intrinsics,
) -> ProjectionErrors {
    const UNDEFINED: ProjectionErrors =
        ProjectionErrors { mspd: f64::INFINITY, proj: f64::INFINITY };
    let est_map = Map::new(set, est, camera);
    let gt_map = Map::new(set, gt, camera);
    let mut images = vec![EMPTY; set.all.len()];
    let z = project(&set.all, &est_map, &mut images);
    let compared = compare(&set.all, &images, &gt_map);
    let visible = z > 0.0 && compared.least_z > 0.0;
    if !visible {
        return UNDEFINED;
    }
    let mut best = compared.most;
    for symmetry in ordered(set, est, gt, symmetries) {
        let map = Map::new(set, &gt.compose(symmetry), camera);
        if let Some(most) = greatest_below(&set.all, &images, &map, best) {
            best = most;
        }
    }
    ProjectionErrors { mspd: best.sqrt(), proj: compared.sum / set.total() as f64 }
}

/// The symmetries, those first that leave the least distance in space.
fn ordered<'a>(set: &VertexSet, est: &Pose, gt: &Pose, symmetries: &'a [Pose]) -> Vec<&'a Pose> {
    let mut order: Vec<(f64, &Pose)> = match Motion::between(set, est, gt) {
        Motion::Far(distance) => symmetries.iter().map(|s| (distance, s)).collect(),
        Motion::Near(moved) => {
            symmetries.iter().map(|s| (after(set, &moved, s).root_mean_square(set), s)).collect()
        }
    };
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.into_iter().map(|(_, s)| s).collect()
}

/// From a point in the set's inner units to `(u z, v z, z)`, principal point left out.
struct Map {
    rows: [[f64; 4]; 3],
}

impl Map {
    fn new(set: &VertexSet, pose: &Pose, camera: &Intrinsics) -> Self {
        let turn = pose.matrix();
        let offset = pose.translation + turn * set.mean();
        let row = |k: usize| {
            let r = turn.row(k) * set.unit;
            [r.x, r.y, r.z, offset[k]]
        };
        let (x, y, z) = (row(0), row(1), row(2));
        let u = std::array::from_fn(|k| camera.fx * x[k] + camera.skew * y[k]);
        Self { rows: [u, y.map(|c| camera.fy * c), z] }
    }
}

/// Sixteen image points relative to the principal point, in pixels.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Image {
    u: [f64; LANES],
    v: [f64; LANES],
}

const EMPTY: Image = Image { u: [0.0; LANES], v: [0.0; LANES] };

struct Compared {
    /// Greatest squared distance.
    most: f64,
    /// Sum of the distances.
    sum: f64,
    /// Least depth on the side that was projected here, in metres.
    least_z: f64,
}

/// Writes the image points and gives the least depth.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn project(blocks: &[CountedBlock], map: &Map, images: &mut [Image]) -> f64 {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => project_all::<true>(blocks, map, images),
        _ => project_all::<{ crate::FUSED }>(blocks, map, images),
    }
}

/// Compares the image points of another pose.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn compare(blocks: &[CountedBlock], images: &[Image], map: &Map) -> Compared {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => compare_all::<true>(blocks, images, map),
        _ => compare_all::<{ crate::FUSED }>(blocks, images, map),
    }
}

/// The greatest squared distance if it is below `best`.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn greatest_below(blocks: &[CountedBlock], images: &[Image], map: &Map, best: f64) -> Option<f64> {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => greatest_of::<true>(blocks, images, map, best),
        _ => greatest_of::<{ crate::FUSED }>(blocks, images, map, best),
    }
}

#[inline(always)]
fn image<const FMA: bool>(map: &Map, block: &Block, image: &mut Image, z: &mut [f64; LANES]) {
    let [a, b, c] = &map.rows;
    for l in 0..LANES {
        let (x, y, d) = (block.x[l], block.y[l], block.z[l]);
        let row = |r: &[f64; 4]| {
            mul_add::<FMA>(r[0], x, mul_add::<FMA>(r[1], y, mul_add::<FMA>(r[2], d, r[3])))
        };
        let depth = row(c);
        let inverse = 1.0 / depth;
        image.u[l] = row(a) * inverse;
        image.v[l] = row(b) * inverse;
        z[l] = if z[l] < depth { z[l] } else { depth };
    }
}

#[inline(always)]
fn least(z: &[f64; LANES]) -> f64 {
    z.iter().fold(f64::INFINITY, |a, &b| if a < b { a } else { b })
}

#[inline(always)]
fn project_all<const FMA: bool>(blocks: &[CountedBlock], map: &Map, images: &mut [Image]) -> f64 {
    let mut z = [f64::INFINITY; LANES];
    for (block, out) in blocks.iter().zip(images) {
        image::<FMA>(map, &block.points, out, &mut z);
    }
    least(&z)
}

#[inline(always)]
fn compare_all<const FMA: bool>(blocks: &[CountedBlock], images: &[Image], map: &Map) -> Compared {
    let mut z = [f64::INFINITY; LANES];
    let (mut most, mut sum) = ([0.0; LANES], [0.0; LANES]);
    for (block, there) in blocks.iter().zip(images) {
        let mut here = EMPTY;
        image::<FMA>(map, &block.points, &mut here, &mut z);
        for l in 0..LANES {
            let (u, v) = (here.u[l] - there.u[l], here.v[l] - there.v[l]);
            let s = mul_add::<FMA>(u, u, v * v);
            most[l] = if s > most[l] { s } else { most[l] };
            sum[l] = mul_add::<FMA>(s.sqrt(), block.count[l], sum[l]);
        }
    }
    let most = most.iter().fold(0.0, |a, &b| if b > a { b } else { a });
    Compared { most, sum: sum.iter().sum(), least_z: least(&z) }
}

#[inline(always)]
fn greatest_of<const FMA: bool>(
    blocks: &[CountedBlock],
    images: &[Image],
    map: &Map,
    best: f64,
) -> Option<f64> {
    let mut z = [f64::INFINITY; LANES];
    let mut most = [0.0; LANES];
    for (blocks, images) in blocks.chunks(8).zip(images.chunks(8)) {
        for (block, there) in blocks.iter().zip(images) {
            let mut here = EMPTY;
            image::<FMA>(map, &block.points, &mut here, &mut z);
            for l in 0..LANES {
                let (u, v) = (here.u[l] - there.u[l], here.v[l] - there.v[l]);
                let s = mul_add::<FMA>(u, u, v * v);
                most[l] = if s > most[l] { s } else { most[l] };
            }
        }
        let visible = least(&z) > 0.0;
        if !visible || most.iter().any(|&s| s >= best) {
            return None;
        }
    }
    Some(most.iter().fold(0.0, |a, &b| if b > a { b } else { a }))
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    use super::*;
    use crate::metrics::oracle::{self, close};

    fn slow(
        points: &[DVec3],
        est: &Pose,
        gt: &Pose,
        symmetries: &[Pose],
        camera: &Intrinsics,
    ) -> Option<ProjectionErrors> {
        let distances = |gt: &Pose| -> Option<Vec<f64>> {
            let pixel = |pose: &Pose, p: &DVec3| camera.project(pose.transform_point(*p));
            points.iter().map(|p| Some(pixel(est, p)?.distance(pixel(gt, p)?))).collect()
        };
        let plain = distances(gt)?;
        let greatest = |list: &[f64]| list.iter().copied().fold(0.0, f64::max);
        let mut mspd = greatest(&plain);
        for s in symmetries {
            mspd = mspd.min(distances(&gt.compose(s)).map_or(f64::INFINITY, |d| greatest(&d)));
        }
        Some(ProjectionErrors { mspd, proj: plain.iter().sum::<f64>() / plain.len() as f64 })
    }

    fn camera() -> Intrinsics {
        Intrinsics { skew: 0.7, ..Intrinsics::new(500.0, 480.0, 160.0, 120.0).expect("valid") }
    }

    proptest! {
        #[test]
        fn equals_the_plain_loops(
            (points, est, gt) in oracle::scene(),
            symmetries in prop::collection::vec(oracle::pose(0.05), 0..6),
        ) {
            let set = VertexSet::new(&points).expect("points");
            let fast = projection_errors(&set, &est, &gt, &symmetries, &camera());
            if let Some(slow) = slow(&points, &est, &gt, &symmetries, &camera()) {
                // The image points are hundreds of pixels from the principal point.
                prop_assert!(close(fast.mspd, slow.mspd, 2e-11), "{fast:?} {slow:?}");
                prop_assert!(close(fast.proj, slow.proj, 2e-11), "{fast:?} {slow:?}");
            } else {
                prop_assert_eq!(fast.mspd, f64::INFINITY);
            }
            let same = projection_errors(&set, &gt, &gt, &symmetries, &camera());
            prop_assert!(same.mspd == 0.0 && same.proj == 0.0 || same.mspd.is_infinite());
        }
    }

    #[test]
    fn a_point_behind_the_camera_has_no_image() {
        let set = VertexSet::new(&[DVec3::ZERO, DVec3::Z]).expect("points");
        let at = |z: f64| Pose::new(DQuat::IDENTITY, DVec3::new(0.1, 0.0, z));
        for (est, gt) in [(at(1.0), at(-0.5)), (at(-0.5), at(1.0)), (at(0.0), at(1.0))] {
            let errors = projection_errors(&set, &est, &gt, &[], &camera());
            assert_eq!((errors.mspd, errors.proj), (f64::INFINITY, f64::INFINITY));
        }
    }

    #[test]
    fn the_mean_counts_every_point_given() {
        let (near, off) = (DVec3::ZERO, DVec3::new(0.0, 0.0, 1.0));
        let set = VertexSet::new(&[near, near, near, off]).expect("points");
        let gt = Pose::new(DQuat::IDENTITY, DVec3::Z);
        let est = Pose::new(DQuat::IDENTITY, DVec3::new(0.01, 0.0, 1.0));
        let errors = projection_errors(&set, &est, &gt, &[], &camera());
        assert!((errors.proj - (3.0 * 5.0 + 2.5) / 4.0).abs() < 1e-12);
        assert!((errors.mspd - 5.0).abs() < 1e-12);
    }
}
