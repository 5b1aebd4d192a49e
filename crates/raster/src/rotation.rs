//! Rotations in every form people store them, and the angle between two of them.
//!
//! Inside the crate a rotation is a unit quaternion in `f64` (`glam::DQuat`). Everything here is
//! scale-safe: a quaternion of norm `1e-200` is as good as one of norm 1.

use glam::{DMat3, DQuat, DVec3};

/// A quaternion shorter than this is refused as zero (the floor of the Kelvins pose challenge).
pub const MIN_QUATERNION_NORM: f64 = 1e-12;

/// A matrix whose `R Rᵀ` differs from the identity by more than this is not a rounded rotation
/// any more and is refused; below it is projected to the nearest rotation.
pub const MAX_DEPARTURE: f64 = 1e-2;

/// A departure above this is worth a warning: single-precision poses stay below it.
pub const NOTABLE_DEPARTURE: f64 = 1e-5;

/// Why some numbers are not a rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NotARotation {
    /// One of them is NaN or infinite.
    NotFinite,
    /// The quaternion's norm is zero (below [`MIN_QUATERNION_NORM`]).
    ZeroNorm,
    /// The matrix is a reflection: its determinant is negative.
    Reflection {
        /// The determinant.
        determinant: f64,
    },
    /// The largest element of `|R Rᵀ - I|` is above [`MAX_DEPARTURE`].
    NotOrthonormal {
        /// That element.
        departure: f64,
        /// The determinant.
        determinant: f64,
    },
    /// The two columns of a 6D rotation are parallel or zero.
    Degenerate,
}

impl NotARotation {
    /// What was found, for a message.
    #[must_use]
    pub fn found(&self) -> String {
        match self {
            Self::NotFinite => "a value that is NaN or infinite".into(),
            Self::ZeroNorm => "a quaternion of zero norm".into(),
            Self::Reflection { determinant } => {
                format!("a reflection (determinant {determinant:.4})")
            }
            Self::NotOrthonormal { departure, determinant } => format!(
                "a matrix that is not orthonormal (|R R^T - I| up to {departure:.3e}, determinant {determinant:.4})"
            ),
            Self::Degenerate => "two parallel or zero vectors".into(),
        }
    }

    /// What was expected, for a message.
    #[must_use]
    pub fn expected(&self) -> &'static str {
        match self {
            Self::NotFinite => "finite numbers",
            Self::ZeroNorm => "a quaternion of norm 1",
            Self::Reflection { .. } | Self::NotOrthonormal { .. } => {
                "a rotation matrix (orthonormal to 1e-2, determinant +1)"
            }
            Self::Degenerate => "two independent vectors",
        }
    }
}

/// Unit quaternion from `(w, x, y, z)` of any norm.
///
/// # Errors
/// [`NotARotation::NotFinite`], [`NotARotation::ZeroNorm`].
pub fn from_quat_wxyz(q: [f64; 4]) -> Result<DQuat, NotARotation> {
    if !q.iter().all(|c| c.is_finite()) {
        return Err(NotARotation::NotFinite);
    }
    let largest = q.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
    if largest < MIN_QUATERNION_NORM / 2.0 {
        return Err(NotARotation::ZeroNorm);
    }
    let [w, x, y, z] = q.map(|c| c / largest);
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    if norm * largest < MIN_QUATERNION_NORM {
        return Err(NotARotation::ZeroNorm);
    }
    Ok(DQuat::from_xyzw(x / norm, y / norm, z / norm, w / norm))
}

/// Unit quaternion from `(x, y, z, w)` of any norm.
///
/// # Errors
/// As [`from_quat_wxyz`].
pub fn from_quat_xyzw(q: [f64; 4]) -> Result<DQuat, NotARotation> {
    from_quat_wxyz([q[3], q[0], q[1], q[2]])
}

/// Unit quaternion of the turn by `|r|` radians about `r` (axis-angle, the exponential map).
///
/// # Errors
/// [`NotARotation::NotFinite`].
pub fn from_axis_angle(r: [f64; 3]) -> Result<DQuat, NotARotation> {
    if !r.iter().all(|c| c.is_finite()) {
        return Err(NotARotation::NotFinite);
    }
    let r = DVec3::from_array(r);
    let largest = r.abs().max_element();
    if largest == 0.0 {
        return Ok(DQuat::IDENTITY);
    }
    let angle = (r / largest).length() * largest;
    if !angle.is_finite() {
        return Err(NotARotation::NotFinite);
    }
    let axis = (r / largest).normalize();
    let (sin, cos) = (0.5 * angle).sin_cos();
    from_quat_wxyz([cos, axis.x * sin, axis.y * sin, axis.z * sin])
}

/// Unit quaternion and departure from orthonormality of a 3x3 matrix, row by row.
///
/// The matrix is replaced by the nearest rotation (polar decomposition; the same rotation as
/// `U Vᵀ` of its singular value decomposition). The departure is the largest element of
/// `|R Rᵀ - I|`; a caller warns above [`NOTABLE_DEPARTURE`].
///
/// # Errors
/// [`NotARotation::NotFinite`], [`NotARotation::Reflection`] and
/// [`NotARotation::NotOrthonormal`] above [`MAX_DEPARTURE`].
pub fn from_matrix(rows: [[f64; 3]; 3]) -> Result<(DQuat, f64), NotARotation> {
    if !rows.iter().flatten().all(|c| c.is_finite()) {
        return Err(NotARotation::NotFinite);
    }
    let m = DMat3::from_cols_array_2d(&rows).transpose();
    let gram = m * m.transpose() - DMat3::IDENTITY;
    // An overflow of the products makes infinities, or NaN where two of them cancel.
    let elements = gram.to_cols_array().map(|c| if c.is_nan() { f64::INFINITY } else { c.abs() });
    let departure = elements.into_iter().fold(0.0, f64::max);
    let determinant = m.determinant();
    if departure > MAX_DEPARTURE {
        return Err(NotARotation::NotOrthonormal { departure, determinant });
    }
    if determinant < 0.0 {
        return Err(NotARotation::Reflection { determinant });
    }
    Ok((nearest_rotation(m, departure), departure))
}

/// Rotation from its first two columns or rows (the "6D" form of Zhou et al., CVPR 2019), by
/// Gram-Schmidt; the two vectors need not be orthonormal.
///
/// # Errors
/// [`NotARotation::NotFinite`], [`NotARotation::Degenerate`].
pub fn from_6d(a: [f64; 3], b: [f64; 3], layout: SixD) -> Result<DQuat, NotARotation> {
    let (a, b) = (DVec3::from_array(a), DVec3::from_array(b));
    if !a.is_finite() || !b.is_finite() {
        return Err(NotARotation::NotFinite);
    }
    let x = (a / a.abs().max_element()).try_normalize().ok_or(NotARotation::Degenerate)?;
    let b = b / b.abs().max_element();
    let y = (b - x * x.dot(b)).try_normalize().ok_or(NotARotation::Degenerate)?;
    if !x.is_finite() || !y.is_finite() || x.dot(y).abs() > 1e-6 {
        return Err(NotARotation::Degenerate);
    }
    let m = DMat3::from_cols(x, y, x.cross(y));
    let m = match layout {
        SixD::Columns => m,
        SixD::Rows => m.transpose(),
    };
    // The two vectors are normal to each other to 1e-6.
    Ok(nearest_rotation(m, 1e-5))
}

/// Which two vectors of the matrix a 6D rotation holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SixD {
    /// The first two columns (Zhou et al., the paper).
    Columns,
    /// The first two rows (`PyTorch3D`).
    Rows,
}

/// Nearest rotation of a matrix that is nearly one: Newton's iteration for the polar
/// decomposition, `X ← (X + X⁻ᵀ) / 2`, which takes a departure `d` (at most [`MAX_DEPARTURE`]) to
/// `2.25 d²` at most. None is needed where the departure is that of rounding.
fn nearest_rotation(mut m: DMat3, mut departure: f64) -> DQuat {
    while departure > 1e-15 {
        let [a, b, c] = [m.x_axis, m.y_axis, m.z_axis];
        // The inverse, transposed, is made of cross products.
        let (bc, ca, ab) = (b.cross(c), c.cross(a), a.cross(b));
        m = (m + DMat3::from_cols(bc, ca, ab) * a.dot(bc).recip()) * 0.5;
        departure = 2.25 * departure.powi(2);
    }
    let q = quaternion(m).normalize();
    // Of the two signs the one with w >= 0, so that equal matrices give equal quaternions.
    if q.w < 0.0 { -q } else { q }
}

/// The quaternion of a rotation matrix times four times its largest component (Shepperd's method,
/// without the root: the caller normalises).
fn quaternion(m: DMat3) -> DQuat {
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    if z.z <= 0.0 {
        let (difference, one) = (y.y - x.x, 1.0 - z.z);
        if difference <= 0.0 {
            DQuat::from_xyzw(one - difference, x.y + y.x, x.z + z.x, y.z - z.y)
        } else {
            DQuat::from_xyzw(x.y + y.x, one + difference, y.z + z.y, z.x - x.z)
        }
    } else {
        let (sum, one) = (y.y + x.x, 1.0 + z.z);
        if sum <= 0.0 {
            DQuat::from_xyzw(x.z + z.x, y.z + z.y, one - sum, x.y - y.x)
        } else {
            DQuat::from_xyzw(y.z - z.y, z.x - x.z, x.y - y.x, one + sum)
        }
    }
}

/// Angle between two rotations in radians, in `[0, π]`: `2 atan2(|v|, |w|)` of the relative
/// quaternion.
///
/// Unlike every form with an arc cosine it is exact near 0 and π, is exactly 0 for equal
/// quaternions (and for `q` and `-q`), and has no NaN.
#[must_use]
pub fn angle(a: DQuat, b: DQuat) -> f64 {
    let (v, w) = relative(a, b);
    2.0 * v.length().atan2(w.abs())
}

/// Vector part and scalar part of `conj(a) * b`, in an order of operations that gives exact zeros
/// for `a == b`.
#[must_use]
pub(crate) fn relative(a: DQuat, b: DQuat) -> (DVec3, f64) {
    let v = DVec3::new(
        (a.w * b.x - a.x * b.w) + (a.z * b.y - a.y * b.z),
        (a.w * b.y - a.y * b.w) + (a.x * b.z - a.z * b.x),
        (a.w * b.z - a.z * b.w) + (a.y * b.x - a.x * b.y),
    );
    (v, (a.w * b.w + a.x * b.x) + (a.y * b.y + a.z * b.z))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn unit() -> impl Strategy<Value = DQuat> {
        prop::array::uniform4(-1.0..1.0_f64)
            .prop_filter("not zero", |q| q.iter().any(|c| c.abs() > 0.05))
            .prop_map(|q| from_quat_wxyz(q).expect("not zero"))
    }

    fn rows(q: DQuat) -> [[f64; 3]; 3] {
        DMat3::from_quat(q).transpose().to_cols_array_2d()
    }

    #[test]
    fn a_known_turn_has_its_angle() {
        for degrees in [0.0, 1e-7, 0.5, 45.0, 90.0, 179.999_999, 180.0] {
            let q = from_axis_angle([0.0, f64::to_radians(degrees), 0.0]).expect("finite");
            let measured = angle(DQuat::IDENTITY, q).to_degrees();
            assert!((measured - degrees).abs() < 1e-13, "{degrees} {measured}");
        }
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        assert_eq!(from_quat_wxyz([0.0; 4]), Err(NotARotation::ZeroNorm));
        assert_eq!(from_quat_wxyz([1e-13, 0.0, 0.0, 0.0]), Err(NotARotation::ZeroNorm));
        assert_eq!(from_quat_wxyz([f64::NAN, 0.0, 0.0, 1.0]), Err(NotARotation::NotFinite));
        let mirror = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(matches!(from_matrix(mirror), Err(NotARotation::Reflection { .. })));
        let scaled = [[1.1, 0.0, 0.0], [0.0, 1.1, 0.0], [0.0, 0.0, 1.1]];
        assert!(matches!(from_matrix(scaled), Err(NotARotation::NotOrthonormal { .. })));
        let huge = [[1e200, 0.0, 0.0], [0.0, 1e200, 1e200], [0.0, -1e200, 1e200]];
        assert!(matches!(from_matrix(huge), Err(NotARotation::NotOrthonormal { .. })));
        let parallel = from_6d([1.0, 0.0, 0.0], [2.0, 0.0, 0.0], SixD::Columns);
        assert_eq!(parallel, Err(NotARotation::Degenerate));
        assert_eq!(from_6d([0.0; 3], [0.0; 3], SixD::Rows), Err(NotARotation::Degenerate));
    }

    #[test]
    fn huge_and_tiny_quaternions_are_normalised_without_overflow() {
        let q = from_quat_wxyz([1e200, 1e200, 0.0, 0.0]).expect("finite");
        assert!((q.w - 0.5_f64.sqrt()).abs() < 1e-15);
        let q = from_quat_wxyz([1e-11, 0.0, 0.0, 0.0]).expect("above the floor");
        assert!((q.w - 1.0).abs() < 1e-15);
    }

    proptest! {
        #[test]
        fn equal_rotations_are_exactly_zero_apart(q in unit()) {
            prop_assert_eq!(angle(q, q).to_bits(), 0);
            prop_assert_eq!(angle(q, -q).to_bits(), 0);
        }

        #[test]
        fn the_angle_is_that_of_the_turn_between(q in unit(), axis in prop::array::uniform3(-1.0..1.0_f64), a in 0.0..3.1_f64) {
            let axis = DVec3::from_array(axis);
            prop_assume!(axis.length() > 0.1);
            let turn = from_axis_angle((axis.normalize() * a).to_array()).expect("finite");
            prop_assert!((angle(q, q * turn) - a).abs() < 1e-14);
        }

        #[test]
        fn every_form_gives_the_same_rotation(q in unit()) {
            let r = rows(q);
            let (m, departure) = from_matrix(r).expect("a rotation");
            prop_assert!(departure < 1e-14);
            prop_assert!(angle(m, q) < 1e-14);
            let column = |j: usize| [r[0][j], r[1][j], r[2][j]];
            prop_assert!(angle(from_6d(column(0), column(1), SixD::Columns).expect("independent"), q) < 1e-14);
            prop_assert!(angle(from_6d(r[0], r[1], SixD::Rows).expect("independent"), q) < 1e-14);
            let xyzw = from_quat_xyzw([q.x, q.y, q.z, q.w]).expect("unit");
            prop_assert!(angle(xyzw, q) < 1e-15);
        }

        #[test]
        fn the_projection_is_the_nearest_rotation(q in unit(), noise in prop::array::uniform9(-3e-3..3e-3_f64), digits in 0..14_i32) {
            let noise = DMat3::from_cols_array(&noise) * 10.0_f64.powi(-digits);
            let m = DMat3::from_quat(q) + noise;
            let (p, _) = from_matrix(m.transpose().to_cols_array_2d()).expect("nearly orthonormal");
            // Optimality: Pᵀ M is symmetric (the polar factor), and positive definite.
            let s = DMat3::from_quat(p).transpose() * m;
            prop_assert!((s - s.transpose()).to_cols_array().iter().all(|c| c.abs() < 4e-15));
            prop_assert!(s.determinant() > 0.9);
        }
    }
}
