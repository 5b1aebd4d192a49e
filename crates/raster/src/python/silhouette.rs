//! Bindings of [`crate::raster`]: masks and their gradients.
//!
//! A batch is `(B, 3, 3)` rotations, `(B, 3)` translations and one camera matrix or `B` of them.
//! Masks are written into an array of the caller's, so that memory can be used again.
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]
#![expect(clippy::too_many_arguments, reason = "a batch is five arrays, a mode three numbers")]
#![expect(
    non_snake_case,
    reason = "R and K are what the field, and so the Python side, calls them"
)]

use std::sync::Arc;

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{
    IntoPyArray, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::error::MeshError;
use crate::camera::Intrinsics;
use crate::raster::{
    Batch, Gradients, KaolinCutoff, Mode, Model, Pixel, Pytorch3dCutoff, Size, Traces, View, Wanted,
};
use crate::{Error, threads};

/// How far entries of `K` that have to be 0 or 1 may be off, in pixels and for focal lengths above
/// one pixel relative to them: gradient checkers move every entry a little.
const K_TOLERANCE: f64 = 1e-4;

/// `R`, `t` and `K` gradients, and `(V, 3)` for each model if asked for.
type PyGradients<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Vec<Bound<'py, PyArray2<f64>>>,
);

/// A mesh prepared for drawing. Cheap to hand around.
#[pyclass(frozen, name = "Model", module = "dronepose._native")]
pub(super) struct PyModel(Arc<Model>);

impl PyModel {
    /// Another handle on the same model.
    pub(super) fn new(model: Arc<Model>) -> Self {
        Self(model)
    }
}

#[pymethods]
impl PyModel {
    /// `(V, 3)` metres, `(F, 3)`.
    #[new]
    fn from_arrays(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, u32>,
    ) -> PyResult<Self> {
        let vertices = rows::<3, _>("vertices", vertices.as_slice()?)?;
        let faces = rows::<3, _>("faces", faces.as_slice()?)?;
        let model = py.detach(|| Model::new(vertices, faces)).map_err(named)?;
        Ok(Self(Arc::new(model)))
    }

    /// The same faces over other vertices, `(V, 3)` metres.
    fn with_vertices(&self, py: Python<'_>, vertices: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let vertices = rows::<3, _>("vertices", vertices.as_slice()?)?;
        let model = py.detach(|| self.0.with_vertices(vertices)).map_err(named)?;
        Ok(Self(Arc::new(model)))
    }

    /// `(V, F)`.
    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.0.vertex_count(), self.0.faces().len())
    }
}

/// Errors of a model begin with the name of the argument.
fn named(error: Error) -> PyErr {
    match error {
        Error::NonFiniteVertex { vertex } => {
            MeshError::new_err(format!("vertices: vertex {vertex} is not finite"))
        }
        Error::FaceIndex { .. } => MeshError::new_err(format!("faces: {error}")),
        _ => error.into(),
    }
}

fn rows<'a, const N: usize, T>(name: &str, numbers: &'a [T]) -> PyResult<&'a [[T; N]]> {
    match numbers.as_chunks::<N>() {
        (rows, []) => Ok(rows),
        _ => Err(PyValueError::new_err(format!("{name}: expected rows of {N}"))),
    }
}

/// A mode by name, with its width (pixels for coverage, NDC otherwise) and cut-off.
fn mode_of(name: &str, width: f64, cutoff: Option<(f64, usize)>) -> PyResult<Mode> {
    match name {
        "coverage" => Ok(Mode::Coverage { sigma: width }),
        "hard" => Ok(Mode::Hard),
        "dibr" => {
            let cutoff = cutoff.map(|(boxlen, knum)| KaolinCutoff { boxlen, knum });
            Ok(Mode::Dibr { delta: width, cutoff })
        }
        "sigmoid" => {
            let cutoff = cutoff.map(|(blur_radius, faces_per_pixel)| Pytorch3dCutoff {
                blur_radius,
                faces_per_pixel,
            });
            Ok(Mode::Sigmoid { sigma: width, cutoff })
        }
        _ => Err(PyValueError::new_err(format!(
            "mode: expected 'coverage', 'hard', 'dibr' or 'sigmoid', got '{name}'"
        ))),
    }
}

/// The camera of a matrix whose fixed entries are (nearly) 0 and 1.
fn camera_of(k: &[f64; 9], row: usize) -> crate::Result<Intrinsics> {
    let [fx, skew, cx, below, fy, cy, a, b, one] = *k;
    let pixels = K_TOLERANCE * fx.abs().max(fy.abs()).max(1.0);
    let fixed = [
        (below, 0.0, pixels, "[1, 0]"),
        (a, 0.0, K_TOLERANCE, "[2, 0]"),
        (b, 0.0, K_TOLERANCE, "[2, 1]"),
        (one, 1.0, K_TOLERANCE, "[2, 2]"),
    ];
    for (found, expected, tolerance, place) in fixed {
        if (found - expected).abs() > tolerance || found.is_nan() {
            let message = format!(
                "camera {row} has {found} at {place}; expected {expected}, as in \
                 [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
            );
            return Err(Error::argument("K", message));
        }
    }
    Ok(Intrinsics { fx, fy, cx, cy, skew, width: None, height: None })
}

fn views(
    R: &PyReadonlyArray3<'_, f64>,
    t: &PyReadonlyArray2<'_, f64>,
    K: &PyReadonlyArray3<'_, f64>,
) -> PyResult<Vec<View>> {
    let (R, t, K) = (
        rows::<9, _>("R", R.as_slice()?)?,
        rows::<3, _>("t", t.as_slice()?)?,
        rows::<9, _>("K", K.as_slice()?)?,
    );
    if R.len() != t.len() {
        let message = format!(
            "R, t: expected as many rotations as translations, got {} and {}",
            R.len(),
            t.len()
        );
        return Err(PyValueError::new_err(message));
    }
    if K.len() != 1 && K.len() != R.len() {
        let message = format!("K: expected one camera or {}, got {}", R.len(), K.len());
        return Err(PyValueError::new_err(message));
    }
    let cameras: Vec<_> =
        K.iter().enumerate().map(|(row, k)| camera_of(k, row)).collect::<Result<_, _>>()?;
    let view = |(row, (r, &translation)): (usize, (&[f64; 9], &[f64; 3]))| View {
        rotation: [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]],
        translation,
        camera: cameras[if cameras.len() == 1 { 0 } else { row }],
    };
    Ok(R.iter().zip(t).enumerate().map(view).collect())
}

/// What every call says about a batch, taken apart.
struct Request<'py> {
    models: Vec<PyRef<'py, PyModel>>,
    views: Vec<View>,
    mode: Mode,
    near: Option<f64>,
    threads: usize,
}

impl Request<'_> {
    /// Run on the pool of this process, without the GIL.
    fn run<T: Send>(
        &self,
        py: Python<'_>,
        shape: &[usize],
        name: &str,
        work: impl FnOnce(&Batch<'_>) -> crate::Result<T> + Send,
    ) -> PyResult<T> {
        let &[images, height, width] = shape else { unreachable!("three axes") };
        if images != self.views.len() {
            let expected = self.views.len();
            let message = format!("{name}: expected {expected} images, got {images}");
            return Err(PyValueError::new_err(message));
        }
        let models: Vec<&Model> = self.models.iter().map(|m| &*m.0).collect();
        let (views, mode, near) = (&*self.views, self.mode, self.near);
        let size = Size { height, width };
        let threads = self.threads;
        Ok(py.detach(move || {
            let batch = Batch { models: &models, views, size, mode, near };
            batch.check()?;
            threads::install(batch.threads(threads), || work(&batch))?
        })?)
    }
}

/// An array of `f32` or `f64` that is written to.
#[derive(FromPyObject)]
pub(super) enum Out<'py> {
    #[pyo3(transparent)]
    Single(PyReadwriteArray3<'py, f32>),
    #[pyo3(transparent)]
    Double(PyReadwriteArray3<'py, f64>),
}

/// An array of `f32` or `f64` that is read.
#[derive(FromPyObject)]
pub(super) enum In<'py> {
    #[pyo3(transparent)]
    Single(PyReadonlyArray3<'py, f32>),
    #[pyo3(transparent)]
    Double(PyReadonlyArray3<'py, f64>),
}

/// What a batch of masks leaves behind for its gradients.
#[pyclass(frozen, name = "Traces", module = "dronepose._native")]
pub(super) struct PyTraces(Traces);

#[pymethods]
impl PyTraces {
    /// Memory in bytes.
    #[getter]
    fn nbytes(&self) -> usize {
        self.0.bytes()
    }
}

/// Masks into `out`, `(B, H, W)`; with `traced`, their traces for the gradients.
#[pyfunction]
pub(super) fn silhouette<'py>(
    py: Python<'py>,
    models: Vec<PyRef<'py, PyModel>>,
    R: PyReadonlyArray3<'py, f64>,
    t: PyReadonlyArray2<'py, f64>,
    K: PyReadonlyArray3<'py, f64>,
    mode: &str,
    width: f64,
    cutoff: Option<(f64, usize)>,
    near: Option<f64>,
    threads: usize,
    out: Out<'py>,
    traced: bool,
) -> PyResult<Option<PyTraces>> {
    let mode = mode_of(mode, width, cutoff)?;
    let request = Request { models, views: views(&R, &t, &K)?, mode, near, threads };
    match out {
        Out::Single(out) => draw(py, &request, out, traced),
        Out::Double(out) => draw(py, &request, out, traced),
    }
}

fn draw<T: Pixel + numpy::Element>(
    py: Python<'_>,
    request: &Request<'_>,
    mut out: PyReadwriteArray3<'_, T>,
    traced: bool,
) -> PyResult<Option<PyTraces>> {
    let shape = out.as_array().shape().to_vec();
    let pixels = out.as_slice_mut()?;
    if traced {
        let traces = request.run(py, &shape, "out", |batch| batch.draw_traced(pixels))?;
        return Ok(Some(PyTraces(traces)));
    }
    request.run(py, &shape, "out", |batch| batch.draw(pixels))?;
    Ok(None)
}

/// Gradients of `sum(upstream * masks)` for `R`, `t`, `K` and, if asked for, each model's vertices.
#[pyfunction]
pub(super) fn silhouette_gradients<'py>(
    py: Python<'py>,
    models: Vec<PyRef<'py, PyModel>>,
    R: PyReadonlyArray3<'py, f64>,
    t: PyReadonlyArray2<'py, f64>,
    K: PyReadonlyArray3<'py, f64>,
    mode: &str,
    width: f64,
    cutoff: Option<(f64, usize)>,
    near: Option<f64>,
    threads: usize,
    upstream: In<'py>,
    vertices: bool,
    traces: Option<PyRef<'py, PyTraces>>,
) -> PyResult<PyGradients<'py>> {
    let mode = mode_of(mode, width, cutoff)?;
    let request = Request { models, views: views(&R, &t, &K)?, mode, near, threads };
    let wanted = Wanted { vertices };
    let none = Traces::default();
    let traces = traces.as_ref().map_or(&none, |traces| &traces.0);
    let gradients = match upstream {
        In::Single(upstream) => back(py, &request, traces, &upstream, wanted)?,
        In::Double(upstream) => back(py, &request, traces, &upstream, wanted)?,
    };
    let views = gradients.views;
    let R = Array3::from_shape_fn((views.len(), 3, 3), |(b, i, j)| views[b].rotation[i][j]);
    let t = Array2::from_shape_fn((views.len(), 3), |(b, i)| views[b].translation[i]);
    let K = Array3::from_shape_fn((views.len(), 3, 3), |(b, i, j)| views[b].camera[i][j]);
    let vertices = gradients
        .vertices
        .into_iter()
        .map(|numbers| {
            let count = numbers.len() / 3;
            let rows = Array1::from_vec(numbers).into_shape_with_order((count, 3));
            rows.expect("three numbers each").into_pyarray(py)
        })
        .collect();
    Ok((R.into_pyarray(py), t.into_pyarray(py), K.into_pyarray(py), vertices))
}

fn back<T: Pixel + numpy::Element>(
    py: Python<'_>,
    request: &Request<'_>,
    traces: &Traces,
    upstream: &PyReadonlyArray3<'_, T>,
    wanted: Wanted,
) -> PyResult<Gradients> {
    let shape = upstream.as_array().shape().to_vec();
    let pixels = upstream.as_slice()?;
    request.run(py, &shape, "upstream", |batch| batch.gradients_of(traces, pixels, wanted))
}
