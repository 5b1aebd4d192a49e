//! From two tables of poses to every number: matching, metrics, summaries.

pub mod bootstrap;
pub mod matching;
mod results;
mod samples;
pub mod summary;

pub use results::*;
pub use samples::{Samples, Up, viewing_angles};
