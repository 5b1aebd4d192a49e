//! Reading and writing files; foreign units and frames are converted on the way in and out.

pub mod bop;
pub mod input;
pub mod output;
pub mod pose_csv;
pub mod poses;
pub mod records;
pub mod speed;
pub mod table;

pub use poses::{Format, PoseOptions, parse_poses, read_poses};
pub use table::{PoseTable, Unit};
