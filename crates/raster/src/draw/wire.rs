//! Lines in space under a camera: axes of a model, and the box around it.

use glam::DVec3;

use super::Segment;
use crate::camera::Intrinsics;
use crate::pose::Pose;

/// The x, y and z axis of the model from its origin, `length` metres each; an axis behind the
/// camera is missing.
#[must_use]
pub fn axes(pose: &Pose, camera: &Intrinsics, near: f64, length: f64) -> [Option<Segment>; 3] {
    let origin = pose.transform_point(DVec3::ZERO);
    [DVec3::X, DVec3::Y, DVec3::Z]
        .map(|axis| projected(camera, near, origin, pose.transform_point(length * axis)))
}

/// The edges of the box between two corners in the model frame, as far as they are in front of the
/// camera.
#[must_use]
pub fn box_edges(
    pose: &Pose,
    camera: &Intrinsics,
    near: f64,
    (low, high): (DVec3, DVec3),
) -> Vec<Segment> {
    let corner = |k: usize| {
        let pick = |bit: usize, low: f64, high: f64| if k >> bit & 1 == 1 { high } else { low };
        let p = DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z));
        pose.transform_point(p)
    };
    let edges = (0..8).flat_map(|k| (0..3).map(move |bit| (k, k | 1 << bit)));
    edges
        .filter(|(a, b)| a != b)
        .filter_map(|(a, b)| projected(camera, near, corner(a), corner(b)))
        .collect()
}

/// The image of a line, cut at the near plane.
fn projected(camera: &Intrinsics, near: f64, a: DVec3, b: DVec3) -> Option<Segment> {
    if a.z < near && b.z < near {
        return None;
    }
    let cut = |from: DVec3, to: DVec3| {
        if from.z >= near { from } else { from.lerp(to, (near - from.z) / (to.z - from.z)) }
    };
    let image =
        |p: DVec3| camera.project(DVec3::new(p.x, p.y, p.z.max(near))).map(|p| p.to_array());
    Some([image(cut(a, b))?, image(cut(b, a))?])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Intrinsics {
        Intrinsics::new(100.0, 100.0, 50.0, 40.0).expect("valid")
    }

    #[test]
    fn a_box_in_front_has_twelve_edges_and_its_size() {
        let pose = Pose { translation: DVec3::new(0.0, 0.0, 2.0), ..Pose::IDENTITY };
        let edges = box_edges(&pose, &camera(), 0.1, (DVec3::splat(-0.5), DVec3::splat(0.5)));
        assert_eq!(edges.len(), 12);
        let left = edges.iter().flatten().map(|p| p[0]).fold(f64::INFINITY, f64::min);
        assert!((left - (50.0 - 100.0 * 0.5 / 1.5)).abs() < 1e-12);
    }

    #[test]
    fn what_is_behind_the_camera_is_cut_or_missing() {
        let pose = Pose { translation: DVec3::new(0.0, 0.0, 0.2), ..Pose::IDENTITY };
        let [x, _, z] = axes(&pose, &camera(), 0.1, -0.5);
        assert!(x.is_some());
        let [_, end] = z.expect("half of it");
        assert!((end[0] - 50.0).abs() < 1e-9 && (end[1] - 40.0).abs() < 1e-9);
        let behind = Pose { translation: DVec3::new(0.0, 0.0, -3.0), ..Pose::IDENTITY };
        assert_eq!(axes(&behind, &camera(), 0.1, 1.0), [None; 3]);
        let edges = box_edges(&behind, &camera(), 0.1, (DVec3::splat(-0.5), DVec3::splat(0.5)));
        assert!(edges.is_empty());
    }
}
