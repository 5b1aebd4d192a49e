//! Columns of a row: which fields are the time, the position and the quaternion, and the turn of
//! what they hold into our frames.

use glam::{DMat3, DQuat, DVec3};

use crate::error::{Error, Place, Result, quoted};
use crate::io::Unit;
use crate::io::pose_csv::number;
use crate::io::records::text;
use crate::io::table::{not_a_rotation, translation};
use crate::rotation;
use crate::synth::flight::{Conventions, Order, TimeUnit, time};

/// A quaternion whose norm is off by more is no rounded unit quaternion, but other columns.
const MAX_NORM_ERROR: f64 = 1e-2;

/// The turn of a file's poses into ours.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frames {
    world: DMat3,
    sensor_from_flu: DMat3,
}

impl Frames {
    pub(super) fn new(conventions: &Conventions) -> Self {
        let [roll, pitch, yaw] = conventions.mount_rpy_deg.map(f64::to_radians);
        let body_from_sensor = DMat3::from_rotation_z(yaw)
            * DMat3::from_rotation_y(pitch)
            * DMat3::from_rotation_x(roll);
        let sensor_from_flu =
            conventions.body_axes.matrix().transpose() * body_from_sensor.transpose();
        Self { world: conventions.world.matrix(), sensor_from_flu }
    }
}

/// Where a pose stands in a row.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    pub(super) position: [usize; 3],
    /// Scalar first.
    pub(super) quaternion: [usize; 4],
}

/// One row taken apart, with what is needed to talk about it.
pub(super) struct Fields<'a> {
    pub(super) file: &'a str,
    pub(super) line: u64,
    pub(super) cells: &'a [&'a [u8]],
    /// Names of the columns.
    pub(super) names: &'a [String],
}

impl Fields<'_> {
    pub(super) fn place(&self, column: usize) -> Place {
        let name = self.names.get(column).cloned();
        Place::line(self.file, self.line)
            .column(name.unwrap_or_else(|| format!("field {}", column + 1)))
    }

    /// Refuses another number of fields than that of the header, or of the first row.
    pub(super) fn count(&self, expected: usize, of: &str) -> Result<()> {
        if self.cells.len() == expected {
            return Ok(());
        }
        Err(Error::malformed(
            Place::line(self.file, self.line),
            format!("{} fields", self.cells.len()),
            format!("{expected}, as {of} (a line that was cut off?)"),
        ))
    }

    /// Nanoseconds.
    pub(super) fn time(&self, column: usize, unit: TimeUnit) -> Result<i64> {
        let field = self.cells[column];
        let found = || if field.is_empty() { "an empty field".into() } else { quoted(field) };
        let Some(ns) = time::nanoseconds(field, unit) else {
            return Err(Error::malformed(
                self.place(column),
                found(),
                format!("a time in {} within 292 years (--time-unit says the unit)", unit.name()),
            ));
        };
        // The year 2106, in the unit of the file: seconds never get there, nanoseconds always.
        if unit == TimeUnit::S && ns.abs() > 4_300_000_000_i64 * 1_000_000_000 {
            return Err(Error::malformed(
                self.place(column),
                found(),
                "a time in seconds; for ms, us or ns give --time-unit",
            ));
        }
        Ok(ns)
    }

    /// A pose in our frames, and the quaternion as it stands in the file.
    pub(super) fn pose(&self, at: &Columns, frames: &Frames) -> Result<(DVec3, DQuat, DQuat)> {
        let value = |k: usize| number(self.cells[k], || self.place(k));
        let mut p = [0.0; 3];
        for (slot, &k) in p.iter_mut().zip(&at.position) {
            *slot = value(k)?;
        }
        let p = translation(p, Unit::Metre, || self.place(at.position[0]))?;
        let mut q = [0.0; 4];
        for (slot, &k) in q.iter_mut().zip(&at.quaternion) {
            *slot = value(k)?;
        }
        let first = at.quaternion.iter().min().copied().unwrap_or_default();
        let unit = rotation::from_quat_wxyz(q).map_err(|e| not_a_rotation(self.place(first), e))?;
        let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
        if (norm - 1.0).abs() > MAX_NORM_ERROR {
            return Err(Error::malformed(
                self.place(first),
                format!("a quaternion of norm {norm:.4}"),
                "norm 1 to 0.01 (are these the columns of the quaternion?)",
            ));
        }
        let m = frames.world * DMat3::from_quat(unit) * frames.sensor_from_flu;
        let (turned, _) = rotation::from_matrix(m.transpose().to_cols_array_2d())
            .map_err(|e| not_a_rotation(self.place(first), e))?;
        Ok((frames.world * p, turned, unit))
    }
}

/// Four neighbouring columns as a quaternion, scalar first.
pub(super) fn ordered(first: usize, order: Order) -> [usize; 4] {
    match order {
        Order::Wxyz => [first, first + 1, first + 2, first + 3],
        Order::Xyzw => [first + 3, first, first + 1, first + 2],
    }
}

/// A header line: names as they stand there, and where they are.
pub(super) struct Header {
    pub(super) file: String,
    pub(super) line: u64,
    pub(super) names: Vec<String>,
}

impl Header {
    pub(super) fn new(file: &str, line: u64, fields: &[&[u8]]) -> Result<Self> {
        let mut names = Vec::with_capacity(fields.len());
        for field in fields {
            let Some(name) = text(field) else {
                let found = format!("bytes that are not UTF-8 in {}", quoted(field));
                return Err(Error::malformed(Place::line(file, line), found, "UTF-8 text"));
            };
            names.push(name.trim_start_matches('#').trim().to_owned());
        }
        Ok(Self { file: file.to_owned(), line, names })
    }

    /// The one column that has one of these names, in any case.
    pub(super) fn find(&self, wanted: &[&str]) -> Result<Option<usize>> {
        let known = |name: &String| wanted.iter().any(|w| w.eq_ignore_ascii_case(name));
        let mut found = (0..self.names.len()).filter(|&k| known(&self.names[k]));
        let first = found.next();
        if let (Some(a), Some(b)) = (first, found.next()) {
            return Err(Error::malformed(
                Place::line(&self.file, self.line).column(self.names[b].clone()),
                format!(
                    "two columns for one thing: {} and {}",
                    quoted(self.names[a].as_bytes()),
                    quoted(self.names[b].as_bytes())
                ),
                format!("one of {}", wanted.join(", ")),
            ));
        }
        Ok(first)
    }

    /// As [`Header::find`], for a column that has to be there.
    pub(super) fn need(&self, wanted: &[&str]) -> Result<usize> {
        self.find(wanted)?.ok_or_else(|| {
            let shown: Vec<String> =
                self.names.iter().take(12).map(|n| quoted(n.as_bytes())).collect();
            Error::malformed(
                Place::line(&self.file, self.line).column(wanted[0]),
                format!("a header without it: {}", shown.join(", ")),
                format!("a column {}", wanted.join(" or ")),
            )
        })
    }

    /// Three columns of a position.
    pub(super) fn three(&self, wanted: [&[&str]; 3]) -> Result<[usize; 3]> {
        Ok([self.need(wanted[0])?, self.need(wanted[1])?, self.need(wanted[2])?])
    }
}
