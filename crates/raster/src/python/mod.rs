//! The extension module `dronepose._native`: arguments in, one call of the core with the GIL
//! released, arrays out. No algorithm here; shapes and dtypes are prepared by `python/dronepose`.
//!
//! Loading the module does not import `NumPy`; the first array does.

mod cli;
mod error;
mod evaluate;
mod gbuffer;
mod losses;
mod mesh;
mod metrics;
mod shade;
mod silhouette;
mod synth;

#[pyo3::pymodule(gil_used = false)]
mod _native {
    #[pymodule_export]
    use super::cli::{cli_dronepose, cli_run};
    #[pymodule_export]
    use super::error::MeshError;
    #[pymodule_export]
    use super::evaluate::evaluate;
    #[pymodule_export]
    use super::gbuffer::{flow, gbuffer};
    #[pymodule_export]
    use super::losses::{mask_loss, scale_images, signed_distance};
    #[pymodule_export]
    use super::mesh::PyMesh;
    #[pymodule_export]
    use super::metrics::{
        PySymmetries, add, add_passes, adds, matrix_from_6d, matrix_from_axis_angle,
        matrix_from_quat_wxyz, matrix_from_quat_xyzw, mssd, npe, orientation_error, projection,
        quat_wxyz_from_matrix, symmetric_orientation_error, translation_error,
    };
    #[pymodule_export]
    use super::shade::{PyEnvironment, PyTexture, colours, srgb_bytes, srgb_linear};
    #[pymodule_export]
    use super::silhouette::{PyModel, PyTraces, silhouette, silhouette_gradients};
    #[pymodule_export]
    use super::synth::{
        PyFlight, PyPlan, PyTrack, fly_coins, free_space, read_anchors, synth_defaults,
    };

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "the name that Python gives it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
