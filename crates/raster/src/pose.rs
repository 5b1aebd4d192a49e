//! A rigid pose, `cam_from_model`.

use glam::{DMat3, DQuat, DVec3};

/// `p_cam = R p_model + t`: OpenCV camera (x right, y down, z forward), metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// `R` as a unit quaternion.
    pub rotation: DQuat,
    /// `t`, in metres.
    pub translation: DVec3,
}

impl Pose {
    /// The pose that moves nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// From a unit quaternion and a translation in metres.
    #[must_use]
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        Self { rotation, translation }
    }

    /// `R` as a matrix.
    #[must_use]
    pub fn matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// A point of the model in the camera frame.
    #[must_use]
    pub fn transform_point(&self, p_model: DVec3) -> DVec3 {
        self.matrix() * p_model + self.translation
    }

    /// `self * other`: first `other`, then `self`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            rotation: (self.rotation * other.rotation).normalize(),
            translation: self.matrix() * other.translation + self.translation,
        }
    }

    /// `model_from_cam`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self {
            rotation: self.rotation.conjugate(),
            translation: -(self.matrix().transpose() * self.translation),
        }
    }

    /// Unit vector from the model's origin to the camera, in the model frame: where the model is
    /// seen from. `None` if the two coincide.
    #[must_use]
    pub fn viewing_direction(&self) -> Option<DVec3> {
        (-(self.matrix().transpose() * self.translation)).try_normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_times_its_inverse_is_the_identity() {
        let q = crate::rotation::from_axis_angle([0.3, -1.0, 0.4]).expect("finite");
        let pose = Pose::new(q, DVec3::new(1.0, -2.0, 3.0));
        let identity = pose.compose(&pose.inverse());
        assert!(identity.translation.length() < 1e-15);
        assert!(crate::rotation::angle(identity.rotation, DQuat::IDENTITY) < 1e-15);
        let p = DVec3::new(0.1, 0.2, 0.3);
        assert!(pose.inverse().transform_point(pose.transform_point(p)).distance(p) < 1e-15);
    }

    #[test]
    fn a_model_in_front_of_the_camera_is_seen_from_its_minus_z() {
        let pose = Pose::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, 2.0));
        assert_eq!(pose.viewing_direction(), Some(-DVec3::Z));
        assert_eq!(Pose::IDENTITY.viewing_direction(), None);
    }
}
