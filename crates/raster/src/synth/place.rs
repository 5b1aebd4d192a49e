//! A flight put into a scene by a similarity: `p_scene = scale * Rz(yaw) * p + offset`.
//!
//! Only turns about the vertical: a drone that hovers level has to hover level in the scene.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::synth::flight::{Track, positive};

/// A similarity that keeps z up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Placement {
    /// Above zero. Speeds grow with it.
    pub scale: f64,
    /// Degrees about z, counter-clockwise from above.
    pub yaw_deg: f64,
    /// Metres.
    pub offset: [f64; 3],
}

/// What [`fit`] may choose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fit {
    /// The offset: the middle of the flight's box comes to the middle of the anchors' box.
    Centre,
    /// Also the scale: the flight's box becomes as large as fits into the anchors' box from above.
    Fill,
}

impl Default for Placement {
    fn default() -> Self {
        Self { scale: 1.0, yaw_deg: 0.0, offset: [0.0; 3] }
    }
}

impl Placement {
    fn check(&self) -> Result<()> {
        positive("scale", self.scale)?;
        if !self.yaw_deg.is_finite() || self.offset.iter().any(|x| !x.is_finite()) {
            return Err(Error::argument("yaw_deg, offset", "expected finite numbers"));
        }
        Ok(())
    }

    fn turn(&self) -> DQuat {
        DQuat::from_rotation_z(self.yaw_deg.to_radians())
    }

    /// Carries a flight into the scene.
    ///
    /// # Errors
    /// [`Error::Argument`]: a scale that is not above zero, or a number that is not finite.
    pub fn apply(&self, track: &mut Track) -> Result<()> {
        self.check()?;
        let (turn, offset) = (self.turn(), DVec3::from_array(self.offset));
        for p in &mut track.positions {
            *p = self.scale * (turn * *p) + offset;
        }
        for q in &mut track.rotations {
            *q = (turn * *q).normalize();
        }
        Ok(())
    }
}

/// The placement that brings a flight over the anchors: yaw (and scale, for [`Fit::Centre`]) as
/// they are in `given`, whose offset is added to the one that is found.
///
/// # Errors
/// As [`Placement::apply`]; [`Error::Argument`] if there is no anchor, or if a flight without extent
/// is to fill something.
pub fn fit(track: &Track, anchors: &[DVec3], given: &Placement, how: Fit) -> Result<Placement> {
    given.check()?;
    let turn = given.turn();
    let turned: Vec<DVec3> = track.positions.iter().map(|p| turn * *p).collect();
    let (Some(flight), Some(scene)) = (bounds(&turned), bounds(anchors)) else {
        return Err(Error::argument("anchors", "one at least is needed to place a flight by"));
    };
    let mut placed = *given;
    if how == Fit::Fill {
        let (have, want) = (flight.1 - flight.0, scene.1 - scene.0);
        let ratio = |have: f64, want: f64| if have > 0.0 { want / have } else { f64::INFINITY };
        placed.scale = ratio(have.x, want.x).min(ratio(have.y, want.y));
        if !(placed.scale > 0.0 && placed.scale.is_finite()) {
            return Err(Error::argument(
                "fit",
                format!(
                    "the flight covers {:.2} x {:.2} m and the anchors {:.2} x {:.2} m from above; \
                     expected an area each (give a scale)",
                    have.x, have.y, want.x, want.y
                ),
            ));
        }
    }
    let middle = |b: (DVec3, DVec3)| 0.5 * (b.0 + b.1);
    let offset = middle(scene) - placed.scale * middle(flight) + DVec3::from_array(given.offset);
    placed.offset = offset.to_array();
    Ok(placed)
}

/// Corners of the box of some points; `None` of nothing.
#[must_use]
pub fn bounds(points: &[DVec3]) -> Option<(DVec3, DVec3)> {
    let first = *points.first()?;
    Some(points.iter().fold((first, first), |(lo, hi), p| (lo.min(*p), hi.max(*p))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track() -> Track {
        let positions = vec![DVec3::ZERO, DVec3::new(4.0, 2.0, 1.0)];
        let n = positions.len();
        Track {
            rate_hz: 60.0,
            frames: (0..n.cast_signed() as i64).collect(),
            rotations: vec![DQuat::IDENTITY; n],
            lines: vec![1; n],
            segments: std::iter::once(0..n).collect(),
            positions,
        }
    }

    #[test]
    fn a_similarity_scales_turns_and_moves() {
        let mut track = track();
        let placement = Placement { scale: 2.0, yaw_deg: 90.0, offset: [1.0, 0.0, 0.5] };
        placement.apply(&mut track).expect("sound");
        assert!(track.positions[1].distance(DVec3::new(-3.0, 8.0, 2.5)) < 1e-12);
        assert!((track.rotations[1] * DVec3::X).distance(DVec3::Y) < 1e-12);
    }

    #[test]
    fn a_fit_brings_one_middle_over_the_other() {
        let anchors = [DVec3::new(10.0, 10.0, 1.0), DVec3::new(18.0, 18.0, 2.0)];
        for (how, scale) in [(Fit::Centre, 1.0), (Fit::Fill, 2.0)] {
            let mut track = track();
            let placed = fit(&track, &anchors, &Placement::default(), how).expect("placed");
            assert!((placed.scale - scale).abs() < 1e-12);
            placed.apply(&mut track).expect("sound");
            let (lo, hi) = bounds(&track.positions).expect("points");
            assert!((0.5 * (lo + hi)).distance(DVec3::new(14.0, 14.0, 1.5)) < 1e-12);
        }
        let up = Placement { offset: [0.0, 0.0, 1.0], ..Placement::default() };
        let placed = fit(&track(), &anchors, &up, Fit::Centre).expect("placed");
        assert!((placed.offset[2] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_placed_is_refused() {
        let given = Placement { scale: 0.0, ..Placement::default() };
        assert!(given.apply(&mut track()).is_err());
        assert!(fit(&track(), &[], &Placement::default(), Fit::Centre).is_err());
        let one = fit(&track(), &[DVec3::ZERO], &Placement::default(), Fit::Fill);
        assert!(one.expect_err("refused").to_string().starts_with("fit: the flight covers 4.00 x"));
    }
}
