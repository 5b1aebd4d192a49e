//! The commands as functions: the binaries and the Python console scripts both call them. Here
//! `dronepose-eval`; [`command`] is `dronepose` with its subcommands.

pub mod args;
pub mod command;
mod progress;
pub mod render;

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::Parser;

use crate::cli::args::Args;
use crate::cli::progress::Bar;
use crate::error::{Error, Place, Result, visible};
use crate::eval::per_sample::write_per_sample;
use crate::eval::{Cameras, Evaluator, Objects, Outcome, Progress, Request, Silent};
use crate::io::output::Outputs;
use crate::io::{PoseOptions, PoseTable, Unit, read_poses};
use crate::mesh::Mesh;
use crate::report::{self, Method, Report};
use crate::threads;

/// What is known of the terminal behind the streams.
#[derive(Debug, Clone, Copy, Default)]
pub struct Terminal {
    /// Standard output takes ANSI colours.
    pub color: bool,
    /// Columns of standard output; unknown if it is no terminal.
    pub width: Option<u16>,
    /// Standard error is a terminal: show progress.
    pub progress: bool,
}

impl Terminal {
    /// Of this process.
    #[must_use]
    pub fn detect() -> Self {
        let tty = io::stdout().is_terminal();
        Self {
            color: tty && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty()),
            width: tty.then(|| std::env::var("COLUMNS").ok()?.parse().ok()).flatten(),
            progress: io::stderr().is_terminal(),
        }
    }
}

/// Tables read and objects prepared for an evaluation.
struct Loaded {
    predictions: PoseTable,
    gt: PoseTable,
    others: Vec<PoseTable>,
    objects: Objects,
    cameras: Cameras,
}

/// Run `dronepose-eval` with `args`, the program's name first, and return its exit code.
///
/// 0: done, or the reader of `out` went away. 1: an input was refused. 2: the command line was not
/// understood.
pub fn run(
    args: impl IntoIterator<Item = OsString>,
    out: &mut dyn Write,
    err: &mut dyn Write,
    terminal: Terminal,
) -> u8 {
    let args = match Args::try_parse_from(args) {
        Ok(args) => args,
        Err(usage) if usage.use_stderr() => {
            let _ = write!(err, "{usage}");
            return 2;
        }
        Err(help) => return finish(write!(out, "{help}"), err),
    };
    run_parsed(&args, out, err, terminal)
}

/// The evaluation once the command line is parsed.
fn run_parsed(args: &Args, out: &mut dyn Write, err: &mut dyn Write, terminal: Terminal) -> u8 {
    let checked = args.request().and_then(|request| Ok((request, args.to_stdout()?)));
    let (request, to_stdout) = match checked {
        Ok(checked) => checked,
        Err(error) => {
            let _ = writeln!(err, "error: {error}\n\nFor more information, try '--help'.");
            return 2;
        }
    };
    match evaluate(args, &request, Given::default(), terminal) {
        Ok((outcome, printed)) => {
            if !args.quiet {
                for line in &outcome.evaluation.warnings {
                    let _ = writeln!(err, "warning: {}", visible(line));
                }
                for other in &outcome.evaluation.compare {
                    for line in &other.warnings {
                        let _ = writeln!(err, "warning: {}", visible(line));
                    }
                }
                for line in &outcome.evaluation.notes {
                    let _ = writeln!(err, "note: {}", visible(line));
                }
            }
            let text = if to_stdout || !args.quiet { printed } else { String::new() };
            finish(out.write_all(text.as_bytes()).and_then(|()| out.flush()), err)
        }
        Err(error) => {
            // If standard error is closed too, nobody is left to tell.
            let _ = writeln!(err, "error: {}", visible(&error.to_string()));
            1
        }
    }
}

/// Exit code after writing to standard output; a closed pipe is not an error.
fn finish(written: io::Result<()>, err: &mut dyn Write) -> u8 {
    match written {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            let _ = writeln!(err, "error: cannot write to standard output: {e}");
            1
        }
        _ => 0,
    }
}

/// Inputs that are already there and need not be read from the paths in the arguments.
#[derive(Debug, Default)]
pub struct Given<'a> {
    /// In the place of `PREDICTIONS`.
    pub predictions: Option<PoseTable>,
    /// In the place of `GT`.
    pub gt: Option<PoseTable>,
    /// In the place of `--mesh`, in metres.
    pub mesh: Option<&'a Mesh>,
}

/// The evaluation behind the command, for other front ends: `args` as on the command line, the
/// program's name first. Returns the JSON and the terminal table; writes the files that the
/// arguments ask for.
///
/// # Errors
/// [`Error::Argument`] for a command line that is not understood; everything that the command
/// refuses.
pub fn evaluate_args(args: &[OsString], given: Given<'_>) -> Result<(String, String)> {
    let args = Args::try_parse_from(args).map_err(|usage| {
        let text = usage.to_string();
        let first = text.lines().next().unwrap_or_default();
        Error::argument("options", first.trim_start_matches("error: "))
    })?;
    let (outcome, table) = evaluate(&args, &args.request()?, given, Terminal::default())?;
    Ok((report::json(&outcome.evaluation), table))
}

/// Read, compute and write the files; the text is for standard output.
fn evaluate(
    args: &Args,
    request: &Request,
    given: Given<'_>,
    terminal: Terminal,
) -> Result<(Outcome, String)> {
    let bar = (terminal.progress && !args.quiet).then(Bar::new);
    let progress: &dyn Progress = bar.as_ref().map_or(&Silent, |bar| bar as &dyn Progress);
    let (loaded, outcome) = threads::install(args.threads, || {
        progress.begin("reading", 0);
        let loaded = load(args, given)?;
        let evaluator = Evaluator {
            gt: &loaded.gt,
            objects: &loaded.objects,
            cameras: &loaded.cameras,
            request,
        };
        let outcome = evaluator.run(&loaded.predictions, &loaded.others, progress)?;
        Ok::<_, Error>((loaded, outcome))
    })??;
    drop(bar);
    let printed = write_outputs(args, &loaded, &outcome, terminal)?;
    Ok((outcome, printed))
}

fn load(args: &Args, given: Given<'_>) -> Result<Loaded> {
    let options = |unit: Option<args::PoseUnit>| PoseOptions {
        format: args.pose_format(),
        unit: unit.or(args.unit).map(Unit::from),
        keep: args.by.clone(),
    };
    let read = |table: Option<PoseTable>, path: &Path, unit| match table {
        Some(table) => Ok(table),
        None => read_poses(path, &options(unit)),
    };
    let poses = || {
        rayon::join(
            || read(given.predictions, &args.predictions, args.pred_unit),
            || read(given.gt, &args.gt, args.gt_unit),
        )
    };
    let ((predictions, gt), objects) = rayon::join(poses, || load_objects(args, given.mesh));
    let (mut predictions, mut gt, objects) = (predictions?, gt?, objects?);
    let mut others = Vec::with_capacity(args.compare.len());
    for path in &args.compare {
        others.push(read_poses(path, &options(args.pred_unit))?);
    }
    if !args.objects.is_empty() {
        for table in std::iter::once(&mut predictions).chain([&mut gt]).chain(&mut others) {
            keep_objects(table, &args.objects)?;
        }
    }
    let cameras = args.camera.as_deref().map(Cameras::read).transpose()?.unwrap_or_default();
    Ok(Loaded { predictions, gt, others, objects, cameras })
}

fn load_objects(args: &Args, mesh: Option<&Mesh>) -> Result<Objects> {
    let mut objects = mesh.map(Objects::from_mesh).transpose()?.unwrap_or_default();
    if let Some(mesh) = &args.mesh {
        objects.read_mesh(mesh, args.mesh_unit.map(Unit::from))?;
    }
    if let Some(symmetries) = &args.symmetries {
        objects.read_symmetries(symmetries, Unit::Millimetre, args.mesh.as_deref())?;
    }
    Ok(objects)
}

fn keep_objects(table: &mut PoseTable, objects: &[u32]) -> Result<()> {
    if table.keep_objects(objects) == 0 {
        return Err(Error::Mismatch {
            place: Place::file(&table.name).column("obj_id"),
            message: format!("--objects: found no pose of {objects:?}, expected at least one"),
        });
    }
    Ok(())
}

/// Write every file, then return what goes to standard output.
fn write_outputs(
    args: &Args,
    loaded: &Loaded,
    outcome: &Outcome,
    terminal: Terminal,
) -> Result<String> {
    let evaluation = &outcome.evaluation;
    let n_gt = evaluation.n_gt;
    let mut methods = vec![Method { name: &evaluation.name, samples: &outcome.samples, n_gt }];
    for (comparison, samples) in evaluation.compare.iter().zip(&outcome.others) {
        methods.push(Method { name: &comparison.name, samples, n_gt });
    }
    let report = Report { evaluation, methods };
    let per_sample = |out: &mut dyn Write| write_per_sample(out, &loaded.gt, &outcome.samples);
    let mut printed = None;
    let mut outputs = Outputs::default();
    let mut emit = |path: &Option<std::path::PathBuf>, text: &dyn Fn() -> String| -> Result<()> {
        match path.as_deref() {
            None => Ok(()),
            Some(path) if path == Path::new("-") => {
                printed = Some(text());
                Ok(())
            }
            Some(path) => outputs.write(path, |out| out.write_all(text().as_bytes())),
        }
    };
    emit(&args.json, &|| report::json(evaluation))?;
    emit(&args.html, &|| report::html(&report))?;
    emit(&args.markdown, &|| report::markdown(&report))?;
    emit(&args.latex, &|| report::latex(&report))?;
    match args.per_sample.as_deref() {
        None => {}
        Some(path) if path == Path::new("-") => {
            let mut text = Vec::new();
            per_sample(&mut text)
                .map_err(|source| Error::Write { path: path.to_owned(), source })?;
            printed = Some(String::from_utf8_lossy(&text).into_owned());
        }
        Some(path) => outputs.write(path, per_sample)?,
    }
    outputs.commit()?;
    Ok(printed.unwrap_or_else(|| report::table(&report, terminal.width, terminal.color)))
}

/// An interrupt (Ctrl-C), a hang-up or a request to terminate removes unfinished outputs.
fn watch_interrupts() {
    // Fails only if a handler is already there; then that one is in charge.
    let _ = ctrlc::set_handler(|| {
        let _no_more_outputs = crate::io::output::remove_unfinished();
        std::process::exit(130);
    });
}

/// [`run`] with the streams of this process. An interrupt removes unfinished outputs.
#[must_use]
pub fn main_with(args: Vec<OsString>) -> u8 {
    watch_interrupts();
    run(args, &mut io::stdout(), &mut io::stderr(), Terminal::detect())
}

/// [`main_with`] the arguments of this process.
#[must_use]
pub fn main() -> ExitCode {
    ExitCode::from(main_with(std::env::args_os().collect()))
}
