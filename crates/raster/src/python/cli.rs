//! Binding of [`crate::cli`].

use std::ffi::OsString;
use std::io::Write;

use pyo3::prelude::*;

/// Run `dronepose-eval`, the program's name first; its exit code.
#[pyfunction]
pub(super) fn cli_run(py: Python<'_>, args: Vec<OsString>) -> u8 {
    py.detach(|| {
        let code = crate::cli::main_with(args);
        // A library's standard output is not flushed when the process ends; if its reader went
        // away, nobody is left to tell.
        let _ = std::io::stdout().flush();
        code
    })
}
