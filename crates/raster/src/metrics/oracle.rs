//! What the tests of the metrics share: random scenes, and when two numbers agree.

use glam::DVec3;
use proptest::prelude::*;

use crate::pose::Pose;
use crate::rotation::from_axis_angle;

/// Agreement to 1e-12 of the value, or absolutely to `floor`.
pub(crate) fn close(a: f64, b: f64, floor: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs()) + floor
}

pub(crate) fn vector(size: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-size..size).prop_map(DVec3::from_array)
}

/// A pose about a metre and a half in front of the camera, moved by up to `shift` metres.
pub(crate) fn pose(shift: f64) -> impl Strategy<Value = Pose> {
    (vector(3.0), vector(shift))
        .prop_map(|(r, t)| Pose::new(from_axis_angle(r.to_array()).expect("finite"), t))
}

/// Points of a drone's size with repetitions, an estimate near or far, and the true pose.
pub(crate) fn scene() -> impl Strategy<Value = (Vec<DVec3>, Pose, Pose)> {
    let points = prop::collection::vec((vector(0.3), 0..4_u8), 1..200).prop_map(|list| {
        list.into_iter().flat_map(|(p, n)| vec![p; 1 + usize::from(n / 2)]).collect::<Vec<_>>()
    });
    let scale = prop::sample::select(vec![1e-6, 1e-3, 0.05, 1.0]);
    (points, pose(0.3), scale, vector(1.0), vector(1.0)).prop_map(|(points, gt, scale, r, t)| {
        let gt = Pose { translation: gt.translation + DVec3::new(0.0, 0.0, 1.5), ..gt };
        let turn = from_axis_angle((r * scale).to_array()).expect("finite");
        let est = Pose::new((gt.rotation * turn).normalize(), gt.translation + t * 0.3 * scale);
        (points, est, gt)
    })
}
