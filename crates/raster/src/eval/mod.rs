//! From two tables of poses to every number: matching, metrics, summaries.

mod results;
mod samples;

pub use results::*;
pub use samples::{Samples, Up, viewing_angles};
