//! The one error type of the crate: what was wrong, in which input and where, and what was expected.

use std::borrow::Cow;
use std::fmt;
use std::path::PathBuf;

/// A specialised `Result` for this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// A place in an input file, printed as `FILE:LINE:COLUMN` with the parts that make sense.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file as the user named it (`<stdin>` for standard input).
    pub file: String,
    /// Physical line, counted from 1.
    pub line: Option<u64>,
    /// Name of the column, or of a group of columns such as `qw..qz`.
    pub column: Option<String>,
}

impl Place {
    /// The whole file.
    #[must_use]
    pub fn file(file: &str) -> Self {
        Self { file: file.to_owned(), line: None, column: None }
    }

    /// A line of the file.
    #[must_use]
    pub fn line(file: &str, line: u64) -> Self {
        Self { line: Some(line), ..Self::file(file) }
    }

    /// The same place, narrowed to a column.
    #[must_use]
    pub fn column(self, column: impl Into<String>) -> Self {
        Self { column: Some(column.into()), ..self }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&visible(&self.file))?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(column) = &self.column {
            // Often text of the file: a key, an id.
            write!(f, ":{}", shortened(column.as_bytes()))?;
        }
        Ok(())
    }
}

/// Everything that can go wrong outside programmer error.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened or read.
    #[error("cannot read {}: {source}", visible(&path.to_string_lossy()))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },

    /// A file could not be written.
    #[error("cannot write {}: {source}", visible(&path.to_string_lossy()))]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },

    /// The content of a file is not what its format asks for.
    #[error("{place}: found {found}, expected {expected}")]
    Malformed {
        /// Where.
        place: Place,
        /// What was there.
        found: String,
        /// What should have been there, and the remedy.
        expected: String,
    },

    /// Two inputs do not fit together.
    #[error("{place}: {message}")]
    Mismatch {
        /// The input the user most likely wants to change.
        place: Place,
        /// What does not fit.
        message: String,
    },

    /// A face names a vertex that does not exist.
    #[error("face {face} refers to vertex {vertex}, but the mesh has {vertices} vertices")]
    FaceIndex {
        /// Index of the face.
        face: usize,
        /// The vertex index it holds.
        vertex: u64,
        /// How many vertices there are.
        vertices: usize,
    },

    /// A vertex coordinate is NaN or infinite.
    #[error("vertex {vertex} is not finite")]
    NonFiniteVertex {
        /// Index of the vertex.
        vertex: usize,
    },

    /// A point set that has to hold at least one point is empty.
    #[error("{0}: at least one point is needed")]
    NoPoints(&'static str),

    /// A matrix, quaternion or vector does not describe a rotation.
    #[error("{argument}: found {found}, expected {expected}")]
    NotARotation {
        /// The argument, with the row where there are several: `R_est[12]`.
        argument: String,
        /// What was there.
        found: String,
        /// What was expected.
        expected: &'static str,
    },

    /// An argument has a value outside its range.
    #[error("{argument}: {message}")]
    Argument {
        /// The argument's name, as the caller wrote it.
        argument: String,
        /// What is wrong with it, and what is allowed.
        message: String,
    },

    /// `--strict` was given and something would have been a warning.
    #[error("{0} (refused by --strict)")]
    Strict(String),
}

impl Error {
    /// [`Error::Malformed`] from its parts.
    pub(crate) fn malformed(
        place: Place,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Malformed { place, found: found.into(), expected: expected.into() }
    }

    /// [`Error::Argument`] from its parts.
    pub(crate) fn argument(argument: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Argument { argument: argument.into(), message: message.into() }
    }
}

/// User text shortened for a message: quoted, control characters escaped, at most 60 characters.
pub(crate) fn quoted(text: &[u8]) -> String {
    format!("'{}'", shortened(text))
}

/// As [`quoted`], without the quotes.
pub(crate) fn shortened(text: &[u8]) -> String {
    const LIMIT: usize = 60;
    let text = String::from_utf8_lossy(&text[..text.len().min(4 * LIMIT + 4)]);
    match text.char_indices().nth(LIMIT) {
        Some((end, _)) => format!("{}…", visible(&text[..end])),
        None => visible(&text).into_owned(),
    }
}

/// Text on one line, its control characters escaped, so that it cannot steer a terminal.
pub(crate) fn visible(text: &str) -> Cow<'_, str> {
    if !text.contains(char::is_control) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        if c.is_control() {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    out.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_one_short_line_whatever_the_names() {
        let place = Place::line("a\nb.csv", 3).column("\u{1b}[2J".to_owned() + &"x".repeat(1000));
        let text = place.to_string();
        assert!(text.starts_with("a\\nb.csv:3:\\u{1b}[2Jxxx"), "{text}");
        assert!(text.len() < 100, "{text}");
    }

    #[test]
    fn the_path_of_an_error_is_visible() {
        let source = std::io::Error::other("full");
        let error = Error::Write { path: "\u{7}\r.json".into(), source };
        assert_eq!(error.to_string(), "cannot write \\u{7}\\r.json: full");
    }

    #[test]
    fn quoted_text_is_cut_between_characters() {
        assert_eq!(quoted(b"a\tb"), "'a\\tb'");
        let long = "\u{1f681}".repeat(100);
        assert_eq!(quoted(long.as_bytes()), format!("'{}…'", "\u{1f681}".repeat(60)));
    }
}
