//! Comma-separated records from a stream: one physical line after the other, in bounded memory,
//! with the line number of every record.
//!
//! Written here, not taken from the `csv` crate, for three things that it does not give: the
//! physical line of a record after blank lines, the line where an unclosed quote opens, and a
//! bound on what an unclosed quote swallows. Quoting is RFC 4180; line ends are LF, CR LF or CR.

use std::io::Read;

use crate::error::{Error, Place, Result, quoted};
use crate::io::input::Input;

/// A single line longer than this is refused.
const MAX_LINE: usize = 64 << 20;
/// A quoted field may run over line ends, but a record stays below this.
const MAX_QUOTED: usize = 1 << 20;

/// More blank lines in a row are no table, but gigabytes in a small packed file.
const MAX_BLANK: u64 = 10_000_000;
/// More fields than any table has; a line of commas would take sixteen times its size.
const MAX_FIELDS: usize = 100_000;

/// Reads records; the fields of the latest one are borrowed from it.
#[derive(Debug)]
pub struct Records {
    input: Input,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    at_eof: bool,
    skip_lf: bool,
    line: u64,
    unquoted: Vec<u8>,
    joined: Vec<u8>,
    /// Met while reading ahead; reported when the lines before it are used up.
    failed: Option<Error>,
}

/// What stands between two fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separator {
    /// A comma.
    Comma,
    /// A tab.
    Tab,
    /// Any white space, of any length.
    Space,
}

/// One record: its fields and where it begins.
#[derive(Debug)]
pub struct Record<'a> {
    /// Physical line of its first character, from 1.
    pub line: u64,
    text: &'a [u8],
}

impl<'a> Record<'a> {
    /// The fields, white space around them removed, quotes taken off.
    pub fn split_into(&self, fields: &mut Vec<&'a [u8]>) {
        fields.clear();
        let mut from = 0;
        for comma in memchr::memchr_iter(b',', self.text) {
            fields.push(self.text[from..comma].trim_ascii());
            from = comma + 1;
        }
        fields.push(self.text[from..].trim_ascii());
    }

    /// The fields between separators of a kind, white space around them removed; of more than
    /// 100,000 only the first.
    pub fn split_by(&self, separator: Separator, fields: &mut Vec<&'a [u8]>) {
        fields.clear();
        match separator {
            Separator::Comma => self.split_into(fields),
            Separator::Tab => {
                let parts = self.text.split(|&b| b == b'\t').take(MAX_FIELDS);
                fields.extend(parts.map(<[u8]>::trim_ascii));
            }
            Separator::Space => {
                let parts = self.text.split(u8::is_ascii_whitespace).filter(|f| !f.is_empty());
                fields.extend(parts.take(MAX_FIELDS));
            }
        }
    }

    /// The line as it is, without quotes and line end.
    #[must_use]
    pub fn text(&self) -> &'a [u8] {
        self.text
    }
}

/// Calls `each` with every record of whole lines that need no state to be read: without a quote,
/// ended by LF or CR LF. Lines are counted from 1. Returns how many there are, blank ones too;
/// `None` for other lines, or as soon as `each` says so.
pub(crate) fn plain_records<'a>(
    lines: &'a [u8],
    mut each: impl FnMut(Record<'a>) -> Option<()>,
) -> Option<u64> {
    let lone = |k: usize| lines[k] == b'"' || lines.get(k + 1) != Some(&b'\n');
    if memchr::memchr2_iter(b'"', b'\r', lines).any(lone) {
        return None;
    }
    let (mut line, mut from) = (0, 0);
    for end in memchr::memchr_iter(b'\n', lines) {
        let text = &lines[from..end];
        (from, line) = (end + 1, line + 1);
        if !text.trim_ascii_start().is_empty() {
            each(Record { line, text: text.strip_suffix(b"\r").unwrap_or(text) })?;
        }
    }
    (from == lines.len()).then_some(line)
}

/// Separator that stands for a comma inside quotes while a quoted record is taken apart; it
/// cannot occur in UTF-8.
const QUOTED_COMMA: u8 = 0xff;

/// The text of a field as UTF-8.
///
/// # Errors
/// `None` if the bytes are not UTF-8.
#[must_use]
pub fn text(field: &[u8]) -> Option<std::borrow::Cow<'_, str>> {
    if memchr::memchr(QUOTED_COMMA, field).is_none() {
        return std::str::from_utf8(field).ok().map(Into::into);
    }
    let restored = field.iter().map(|&b| if b == QUOTED_COMMA { b',' } else { b }).collect();
    String::from_utf8(restored).ok().map(Into::into)
}

impl Records {
    /// Read from `input`; a byte-order mark is skipped.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn new(input: Input) -> Result<Self> {
        let mut records = Self {
            input,
            buffer: vec![0; 1 << 18],
            start: 0,
            end: 0,
            at_eof: false,
            skip_lf: false,
            line: 0,
            unquoted: Vec::new(),
            joined: Vec::new(),
            failed: None,
        };
        records.fill()?;
        if records.buffer[..records.end].starts_with(b"\xef\xbb\xbf") {
            records.start = 3;
        }
        Ok(records)
    }

    /// The name of the input.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.input.name
    }

    /// The line of the latest record.
    pub(crate) fn line(&self) -> u64 {
        self.line
    }

    /// The input behind, after the last record.
    #[must_use]
    pub fn into_input(self) -> Input {
        self.input
    }

    /// Read more behind what is there, making room first. False at the end of the input.
    fn fill(&mut self) -> Result<bool> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        if self.at_eof {
            return Ok(false);
        }
        if self.start > 0 {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
        }
        if self.end == self.buffer.len() {
            if self.end >= MAX_LINE {
                return Err(Error::malformed(
                    Place::line(self.name(), self.line + 1),
                    format!("a line of more than {} MiB", MAX_LINE >> 20),
                    "rows of numbers",
                ));
            }
            self.buffer.resize(2 * self.end, 0);
        }
        let path = self.input.name.clone();
        let n = loop {
            match self.input.read(&mut self.buffer[self.end..]) {
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(source) => return Err(Error::Read { path: path.into(), source }),
                Ok(n) => break n,
            }
        };
        self.end += n;
        self.at_eof = n == 0;
        Ok(n > 0)
    }

    /// Bounds of the next physical line in the buffer, without its end.
    fn next_line(&mut self) -> Result<Option<(usize, usize)>> {
        let mut scanned = 0;
        loop {
            if self.skip_lf && self.start < self.end {
                self.skip_lf = false;
                if self.buffer[self.start] == b'\n' {
                    self.start += 1;
                }
            }
            let rest = &self.buffer[self.start + scanned..self.end];
            if let Some(k) = memchr::memchr2(b'\n', b'\r', rest) {
                let bounds = (self.start, self.start + scanned + k);
                self.skip_lf = rest[k] == b'\r';
                self.start = bounds.1 + 1;
                self.line += 1;
                return Ok(Some(bounds));
            }
            scanned = self.end - self.start;
            if !self.fill()? {
                if self.start == self.end {
                    return Ok(None);
                }
                let bounds = (self.start, self.end);
                self.start = self.end;
                self.line += 1;
                return Ok(Some(bounds));
            }
        }
    }

    /// Move about `size` bytes of whole lines, ended by LF, to `lines`. False if there are none:
    /// the rest is for [`Records::next_record`], errors of reading too.
    ///
    /// The caller says by [`Records::used`] how many lines it has read, and gives back by
    /// [`Records::unread`] what it could not.
    pub(crate) fn take_lines(&mut self, size: usize, lines: &mut Vec<u8>) -> bool {
        lines.clear();
        while self.end - self.start < size && self.failed.is_none() {
            match self.fill() {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => self.failed = Some(error),
            }
        }
        if self.skip_lf && self.start < self.end {
            self.skip_lf = false;
            self.start += usize::from(self.buffer[self.start] == b'\n');
        }
        let ahead = &self.buffer[self.start..self.end.min(self.start + size)];
        let Some(last) = memchr::memrchr(b'\n', ahead) else { return false };
        lines.extend_from_slice(&ahead[..=last]);
        self.start += last + 1;
        true
    }

    /// So many lines were read elsewhere.
    pub(crate) fn used(&mut self, lines: u64) {
        self.line += lines;
    }

    /// Put lines back in front of what comes next.
    pub(crate) fn unread(&mut self, lines: &[u8]) {
        let rest = self.start..self.end;
        let mut buffer = Vec::with_capacity(lines.len() + self.buffer.len());
        buffer.extend_from_slice(lines);
        buffer.extend_from_slice(&self.buffer[rest]);
        (self.start, self.end) = (0, buffer.len());
        self.buffer = buffer;
    }

    /// The next record that is not blank, or `None` at the end.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Malformed`] for an unclosed or misplaced quote, a line of more
    /// than 64 MiB or 100,000 fields.
    pub fn next_record(&mut self) -> Result<Option<Record<'_>>> {
        let last = self.line;
        let (from, to) = loop {
            let Some(bounds) = self.next_line()? else { return Ok(None) };
            if !self.buffer[bounds.0..bounds.1].trim_ascii().is_empty() {
                break bounds;
            }
            if self.line - last > MAX_BLANK {
                return Err(Error::malformed(
                    Place::line(self.name(), last + 1),
                    format!("more than {MAX_BLANK} blank lines"),
                    "rows of numbers",
                ));
            }
        };
        let line = self.line;
        let quotes = memchr::memchr(b'"', &self.buffer[from..to]).is_some();
        if quotes {
            self.join_quoted(from, to)?;
            self.take_off_quotes(line)?;
        }
        let text = if quotes { &self.unquoted } else { &self.buffer[from..to] };
        if text.len() >= MAX_FIELDS && memchr::memchr_iter(b',', text).nth(MAX_FIELDS - 1).is_some()
        {
            return Err(Error::malformed(
                Place::line(self.name(), line),
                format!("more than {MAX_FIELDS} fields"),
                "a table of poses",
            ));
        }
        Ok(Some(Record { line, text }))
    }

    /// Gather lines until the quotes are balanced.
    fn join_quoted(&mut self, from: usize, to: usize) -> Result<()> {
        let opened = self.line;
        self.joined.clear();
        self.joined.extend_from_slice(&self.buffer[from..to]);
        let mut quotes = memchr::memchr_iter(b'"', &self.joined).count();
        while quotes % 2 == 1 {
            let next = if self.joined.len() > MAX_QUOTED { None } else { self.next_line()? };
            let Some((from, to)) = next else {
                return Err(Error::malformed(
                    Place::line(self.name(), opened).column(unclosed_column(&self.joined)),
                    "a quote that is never closed",
                    "a closing quote before the end of the field",
                ));
            };
            let line = &self.buffer[from..to];
            quotes += memchr::memchr_iter(b'"', line).count();
            self.joined.push(b'\n');
            self.joined.extend_from_slice(line);
        }
        Ok(())
    }

    fn take_off_quotes(&mut self, line: u64) -> Result<()> {
        self.unquoted.clear();
        let mut bytes = self.joined.iter().copied().peekable();
        let mut inside = false;
        let mut field_start = 0;
        while let Some(b) = bytes.next() {
            match b {
                b'"' if inside => {
                    if bytes.peek() == Some(&b'"') {
                        bytes.next();
                        self.unquoted.push(b'"');
                    } else {
                        inside = false;
                        let mut rest = bytes.clone();
                        let after = rest.find(|c| !matches!(c, b' ' | b'\t'));
                        if after.is_some_and(|c| c != b',') {
                            return Err(misplaced(&self.input.name, line, &self.joined));
                        }
                    }
                }
                b'"' => {
                    if !self.unquoted[field_start..].trim_ascii().is_empty() {
                        return Err(misplaced(&self.input.name, line, &self.joined));
                    }
                    self.unquoted.truncate(field_start);
                    inside = true;
                }
                b',' if inside => self.unquoted.push(QUOTED_COMMA),
                b',' => {
                    self.unquoted.push(b);
                    field_start = self.unquoted.len();
                }
                _ => self.unquoted.push(b),
            }
        }
        Ok(())
    }
}

/// Number of the field that holds the last quote, as a column name.
fn unclosed_column(record: &[u8]) -> String {
    let mut inside = false;
    let mut field = 1;
    let mut opened = 1;
    for &b in record {
        match b {
            b'"' => {
                inside = !inside;
                opened = field;
            }
            b',' if !inside => field += 1,
            _ => {}
        }
    }
    format!("field {opened}")
}

fn misplaced(name: &str, line: u64, record: &[u8]) -> Error {
    Error::malformed(
        Place::line(name, line),
        format!("a quote inside a field, in {}", quoted(record)),
        "quotes around a whole field, and doubled inside it",
    )
}

#[cfg(test)]
mod tests;
