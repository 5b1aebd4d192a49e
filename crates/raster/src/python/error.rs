//! Core errors as Python exceptions: the standard class where one fits, ours where none does.

use std::io::ErrorKind;

use pyo3::PyErr;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyPermissionError, PyValueError};

use crate::Error;

pyo3::create_exception!(
    dronepose._native,
    MeshError,
    PyValueError,
    "A mesh file or a mesh array that is not a usable mesh."
);

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        let text = error.to_string();
        match error {
            Error::Read { source, .. } | Error::Write { source, .. } => match source.kind() {
                ErrorKind::NotFound => PyFileNotFoundError::new_err(text),
                ErrorKind::PermissionDenied => PyPermissionError::new_err(text),
                _ => PyOSError::new_err(text),
            },
            Error::FaceIndex { .. } | Error::NonFiniteVertex { .. } | Error::NoPoints(_) => {
                MeshError::new_err(text)
            }
            _ => PyValueError::new_err(text),
        }
    }
}

/// An error in a mesh file: everything but the operating system's errors is a [`MeshError`].
pub(super) fn in_mesh(error: Error) -> PyErr {
    match error {
        Error::Read { .. } | Error::Write { .. } => error.into(),
        _ => MeshError::new_err(error.to_string()),
    }
}
