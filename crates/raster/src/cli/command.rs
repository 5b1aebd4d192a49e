//! The command `dronepose`: one parser with a subcommand for each thing it does.
//!
//! `eval` and `render` are Rust. The console script of the Python package runs further subcommands
//! itself, and names them here so that the help lists them.

use std::ffi::OsString;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use super::{Terminal, args, finish, render, run_parsed, watch_interrupts};

/// 6D drone pose: draw poses, score them.
#[derive(Debug, Parser)]
#[command(
    name = "dronepose",
    version,
    arg_required_else_help = true,
    disable_help_subcommand = true,
    max_term_width = 100,
    after_help = "'dronepose COMMAND --help' explains a command, with examples."
)]
struct Dronepose {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Render(Box<render::Args>),
    Eval(Box<args::Args>),
}

/// A subcommand that is not run here: its name and what the help says of it.
pub type Further = (String, String);

/// Run `dronepose` with `args`, the program's name first, and return its exit code: 0 done, 1 an
/// input was refused, 2 the command line was not understood.
pub fn run(
    args: Vec<OsString>,
    further: &[Further],
    out: &mut dyn Write,
    err: &mut dyn Write,
    terminal: Terminal,
) -> u8 {
    let mut parser = Dronepose::command();
    for (name, about) in further {
        parser = parser.subcommand(clap::Command::new(name.clone()).about(about.clone()));
    }
    let line: Vec<String> = args.iter().map(|a| a.to_string_lossy().into_owned()).collect();
    let parsed = parser.try_get_matches_from_mut(args).and_then(|matches| {
        Dronepose::from_arg_matches(&matches).map_err(|e| e.format(&mut parser))
    });
    match parsed {
        Ok(Dronepose { command: Command::Eval(args) }) => run_parsed(&args, out, err, terminal),
        Ok(Dronepose { command: Command::Render(args) }) => {
            render::run(&args, &line, out, err, terminal)
        }
        Err(usage) if usage.use_stderr() => {
            // If standard error is closed, nobody is left to tell.
            let _ = write!(err, "{usage}");
            2
        }
        Err(help) => finish(write!(out, "{help}"), err),
    }
}

/// [`run`] with the streams of this process. An interrupt removes unfinished outputs.
#[must_use]
pub fn main_with(args: Vec<OsString>, further: &[Further]) -> u8 {
    watch_interrupts();
    run(args, further, &mut io::stdout(), &mut io::stderr(), Terminal::detect())
}

/// [`main_with`] the arguments of this process.
#[must_use]
pub fn main() -> ExitCode {
    ExitCode::from(main_with(std::env::args_os().collect(), &[]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ran(line: &[&str], further: &[Further]) -> (u8, String, String) {
        let args = line.iter().map(OsString::from).collect();
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let code = run(args, further, &mut out, &mut err, Terminal::default());
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (code, text(out), text(err))
    }

    #[test]
    fn the_parser_is_sound_and_lists_its_commands() {
        Dronepose::command().debug_assert();
        let further = [("train".to_owned(), "Train a network".to_owned())];
        let (code, out, err) = ran(&["dronepose", "--help"], &further);
        assert_eq!((code, err.as_str()), (0, ""));
        for wanted in ["render ", "eval ", "train   Train a network"] {
            assert!(out.contains(wanted), "{out}");
        }
    }

    #[test]
    fn what_is_not_understood_ends_with_2() {
        let (code, out, err) = ran(&["dronepose", "rendr"], &[]);
        assert_eq!((code, out.as_str()), (2, ""));
        assert!(err.contains("'render'"), "{err}");
        assert_eq!(ran(&["dronepose"], &[]).0, 2);
        let further = [("train".to_owned(), String::new())];
        assert_eq!(ran(&["dronepose", "train"], &further).0, 2);
    }
}
