//! The symmetries of a model, as the BOP format states them, and the rotation error under them.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::pose::Pose;
use crate::rotation::{from_axis_angle, from_matrix, relative};

/// The step of BOP's evaluation for continuous symmetries (`max_sym_disc_step`), in radians.
pub const DEFAULT_STEP: f64 = 0.01;

/// Rigid motions of a model onto itself.
#[derive(Debug, Clone)]
pub struct Symmetries {
    /// The identity, then those given.
    discrete: Vec<Pose>,
    /// Unit axes of continuous symmetries.
    axes: Vec<DVec3>,
    transforms: Vec<Pose>,
}

impl Symmetries {
    /// No symmetry but the identity.
    #[must_use]
    pub fn none() -> Self {
        Self { discrete: vec![Pose::IDENTITY], axes: Vec::new(), transforms: vec![Pose::IDENTITY] }
    }

    /// From discrete symmetries (`model_from_model`, metres, the identity left out or not) and
    /// continuous ones, each the direction of its axis (of any length) and a point on it (metres).
    ///
    /// As in the BOP toolkit, a continuous symmetry is replaced by `ceil(π / max_step)` rotations
    /// (315 for the usual 0.01) at equal angles, the identity included; each of them follows each
    /// discrete symmetry, and several continuous symmetries are not combined with each other.
    ///
    /// # Errors
    /// [`Error::Argument`] for a step outside `(0, π]`, an axis of zero length, or numbers that
    /// are not finite.
    pub fn new(discrete: &[Pose], continuous: &[(DVec3, DVec3)], max_step: f64) -> Result<Self> {
        if !(max_step > 0.0 && max_step <= std::f64::consts::PI) {
            return Err(Error::argument(
                "max_sym_disc_step",
                format!("{max_step}; expected radians above 0 and up to pi"),
            ));
        }
        let steps = (std::f64::consts::PI / max_step).ceil();
        if steps > 1e6 {
            return Err(Error::argument(
                "max_sym_disc_step",
                format!("{max_step} makes {steps} rotations an axis; 1000000 are allowed"),
            ));
        }
        let mut all = vec![Pose::IDENTITY];
        for (k, pose) in discrete.iter().enumerate() {
            if !pose.translation.is_finite() || !pose.rotation.is_finite() {
                let name = format!("symmetries_discrete[{k}]");
                return Err(Error::argument(name, "a value is NaN or infinite"));
            }
            if *pose != Pose::IDENTITY {
                all.push(*pose);
            }
        }
        let mut turns = vec![Pose::IDENTITY];
        let mut axes = Vec::new();
        for (k, (axis, offset)) in continuous.iter().enumerate() {
            let name = || format!("symmetries_continuous[{k}]");
            if !axis.is_finite() || !offset.is_finite() {
                return Err(Error::argument(name(), "a value is NaN or infinite"));
            }
            let unit = (*axis / axis.abs().max_element())
                .try_normalize()
                .ok_or_else(|| Error::argument(name(), "the axis has length zero"))?;
            axes.push(unit);
            for step in 1..steps as u32 {
                let angle = f64::from(step) * (2.0 * std::f64::consts::PI / steps);
                let turn = from_axis_angle((unit * angle).to_array())
                    .map_err(|e| Error::argument(name(), e.found()))?;
                let turn = Pose::new(turn, DVec3::ZERO);
                turns.push(Pose { translation: *offset - turn.transform_point(*offset), ..turn });
            }
        }
        let transforms = all.iter().flat_map(|d| turns.iter().map(|t| t.compose(d))).collect();
        Ok(Self { discrete: all, axes, transforms })
    }

    /// All symmetries as motions `model_from_model` in metres, the identity first; continuous ones
    /// as discretised.
    #[must_use]
    pub fn transforms(&self) -> &[Pose] {
        &self.transforms
    }

    /// Whether there is none but the identity.
    #[must_use]
    pub fn is_trivial(&self) -> bool {
        self.transforms.len() == 1
    }
}

/// A discrete symmetry from the 16 numbers of a BOP `symmetries_discrete` entry: a 4x4 matrix, row
/// by row, `model_from_model`; its translation is multiplied by `metres` (0.001 for BOP's
/// millimetres).
///
/// # Errors
/// [`Error::NotARotation`] if the upper left 3x3 is none, [`Error::Argument`] for a translation
/// that is not finite or a last row other than `0, 0, 0, 1`.
pub fn from_rows(m: &[f64; 16], metres: f64) -> Result<Pose> {
    const NAME: &str = "symmetries_discrete";
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| m[4 * i + j]));
    let (rotation, _) = from_matrix(rows).map_err(|e| Error::NotARotation {
        argument: NAME.into(),
        found: e.found(),
        expected: e.expected(),
    })?;
    if m[12..15].iter().any(|&c| c.abs() > 1e-9) || (m[15] - 1.0).abs() > 1e-9 {
        let found = format!("the last row is {:?}; expected 0, 0, 0, 1", &m[12..]);
        return Err(Error::argument(NAME, found));
    }
    let translation = DVec3::new(m[3], m[7], m[11]) * metres;
    if !translation.is_finite() {
        return Err(Error::argument(NAME, "the translation is NaN or infinite"));
    }
    Ok(Pose::new(rotation, translation))
}

/// Least angle over the symmetries between the estimated rotation and the true one, in radians, in
/// `[0, π]`.
///
/// Continuous symmetries are not discretised here: over all turns `C(φ)` about the unit axis `a`
/// the relative quaternion `(w, v)` has its least angle `2 atan2(|v - a (a·v)|, √(w² + (a·v)²))`.
/// The discretised least angle is larger by less than half a step. Exactly 0 for equal rotations.
#[must_use]
pub fn rotation_angle(est: &Pose, gt: &Pose, symmetries: &Symmetries) -> f64 {
    let mut best = f64::INFINITY;
    for symmetry in &symmetries.discrete {
        // R_est against R_gt C D: the turn R_gtᵀ R_est Dᵀ against C.
        let (v, w) = if symmetry.rotation == glam::DQuat::IDENTITY {
            relative(gt.rotation, est.rotation)
        } else {
            relative(gt.rotation, est.rotation * symmetry.rotation.conjugate())
        };
        let mut least = 2.0 * v.length().atan2(w.abs());
        for axis in &symmetries.axes {
            let along = axis.dot(v);
            let angle = 2.0 * (v - *axis * along).length().atan2(w.hypot(along));
            least = if angle < least { angle } else { least };
        }
        best = if least < best { least } else { best };
    }
    best
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use proptest::prelude::*;

    use super::*;
    use crate::metrics::oracle;
    use crate::rotation::angle;

    fn half_turn() -> Pose {
        Pose::new(DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0), DVec3::new(0.2, 0.0, 0.0))
    }

    #[test]
    fn the_expansion_is_that_of_the_toolkit() {
        let s =
            Symmetries::new(&[half_turn()], &[(DVec3::Y * 3.0, DVec3::X)], 0.01).expect("valid");
        assert_eq!(s.transforms().len(), 2 * 315);
        assert_eq!(s.transforms()[0], Pose::IDENTITY);
        let step = angle(DQuat::IDENTITY, s.transforms()[1].rotation);
        assert!((step - 2.0 * std::f64::consts::PI / 315.0).abs() < 1e-15);
        // A point on the axis stays.
        for t in &s.transforms()[..315] {
            assert!(
                t.transform_point(DVec3::new(1.0, 5.0, 0.0)).distance(DVec3::new(1.0, 5.0, 0.0))
                    < 1e-14
            );
        }
        // Two axes are concatenated: 1 + 314 + 314.
        let s = Symmetries::new(&[], &[(DVec3::X, DVec3::ZERO), (DVec3::Y, DVec3::ZERO)], 0.01);
        assert_eq!(s.expect("valid").transforms().len(), 629);
        assert!(Symmetries::none().is_trivial());
    }

    #[test]
    fn sixteen_numbers_are_read_row_by_row() {
        let mut m = [0.0; 16];
        (m[0], m[5], m[10], m[15], m[3]) = (-1.0, -1.0, 1.0, 1.0, 200.0);
        let pose = from_rows(&m, 1e-3).expect("valid");
        assert!(angle(pose.rotation, half_turn().rotation) < 1e-15);
        assert!(pose.translation.distance(DVec3::X * 0.2) < 1e-15);
        m[13] = 1.0;
        assert!(from_rows(&m, 1e-3).is_err());
        (m[13], m[0]) = (0.0, 1.0);
        assert!(matches!(from_rows(&m, 1e-3), Err(Error::NotARotation { .. })));
    }

    #[test]
    fn wrong_symmetries_are_refused() {
        assert!(Symmetries::new(&[], &[(DVec3::ZERO, DVec3::ZERO)], 0.01).is_err());
        assert!(Symmetries::new(&[], &[(DVec3::X, DVec3::NAN)], 0.01).is_err());
        assert!(Symmetries::new(&[], &[], 0.0).is_err());
        assert!(Symmetries::new(&[], &[], 1e-9).is_err());
        assert!(Symmetries::new(&[], &[], f64::NAN).is_err());
    }

    proptest! {
        #[test]
        fn the_closed_form_is_the_limit_of_the_discretised_one(
            est in oracle::pose(0.1), gt in oracle::pose(0.1), axis in oracle::vector(1.0),
            two in any::<bool>(), discrete in any::<bool>(),
        ) {
            prop_assume!(axis.length() > 0.1);
            let discrete: &[Pose] = if discrete { &[half_turn()] } else { &[] };
            let axes = [(axis, DVec3::X), (DVec3::new(axis.z, 0.3, -axis.x), DVec3::ZERO)];
            let s = Symmetries::new(discrete, &axes[..=usize::from(two)], 0.01).expect("valid");
            let exact = rotation_angle(&est, &gt, &s);
            let discretised = s.transforms().iter()
                .map(|t| angle(est.rotation, gt.compose(t).rotation))
                .fold(f64::INFINITY, f64::min);
            prop_assert!(exact <= discretised + 1e-14 && discretised <= exact + 0.01);
            let s = Symmetries::new(discrete, &[], 0.01).expect("valid");
            let slow = s.transforms().iter()
                .map(|t| angle(est.rotation, gt.compose(t).rotation))
                .fold(f64::INFINITY, f64::min);
            prop_assert!((rotation_angle(&est, &gt, &s) - slow).abs() < 1e-14);
            prop_assert_eq!(rotation_angle(&gt, &gt, &s), 0.0);
        }
    }
}
