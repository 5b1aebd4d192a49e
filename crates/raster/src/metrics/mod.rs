//! Pose errors over a set of model points, exact and in `f64`.
//!
//! Definitions and edge conventions are those of the BOP toolkit unless a function says otherwise.
//! `est` is the estimated pose, `gt` the true one, both `cam_from_model`; lengths are metres,
//! angles radians, image distances pixels.

#![expect(
    clippy::inline_always,
    clippy::needless_range_loop,
    reason = "plain loops over lanes, compiled once for each instruction set: what is not inlined \
              there is compiled for none of them"
)]
#![cfg_attr(test, expect(clippy::float_cmp, reason = "tests of what has to be the same bits"))]

pub mod add;
pub mod adds;
pub mod batch;
mod motion;
pub mod mspd;
pub mod mssd;
pub mod nearest;
#[cfg(test)]
pub(crate) mod oracle;
pub mod symmetry;
pub mod vertices;

pub use add::{add, add_below, add_bounds};
pub use adds::adds;
pub use batch::{add_batch, add_below_batch, adds_batch, mssd_batch, projection_batch};
pub use mspd::{ProjectionErrors, projection_errors};
pub use mssd::mssd;
pub use symmetry::{Symmetries, rotation_angle};
pub use vertices::VertexSet;
