//! Flights: a file of poses over time in, poses in our frames out, cut where they make no sense.
//!
//! [`read`](mod@read) knows the formats, `clean` drops rows and cuts, [`resample`] gives a steady rate.

mod clean;
mod columns;
mod detect;
pub mod read;
pub mod resample;
mod time;

use std::ops::Range;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::io::input::InputFile;
use crate::synth::axes::{Axes, World};

pub use read::{parse_flight, read_flight};
pub use resample::Track;

/// Formats of flights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// By the first line of the file.
    #[default]
    Auto,
    /// The UAVA data set's files: tabs, two time steps in a row, no time.
    Uava,
    /// `airsim_rec.txt`: tabs, a header, milliseconds.
    Airsim,
    /// `time x y z qx qy qz qw` between white space, seconds.
    Tum,
    /// EuRoC's `state_groundtruth_estimate0`: commas, nanoseconds, position, quaternion scalar first.
    Euroc,
    /// Commas, and a header that names the columns.
    Csv,
}

/// Order of the four numbers of a quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// Scalar first.
    Wxyz,
    /// Scalar last.
    Xyzw,
}

/// Unit of time stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

/// How a file is to be read; what is `None` is as its format has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// The format.
    pub format: Format,
    /// World axes of the file.
    pub world: Option<World>,
    /// Body axes of the file.
    pub body_axes: Option<Axes>,
    /// Order of quaternions, for formats that do not name their columns.
    pub quaternion: Option<Order>,
    /// Unit of time stamps.
    pub time_unit: Option<TimeUnit>,
    /// How the sensor, whose poses the file has, sits in the drone: roll, pitch, yaw in degrees,
    /// `body_from_sensor = Rz(yaw) Ry(pitch) Rx(roll)` in forward-left-up axes.
    pub mount_rpy_deg: [f64; 3],
    /// The vehicle of an AirSim file that has several.
    pub vehicle: Option<String>,
    /// Time steps a second of a file without time (UAVA).
    pub rate_hz: f64,
    /// Where a flight is cut.
    pub limits: Limits,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            format: Format::Auto,
            world: None,
            body_axes: None,
            quaternion: None,
            time_unit: None,
            mount_rpy_deg: [0.0; 3],
            vehicle: None,
            rate_hz: 60.0,
            limits: Limits::default(),
        }
    }
}

/// Where a flight is cut, and which rows are dropped.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// A row that comes less than this after the last one is a duplicate, and dropped. Seconds.
    pub min_step_s: f64,
    /// A longer time without a row is a gap. Seconds.
    pub max_gap_s: f64,
    /// A faster move from row to row is a jump. Metres a second.
    pub max_speed_m_s: f64,
    /// A faster turn from row to row is a jump. Degrees a second.
    pub max_turn_deg_s: f64,
}

impl Default for Limits {
    /// A racing drone stays below: the fastest of the UZH-FPV flights makes 12 m/s, 99 % of its
    /// turns are below 172 degrees a second.
    fn default() -> Self {
        Self { min_step_s: 1e-3, max_gap_s: 0.2, max_speed_m_s: 25.0, max_turn_deg_s: 1200.0 }
    }
}

/// What was wrong with a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A time stamp (nearly) again: the row is dropped.
    Duplicate,
    /// Time goes back: the flight is cut, and its clock set on.
    Backward,
    /// Too long without a row: the flight is cut.
    Gap,
    /// Too fast a move or turn: the flight is cut.
    Jump,
    /// The row does not go on where the one before ended (UAVA): the flight is cut.
    Break,
    /// A piece between two cuts with a single row: it is dropped.
    Short,
}

/// A row at which a flight was cut, or which was dropped.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Issue {
    /// What it is.
    pub kind: Kind,
    /// Line of the file, from 1.
    pub line: u64,
    /// What was found, in words.
    pub text: String,
}

/// The conventions that a file was read with.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Conventions {
    /// The format.
    pub format: Format,
    /// World axes of the file.
    pub world: World,
    /// Body axes of the file.
    pub body_axes: Axes,
    /// Order of its quaternions.
    pub quaternion: Order,
    /// Unit of its time stamps; `None` without.
    pub time_unit: Option<TimeUnit>,
    /// The mount that was taken off, degrees.
    pub mount_rpy_deg: [f64; 3],
}

/// A flight in our frames: `world_from_body` over time, in pieces without gaps or jumps.
#[derive(Debug, Clone)]
pub struct Flight {
    /// The file.
    pub source: InputFile,
    /// How it was read.
    pub conventions: Conventions,
    /// Rows of the file.
    pub rows: usize,
    /// Quaternions of the file that are on the other side than the one before.
    pub sign_flips: usize,
    /// Seconds since the first row, rising.
    pub time: Vec<f64>,
    /// Metres, world frame.
    pub positions: Vec<DVec3>,
    /// `world_from_body`, neighbours on one side.
    pub rotations: Vec<DQuat>,
    /// Lines of the file, from 1.
    pub lines: Vec<u64>,
    /// The pieces, each of two rows at least.
    pub segments: Vec<Range<usize>>,
    /// Rows that were dropped, and cuts, in the order of the file.
    pub issues: Vec<Issue>,
}

/// A row as it was read, in our frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    /// Seconds since the first row.
    pub(crate) time: f64,
    pub(crate) position: DVec3,
    pub(crate) rotation: DQuat,
    pub(crate) line: u64,
    /// Does not go on where the row before ended.
    pub(crate) cut: bool,
}

/// Refuses a number that is not above zero and finite.
pub(crate) fn positive(argument: &str, value: f64) -> Result<()> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(Error::argument(argument, format!("found {value}, expected a finite number above zero")))
}

impl Limits {
    /// # Errors
    /// [`Error::Argument`] for a limit that is not above zero (`min_step_s` may be zero).
    pub fn check(&self) -> Result<()> {
        if !(self.min_step_s >= 0.0 && self.min_step_s.is_finite()) {
            let text = format!("found {}, expected seconds, 0 or more", self.min_step_s);
            return Err(Error::argument("min_step_s", text));
        }
        for (name, value) in [
            ("max_gap_s", self.max_gap_s),
            ("max_speed_m_s", self.max_speed_m_s),
            ("max_turn_deg_s", self.max_turn_deg_s),
        ] {
            if value.is_nan() || value <= 0.0 {
                let text = format!("found {value}, expected a number above zero");
                return Err(Error::argument(name, text));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
