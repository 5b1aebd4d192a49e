//! Reading and writing files, one format a module; foreign units and frames are converted on the
//! way in and out, and every refusal names file, line and remedy.

pub mod bop;
pub mod input;
pub mod mesh_file;
mod mesh_text;
#[cfg(feature = "cli")]
pub mod npy;
pub mod obj;
pub mod output;
pub mod ply;
#[cfg(feature = "cli")]
pub mod png;
pub mod pose_csv;
pub mod poses;
pub mod records;
pub mod speed;
pub mod stl;
pub mod table;

pub use mesh_file::read_mesh;
pub use poses::{Format, PoseOptions, parse_poses, read_poses};
pub use table::{PoseTable, Unit};
