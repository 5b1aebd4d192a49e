//! One format a file: reading, with file, line and remedy in every refusal.

pub mod mesh_file;
pub mod obj;
pub mod ply;
pub mod stl;
