//! Pose errors over a set of model points, exact and in `f64`.
//!
//! Definitions and edge conventions are those of the BOP toolkit unless a function says otherwise.
//! `est` is the estimated pose, `gt` the true one, both `cam_from_model`; lengths are metres,
//! angles radians, image distances pixels.

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

pub use vertices::VertexSet;
