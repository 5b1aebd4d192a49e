//! From two tables of poses to every number: matching, metrics, summaries.

mod blunders;
pub mod bootstrap;
mod compute;
mod evaluate;
mod groups;
pub mod matching;
pub mod objects;
pub mod per_sample;
pub mod request;
mod results;
mod samples;
pub mod summary;

pub use evaluate::{Evaluator, Outcome};
pub use objects::{Cameras, MeshModel, Object, Objects};
pub use request::{Choice, Level, Preset, Progress, Reference, Request, Silent};
pub use results::*;
pub use samples::{Samples, Up, viewing_angles};
