//! From rows to pieces of a flight: duplicates dropped, cuts where time or motion make no sense,
//! quaternions on one side.

use crate::error::{Error, Place, Result};
use crate::rotation;
use crate::synth::flight::{Flight, Issue, Kind, Limits, Row};

/// Fills a flight, of which only the facts are there, with its rows.
pub(super) fn clean(
    mut flight: Flight,
    rows: Vec<Row>,
    file: &str,
    limits: &Limits,
) -> Result<Flight> {
    let median = median_step(&rows);
    let mut begin = 0;
    // Added to the clock since it last went back.
    let mut offset = 0.0;
    let mut last: Option<Row> = None;
    for mut row in rows {
        if let Some(before) = last {
            let step = row.time + offset - before.time;
            if step.abs() < limits.min_step_s || step == 0.0 {
                let text = format!("{:.3} ms after the row before: dropped", step * 1e3);
                flight.note(Kind::Duplicate, row.line, text);
                continue;
            }
            if let Some((kind, text)) = cut(&before, &row, step, limits) {
                flight.note(kind, row.line, text);
                flight.end_piece(&mut begin);
            }
            if step < 0.0 {
                // A new recording in the same file: its clock goes on a gap later.
                offset += limits.max_gap_s - step;
            }
            if before.rotation.dot(row.rotation) < 0.0 {
                row.rotation = -row.rotation;
            }
        }
        row.time += offset;
        flight.time.push(row.time);
        flight.positions.push(row.position);
        flight.rotations.push(row.rotation);
        flight.lines.push(row.line);
        last = Some(row);
    }
    flight.end_piece(&mut begin);
    if flight.segments.is_empty() {
        let first = &flight.issues[0];
        return Err(Error::malformed(
            Place::line(file, first.line),
            format!(
                "no two poses that go on from one another (steps of {median:.3} s, cut at more \
                 than {} s; first: {})",
                limits.max_gap_s, first.text
            ),
            "a flight; for one that was recorded slowly give a longer --max-gap",
        ));
    }
    Ok(flight)
}

/// Why a flight is cut between two rows, if it is.
fn cut(before: &Row, row: &Row, step: f64, limits: &Limits) -> Option<(Kind, String)> {
    if step < 0.0 {
        return Some((Kind::Backward, format!("time goes back by {:.6} s: cut", -step)));
    }
    if row.cut {
        let apart = before.position.distance(row.position);
        let text = format!("begins {apart:.3} m from where the row before ended: cut");
        return Some((Kind::Break, text));
    }
    if step > limits.max_gap_s {
        let text = format!("{step:.3} s after the row before (at most {}): cut", limits.max_gap_s);
        return Some((Kind::Gap, text));
    }
    let speed = before.position.distance(row.position) / step;
    if speed > limits.max_speed_m_s {
        let text = format!("{speed:.1} m/s (at most {}): cut", limits.max_speed_m_s);
        return Some((Kind::Jump, text));
    }
    let turn = rotation::angle(before.rotation, row.rotation).to_degrees() / step;
    if turn > limits.max_turn_deg_s {
        let text = format!("{turn:.0} degrees/s (at most {}): cut", limits.max_turn_deg_s);
        return Some((Kind::Jump, text));
    }
    None
}

impl Flight {
    fn note(&mut self, kind: Kind, line: u64, text: String) {
        self.issues.push(Issue { kind, line, text });
    }

    /// Closes the piece that began at `begin`; one row is none.
    fn end_piece(&mut self, begin: &mut usize) {
        let end = self.time.len();
        if end - *begin >= 2 {
            self.segments.push(*begin..end);
        } else if end > *begin {
            let line = self.lines[*begin];
            self.note(Kind::Short, line, "a single row between two cuts: dropped".into());
            self.time.truncate(*begin);
            self.positions.truncate(*begin);
            self.rotations.truncate(*begin);
            self.lines.truncate(*begin);
        }
        *begin = self.time.len();
    }
}

/// Median of the steps forward in time, seconds.
fn median_step(rows: &[Row]) -> f64 {
    let mut steps: Vec<f64> = rows.windows(2).map(|w| w[1].time - w[0].time).collect();
    steps.retain(|s| *s > 0.0);
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(f64::NAN)
}
