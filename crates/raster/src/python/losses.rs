//! Bindings of [`crate::losses`]. Results are written into arrays of the caller's.
#![expect(clippy::needless_pass_by_value, reason = "array borrows come by value")]
#![expect(
    clippy::too_many_arguments,
    reason = "two masks, a loss of four numbers, an array to fill"
)]

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray3, PyReadwriteArray3};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use super::silhouette::{In, Out};
use crate::losses::{self, Loss, Sample, Size};
use crate::threads;

/// A loss by name.
fn loss_of(name: &str, size: usize, sigmas: Vec<f64>, eps: f64) -> PyResult<Loss> {
    let sigma = || match *sigmas {
        [sigma] => Ok(sigma),
        _ => Err(PyValueError::new_err(format!("sigma: expected one, got {}", sigmas.len()))),
    };
    match name {
        "box" => Ok(Loss::Box { size }),
        "gaussian" => Ok(Loss::Gaussian { size, sigma: sigma()? }),
        "blurred" => Ok(Loss::Blurred { sigma: sigma()? }),
        "tanimoto" => Ok(Loss::Tanimoto { sigmas, eps }),
        _ => Err(PyValueError::new_err(format!(
            "name: expected 'box', 'gaussian', 'tanimoto' or 'blurred', got '{name}'"
        ))),
    }
}

/// Refuses another shape than the first array's.
fn same(name: &str, found: &[usize], expected: &[usize]) -> PyResult<()> {
    if found == expected {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{name}: expected shape {expected:?}, got {found:?}")))
}

fn mixed() -> PyErr {
    PyTypeError::new_err("pred, target: expected arrays of one dtype, float32 or float64")
}

/// The loss of each image, `(B,)`, and its gradient for `pred` into `gradient` if there is one.
#[pyfunction]
pub(super) fn mask_loss<'py>(
    py: Python<'py>,
    name: &str,
    size: usize,
    sigmas: Vec<f64>,
    eps: f64,
    pred: In<'py>,
    target: In<'py>,
    gradient: Option<Out<'py>>,
    threads: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let loss = loss_of(name, size, sigmas, eps)?;
    match (pred, target, gradient) {
        (In::Single(p), In::Single(t), None) => evaluate(py, &loss, p, t, None, threads),
        (In::Double(p), In::Double(t), None) => evaluate(py, &loss, p, t, None, threads),
        (In::Single(p), In::Single(t), Some(Out::Single(g))) => {
            evaluate(py, &loss, p, t, Some(g), threads)
        }
        (In::Double(p), In::Double(t), Some(Out::Double(g))) => {
            evaluate(py, &loss, p, t, Some(g), threads)
        }
        _ => Err(mixed()),
    }
}

fn evaluate<'py, T: Sample + numpy::Element>(
    py: Python<'py>,
    loss: &Loss,
    pred: PyReadonlyArray3<'py, T>,
    target: PyReadonlyArray3<'py, T>,
    mut gradient: Option<PyReadwriteArray3<'py, T>>,
    threads: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let shape = pred.as_array().shape().to_vec();
    same("target", target.as_array().shape(), &shape)?;
    if let Some(gradient) = &gradient {
        same("gradient", gradient.as_array().shape(), &shape)?;
    }
    let size = Size { height: shape[1], width: shape[2] };
    let mut values = vec![0.0; shape[0]];
    let (pred, target) = (pred.as_slice()?, target.as_slice()?);
    let gradient = gradient.as_mut().map(|g| g.as_slice_mut()).transpose()?;
    let all = &mut values;
    py.detach(move || {
        // Images are done side by side, a single one is not shared out.
        let threads = threads::or_one(threads, all.len() == 1);
        threads::install(threads, || loss.evaluate(pred, target, size, all, gradient))?
    })?;
    Ok(values.into_pyarray(py))
}

/// Each image times its number, into `out`.
#[pyfunction]
pub(super) fn scale_images<'py>(
    py: Python<'py>,
    images: In<'py>,
    factors: PyReadonlyArray1<'py, f64>,
    out: Out<'py>,
    threads: usize,
) -> PyResult<()> {
    let factors = factors.as_slice()?;
    match (images, out) {
        (In::Single(images), Out::Single(out)) => scale(py, images, factors, out, threads),
        (In::Double(images), Out::Double(out)) => scale(py, images, factors, out, threads),
        _ => Err(mixed()),
    }
}

fn scale<'py, T: Sample + numpy::Element>(
    py: Python<'py>,
    images: PyReadonlyArray3<'py, T>,
    factors: &[f64],
    mut out: PyReadwriteArray3<'py, T>,
    threads: usize,
) -> PyResult<()> {
    let shape = images.as_array().shape().to_vec();
    same("out", out.as_array().shape(), &shape)?;
    same("factors", &[factors.len()], &shape[..1])?;
    let factors: Vec<T> = factors.iter().map(|&f| T::from_f64(f)).collect();
    let (images, out) = (images.as_slice()?, out.as_slice_mut()?);
    let pixels = (shape[1] * shape[2]).max(1);
    let work = || losses::scale(images, &factors, pixels, out);
    Ok(py.detach(move || threads::install(threads::or_one(threads, shape[0] == 1), work))?)
}

/// Signed distances in pixels to the outlines of `target > 1/2`, into `out`.
#[pyfunction]
pub(super) fn signed_distance<'py>(
    py: Python<'py>,
    target: In<'py>,
    out: Out<'py>,
    threads: usize,
) -> PyResult<()> {
    match (target, out) {
        (In::Single(target), Out::Single(out)) => distances(py, target, out, threads),
        (In::Double(target), Out::Double(out)) => distances(py, target, out, threads),
        _ => Err(mixed()),
    }
}

fn distances<'py, T: Sample + numpy::Element>(
    py: Python<'py>,
    target: PyReadonlyArray3<'py, T>,
    mut out: PyReadwriteArray3<'py, T>,
    threads: usize,
) -> PyResult<()> {
    let shape = target.as_array().shape().to_vec();
    same("out", out.as_array().shape(), &shape)?;
    let size = Size { height: shape[1], width: shape[2] };
    let (target, out) = (target.as_slice()?, out.as_slice_mut()?);
    let work = || losses::signed_distance(target, size, out);
    Ok(py.detach(move || threads::install(threads::or_one(threads, shape[0] == 1), work))?)
}
