//! What the estimated pose does to a model point, seen from the true pose.
//!
//! With `ΔR = R_gtᵀ R_est` the point `p` is displaced by `D(p) = (ΔR - I)(p - c) + d` in the model
//! frame, where `c` is the mean of the points and `d = D(c)`. `ΔR` turns by `θ` about a unit axis
//! `n`; with `s = sin(θ/2)`, `w = cos(θ/2)` and `e1, e2` orthonormal and normal to `n`,
//!
//! ```text
//! |D|² = (2s e1·q - s d1 + w d2)² + (2s e2·q - s d2 - w d1)² + (n·d)²,   q = p - c, di = ei·d
//! ```
//!
//! Nothing cancels for small angles, equal poses give exact zeros, and `e1` can be chosen without
//! an x component: seven multiplications and additions a point.

use glam::DVec3;

use super::vertices::{VertexSet, power_of_two_below};
use crate::pose::Pose;
use crate::rotation::relative;

/// Relative motion; lengths in the set's units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moved {
    /// Vector and scalar part of the quaternion of `ΔR`.
    pub(crate) v: DVec3,
    pub(crate) w: f64,
    /// Displacement of the mean, in the true model frame.
    pub(crate) d: DVec3,
}

/// A motion, or one so far that the model is a point beside it.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Motion {
    Near(Moved),
    /// The length of the translation, in metres.
    Far(f64),
}

/// Beyond so many units of translation the extent of the model is lost in rounding by far, and
/// below it no square overflows.
const FAR: f64 = 1.157_920_892_373_162e77; // 2^256

impl Motion {
    pub(crate) fn between(set: &VertexSet, est: &Pose, gt: &Pose) -> Self {
        // Halved first, for translations whose difference overflows.
        let half = est.translation * 0.5 - gt.translation * 0.5;
        let largest = half.abs().max_element();
        if largest > FAR * set.unit {
            let scale = power_of_two_below(largest);
            return Self::Far((half / scale).length() * scale * 2.0);
        }
        let shift = if largest > 1e300 {
            half / set.unit * 2.0
        } else {
            (est.translation - gt.translation) / set.unit
        };
        let (v, w) = relative(gt.rotation, est.rotation);
        let d = gt.matrix().transpose() * shift;
        Self::Near(Moved { v, w, d: d + turn_minus_one(v, w, set.centre) })
    }
}

/// `(R - I) p` for the rotation with quaternion `(w, v)`.
pub(crate) fn turn_minus_one(v: DVec3, w: f64, p: DVec3) -> DVec3 {
    let c = v.cross(p);
    (c * w + v.cross(c)) * 2.0
}

/// The rows of the screw form, scaled by a power of two so that squares neither overflow nor
/// vanish. `|D| = scale * sqrt(s)` metres with
/// `s = (u·(y,z,1))² + (v·(x,y,z,1))² + w2`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Screw {
    pub(crate) u: [f64; 3],
    pub(crate) v: [f64; 4],
    pub(crate) w2: f64,
    /// Units for one unit of `sqrt(s)`: a power of two.
    pub(crate) scale: f64,
}

impl Moved {
    /// Unit axis and sine of half the angle.
    fn axis(&self) -> (DVec3, f64) {
        let largest = self.v.abs().max_element();
        if largest == 0.0 {
            return (DVec3::Z, 0.0);
        }
        let scale = power_of_two_below(largest);
        let v = self.v / scale;
        let length = v.length();
        (v / length, length * scale)
    }

    /// `None` if no point moves. `extent` is the largest coordinate of a point.
    pub(crate) fn screw(&self, extent: f64) -> Option<Screw> {
        let (n, s) = self.axis();
        let largest = self.d.abs().max_element().max(2.0 * s * extent);
        if largest == 0.0 {
            return None;
        }
        let scale = power_of_two_below(largest);
        let (twice, d) = (2.0 * s / scale, self.d / scale);
        let flat = (n.y * n.y + n.z * n.z).sqrt();
        let e1 = if flat > 1e-100 { DVec3::new(0.0, n.z / flat, -n.y / flat) } else { DVec3::Y };
        let e2 = n.cross(e1);
        let (d1, d2, along) = (e1.dot(d), e2.dot(d), n.dot(d));
        let (r1, r2) = (e1 * twice, e2 * twice);
        Some(Screw {
            u: [r1.y, r1.z, self.w * d2 - s * d1],
            v: [r2.x, r2.y, r2.z, -s * d2 - self.w * d1],
            w2: along * along,
            scale,
        })
    }

    /// The root of the mean squared displacement in units, a little less than which it certainly
    /// is: no greatest displacement is below.
    pub(crate) fn root_mean_square(&self, set: &VertexSet) -> f64 {
        let (_, high, s) = self.bounds_and_sine(set);
        (high * (1.0 - 4.0 * SLACK) - 8.0 * s * SLACK).max(0.0)
    }

    /// Bounds of the mean displacement in units: that of the mean point, and the root mean square,
    /// both widened by more than everything that rounding can do to them or to the mean.
    pub(crate) fn bounds(&self, set: &VertexSet) -> (f64, f64) {
        let (low, high, _) = self.bounds_and_sine(set);
        (low, high)
    }

    fn bounds_and_sine(&self, set: &VertexSet) -> (f64, f64, f64) {
        let (n, s) = self.axis();
        let largest = self.d.abs().max_element().max(2.0 * s);
        if largest == 0.0 {
            return (0.0, 0.0, 0.0);
        }
        let scale = power_of_two_below(largest);
        let (twice, d2) = (2.0 * s / scale, (self.d / scale).length_squared());
        let c = set.covariance;
        let trace = c.x_axis.x + c.y_axis.y + c.z_axis.z;
        let spread = (trace - n.dot(c * n)).max(0.0) + trace * SLACK * SLACK;
        let slack = SLACK * twice;
        let low = (d2.sqrt() * (1.0 - SLACK) - slack).max(0.0);
        let high = (d2 + twice * twice * spread).sqrt() * (1.0 + SLACK) + slack;
        (low * scale, high * scale, s)
    }
}

/// Relative margin of the bounds. The mean is rounded to about 1e-15 of itself, the centre to
/// 1e-16 of a unit (which is at least half the largest coordinate).
const SLACK: f64 = 1e-13;
