//! The rules that choose samples, one function each: DronePose, section 3 (Dataset).
//!
//! The numbers that the paper does not give (motion, cubes, border) are settings with defaults of
//! our own.

use glam::{DMat3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::Pose;
use crate::camera::Intrinsics;
use crate::error::{Error, Result};
use crate::random::{generator, unit};
use crate::rotation;
use crate::synth::axes::Axes;
use crate::synth::flight::positive;

/// How the two limits of the ego-motion rule go together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Motion {
    /// A move or a turn is enough.
    Any,
    /// It takes a move and a turn.
    All,
}

/// A pinhole camera, as six numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Pixels.
    pub fx: f64,
    /// Pixels.
    pub fy: f64,
    /// Pixels.
    pub cx: f64,
    /// Pixels.
    pub cy: f64,
    /// Shear of u with y, in pixels.
    pub skew: f64,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Settings of all rules.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// Seed of the run.
    pub seed: u64,
    /// What the ids begin with.
    pub prefix: String,
    /// Least distance of drone and anchor, metres (0.8 in the paper).
    pub min_distance_m: f64,
    /// Largest distance of drone and anchor, metres (1.5 in the paper).
    pub max_distance_m: f64,
    /// Frames from t to t + 1.
    pub stride: u32,
    /// A shorter move to a neighbour is limited, metres.
    pub min_move_m: f64,
    /// A smaller turn to a neighbour is limited, degrees.
    pub min_turn_deg: f64,
    /// A longer move to a neighbour is refused, metres.
    pub max_move_m: f64,
    /// A larger turn to a neighbour is refused, degrees.
    pub max_turn_deg: f64,
    /// Whether one of the two is enough.
    pub motion: Motion,
    /// Edge of the cube around the anchor in which the view's origin is drawn, metres.
    pub anchor_cube_m: f64,
    /// Edge of the cube around the drone in which the point that is looked at is drawn, metres.
    pub drone_cube_m: f64,
    /// Share of the width and of the height, at each edge of the image, where the drone's centroid
    /// may not be.
    pub border: f64,
    /// The exocentric camera.
    pub exo: Camera,
    /// The drone's camera looks forward, and down by so many degrees.
    pub ego_down_deg: f64,
    /// Where the drone's camera is in the body frame, metres.
    pub ego_offset_m: [f64; 3],
    /// Which way the axes of the drone's mesh point.
    pub model_axes: Axes,
    /// The drone's centroid in the frame of its mesh, metres.
    pub centroid_m: [f64; 3],
    /// Two corners of the box of the drone's mesh, in its frame, metres: asks for the rule `whole`.
    pub whole_box_m: Option<[[f64; 3]; 2]>,
}

impl Default for Rules {
    fn default() -> Self {
        // 64.69 degrees from left to right, 320x240 (supplement, Dataset).
        let f = 160.0 / (0.5 * 64.69_f64).to_radians().tan();
        Self {
            seed: 0,
            prefix: String::new(),
            min_distance_m: 0.8,
            max_distance_m: 1.5,
            stride: 1,
            min_move_m: 0.01,
            min_turn_deg: 0.5,
            max_move_m: 0.5,
            max_turn_deg: 20.0,
            motion: Motion::Any,
            anchor_cube_m: 0.5,
            drone_cube_m: 0.6,
            border: 0.25,
            exo: Camera { fx: f, fy: f, cx: 160.0, cy: 120.0, skew: 0.0, width: 320, height: 240 },
            ego_down_deg: 0.0,
            ego_offset_m: [0.0; 3],
            model_axes: Axes::FLU,
            centroid_m: [0.0; 3],
            whole_box_m: None,
        }
    }
}

impl Rules {
    /// The exocentric camera, checked, and everything else too.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the setting.
    pub fn check(&self) -> Result<Intrinsics> {
        for (name, value) in [
            ("min_distance_m", self.min_distance_m),
            ("min_move_m", self.min_move_m),
            ("min_turn_deg", self.min_turn_deg),
            ("anchor_cube_m", self.anchor_cube_m),
            ("drone_cube_m", self.drone_cube_m),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::argument(name, format!("found {value}, expected 0 or more")));
            }
        }
        for (name, value) in [
            ("max_distance_m", self.max_distance_m),
            ("max_move_m", self.max_move_m),
            ("max_turn_deg", self.max_turn_deg),
        ] {
            positive(name, value)?;
        }
        for (name, low, high) in [
            ("distance_m", self.min_distance_m, self.max_distance_m),
            ("move_m", self.min_move_m, self.max_move_m),
            ("turn_deg", self.min_turn_deg, self.max_turn_deg),
        ] {
            if low > high {
                let text = format!("the least, {low}, is above the largest, {high}");
                return Err(Error::argument(name, text));
            }
        }
        if self.stride == 0 {
            return Err(Error::argument("stride", "found 0, expected 1 or more frames"));
        }
        if !(0.0..0.5).contains(&self.border) {
            let text = format!("found {}, expected a share of the image in [0, 0.5)", self.border);
            return Err(Error::argument("border", text));
        }
        if self.whole_box_m.iter().flatten().flatten().any(|x| !x.is_finite()) {
            return Err(Error::argument("whole_box_m", "expected finite corners"));
        }
        let numbers = [self.ego_down_deg].into_iter().chain(self.ego_offset_m);
        if numbers.chain(self.centroid_m).any(|x| !x.is_finite()) {
            return Err(Error::argument("ego_down_deg, ego_offset_m, centroid_m", "not finite"));
        }
        if !self.model_axes.right_handed() {
            let axes = String::from(self.model_axes);
            return Err(Error::argument("model_axes", format!("'{axes}' are left-handed")));
        }
        let c = self.exo;
        let rows = [[c.fx, c.skew, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]];
        if c.width == 0 || c.height == 0 {
            return Err(Error::argument("exo", "an image without pixels"));
        }
        Ok(Intrinsics::from_matrix(rows)?.with_size(c.width, c.height))
    }

    /// `body_from_cam` of the drone's camera, whose axes are `OpenCV`'s.
    #[must_use]
    pub fn ego_mount(&self) -> Pose {
        let forward = DMat3::from_cols(-DVec3::Y, -DVec3::Z, DVec3::X);
        let down = DMat3::from_rotation_y(self.ego_down_deg.to_radians());
        let rotation = DQuat::from_mat3(&(down * forward)).normalize();
        Pose::new(rotation, DVec3::from_array(self.ego_offset_m))
    }

    /// `body_from_model`.
    #[must_use]
    pub fn body_from_model(&self) -> Pose {
        Pose::new(DQuat::from_mat3(&self.model_axes.matrix()).normalize(), DVec3::ZERO)
    }
}

/// Rule `anchor`: the nearest anchor, its distance, and whether others are as near. Of several the
/// first in the file is taken. `None` without anchors.
#[must_use]
pub fn nearest_anchor(p: DVec3, anchors: &[DVec3]) -> Option<(usize, f64, bool)> {
    let mut best = (0, p.distance_squared(*anchors.first()?), false);
    for (k, anchor) in anchors.iter().enumerate().skip(1) {
        let d = p.distance_squared(*anchor);
        if d < best.1 {
            best = (k, d, false);
        } else if d.to_bits() == best.1.to_bits() {
            best.2 = true;
        }
    }
    Some((best.0, best.1.sqrt(), best.2))
}

/// How far a pose is from a neighbour in time: metres and degrees.
#[must_use]
pub fn motion(a: &Pose, b: &Pose) -> (f64, f64) {
    let turn = rotation::angle(a.rotation, b.rotation).to_degrees();
    (a.translation.distance(b.translation), turn)
}

/// Rule `ego-motion`, against one neighbour: not too little of both (or of either, for
/// [`Motion::All`]), not too much of either.
#[must_use]
pub fn moves_enough(rules: &Rules, (distance, turn): (f64, f64)) -> bool {
    let (moves, turns) = (distance >= rules.min_move_m, turn >= rules.min_turn_deg);
    let enough = match rules.motion {
        Motion::Any => moves || turns,
        Motion::All => moves && turns,
    };
    enough && distance <= rules.max_move_m && turn <= rules.max_turn_deg
}

/// Rule `look-at`: where the view of frame `frame` is taken from and what it looks at, uniform in
/// cubes along the axes around anchor and drone. The draw depends on seed and frame alone.
#[must_use]
pub fn draw_view(rules: &Rules, frame: i64, anchor: DVec3, drone: DVec3) -> (DVec3, DVec3) {
    let mut rng = generator(rules.seed, frame.cast_unsigned());
    let mut cube = |edge: f64| {
        // One after the other: x, y, z.
        let [x, y, z] = [(); 3].map(|()| (unit(&mut rng) - 0.5) * edge);
        DVec3::new(x, y, z)
    };
    let eye = anchor + cube(rules.anchor_cube_m);
    let target = drone + cube(rules.drone_cube_m);
    (eye, target)
}

/// `cam_from_world` of a camera at `eye` that looks at `target` without roll: its x axis is level,
/// its y axis points down. `None` where that is undefined: from a point to itself, or straight up
/// or down.
#[must_use]
pub fn look_at(eye: DVec3, target: DVec3) -> Option<Pose> {
    let z = (target - eye).try_normalize()?;
    let right = z.cross(DVec3::Z);
    if right.length() < 1e-6 {
        return None;
    }
    let x = right.normalize();
    let world_from_cam = DMat3::from_cols(x, z.cross(x), z);
    let rotation = DQuat::from_mat3(&world_from_cam).normalize();
    Some(Pose::new(rotation, eye).inverse())
}

/// Rule `border`: the image point of the drone's centroid, if it is in front of the camera and not
/// near the border of the image.
#[must_use]
pub fn inside(
    camera: &Intrinsics,
    border: f64,
    cam_from_model: &Pose,
    centroid: DVec3,
) -> Option<DVec2> {
    let uv = camera.project(cam_from_model.transform_point(centroid))?;
    let size = DVec2::new(f64::from(camera.width?), f64::from(camera.height?));
    let margin = border * size;
    (uv.cmpge(margin).all() && uv.cmple(size - margin).all()).then_some(uv)
}

/// Rule `whole`: whether all corners of the drone's box are in the image.
#[must_use]
pub fn whole(camera: &Intrinsics, cam_from_model: &Pose, corners: [[f64; 3]; 2]) -> bool {
    let [a, b] = corners.map(DVec3::from_array);
    (0..8).all(|k| {
        let from_b = [k & 1 != 0, k & 2 != 0, k & 4 != 0];
        let corner = DVec3::new(
            if from_b[0] { b.x } else { a.x },
            if from_b[1] { b.y } else { a.y },
            if from_b[2] { b.z } else { a.z },
        );
        inside(camera, 0.0, cam_from_model, corner).is_some()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_anchor_is_the_first_of_equals() {
        let anchors = [DVec3::X, DVec3::ZERO, DVec3::ZERO, 2.0 * DVec3::X];
        assert_eq!(nearest_anchor(DVec3::new(0.1, 0.0, 0.0), &anchors), Some((1, 0.1, true)));
        assert_eq!(nearest_anchor(DVec3::new(1.9, 0.0, 0.0), &anchors).map(|n| n.0), Some(3));
        assert_eq!(nearest_anchor(DVec3::new(1.5, 0.0, 0.0), &anchors), Some((0, 0.5, true)));
        assert_eq!(nearest_anchor(DVec3::ZERO, &[]), None);
    }

    #[test]
    fn limited_motion_is_both_or_either() {
        let mut rules = Rules::default();
        for (moved, any, all) in [
            ((0.0, 0.0), false, false),
            ((0.02, 0.0), true, false),
            ((0.0, 1.0), true, false),
            ((0.02, 1.0), true, true),
            ((0.6, 1.0), false, false),
            ((0.02, 30.0), false, false),
        ] {
            rules.motion = Motion::Any;
            assert_eq!(moves_enough(&rules, moved), any, "{moved:?}");
            rules.motion = Motion::All;
            assert_eq!(moves_enough(&rules, moved), all, "{moved:?}");
        }
    }

    #[test]
    fn a_view_has_its_target_on_the_axis_and_no_roll() {
        let (eye, target) = (DVec3::new(1.0, -2.0, 1.5), DVec3::new(2.0, 0.5, 0.7));
        let cam = look_at(eye, target).expect("defined");
        let seen = cam.transform_point(target);
        assert!(seen.x.abs() < 1e-12 && seen.y.abs() < 1e-12, "{seen}");
        assert!((seen.z - eye.distance(target)).abs() < 1e-12);
        assert!(cam.transform_point(eye).length() < 1e-12);
        // x stays level, and what is above appears above: y points down.
        let m = cam.matrix();
        assert!((m * DVec3::Z).x.abs() < 1e-12 && (m * DVec3::Z).y < 0.0);
        // What is left of the view from above appears on the left.
        let left = DVec3::Z.cross(target - eye);
        assert!((m * left).x < 0.0);
        assert!(look_at(eye, eye).is_none());
        assert!(look_at(eye, eye + DVec3::Z).is_none());
    }

    #[test]
    fn draws_stay_in_their_cubes_fill_them_and_depend_on_seed_and_frame_alone() {
        let rules = Rules { seed: 5, ..Rules::default() };
        let (anchor, drone) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.0, 1.0));
        let (mut low, mut high, mut sum) = (DVec3::INFINITY, DVec3::NEG_INFINITY, DVec3::ZERO);
        let n = 4000;
        for frame in 0..n {
            let (eye, target) = draw_view(&rules, frame, anchor, drone);
            let (a, d) = (eye - anchor, target - drone);
            assert!(a.abs().max_element() <= 0.25 && d.abs().max_element() <= 0.3);
            (low, high, sum) = (low.min(a), high.max(a), sum + a);
        }
        assert!(low.max_element() < -0.249 && high.min_element() > 0.249, "{low} {high}");
        // Standard error 0.5 / sqrt(12 n) = 0.0023.
        assert!((sum / n as f64).abs().max_element() < 0.01);
        let again = draw_view(&rules, 17, anchor, drone);
        assert_eq!(again, draw_view(&rules, 17, anchor, drone));
        assert_ne!(again, draw_view(&Rules { seed: 6, ..rules }, 17, anchor, drone));
    }

    #[test]
    fn a_centroid_near_the_border_is_not_inside() {
        let camera = Rules::default().check().expect("sound");
        let at = |u: f64, v: f64| {
            let (x, y) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
            inside(&camera, 0.1, &Pose::IDENTITY, 2.0 * DVec3::new(x, y, 1.0))
        };
        assert!(at(160.0, 120.0).is_some() && at(33.0, 25.0).is_some());
        assert!(at(287.0, 215.0).is_some());
        for (u, v) in [(31.0, 120.0), (289.0, 120.0), (160.0, 23.0), (160.0, 217.0), (-5.0, 9.0)] {
            assert_eq!(at(u, v), None, "{u} {v}");
        }
        let behind = inside(&camera, 0.0, &Pose::IDENTITY, DVec3::new(0.0, 0.0, -2.0));
        assert_eq!(behind, None);
    }

    #[test]
    fn a_drone_is_whole_if_each_corner_of_its_box_is_seen() {
        let camera = Rules::default().check().expect("sound");
        let at = |x: f64, z: f64| Pose::new(DQuat::IDENTITY, DVec3::new(x, 0.0, z));
        let corners = [[-0.2, -0.1, -0.2], [0.2, 0.1, 0.2]];
        assert!(whole(&camera, &at(0.0, 1.0), corners));
        // Half of the image is tan(32.345 degrees) wide at 1 m: 0.633.
        assert!(whole(&camera, &at(0.3, 1.0), corners) && !whole(&camera, &at(0.32, 1.0), corners));
        assert!(!whole(&camera, &at(-0.32, 1.0), corners));
        assert!(!whole(&camera, &at(0.0, 0.1), corners));
    }

    #[test]
    fn the_drone_looks_ahead_and_down() {
        let mount = Rules { ego_down_deg: 20.0, ..Rules::default() }.ego_mount();
        let axis = mount.matrix() * DVec3::Z;
        assert!((axis.x - 20.0_f64.to_radians().cos()).abs() < 1e-12 && axis.z < 0.0, "{axis}");
        assert!((mount.matrix() * DVec3::X).distance(-DVec3::Y) < 1e-12);
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let bad = |change: fn(&mut Rules)| {
            let mut rules = Rules::default();
            change(&mut rules);
            rules.check().expect_err("refused").to_string()
        };
        for (error, expected) in [
            (bad(|r| r.min_distance_m = -1.0), "min_distance_m: found -1"),
            (bad(|r| r.max_distance_m = 0.5), "distance_m: the least, 0.8, is above the largest"),
            (bad(|r| r.max_move_m = f64::NAN), "max_move_m: found NaN"),
            (bad(|r| r.stride = 0), "stride: found 0"),
            (bad(|r| r.border = 0.5), "border: found 0.5"),
            (bad(|r| r.exo.fx = -1.0), "fx: -1 is no focal length"),
            (bad(|r| r.exo.width = 0), "exo: an image without pixels"),
            (bad(|r| r.centroid_m[1] = f64::INFINITY), "ego_down_deg, "),
            (
                bad(|r| r.model_axes = Axes::parse("a", "ruf").expect("axes")),
                "model_axes: 'ruf' are left-handed",
            ),
        ] {
            assert!(error.starts_with(expected), "{error}");
        }
    }
}
