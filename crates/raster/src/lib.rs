//! Mesh geometry and 6D pose metrics for drones, in parallel and exact.
//!
//! One convention everywhere: OpenCV camera (x right, y down, z forward), metres, radians, seconds;
//! a pose is `cam_from_model`; a quaternion is a unit `glam::DQuat`, and arguments name their
//! order (`quat_wxyz`, `quat_xyzw`).
//!
//! Layers, each of which knows only those before it: `rotation pose camera symmetry mesh`, then
//! `metrics`, then `io`, then `eval`, then `report`, then `cli` and `python`.

pub mod camera;
pub mod error;
pub mod eval;
pub mod metrics;
pub mod pose;
pub mod rotation;

pub use error::{Error, Place, Result};
pub use pose::Pose;
