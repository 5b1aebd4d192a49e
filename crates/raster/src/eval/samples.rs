//! Errors of the single samples, in columns.

use crate::pose::Pose;

/// Per-sample errors over the *matched* samples, in the order of the ground truth. All columns
/// have the same length; no value is NaN (an undefined projection error is `f64::INFINITY`).
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// Row of the ground-truth table.
    pub gt_row: Vec<u32>,
    /// Row of the prediction table.
    pub pred_row: Vec<u32>,
    /// Translation error, metres.
    pub te_m: Vec<f64>,
    /// Normalised position error.
    pub npe: Vec<f64>,
    /// Orientation error, radians.
    pub oe_rad: Vec<f64>,
    /// Orientation error to the nearest symmetric pose, radians.
    pub oe_sym_rad: Option<Vec<f64>>,
    /// Average distance, metres.
    pub add_m: Option<Vec<f64>>,
    /// Average distance to the nearest vertex, metres.
    pub adds_m: Option<Vec<f64>>,
    /// Maximum symmetry-aware surface distance, metres.
    pub mssd_m: Option<Vec<f64>>,
    /// Maximum symmetry-aware projection distance, pixels.
    pub mspd_px: Option<Vec<f64>>,
    /// Mean projection error, pixels.
    pub proj_px: Option<Vec<f64>>,
    /// Distance of the model's origin from the camera, metres (ground truth).
    pub distance_m: Vec<f64>,
    /// Azimuth of the camera seen from the model, degrees in (-180, 180] (ground truth).
    pub azimuth_deg: Vec<f64>,
    /// Elevation of the camera seen from the model, degrees in [-90, 90] (ground truth).
    pub elevation_deg: Vec<f64>,
}

impl Samples {
    /// Number of matched samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.te_m.len()
    }

    /// No sample is matched.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.te_m.is_empty()
    }

    /// Combined pose error of a sample: NPE + OE in radians.
    #[must_use]
    pub fn cpe(&self, i: usize) -> f64 {
        self.npe[i] + self.oe_rad[i]
    }
}

/// The model's axis that points up, which azimuth and elevation refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Up {
    /// +y is up, azimuth 0 is +z, 90 degrees is +x (CAD and game engines).
    Y,
    /// +z is up, azimuth 0 is +x, 90 degrees is +y (robotics, FLU).
    Z,
}

impl Up {
    /// `y` or `z`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

/// Azimuth and elevation in degrees of the direction from the model to the camera, in the model
/// frame; `(0, 0)` where the two coincide.
#[must_use]
pub fn viewing_angles(pose: &Pose, up: Up) -> (f64, f64) {
    let Some(d) = pose.viewing_direction() else { return (0.0, 0.0) };
    let (forward, side, up) = match up {
        Up::Y => (d.z, d.x, d.y),
        Up::Z => (d.x, d.y, d.z),
    };
    (side.atan2(forward).to_degrees(), up.clamp(-1.0, 1.0).asin().to_degrees())
}
