//! Rendering with gradients, mesh geometry and 6D pose metrics for drones, in parallel.
//!
//! One convention everywhere: OpenCV camera (x right, y down, z forward), metres, radians, seconds;
//! a pose is `cam_from_model`; a quaternion is a unit `glam::DQuat`, and arguments name their
//! order (`quat_wxyz`, `quat_xyzw`).
//!
//! Silhouettes and their gradients are in [`raster`], losses that compare them in [`losses`], depth,
//! normals and optical flow in [`gbuffer`], pose errors in [`metrics`], flights, anchors and the rules that
//! make samples of them in [`synth`].
//!
//! Layers, each of which knows only those before it: `error rotation pose camera threads random mesh`, then
//! `raster`, then `losses` and `gbuffer`, then `metrics`, then `io`, then `eval` and `synth`, then `report` and
//! `draw`, then `cli`, then `python`.

pub mod camera;
#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "cli")]
pub mod draw;
pub mod error;
pub mod eval;
pub mod gbuffer;
pub mod io;
pub mod losses;
pub mod mesh;
pub mod metrics;
pub mod pose;
#[cfg(feature = "python")]
mod python;
pub mod random;
pub mod raster;
pub mod report;
pub mod rotation;
pub mod shade;
pub mod synth;
pub mod threads;

pub use error::{Error, Place, Result};
pub use mesh::Mesh;
pub use pose::Pose;

/// Whether every machine of the build's target multiplies and adds in one instruction; elsewhere
/// `mul_add` is a library call.
#[cfg_attr(
    all(target_feature = "avx2", target_feature = "fma", not(test)),
    expect(dead_code, reason = "what such a build dispatches to has the instruction anyway")
)]
pub(crate) const FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));
