//! Frames of files: which way their axes point, and the turn into ours.
//!
//! With `W` from the file's world to ours and `B` from the file's body axes to forward-left-up, a
//! rotation `R` (body to world, in the file's axes) becomes `W R Bᵀ`, and a position `W p`. Both are
//! proper turns or both are reflections, or what comes out is no rotation.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// World axes of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum World {
    /// z up, right-handed: east-north-up, north-west-up, Blender, Matterport3D, motion capture.
    #[serde(rename = "z-up")]
    ZUp,
    /// x north, y east, z down: AirSim, PX4.
    #[serde(rename = "ned")]
    Ned,
    /// y up, right-handed, z towards the viewer: OpenGL, glTF.
    #[serde(rename = "y-up")]
    YUp,
    /// x right, y up, z forward, left-handed: Unity.
    #[serde(rename = "unity")]
    Unity,
}

impl World {
    /// `W`: the file's coordinates to ours.
    #[must_use]
    pub fn matrix(self) -> DMat3 {
        let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
        match self {
            Self::ZUp => DMat3::IDENTITY,
            Self::Ned => DMat3::from_cols(x, -y, -z),
            Self::YUp => DMat3::from_cols(x, z, -y),
            Self::Unity => DMat3::from_cols(-y, z, x),
        }
    }
}

/// Which way the x, y and z axes of a body point, as three letters of `f`orward, `b`ack, `l`eft,
/// `r`ight, `u`p, `d`own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Axes([u8; 3]);

impl Axes {
    /// Forward, left, up: ours.
    pub const FLU: Self = Self(*b"flu");
    /// Forward, right, down: aviation.
    pub const FRD: Self = Self(*b"frd");

    /// From three letters.
    ///
    /// # Errors
    /// [`Error::Argument`] that names `argument`, if they are not three different axes.
    pub fn parse(argument: &str, text: &str) -> Result<Self> {
        let wrong = || {
            Error::argument(
                argument,
                format!(
                    "found '{}', expected which way x, y and z point, as three letters of f b l r \
                     u d, such as flu (forward, left, up) or frd",
                    text.escape_debug()
                ),
            )
        };
        let letters: [u8; 3] =
            text.to_ascii_lowercase().into_bytes().try_into().map_err(|_| wrong())?;
        let axes = Self(letters);
        let known = letters.iter().all(|l| b"fblrud".contains(l));
        if known && axes.matrix().determinant() != 0.0 { Ok(axes) } else { Err(wrong()) }
    }

    /// `B`: coordinates along these axes to forward-left-up.
    #[must_use]
    pub fn matrix(self) -> DMat3 {
        let direction = |letter| match letter {
            b'f' => DVec3::X,
            b'b' => -DVec3::X,
            b'l' => DVec3::Y,
            b'r' => -DVec3::Y,
            b'u' => DVec3::Z,
            _ => -DVec3::Z,
        };
        let [x, y, z] = self.0.map(direction);
        DMat3::from_cols(x, y, z)
    }

    /// Whether they are right-handed.
    #[must_use]
    pub fn right_handed(self) -> bool {
        self.matrix().determinant() > 0.0
    }
}

impl TryFrom<String> for Axes {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        Self::parse("axes", &text).map_err(|e| e.to_string())
    }
}

impl From<Axes> for String {
    fn from(axes: Axes) -> Self {
        axes.0.map(char::from).iter().collect()
    }
}

/// Refuses a body of the other handedness than its world: no rotation could connect them.
///
/// # Errors
/// [`Error::Argument`] naming both.
pub fn same_handedness(world: World, body: Axes) -> Result<()> {
    let right = world.matrix().determinant() > 0.0;
    if right == body.right_handed() {
        return Ok(());
    }
    let hand = |right| if right { "right-handed" } else { "left-handed" };
    Err(Error::argument(
        "body_axes",
        format!(
            "'{}' are {}, but the world '{}' is {}; expected both of one kind",
            String::from(body),
            hand(!right),
            serde_json::to_value(world).unwrap_or_default().as_str().unwrap_or_default(),
            hand(right)
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes(text: &str) -> Axes {
        Axes::parse("body_axes", text).expect("axes")
    }

    #[test]
    fn axes_point_where_their_letters_say() {
        assert_eq!(axes("flu").matrix(), DMat3::IDENTITY);
        assert_eq!(axes("FRD"), Axes::FRD);
        // The drone of the paper: x left, y up, z forward.
        let p = axes("luf").matrix() * DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(p, DVec3::new(3.0, 1.0, 2.0));
        assert!(axes("luf").right_handed() && axes("urf").right_handed());
        assert!(!axes("ruf").right_handed());
    }

    #[test]
    fn what_is_no_three_axes_is_refused() {
        for text in ["", "fl", "flux", "ffu", "fbu", "xyz", "\u{1b}[m"] {
            let error = Axes::parse("body_axes", text).expect_err("refused").to_string();
            assert!(error.starts_with("body_axes: found '"), "{error}");
            assert!(!error.contains('\u{1b}'));
        }
    }

    #[test]
    fn every_world_has_its_up_in_our_z() {
        for (world, up) in [
            (World::ZUp, DVec3::Z),
            (World::Ned, -DVec3::Z),
            (World::YUp, DVec3::Y),
            (World::Unity, DVec3::Y),
        ] {
            assert_eq!(world.matrix() * up, DVec3::Z, "{world:?}");
        }
        // Unity's camera looks along z, and a drone at its origin too.
        assert_eq!(World::Unity.matrix() * DVec3::Z, DVec3::X);
    }

    #[test]
    fn handedness_must_agree() {
        same_handedness(World::Unity, axes("ruf")).expect("both left-handed");
        same_handedness(World::Ned, Axes::FRD).expect("both right-handed");
        let error = same_handedness(World::Unity, Axes::FLU).expect_err("refused").to_string();
        assert!(error.contains("'flu' are right-handed, but the world 'unity'"), "{error}");
    }
}
