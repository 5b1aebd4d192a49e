//! Binding of [`crate::mesh::Mesh`].
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use glam::DVec3;
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::error::in_mesh;
use super::silhouette::PyModel;
use crate::mesh::Mesh;
use crate::metrics::VertexSet;
use crate::raster::Model;

/// Vertices in metres and triangles over them, with what the metrics precompute.
#[pyclass(frozen, name = "Mesh", module = "dronepose._native")]
pub(super) struct PyMesh {
    mesh: Mesh,
    /// Made when a metric first asks for it.
    vertex_set: OnceLock<VertexSet>,
    /// Made when it is first drawn.
    model: OnceLock<Arc<Model>>,
}

impl PyMesh {
    fn from_core(mesh: Mesh) -> Self {
        Self { mesh, vertex_set: OnceLock::new(), model: OnceLock::new() }
    }

    /// The mesh, in metres.
    pub(super) fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The vertices as the metrics take them.
    pub(super) fn vertex_set(&self) -> crate::Result<&VertexSet> {
        if let Some(set) = self.vertex_set.get() {
            return Ok(set);
        }
        let set = VertexSet::with_hull(self.mesh.vertices(), self.mesh.hull_candidates())?;
        Ok(self.vertex_set.get_or_init(|| set))
    }

    /// The mesh prepared for drawing.
    pub(super) fn model(&self) -> crate::Result<&Arc<Model>> {
        if let Some(model) = self.model.get() {
            return Ok(model);
        }
        let model = Arc::new(Model::from_mesh(&self.mesh)?);
        Ok(self.model.get_or_init(|| model))
    }
}

#[pymethods]
impl PyMesh {
    #[new]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, u32>,
    ) -> PyResult<Self> {
        let vertices = points("vertices", &vertices)?;
        let (faces, rest) = faces.as_slice()?.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(PyValueError::new_err("faces: expected shape (F, 3)"));
        }
        let faces = faces.to_vec();
        py.detach(|| Mesh::new(vertices, faces)).map(Self::from_core).map_err(in_mesh)
    }

    /// An OBJ, PLY or STL file, scaled to metres.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, metres_per_unit: f64) -> PyResult<Self> {
        py.detach(|| crate::io::read_mesh(&path)?.scaled(metres_per_unit))
            .map(Self::from_core)
            .map_err(in_mesh)
    }

    /// A copy, `(V, 3)`.
    fn vertices<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let v = self.mesh.vertices();
        Array2::from_shape_fn((v.len(), 3), |(i, k)| v[i][k]).into_pyarray(py)
    }

    /// A copy, `(F, 3)`.
    fn faces<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<i32>> {
        let f = self.mesh.faces();
        Array2::from_shape_fn((f.len(), 3), |(i, k)| f[i][k].cast_signed()).into_pyarray(py)
    }

    /// Metres.
    #[getter]
    fn bbox_diagonal(&self) -> f64 {
        self.mesh.bbox_diagonal()
    }

    /// Metres.
    #[getter]
    fn diameter(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.mesh.diameter())
    }

    /// Prepared for drawing; made once.
    #[pyo3(name = "model")]
    fn prepared(&self, py: Python<'_>) -> PyResult<PyModel> {
        let model = py.detach(|| self.model().cloned())?;
        Ok(PyModel::new(model))
    }

    /// Facts as JSON, and a text for people.
    fn check(&self, py: Python<'_>) -> PyResult<(String, String)> {
        let check = py.detach(|| self.mesh.check());
        let facts = serde_json::to_string(&check)
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok((facts, check.to_string()))
    }
}

/// An `(N, 3)` array as points.
pub(super) fn points(argument: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<DVec3>> {
    let (rows, rest) = array.as_slice()?.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(PyValueError::new_err(format!("{argument}: expected shape (N, 3)")));
    }
    Ok(rows.iter().copied().map(DVec3::from_array).collect())
}
