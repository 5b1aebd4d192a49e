//! Binding of [`crate::cli`].

use std::ffi::OsString;
use std::io::Write;

use pyo3::prelude::*;

/// Run `dronepose-eval`, the program's name first; its exit code.
#[pyfunction]
pub(super) fn cli_run(py: Python<'_>, args: Vec<OsString>) -> u8 {
    py.detach(|| flushed(crate::cli::main_with(args)))
}

/// Run `dronepose`, the program's name first; its exit code. `further` are names and descriptions
/// of the subcommands that Python runs, for the help.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "lists are taken out of Python")]
pub(super) fn cli_dronepose(
    py: Python<'_>,
    args: Vec<OsString>,
    further: Vec<(String, String)>,
) -> u8 {
    py.detach(|| flushed(crate::cli::command::main_with(args, &further)))
}

/// A library's standard output is not flushed when the process ends; if its reader went away,
/// nobody is left to tell.
fn flushed(code: u8) -> u8 {
    let _ = std::io::stdout().flush();
    code
}
