//! Binding of the evaluation behind `dronepose-eval`.

use std::ffi::OsString;

use glam::DVec3;
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::mesh::PyMesh;
use crate::cli::{Given, evaluate_args};
use crate::io::PoseTable;
use crate::{Error, Pose, rotation};

/// A path, or rotations `(N, 3, 3)`, translations `(N, 3)` and `N` ids.
#[derive(FromPyObject)]
pub(super) enum Poses<'py> {
    Path(OsString),
    Arrays(PyReadonlyArray3<'py, f64>, PyReadonlyArray2<'py, f64>, Vec<String>),
}

impl Poses<'_> {
    /// The command-line argument, and the table if it is already in memory.
    fn resolve(&self, name: &str) -> PyResult<(OsString, Option<PoseTable>)> {
        let (r, t, ids) = match self {
            Self::Path(path) => return Ok((path.clone(), None)),
            Self::Arrays(r, t, ids) => (r.as_slice()?, t.as_slice()?, ids),
        };
        let (matrices, translations) = (r.as_chunks::<9>().0, t.as_chunks::<3>().0);
        if matrices.len() != translations.len() {
            let text = format!(
                "{name}: {} rotations, {} translations",
                matrices.len(),
                translations.len()
            );
            return Err(PyValueError::new_err(text));
        }
        let mut poses = Vec::with_capacity(matrices.len());
        for (row, (m, t)) in matrices.iter().zip(translations).enumerate() {
            let rows = [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]];
            let (q, _) = rotation::from_matrix(rows).map_err(|e| Error::NotARotation {
                argument: format!("{name}.R[{row}]"),
                found: e.found(),
                expected: e.expected(),
            })?;
            poses.push(Pose::new(q, DVec3::from_array(*t)));
        }
        let table = PoseTable::from_poses(name, poses, Some(ids.as_slice()))?;
        Ok((name.into(), Some(table)))
    }
}

/// Score predictions: options as on the command line; the JSON and the terminal table.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "arguments come from Python by value")]
pub(super) fn evaluate(
    py: Python<'_>,
    options: Vec<OsString>,
    predictions: Poses<'_>,
    gt: Poses<'_>,
    mesh: Option<PyRef<'_, PyMesh>>,
) -> PyResult<(String, String)> {
    let (predictions_path, predictions) = predictions.resolve("predictions")?;
    let (gt_path, gt) = gt.resolve("gt")?;
    let mut args = vec!["dronepose-eval".into()];
    args.extend(options);
    // Behind `--`, a path may begin with a dash.
    args.extend(["--".into(), predictions_path, gt_path]);
    let mesh = mesh.as_deref().map(PyMesh::mesh);
    Ok(py.detach(|| evaluate_args(&args, Given { predictions, gt, mesh }))?)
}
