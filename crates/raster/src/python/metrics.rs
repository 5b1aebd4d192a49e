//! Bindings of [`crate::metrics`] and [`crate::rotation`].
//!
//! Arrays come as rows: `(N, 3, 3)` rotations, `(N, 3)` translations. Every argument is checked by
//! name and row before the first number is computed.
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]
#![expect(clippy::too_many_arguments, reason = "two poses are four arrays in Python")]
#![expect(non_snake_case, reason = "R is what the field, and so the Python side, calls a rotation")]

use std::ffi::CString;

use glam::{DMat3, DQuat, DVec3};
use numpy::ndarray::{Array2, Array3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;
use rayon::prelude::*;

use super::mesh::{PyMesh, points};
use crate::camera::Intrinsics;
use crate::metrics::{self, Symmetries, VertexSet};
use crate::rotation::{self, NOTABLE_DEPARTURE, NotARotation, SixD};
use crate::{Error, Pose, threads};

/// Poses that one task takes at least: a pose costs less than handing it over.
const MIN_LEN: usize = 256;

type Array1Of<'py> = Bound<'py, PyArray1<f64>>;

// ------------------------------------------------------------------------------------ rotations

/// `(N, 3, 3)` matrices as unit quaternions. Warns if some had to be projected.
fn rotations(
    py: Python<'_>,
    threads: usize,
    argument: &'static str,
    array: &PyReadonlyArray3<'_, f64>,
) -> PyResult<Vec<DQuat>> {
    let (rows, rest) = array.as_slice()?.as_chunks::<9>();
    if !rest.is_empty() {
        return Err(PyValueError::new_err(format!("{argument}: expected shape (N, 3, 3)")));
    }
    let (quaternions, notable) = py.detach(|| -> crate::Result<_> {
        // On the pool of this process: rayon's global one does not survive a fork.
        let converted = map_rows(threads, rows.len(), |row| {
            let m = &rows[row];
            rotation::from_matrix([[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]])
        })?;
        let mut notable = (0_usize, 0_usize, 0.0_f64);
        let mut quaternions = Vec::with_capacity(converted.len());
        for (row, result) in converted.into_iter().enumerate() {
            let (q, departure) = result.map_err(|found| refused(argument, row, &found))?;
            if departure > NOTABLE_DEPARTURE {
                notable.0 += 1;
                if departure > notable.2 {
                    (notable.1, notable.2) = (row, departure);
                }
            }
            quaternions.push(q);
        }
        Ok((quaternions, notable))
    })?;
    if let (count @ 1.., row, departure) = notable {
        let text = format!(
            "{argument}: {count} of {} matrices are not orthonormal (row {row} by {departure:.1e}) \
             and were replaced by the nearest rotation",
            quaternions.len()
        );
        let text = CString::new(text).expect("the text has no NUL");
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)?;
    }
    Ok(quaternions)
}

fn refused(argument: &str, row: usize, found: &NotARotation) -> Error {
    Error::NotARotation {
        argument: format!("{argument}[{row}]"),
        found: found.found(),
        expected: found.expected(),
    }
}

/// `(N, 3)` translations, all finite.
fn translations(argument: &'static str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<DVec3>> {
    let t = points(argument, array)?;
    match t.iter().position(|t| !t.is_finite()) {
        Some(row) => Err(Error::argument(
            format!("{argument}[{row}]"),
            format!("expected finite numbers, got {}", t[row]),
        )
        .into()),
        None => Ok(t),
    }
}

/// Two lists of the same length.
fn same_length(a: usize, b: usize) -> PyResult<()> {
    if a == b {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("expected arrays of the same length, got {a} and {b}")))
}

fn poses(
    py: Python<'_>,
    threads: usize,
    arguments: [&'static str; 2],
    R: &PyReadonlyArray3<'_, f64>,
    t: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Vec<Pose>> {
    let (R, t) = (rotations(py, threads, arguments[0], R)?, translations(arguments[1], t)?);
    same_length(R.len(), t.len())?;
    Ok(R.into_iter().zip(t).map(|(R, t)| Pose::new(R, t)).collect())
}

/// Estimates and ground truth, row by row.
struct Pairs {
    est: Vec<Pose>,
    gt: Vec<Pose>,
}

impl Pairs {
    fn new(
        py: Python<'_>,
        threads: usize,
        R_est: &PyReadonlyArray3<'_, f64>,
        t_est: &PyReadonlyArray2<'_, f64>,
        R_gt: &PyReadonlyArray3<'_, f64>,
        t_gt: &PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let est = poses(py, threads, ["R_est", "t_est"], R_est, t_est)?;
        let gt = poses(py, threads, ["R_gt", "t_gt"], R_gt, t_gt)?;
        same_length(est.len(), gt.len())?;
        Ok(Self { est, gt })
    }
}

fn matrices(py: Python<'_>, quaternions: Vec<DQuat>) -> Bound<'_, PyArray3<f64>> {
    let numbers = quaternions
        .into_iter()
        .flat_map(|q| DMat3::from_quat(q).transpose().to_cols_array())
        .collect::<Vec<f64>>();
    let shape = (numbers.len() / 9, 3, 3);
    Array3::from_shape_vec(shape, numbers).expect("nine numbers each").into_pyarray(py)
}

/// `(N, K)` rows through a conversion that may refuse.
fn converted<const K: usize>(
    argument: &'static str,
    array: &PyReadonlyArray2<'_, f64>,
    convert: impl Fn([f64; K]) -> Result<DQuat, NotARotation>,
) -> PyResult<Vec<DQuat>> {
    let (rows, rest) = array.as_slice()?.as_chunks::<K>();
    if !rest.is_empty() {
        return Err(PyValueError::new_err(format!("{argument}: expected shape (N, {K})")));
    }
    rows.iter()
        .enumerate()
        .map(|(row, &numbers)| {
            convert(numbers).map_err(|found| refused(argument, row, &found).into())
        })
        .collect()
}

/// `(N, 4)` to `(N, 3, 3)`.
#[pyfunction]
pub(super) fn matrix_from_quat_wxyz<'py>(
    py: Python<'py>,
    quat_wxyz: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    Ok(matrices(py, converted("quat_wxyz", &quat_wxyz, rotation::from_quat_wxyz)?))
}

/// `(N, 4)` to `(N, 3, 3)`.
#[pyfunction]
pub(super) fn matrix_from_quat_xyzw<'py>(
    py: Python<'py>,
    quat_xyzw: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    Ok(matrices(py, converted("quat_xyzw", &quat_xyzw, rotation::from_quat_xyzw)?))
}

/// `(N, 3)` to `(N, 3, 3)`.
#[pyfunction]
pub(super) fn matrix_from_axis_angle<'py>(
    py: Python<'py>,
    axis_angle: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    Ok(matrices(py, converted("axis_angle", &axis_angle, rotation::from_axis_angle)?))
}

/// `(N, 6)` to `(N, 3, 3)`.
#[pyfunction]
pub(super) fn matrix_from_6d<'py>(
    py: Python<'py>,
    rotation_6d: PyReadonlyArray2<'py, f64>,
    rows: bool,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let layout = if rows { SixD::Rows } else { SixD::Columns };
    let convert = |[a, b, c, d, e, f]: [f64; 6]| rotation::from_6d([a, b, c], [d, e, f], layout);
    Ok(matrices(py, converted("rotation_6d", &rotation_6d, convert)?))
}

/// `(N, 3, 3)` to `(N, 4)`.
#[pyfunction]
pub(super) fn quat_wxyz_from_matrix<'py>(
    py: Python<'py>,
    R: PyReadonlyArray3<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let q = rotations(py, 1, "R", &R)?;
    let wxyz = |q: &DQuat| [q.w, q.x, q.y, q.z];
    Ok(Array2::from_shape_fn((q.len(), 4), |(i, k)| wxyz(&q[i])[k]).into_pyarray(py))
}

// --------------------------------------------------------------------------------- translations

fn translation_pairs(
    t_est: &PyReadonlyArray2<'_, f64>,
    t_gt: &PyReadonlyArray2<'_, f64>,
) -> PyResult<(Vec<DVec3>, Vec<DVec3>)> {
    let (est, gt) = (translations("t_est", t_est)?, translations("t_gt", t_gt)?);
    same_length(est.len(), gt.len())?;
    Ok((est, gt))
}

/// `(N,)` metres.
#[pyfunction]
pub(super) fn translation_error<'py>(
    py: Python<'py>,
    t_est: PyReadonlyArray2<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let (est, gt) = translation_pairs(&t_est, &t_gt)?;
    let errors = py.detach(|| map_rows(threads, est.len(), |i| est[i].distance(gt[i])))?;
    Ok(errors.into_pyarray(py))
}

/// `(N,)`.
#[pyfunction]
pub(super) fn npe<'py>(
    py: Python<'py>,
    t_est: PyReadonlyArray2<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let (est, gt) = translation_pairs(&t_est, &t_gt)?;
    if let Some(row) = gt.iter().position(|t| t.length() == 0.0) {
        let message = "expected a translation above zero, for NPE divides by its norm, got zero";
        return Err(Error::argument(format!("t_gt[{row}]"), message).into());
    }
    let errors =
        py.detach(|| map_rows(threads, est.len(), |i| est[i].distance(gt[i]) / gt[i].length()))?;
    Ok(errors.into_pyarray(py))
}

/// Something for each row, on the pool; fewer than twice [`MIN_LEN`] are not shared out.
fn map_rows<T: Send>(
    threads: usize,
    n: usize,
    row: impl Fn(usize) -> T + Sync + Send,
) -> crate::Result<Vec<T>> {
    let threads = threads::or_one(threads, n < 2 * MIN_LEN);
    threads::install(threads, || (0..n).into_par_iter().with_min_len(MIN_LEN).map(row).collect())
}

// -------------------------------------------------------------------------------------- metrics

/// `(N,)` radians.
#[pyfunction]
pub(super) fn orientation_error<'py>(
    py: Python<'py>,
    R_est: PyReadonlyArray3<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let (est, gt) =
        (rotations(py, threads, "R_est", &R_est)?, rotations(py, threads, "R_gt", &R_gt)?);
    same_length(est.len(), gt.len())?;
    let errors = py.detach(|| map_rows(threads, est.len(), |i| rotation::angle(est[i], gt[i])))?;
    Ok(errors.into_pyarray(py))
}

/// `(N,)` radians.
#[pyfunction]
pub(super) fn symmetric_orientation_error<'py>(
    py: Python<'py>,
    R_est: PyReadonlyArray3<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    symmetries: PyRef<'py, PySymmetries>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let (est, gt) =
        (rotations(py, threads, "R_est", &R_est)?, rotations(py, threads, "R_gt", &R_gt)?);
    same_length(est.len(), gt.len())?;
    let symmetries = &symmetries.0;
    let turn = |q: DQuat| Pose::new(q, DVec3::ZERO);
    let error = |i: usize| metrics::rotation_angle(&turn(est[i]), &turn(gt[i]), symmetries);
    Ok(py.detach(|| map_rows(threads, est.len(), error))?.into_pyarray(py))
}

/// Run `work` for so many poses on the vertices of a mesh, without the GIL and on the pool of this
/// process.
fn on_vertices<T: Send>(
    py: Python<'_>,
    mesh: &PyMesh,
    poses: usize,
    threads: usize,
    work: impl FnOnce(&VertexSet) -> T + Send,
) -> crate::Result<T> {
    py.detach(|| {
        let set = mesh.vertex_set()?;
        threads::install(threads::or_one(threads, poses == 1), || work(set))
    })
}

/// `(N,)` metres.
#[pyfunction]
pub(super) fn add<'py>(
    py: Python<'py>,
    mesh: PyRef<'py, PyMesh>,
    R_est: PyReadonlyArray3<'py, f64>,
    t_est: PyReadonlyArray2<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let Pairs { est, gt } = Pairs::new(py, threads, &R_est, &t_est, &R_gt, &t_gt)?;
    let errors =
        on_vertices(py, &mesh, est.len(), threads, |set| metrics::add_batch(set, &est, &gt))??;
    Ok(errors.into_pyarray(py))
}

/// `(N,)` metres.
#[pyfunction]
pub(super) fn adds<'py>(
    py: Python<'py>,
    mesh: PyRef<'py, PyMesh>,
    R_est: PyReadonlyArray3<'py, f64>,
    t_est: PyReadonlyArray2<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let Pairs { est, gt } = Pairs::new(py, threads, &R_est, &t_est, &R_gt, &t_gt)?;
    let errors =
        on_vertices(py, &mesh, est.len(), threads, |set| metrics::adds_batch(set, &est, &gt))??;
    Ok(errors.into_pyarray(py))
}

/// `(T,)` numbers of poses whose ADD is below the thresholds.
#[pyfunction]
pub(super) fn add_passes<'py>(
    py: Python<'py>,
    mesh: PyRef<'py, PyMesh>,
    R_est: PyReadonlyArray3<'py, f64>,
    t_est: PyReadonlyArray2<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    thresholds_m: PyReadonlyArray1<'py, f64>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let Pairs { est, gt } = Pairs::new(py, threads, &R_est, &t_est, &R_gt, &t_gt)?;
    let thresholds = thresholds_m.as_slice()?.to_vec();
    let counts: Vec<f64> = on_vertices(py, &mesh, est.len(), threads, |set| {
        let passes = |threshold: f64| {
            (0..est.len())
                .into_par_iter()
                .with_min_len(MIN_LEN)
                .filter(|&i| metrics::add_below(set, &est[i], &gt[i], threshold))
                .count() as f64
        };
        thresholds.iter().map(|&t| passes(t)).collect()
    })?;
    Ok(counts.into_pyarray(py))
}

/// `(N,)` metres.
#[pyfunction]
pub(super) fn mssd<'py>(
    py: Python<'py>,
    mesh: PyRef<'py, PyMesh>,
    R_est: PyReadonlyArray3<'py, f64>,
    t_est: PyReadonlyArray2<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    symmetries: PyRef<'py, PySymmetries>,
    threads: usize,
) -> PyResult<Array1Of<'py>> {
    let Pairs { est, gt } = Pairs::new(py, threads, &R_est, &t_est, &R_gt, &t_gt)?;
    let transforms = symmetries.0.transforms();
    let batch = |set: &VertexSet| metrics::mssd_batch(set, &est, &gt, transforms);
    let errors = on_vertices(py, &mesh, est.len(), threads, batch)??;
    Ok(errors.into_pyarray(py))
}

/// MSPD and mean projection error, `(N,)` pixels each.
#[pyfunction]
pub(super) fn projection<'py>(
    py: Python<'py>,
    mesh: PyRef<'py, PyMesh>,
    R_est: PyReadonlyArray3<'py, f64>,
    t_est: PyReadonlyArray2<'py, f64>,
    R_gt: PyReadonlyArray3<'py, f64>,
    t_gt: PyReadonlyArray2<'py, f64>,
    symmetries: PyRef<'py, PySymmetries>,
    intrinsics: (f64, f64, f64, f64, f64, u32, u32),
    threads: usize,
) -> PyResult<(Array1Of<'py>, Array1Of<'py>)> {
    let Pairs { est, gt } = Pairs::new(py, threads, &R_est, &t_est, &R_gt, &t_gt)?;
    let (fx, fy, cx, cy, skew, width, height) = intrinsics;
    let camera = Intrinsics {
        skew,
        width: Some(width),
        height: Some(height),
        ..Intrinsics::new(fx, fy, cx, cy)?
    };
    let transforms = symmetries.0.transforms();
    let batch = |set: &VertexSet| metrics::projection_batch(set, &est, &gt, transforms, &camera);
    let errors = on_vertices(py, &mesh, est.len(), threads, batch)??;
    let (mspd, proj): (Vec<f64>, Vec<f64>) = errors.iter().map(|e| (e.mspd, e.proj)).unzip();
    Ok((mspd.into_pyarray(py), proj.into_pyarray(py)))
}

/// Transforms under which the model looks the same, the identity first.
#[pyclass(frozen, name = "Symmetries", module = "dronepose._native")]
pub(super) struct PySymmetries(Symmetries);

#[pymethods]
impl PySymmetries {
    #[new]
    fn new(
        py: Python<'_>,
        rotations: PyReadonlyArray3<'_, f64>,
        translations: PyReadonlyArray2<'_, f64>,
        axes: PyReadonlyArray2<'_, f64>,
        max_step: f64,
    ) -> PyResult<Self> {
        let discrete = poses(py, 1, ["discrete", "discrete"], &rotations, &translations)?;
        let (axes, _) = axes.as_slice()?.as_chunks::<6>();
        let continuous: Vec<_> = axes
            .iter()
            .map(|&[a, b, c, d, e, f]| (DVec3::new(a, b, c), DVec3::new(d, e, f)))
            .collect();
        Ok(Self(Symmetries::new(&discrete, &continuous, max_step)?))
    }

    /// `(S, 4, 4)`, metres.
    fn transforms<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let transforms = self.0.transforms();
        let element = |(s, i, j): (usize, usize, usize)| match (i, j) {
            (3, 3) => 1.0,
            (3, _) => 0.0,
            (_, 3) => transforms[s].translation[i],
            _ => transforms[s].matrix().col(j)[i],
        };
        Array3::from_shape_fn((transforms.len(), 4, 4), element).into_pyarray(py)
    }

    fn __len__(&self) -> usize {
        self.0.transforms().len()
    }
}
