//! From a flight and a scan to training data: the data set section of DronePose (Albanis et al.,
//! ECCV workshops 2020), as far as it needs no pictures.
//!
//! A [`flight`] is read, cleaned, cut and resampled; [`anchors`] are the places where somebody
//! stood in the scene, or [`free`] space of it; a [`place`]ment carries the flight into the scene; the [`rules`] choose poses
//! of the drone and views on them; the [`plan`] holds what is to be rendered.
//!
//! **World frame**: metres, z up, right-handed. A file whose z is up keeps its horizontal axes;
//! north-east-down becomes x north, y west, z up. **Body frame**: x forward, y left, z up. A pose of
//! the drone is `world_from_body`; what a camera sees is `cam_from_model`, as everywhere.

pub mod anchors;
pub mod axes;
pub mod flight;
pub mod fly;
pub mod free;
pub mod place;
pub mod plan;
pub mod rules;
