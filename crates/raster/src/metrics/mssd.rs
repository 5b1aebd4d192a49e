//! MSSD, the maximum symmetry-aware surface distance (Drost et al., ICCVW 2017; BOP 2019).

use glam::{DQuat, DVec3};

use super::add::squared;
use super::motion::{Motion, Moved, Screw, turn_minus_one};
use super::vertices::{Block, LANES, VertexSet};
use crate::pose::Pose;

/// Least over the symmetries `S` (and the identity) of the greatest over the model points of
/// `|(R_est p + t_est) - (R_gt S p + t_gt)|`, in metres.
///
/// The greatest distance is that of a vertex of the convex hull, so only hull points are visited
/// if the set knows them ([`VertexSet::with_hull`]). `symmetries` are rigid motions of the model
/// onto itself; the identity may be among them. Exactly 0 for equal poses.
#[must_use]
pub fn mssd(set: &VertexSet, est: &Pose, gt: &Pose, symmetries: &[Pose]) -> f64 {
    let moved = match Motion::between(set, est, gt) {
        // The symmetries move the model by no more than rounding at this distance.
        Motion::Far(distance) => return distance,
        Motion::Near(moved) => moved,
    };
    let mut best = greatest(set, &moved);
    // The least possible first: the others are then mostly out of the question.
    let mut rest: Vec<(f64, Moved)> = symmetries
        .iter()
        .map(|s| after(set, &moved, s))
        .map(|moved| (moved.root_mean_square(set), moved))
        .filter(|(least, _)| *least < best)
        .collect();
    rest.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (least, moved) in rest {
        if least >= best {
            break;
        }
        let here = greatest(set, &moved);
        best = if here < best { here } else { best };
    }
    best * set.unit
}

/// The motion from the pose `gt * symmetry`, given that from `gt`.
pub(crate) fn after(set: &VertexSet, moved: &Moved, symmetry: &Pose) -> Moved {
    // In the frame of `gt` a point p goes to ΔR p + t, t = d - (ΔR - I) c; seen from the frame
    // after the symmetry (R_s, t_s) it is R_sᵀ (ΔR p + t - t_s).
    let back = symmetry.rotation.conjugate();
    let turn = back * DQuat::from_xyzw(moved.v.x, moved.v.y, moved.v.z, moved.w);
    let shift: DVec3 = moved.d - turn_minus_one(moved.v, moved.w, set.centre);
    let shift = symmetry.matrix().transpose() * (shift - symmetry.translation / set.unit);
    let v = DVec3::new(turn.x, turn.y, turn.z);
    Moved { v, w: turn.w, d: shift + turn_minus_one(v, turn.w, set.centre) }
}

/// The greatest displacement of a hull point, in units.
fn greatest(set: &VertexSet, moved: &Moved) -> f64 {
    moved
        .screw(set.extent)
        .map_or(0.0, |screw| greatest_square(&set.hull, &screw).sqrt() * screw.scale)
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512vl+avx512dq+avx512bw+avx2+fma",
    "x86_64+avx2+fma"
))]
fn greatest_square(blocks: &[Block], screw: &Screw) -> f64 {
    multiversion::target::match_target! {
        "x86_64+avx2+fma" => plain::<true>(blocks, screw),
        _ => plain::<{ crate::FUSED }>(blocks, screw),
    }
}

#[inline(always)]
fn plain<const FMA: bool>(blocks: &[Block], screw: &Screw) -> f64 {
    let mut most = [0.0; LANES];
    for b in blocks {
        for l in 0..LANES {
            let s = squared::<FMA>(screw, b.x[l], b.y[l], b.z[l]);
            most[l] = if s > most[l] { s } else { most[l] };
        }
    }
    most.iter().fold(0.0, |a, &b| if b > a { b } else { a })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::metrics::oracle::{self, close};

    fn slow(points: &[DVec3], est: &Pose, gt: &Pose, symmetries: &[Pose]) -> f64 {
        let worst = |gt: &Pose| {
            let distance = |p: &DVec3| est.transform_point(*p).distance(gt.transform_point(*p));
            points.iter().map(distance).fold(0.0, f64::max)
        };
        symmetries.iter().map(|s| worst(&gt.compose(s))).fold(worst(gt), f64::min)
    }

    proptest! {
        #[test]
        fn equals_the_plain_maximum(
            (points, est, gt) in oracle::scene(),
            symmetries in prop::collection::vec(oracle::pose(0.05), 0..6),
        ) {
            let set = VertexSet::new(&points).expect("points");
            let expected = slow(&points, &est, &gt, &symmetries);
            prop_assert!(close(mssd(&set, &est, &gt, &symmetries), expected, 1e-14));
            prop_assert_eq!(mssd(&set, &gt, &gt, &symmetries), 0.0);
        }
    }

    #[test]
    fn a_symmetry_forgives_its_turn() {
        let half = Pose::new(DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0), DVec3::ZERO);
        let points = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y];
        let set = VertexSet::with_hull(&points, &[0, 1, 2, 3]).expect("points");
        let gt = Pose::new(DQuat::IDENTITY, DVec3::Z);
        let est = gt.compose(&half);
        assert!((mssd(&set, &est, &gt, &[]) - 2.0).abs() < 1e-15);
        assert!(mssd(&set, &est, &gt, &[half]) < 1e-15);
    }
}
