//! Poses from CSV: `id,qw,qx,qy,qz,tx,ty,tz` in any order, or a 3x3 matrix `r11..r33`, or an
//! axis-angle vector `rx,ry,rz`; further columns are ignored or kept for `--by`.
//!
//! Columns are found by name, so the order of a quaternion cannot be mistaken.

use rayon::prelude::*;

use crate::error::{Error, Place, Result, quoted};
use crate::io::input::Input;
use crate::io::records::{Records, plain_records, text};
use crate::io::table::{
    Departures, ExtraColumn, PoseTable, Strings, Unit, not_a_rotation, row_limit, translation,
};
use crate::pose::Pose;
use crate::rotation;

const QUAT: [&str; 4] = ["qw", "qx", "qy", "qz"];
const MATRIX: [&str; 9] = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"];
const AXIS_ANGLE: [&str; 3] = ["rx", "ry", "rz"];
const TRANSLATION: [&str; 3] = ["tx", "ty", "tz"];

/// Bytes that a thread parses at a time.
const PIECE: usize = 1 << 18;

/// What the reader should do with a file.
#[derive(Debug, Clone, Copy)]
pub struct CsvOptions<'a> {
    /// Unit of `tx,ty,tz`.
    pub unit: Unit,
    /// Extra columns to keep; names compare without case.
    pub keep: &'a [String],
}

enum RotationColumns {
    Quat([usize; 4]),
    Matrix([usize; 9]),
    AxisAngle([usize; 3]),
}

struct Columns {
    names: Vec<String>,
    id: usize,
    rotation: RotationColumns,
    translation: [usize; 3],
    keep: Vec<usize>,
}

/// Read a pose CSV to its end.
///
/// # Errors
/// [`Error::Malformed`] naming line and column; [`Error::Read`].
pub fn read_pose_csv(input: Input, options: CsvOptions<'_>) -> Result<PoseTable> {
    let mut records = Records::new(input)?;
    let name = records.name().to_owned();
    let (columns, mut warnings) = header(&mut records, options)?;
    let mut table = Rows::new(&name, &columns, options);
    read_plain(&mut records, &mut table, options);
    // The fields borrow from the record, so this allocation serves one line; it is taken back by
    // `recycle` for the next.
    let mut fields: Vec<&[u8]> = Vec::new();
    loop {
        let mut current = recycle(fields);
        let record = match records.next_record() {
            Ok(Some(record)) => record,
            Ok(None) => break,
            Err(e) => return Err(name_field(e, &columns.names)),
        };
        record.split_into(&mut current);
        table.push(record.line, &current)?;
        fields = recycle(current);
    }
    if table.poses.is_empty() {
        return Err(Error::malformed(
            Place::file(&name),
            "a header without any row",
            "at least one row of poses below it",
        ));
    }
    warnings.extend(table.departures.warnings());
    let Rows { ids, poses, lines, extra, .. } = table;
    Ok(PoseTable {
        source: records.into_input().finish("csv")?,
        name,
        unit: options.unit,
        ids,
        poses,
        lines,
        targets: None,
        scores: None,
        extra,
        warnings,
    })
}

/// Read plain lines, blocks of them in parallel while the next ones are being read from the file,
/// up to the first that is not plain or not sound. That one and all behind it are left to the slow
/// way, which also words the error; so the first error of the file is the one reported.
fn read_plain(records: &mut Records, table: &mut Rows<'_>, options: CsvOptions<'_>) {
    // Only on a pool: rayon's global one is not for us (see `threads`).
    let threads = rayon::current_thread_index().map_or(1, |_| rayon::current_num_threads());
    let size = PIECE * if threads == 1 { 1 } else { 2 * threads.min(32) };
    let (mut block, mut next) = (Vec::new(), Vec::new());
    let mut more = records.take_lines(size, &mut block);
    while more {
        let pieces = cut(&block);
        let parse = |lines: &&[u8]| {
            let mut rows = Rows::new(table.name, table.columns, options);
            let mut fields = Vec::with_capacity(table.columns.names.len());
            let count = plain_records(lines, |record| {
                record.split_into(&mut fields);
                rows.push(record.line, &fields).ok()
            })?;
            Some((rows, count))
        };
        let mut ahead = || records.take_lines(size, &mut next);
        let (parsed, taken): (Vec<_>, bool) = if threads == 1 {
            (pieces.iter().map(parse).collect(), ahead())
        } else {
            rayon::join(|| pieces.par_iter().map(parse).collect(), ahead)
        };
        let mut done = 0;
        for (piece, parsed) in pieces.iter().zip(parsed) {
            let fits = |more: &Rows<'_>| {
                row_limit(table.poses.len() + more.poses.len(), table.name).is_ok()
            };
            let Some((rows, count)) = parsed.filter(|(rows, _)| fits(rows)) else {
                if taken {
                    records.unread(&next);
                }
                records.unread(&block[done..]);
                return;
            };
            table.append(rows, records.line());
            records.used(count);
            done += piece.len();
        }
        std::mem::swap(&mut block, &mut next);
        more = taken;
    }
}

/// Whole lines, cut behind line ends into pieces of about [`PIECE`] bytes.
fn cut(mut lines: &[u8]) -> Vec<&[u8]> {
    let mut pieces = Vec::with_capacity(lines.len() / PIECE + 1);
    while let Some(end) = lines.get(PIECE..).and_then(|rest| memchr::memchr(b'\n', rest)) {
        let (piece, rest) = lines.split_at(PIECE + end + 1);
        pieces.push(piece);
        lines = rest;
    }
    if !lines.is_empty() {
        pieces.push(lines);
    }
    pieces
}

/// An empty vector of another lifetime with the same allocation.
fn recycle<'b>(mut fields: Vec<&[u8]>) -> Vec<&'b [u8]> {
    fields.clear();
    fields.into_iter().map(|_| -> &'b [u8] { &[] }).collect()
}

/// Put the header's name in the place of `field 3`.
fn name_field(error: Error, names: &[String]) -> Error {
    let Error::Malformed { mut place, found, expected } = error else { return error };
    let field = place.column.as_deref().and_then(|c| c.strip_prefix("field ")?.parse().ok());
    if let Some(name) = field.and_then(|k: usize| names.get(k.wrapping_sub(1))) {
        place.column = Some(name.clone());
    }
    Error::Malformed { place, found, expected }
}

/// Rows read so far.
struct Rows<'a> {
    name: &'a str,
    columns: &'a Columns,
    unit: Unit,
    ids: Strings,
    poses: Vec<Pose>,
    lines: Vec<u32>,
    extra: Vec<ExtraColumn>,
    departures: Departures,
}

impl<'a> Rows<'a> {
    fn new(name: &'a str, columns: &'a Columns, options: CsvOptions<'_>) -> Self {
        let extra = columns
            .keep
            .iter()
            .map(|&k| ExtraColumn { name: columns.names[k].clone(), values: Strings::default() });
        Self {
            name,
            columns,
            unit: options.unit,
            ids: Strings::default(),
            poses: Vec::new(),
            lines: Vec::new(),
            extra: extra.collect(),
            departures: Departures::default(),
        }
    }

    /// Add the rows that follow, whose lines were counted from `lines_before`.
    fn append(&mut self, more: Self, lines_before: u64) {
        self.ids.append(&more.ids);
        self.poses.extend(more.poses);
        let line = |l: u32| u32::try_from(u64::from(l) + lines_before).unwrap_or(u32::MAX);
        self.lines.extend(more.lines.into_iter().map(line));
        for (column, more) in self.extra.iter_mut().zip(&more.extra) {
            column.values.append(&more.values);
        }
        self.departures.append(more.departures, lines_before);
    }

    fn push(&mut self, line: u64, fields: &[&[u8]]) -> Result<()> {
        let columns = self.columns;
        let place = |column: &str| Place::line(self.name, line).column(column);
        if fields.len() != columns.names.len() {
            return Err(Error::malformed(
                Place::line(self.name, line),
                format!("{} fields", fields.len()),
                format!("{}, as in the header", columns.names.len()),
            ));
        }
        row_limit(self.poses.len(), self.name)?;
        let number = |k: usize| number(fields[k], || place(&columns.names[k]));
        let id = read_id(fields[columns.id], || place("id"))?;
        let rotation = match &columns.rotation {
            RotationColumns::Quat([w, x, y, z]) => {
                let q = [number(*w)?, number(*x)?, number(*y)?, number(*z)?];
                self.departures.quat_wxyz(q, || place("qw..qz"))?
            }
            RotationColumns::Matrix(k) => {
                let mut rows = [[0.0; 3]; 3];
                for (m, &k) in rows.as_flattened_mut().iter_mut().zip(k) {
                    *m = number(k)?;
                }
                self.departures.matrix(rows, || place("r11..r33"))?
            }
            RotationColumns::AxisAngle([x, y, z]) => {
                let r = [number(*x)?, number(*y)?, number(*z)?];
                rotation::from_axis_angle(r).map_err(|e| not_a_rotation(place("rx..rz"), e))?
            }
        };
        let [x, y, z] = columns.translation;
        let t = [number(x)?, number(y)?, number(z)?];
        let translation = translation(t, self.unit, || place("tx..tz"))?;
        for (column, &k) in self.extra.iter_mut().zip(&columns.keep) {
            let value = text(fields[k]).ok_or_else(|| {
                not_utf8(Place::line(self.name, line).column(&columns.names[k]), fields[k])
            })?;
            column.values.push(&value);
        }
        self.ids.push(&id);
        self.poses.push(Pose::new(rotation, translation));
        self.lines.push(u32::try_from(line).unwrap_or(u32::MAX));
        Ok(())
    }
}

fn not_utf8(place: Place, field: &[u8]) -> Error {
    Error::malformed(place, format!("bytes that are not UTF-8 in {}", quoted(field)), "UTF-8 text")
}

/// A finite decimal number.
pub(crate) fn number(field: &[u8], place: impl Fn() -> Place) -> Result<f64> {
    let parsed = fast_float2::parse::<f64, _>(field).ok();
    match parsed {
        Some(x) if x.is_finite() => Ok(x),
        _ => {
            let found = if field.is_empty() { "an empty field".into() } else { quoted(field) };
            let expected = match parsed {
                Some(x) if x.is_infinite() && field.iter().any(u8::is_ascii_digit) => {
                    "a finite number (this one is beyond 1.8e308)"
                }
                _ => "a finite number such as -0.25 or 1.5e-3",
            };
            Err(Error::malformed(place(), found, expected))
        }
    }
}

/// An id: any text that is not empty.
pub(crate) fn read_id(
    field: &[u8],
    place: impl Fn() -> Place,
) -> Result<std::borrow::Cow<'_, str>> {
    let id = text(field).ok_or_else(|| not_utf8(place(), field))?;
    if id.is_empty() {
        return Err(Error::malformed(place(), "an empty id", "a name for every sample"));
    }
    Ok(id)
}

/// Find the columns; the second value holds warnings.
fn header(records: &mut Records, options: CsvOptions<'_>) -> Result<(Columns, Vec<String>)> {
    let file = records.name().to_owned();
    let Some(record) = records.next_record()? else {
        return Err(Error::malformed(
            Place::file(&file),
            "an empty file",
            "a header line such as id,qw,qx,qy,qz,tx,ty,tz",
        ));
    };
    let line = record.line;
    let mut fields = Vec::new();
    record.split_into(&mut fields);
    let mut names = Vec::with_capacity(fields.len());
    for field in &fields {
        let name = text(field).ok_or_else(|| not_utf8(Place::line(&file, line), field))?;
        names.push(name.to_ascii_lowercase());
    }
    let mut by_name = std::collections::HashMap::with_capacity(names.len());
    let mut twice = None;
    for (k, name) in names.iter().enumerate() {
        if by_name.insert(name.as_str(), k).is_some() && twice.is_none() {
            twice = Some(name.as_str());
        }
    }
    let find = |wanted: &str| by_name.get(wanted).copied();
    if !by_name.contains_key("id") || TRANSLATION.iter().all(|t| find(t).is_none()) {
        return Err(no_header(&file, line, &fields, &names));
    }
    let known = |n: &str| {
        n == "id"
            || QUAT.contains(&n)
            || MATRIX.contains(&n)
            || AXIS_ANGLE.contains(&n)
            || TRANSLATION.contains(&n)
            || options.keep.iter().any(|k| k.eq_ignore_ascii_case(n))
    };
    if let Some(name) = twice.filter(|n| known(n)) {
        return Err(Error::malformed(
            Place::line(&file, line).column(name),
            format!("a duplicate column '{name}'"),
            "every column once",
        ));
    }
    let require = |wanted: &str| {
        find(wanted).ok_or_else(|| {
            let hint = closest(wanted, &names, &known)
                .map_or(String::new(), |name| format!(" (is {} meant?)", quoted(name.as_bytes())));
            Error::malformed(
                Place::line(&file, line).column(wanted),
                format!("a header without it: {}", list(&names)),
                format!("a column '{wanted}'{hint}"),
            )
        })
    };
    let mut warnings = Vec::new();
    let any = |group: &[&str]| group.iter().any(|n| find(n).is_some());
    let all = |group: &[&str]| group.iter().all(|n| find(n).is_some());
    let rotation = if all(&QUAT) || !(all(&MATRIX) || all(&AXIS_ANGLE)) && any(&QUAT) {
        RotationColumns::Quat(indices(&QUAT, require)?)
    } else if all(&MATRIX) || !all(&AXIS_ANGLE) && any(&MATRIX) {
        RotationColumns::Matrix(indices(&MATRIX, require)?)
    } else if any(&AXIS_ANGLE) {
        RotationColumns::AxisAngle(indices(&AXIS_ANGLE, require)?)
    } else {
        return Err(Error::malformed(
            Place::line(&file, line).column("qw"),
            format!("a header without a rotation: {}", list(&names)),
            "the columns qw,qx,qy,qz (or r11..r33, or rx,ry,rz)",
        ));
    };
    let forms = [all(&QUAT), all(&MATRIX), all(&AXIS_ANGLE)];
    if forms.iter().filter(|&&f| f).count() > 1 {
        let used = if forms[0] { "the quaternion qw..qz" } else { "the matrix r11..r33" };
        warnings.push(format!(
            "{file}:{line}: several forms of the rotation are there; {used} was used"
        ));
    }
    let columns = Columns {
        id: require("id")?,
        rotation,
        translation: indices(&TRANSLATION, require)?,
        keep: options.keep.iter().filter_map(|k| find(&k.to_ascii_lowercase())).collect(),
        names: Vec::new(),
    };
    drop(by_name);
    Ok((Columns { names, ..columns }, warnings))
}

fn indices<const N: usize>(
    names: &[&str; N],
    find: impl Fn(&str) -> Result<usize>,
) -> Result<[usize; N]> {
    let mut out = [0; N];
    for (slot, name) in out.iter_mut().zip(names) {
        *slot = find(name)?;
    }
    Ok(out)
}

/// At most a dozen names.
fn list(names: &[String]) -> String {
    let mut shown = names.iter().take(12).cloned().collect::<Vec<_>>().join(",");
    if names.len() > 12 {
        shown.push_str(",…");
    }
    quoted(shown.as_bytes())
}

/// A name in the header that differs from the wanted one by one edit and is not itself known.
fn closest<'n>(
    wanted: &str,
    names: &'n [String],
    known: &impl Fn(&str) -> bool,
) -> Option<&'n str> {
    let near = |name: &str| {
        let (a, b) = (wanted.as_bytes(), name.as_bytes());
        let prefix = a.iter().zip(b).take_while(|(x, y)| x == y).count();
        let suffix = a.iter().rev().zip(b.iter().rev()).take_while(|(x, y)| x == y).count();
        a.len().abs_diff(b.len()) <= 1 && prefix + suffix + 1 >= a.len().max(b.len())
    };
    names.iter().map(String::as_str).take(1000).find(|n| !n.is_empty() && !known(n) && near(n))
}

/// The first line is no header: say what it looks like.
fn no_header(file: &str, line: u64, fields: &[&[u8]], names: &[String]) -> Error {
    let first = fields.first().copied().unwrap_or_default();
    let joined = fields.join(&b","[..]);
    let has = |b: u8| memchr::memchr(b, first).is_some();
    let numbers = names.iter().filter(|n| n.parse::<f64>().is_ok()).count();
    let (found, why) = if first.starts_with(b"<") {
        ("an HTML or XML page", "")
    } else if joined.starts_with(b"{") || joined.starts_with(b"[") {
        ("JSON", "")
    } else if has(b';') {
        ("columns separated by ';'", " (the column separator is a comma, the decimal point a dot)")
    } else if has(b'\t') || (has(b' ') && names.len() == 1) {
        ("columns separated by blanks", " (the column separator is a comma)")
    } else if numbers >= 3 {
        ("a row of numbers", " (headerless SPEED submissions are read with --format speed)")
    } else {
        ("a line without these names", "")
    };
    Error::malformed(
        Place::line(file, line),
        format!("{found} instead of a header: {}", quoted(&joined)),
        format!("a header line with the columns id,qw,qx,qy,qz,tx,ty,tz in any order{why}"),
    )
}

#[cfg(test)]
mod tests;
