//! A steady rate: SLERP between the two rows around an instant, and a natural cubic spline through
//! the positions of a piece.
//!
//! Instants are whole multiples of the period since the first row of the file, so that a frame's
//! number does not depend on where the flight is cut. The spline is twice continuously
//! differentiable, passes through every row, and has no acceleration at the two ends of a piece.

use std::ops::Range;

use glam::{DQuat, DVec3};

use crate::error::{Error, Result};
use crate::rotation;
use crate::synth::flight::{Flight, positive};

/// More frames than this are a mistake in the rate or in the time unit.
const MAX_FRAMES: f64 = 5e7;

/// A flight at a steady rate, `world_from_body`.
#[derive(Debug, Clone)]
pub struct Track {
    /// Frames a second.
    pub rate_hz: f64,
    /// Number of the frame: its time is `frame / rate_hz` seconds after the first row.
    pub frames: Vec<i64>,
    /// Metres, world frame.
    pub positions: Vec<DVec3>,
    /// `world_from_body`.
    pub rotations: Vec<DQuat>,
    /// The line of the file at or before the frame.
    pub lines: Vec<u64>,
    /// The pieces; frames of one follow one another.
    pub segments: Vec<Range<usize>>,
}

impl Flight {
    /// The flight at `rate_hz` frames a second. Pieces too short for a frame are left out.
    ///
    /// # Errors
    /// [`Error::Argument`]: a rate that is not above zero, no frame at all, or more than 50 million.
    pub fn resample(&self, rate_hz: f64) -> Result<Track> {
        positive("rate_hz", rate_hz)?;
        let seconds: f64 =
            self.segments.iter().map(|s| self.time[s.end - 1] - self.time[s.start]).sum();
        if seconds * rate_hz > MAX_FRAMES {
            return Err(Error::argument(
                "rate_hz",
                format!(
                    "{:.0} frames in {seconds:.0} s; expected at most 50 million (is the time unit \
                     right?)",
                    seconds * rate_hz
                ),
            ));
        }
        let mut track = Track {
            rate_hz,
            frames: Vec::new(),
            positions: Vec::new(),
            rotations: Vec::new(),
            lines: Vec::new(),
            segments: Vec::new(),
        };
        for piece in &self.segments {
            let begin = track.frames.len();
            self.resample_piece(piece.clone(), &mut track);
            if track.frames.len() > begin {
                track.segments.push(begin..track.frames.len());
            }
        }
        if track.frames.is_empty() {
            return Err(Error::argument(
                "rate_hz",
                format!("no frame of {rate_hz} Hz in the flight"),
            ));
        }
        Ok(track)
    }

    fn resample_piece(&self, piece: Range<usize>, track: &mut Track) {
        let (time, p) = (&self.time[piece.clone()], &self.positions[piece.clone()]);
        let (q, lines) = (&self.rotations[piece.clone()], &self.lines[piece]);
        let curvature = natural_spline(time, p);
        // A row on an instant counts, however its time was rounded.
        let slack = 1e-6 / track.rate_hz;
        let first = ((time[0] - slack) * track.rate_hz).ceil() as i64;
        let last = ((time[time.len() - 1] + slack) * track.rate_hz).floor() as i64;
        let mut k = 0;
        for frame in first..=last {
            let t = (frame as f64 / track.rate_hz).clamp(time[0], time[time.len() - 1]);
            while k + 2 < time.len() && time[k + 1] <= t {
                k += 1;
            }
            let h = time[k + 1] - time[k];
            let b = (t - time[k]) / h;
            let a = 1.0 - b;
            let bend = (a * a * a - a) * curvature[k] + (b * b * b - b) * curvature[k + 1];
            track.frames.push(frame);
            track.positions.push(a * p[k] + b * p[k + 1] + bend * (h * h / 6.0));
            track.rotations.push(slerp(q[k], q[k + 1], b));
            track.lines.push(lines[if b >= 1.0 { k + 1 } else { k }]);
        }
    }
}

/// Second derivatives at the knots of the natural cubic spline through `p` at `time`: a tridiagonal
/// system, solved forth and back.
fn natural_spline(time: &[f64], p: &[DVec3]) -> Vec<DVec3> {
    let n = time.len();
    let mut second = vec![DVec3::ZERO; n];
    let mut upper = vec![0.0; n];
    for i in 1..n - 1 {
        let (h0, h1) = (time[i] - time[i - 1], time[i + 1] - time[i]);
        let slope = (p[i + 1] - p[i]) / h1 - (p[i] - p[i - 1]) / h0;
        let pivot = 2.0 * (h0 + h1) - h0 * upper[i - 1];
        upper[i] = h1 / pivot;
        second[i] = (6.0 * slope - h0 * second[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        second[i] = second[i] - upper[i] * second[i + 1];
    }
    second
}

/// The rotation that is a share `s` of the way from `a` to `b`, along the shorter arc.
#[must_use]
pub fn slerp(a: DQuat, b: DQuat, s: f64) -> DQuat {
    let (v, w) = rotation::relative(a, b);
    let (v, w) = if w < 0.0 { (-v, -w) } else { (v, w) };
    let sine = v.length();
    if sine == 0.0 {
        return a;
    }
    let (sin, cos) = (s * sine.atan2(w)).sin_cos();
    let v = v * (sin / sine);
    (a * DQuat::from_xyzw(v.x, v.y, v.z, cos)).normalize()
}
