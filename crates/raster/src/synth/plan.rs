//! The plan of a data set: what is left of a flight after the rules, with every pose that is needed
//! to render it, and a funnel that says what each rule removed.

use std::io::{self, Write};
use std::path::Path;

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::Serialize;

use crate::Pose;
use crate::camera::Intrinsics;
use crate::error::Result;
use crate::io::output::Outputs;
use crate::synth::flight::Track;
use crate::synth::rules::{self, Rules};
use crate::threads;

/// One rule of the funnel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// Its name.
    pub rule: &'static str,
    /// Where the paper has it.
    pub paper: &'static str,
    /// Poses that came in.
    pub came_in: usize,
    /// Poses that it removed.
    pub removed: usize,
    /// What it asks for, with the numbers of this run.
    pub asks: String,
}

/// One sample: a pair of frames t, t + 1, seen from one exocentric view and by the drone itself.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Number of the frame t: its time is `frame / rate_hz`.
    pub frame: i64,
    /// Index into the track.
    pub index: usize,
    /// Piece of the flight.
    pub segment: usize,
    /// Index of the nearest anchor.
    pub anchor: usize,
    /// Metres from that anchor to the drone.
    pub distance_m: f64,
    /// Metres and degrees from t - 1.
    pub previous: (f64, f64),
    /// Metres and degrees to t + 1.
    pub next: (f64, f64),
    /// `cam_from_world` of the exocentric camera, the same at t and t + 1.
    pub exo: Pose,
    /// `cam_from_world` of the drone's camera at t.
    pub ego: Pose,
    /// `cam_from_world` of the drone's camera at t + 1.
    pub ego_next: Pose,
    /// `world_from_model` of the drone at t.
    pub drone: Pose,
    /// `world_from_model` of the drone at t + 1.
    pub drone_next: Pose,
    /// `cam_from_model` at t: the drone in the exocentric camera.
    pub pose: Pose,
    /// `cam_from_model` at t + 1.
    pub pose_next: Pose,
    /// Image point of the drone's centroid at t, pixels.
    pub uv: DVec2,
    /// Image point of the drone's centroid at t + 1, pixels.
    pub uv_next: DVec2,
}

/// Samples and the funnel that led to them.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Frames a second.
    pub rate_hz: f64,
    /// What the ids begin with.
    pub prefix: String,
    /// In the order of the flight.
    pub samples: Vec<Sample>,
    /// In the order of the rules.
    pub funnel: Vec<Step>,
    /// Names of the anchors.
    pub anchors: Vec<String>,
    /// Lines of the flight's file, for each frame of the track.
    pub lines: Vec<u64>,
}

/// A frame on its way through the rules that look at one frame alone.
#[derive(Clone, Copy)]
struct Candidate {
    anchor: usize,
    distance_m: f64,
    tie: bool,
    segment: usize,
    previous: (f64, f64),
    next: (f64, f64),
    /// How many of `distance`, `neighbours`, `ego-motion` it passed.
    passed: u8,
}

const PAPER: &str = "section 3";

/// Why a candidate gives no sample: how many of `look-at`, `border`, `whole` it passed.
type Removed = u8;

/// What the rules look at.
struct Setting<'a> {
    track: &'a Track,
    anchors: &'a [DVec3],
    rules: &'a Rules,
    camera: Intrinsics,
    segment_of: Vec<usize>,
    stride: usize,
    /// `body_from_cam` of the drone's camera.
    mount: Pose,
    /// `body_from_model`.
    model: Pose,
}

impl Setting<'_> {
    /// `world_from_body` of a frame.
    fn pose(&self, i: usize) -> Pose {
        Pose::new(self.track.rotations[i], self.track.positions[i])
    }

    fn candidate(&self, i: usize) -> Candidate {
        let (rules, stride) = (self.rules, self.stride);
        let (anchor, distance_m, tie) = rules::nearest_anchor(
            self.track.positions[i],
            self.anchors,
        )
        .unwrap_or((0, f64::NAN, false));
        let segment = self.segment_of[i];
        let piece = &self.track.segments[segment];
        let none = (f64::NAN, f64::NAN);
        let mut found =
            Candidate { anchor, distance_m, tie, segment, previous: none, next: none, passed: 0 };
        if !(rules.min_distance_m..=rules.max_distance_m).contains(&distance_m) {
            return found;
        }
        found.passed = 1;
        if i < piece.start + stride || i + stride >= piece.end {
            return found;
        }
        found.passed = 2;
        found.previous = rules::motion(&self.pose(i - stride), &self.pose(i));
        found.next = rules::motion(&self.pose(i), &self.pose(i + stride));
        if rules::moves_enough(rules, found.previous) && rules::moves_enough(rules, found.next) {
            found.passed = 3;
        }
        found
    }

    /// The sample of a candidate that passed the rules before.
    fn view(&self, i: usize, c: &Candidate) -> Result<Sample, Removed> {
        let (rules, track) = (self.rules, self.track);
        let frame = track.frames[i];
        let (here, there) = (self.pose(i), self.pose(i + self.stride));
        let anchor = self.anchors[c.anchor];
        let (eye, target) = rules::draw_view(rules, frame, anchor, track.positions[i]);
        let exo = rules::look_at(eye, target).ok_or(0_u8)?;
        let (drone, drone_next) = (here.compose(&self.model), there.compose(&self.model));
        let (pose, pose_next) = (exo.compose(&drone), exo.compose(&drone_next));
        let centroid = DVec3::from_array(rules.centroid_m);
        let inside = |p: &Pose| rules::inside(&self.camera, rules.border, p, centroid).ok_or(1_u8);
        let (uv, uv_next) = (inside(&pose)?, inside(&pose_next)?);
        if let Some(corners) = rules.whole_box_m {
            let whole = |p: &Pose| rules::whole(&self.camera, p, corners);
            if !(whole(&pose) && whole(&pose_next)) {
                return Err(2);
            }
        }
        Ok(Sample {
            frame,
            index: i,
            segment: c.segment,
            anchor: c.anchor,
            distance_m: c.distance_m,
            previous: c.previous,
            next: c.next,
            uv,
            uv_next,
            exo,
            ego: here.compose(&self.mount).inverse(),
            ego_next: there.compose(&self.mount).inverse(),
            drone,
            drone_next,
            pose,
            pose_next,
        })
    }
}

/// The plan of a flight in a scene. The bits do not depend on the number of threads.
///
/// # Errors
/// [`crate::Error::Argument`]: a setting is out of its range, or there is no anchor.
pub fn plan(
    track: &Track,
    anchors: &[DVec3],
    names: &[String],
    rules: &Rules,
    threads: usize,
) -> Result<Plan> {
    let camera = rules.check()?;
    if anchors.is_empty() {
        return Err(crate::Error::argument("anchors", "one at least is needed"));
    }
    let setting = Setting {
        track,
        anchors,
        rules,
        camera,
        segment_of: segments(track),
        stride: rules.stride as usize,
        mount: rules.ego_mount(),
        model: rules.body_from_model(),
    };
    let (candidates, views) = threads::install(threads, || {
        let candidates: Vec<Candidate> =
            (0..track.frames.len()).into_par_iter().map(|i| setting.candidate(i)).collect();
        let views: Vec<Result<Sample, Removed>> = candidates
            .par_iter()
            .enumerate()
            .filter(|(_, c)| c.passed == 3)
            .map(|(i, c)| setting.view(i, c))
            .collect();
        (candidates, views)
    })?;
    let paired = |sample: &Sample| {
        let next = &candidates[sample.index + setting.stride];
        next.passed == 3 && next.anchor == sample.anchor
    };
    let in_view: Vec<Sample> = views.iter().filter_map(|v| v.as_ref().ok().copied()).collect();
    let samples: Vec<Sample> = in_view.iter().filter(|s| paired(s)).copied().collect();
    let at_least = |k: u8| candidates.iter().filter(|c| c.passed >= k).count();
    let ties = candidates.iter().filter(|c| c.tie).count();
    let seen = |k: u8| views.iter().filter(|v| v.as_ref().err().is_none_or(|&e| e >= k)).count();
    let left = [
        candidates.len(),
        at_least(1),
        at_least(2),
        at_least(3),
        seen(1),
        seen(2),
        in_view.len(),
        samples.len(),
    ];
    Ok(Plan {
        rate_hz: track.rate_hz,
        prefix: rules.prefix.clone(),
        samples,
        funnel: funnel(rules, ties, left),
        anchors: names.to_vec(),
        lines: track.lines.clone(),
    })
}

/// The steps, from how many poses each rule left.
fn funnel(rules: &Rules, ties: usize, left: [usize; 8]) -> Vec<Step> {
    let r = rules;
    let word = match r.motion {
        rules::Motion::Any => "or",
        rules::Motion::All => "and",
    };
    let asks = [
        ("anchor", format!("nearest anchor, the first of equals ({ties} ties)")),
        ("distance", format!("{} to {} m from the anchor", r.min_distance_m, r.max_distance_m)),
        ("neighbours", format!("t - {0} and t + {0} in the same piece of the flight", r.stride)),
        (
            "ego-motion",
            format!(
                "moves {} m {word} turns {} degrees against t - 1 and t + 1, at most {} m and {} \
                 degrees",
                r.min_move_m, r.min_turn_deg, r.max_move_m, r.max_turn_deg
            ),
        ),
        (
            "look-at",
            format!(
                "from a cube of {} m about the anchor to one of {} m about the drone, not \
                 straight up or down",
                r.anchor_cube_m, r.drone_cube_m
            ),
        ),
        ("border", format!("centroid at t and t + 1 inside all but {} of the image", r.border)),
        ("whole", "the box of the drone's mesh is in the image at t and t + 1".to_owned()),
        ("pair", "t + 1 passed up to ego-motion too, at the same anchor".to_owned()),
    ];
    let mut came_in = left[0];
    asks.into_iter()
        .zip(left)
        .filter(|((rule, _), _)| *rule != "whole" || r.whole_box_m.is_some())
        .map(|((rule, asks), left)| {
            let step = Step { rule, paper: PAPER, came_in, removed: came_in - left, asks };
            came_in = left;
            step
        })
        .collect()
}

/// The piece of each frame.
fn segments(track: &Track) -> Vec<usize> {
    let mut of = vec![0; track.frames.len()];
    for (k, piece) in track.segments.iter().enumerate() {
        of[piece.clone()].fill(k);
    }
    of
}

/// Columns before the poses.
const VALUES: [&str; 15] = [
    "frame",
    "time_s",
    "segment",
    "source_line",
    "anchor_index",
    "distance_m",
    "move_previous_m",
    "turn_previous_deg",
    "move_next_m",
    "turn_next_deg",
    "u_px",
    "v_px",
    "next_u_px",
    "next_v_px",
    "depth_m",
];
/// What the columns of each pose begin with; the first is the pose that other commands read.
const POSES: [&str; 7] = ["", "next_", "exo_", "ego_", "ego_next_", "drone_", "drone_next_"];
const PARTS: [&str; 7] = ["qw", "qx", "qy", "qz", "tx", "ty", "tz"];

impl Plan {
    /// Names of the columns of numbers.
    #[must_use]
    pub fn columns() -> Vec<String> {
        let poses = POSES.iter().flat_map(|p| PARTS.iter().map(move |part| format!("{p}{part}")));
        VALUES.iter().map(|&v| v.to_owned()).chain(poses).collect()
    }

    /// The numbers of a sample, in the order of [`Plan::columns`].
    #[must_use]
    pub fn row(&self, s: &Sample) -> Vec<f64> {
        let mut row = vec![
            s.frame as f64,
            s.frame as f64 / self.rate_hz,
            s.segment as f64,
            self.lines[s.index] as f64,
            s.anchor as f64,
            s.distance_m,
            s.previous.0,
            s.previous.1,
            s.next.0,
            s.next.1,
            s.uv.x,
            s.uv.y,
            s.uv_next.x,
            s.uv_next.y,
            s.pose.translation.z,
        ];
        for pose in [s.pose, s.pose_next, s.exo, s.ego, s.ego_next, s.drone, s.drone_next] {
            // Of the two signs the one with w >= 0.
            let q = if pose.rotation.w < 0.0 { -pose.rotation } else { pose.rotation };
            row.extend([q.w, q.x, q.y, q.z]);
            row.extend(pose.translation.to_array());
        }
        row
    }

    /// The id of a sample: the prefix and the number of the frame.
    #[must_use]
    pub fn id(&self, s: &Sample) -> String {
        format!("{}{:06}", self.prefix, s.frame)
    }

    /// The samples of which `keep` is true, in their order; a rule that needs pictures removed the
    /// others.
    #[must_use]
    pub fn only(&self, keep: &[bool]) -> Self {
        let kept = self.samples.iter().zip(keep).filter(|(_, k)| **k).map(|(s, _)| *s).collect();
        Self { samples: kept, ..self.clone() }
    }

    /// As CSV: id, anchor, and the columns of [`Plan::columns`].
    ///
    /// # Errors
    /// What `w` says.
    pub fn write_csv(&self, w: &mut dyn Write) -> io::Result<()> {
        writeln!(w, "id,anchor,{}", Self::columns().join(","))?;
        for s in &self.samples {
            write!(w, "{},{}", field(&self.id(s)), field(&self.anchors[s.anchor]))?;
            for x in self.row(s) {
                write!(w, ",{x}")?;
            }
            writeln!(w)?;
        }
        Ok(())
    }

    /// Writes the plan and its manifest, both or none.
    ///
    /// # Errors
    /// [`crate::Error::Write`].
    pub fn write(&self, csv: &Path, manifest: &Path, text: &str) -> Result<()> {
        let mut outputs = Outputs::default();
        outputs.write(csv, |w| self.write_csv(w))?;
        outputs.write(manifest, |w| w.write_all(text.as_bytes()))?;
        outputs.commit()
    }
}

/// A field of a CSV file, quoted where it has to be.
fn field(text: &str) -> std::borrow::Cow<'_, str> {
    if text.contains([',', '"', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\"")).into();
    }
    text.into()
}

#[cfg(test)]
mod tests;
