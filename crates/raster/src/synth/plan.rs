//! The plan of a data set: what is left of a flight after the rules, with every pose that is needed
//! to render it, and a funnel that says what each rule removed.

use std::io::{self, Write};
use std::path::Path;

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::Serialize;

use crate::Pose;
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
    let stride = rules.stride as usize;
    let segment_of = segments(track);
    let pose = |i: usize| Pose::new(track.rotations[i], track.positions[i]);
    let candidate = |i: usize| -> Candidate {
        let (anchor, distance_m, tie) =
            rules::nearest_anchor(track.positions[i], anchors).unwrap_or((0, f64::NAN, false));
        let segment = segment_of[i];
        let piece = &track.segments[segment];
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
        found.previous = rules::motion(&pose(i - stride), &pose(i));
        found.next = rules::motion(&pose(i), &pose(i + stride));
        if rules::moves_enough(rules, found.previous) && rules::moves_enough(rules, found.next) {
            found.passed = 3;
        }
        found
    };
    let (mount, model) = (rules.ego_mount(), rules.body_from_model());
    let centroid = DVec3::from_array(rules.centroid_m);
    // The sample of a candidate; how many of `look-at` and `border` it passed if there is none.
    let view = |i: usize, c: &Candidate| -> std::result::Result<Sample, u8> {
        let frame = track.frames[i];
        let (here, there) = (pose(i), pose(i + stride));
        let (eye, target) = rules::draw_view(rules, frame, anchors[c.anchor], track.positions[i]);
        let exo = rules::look_at(eye, target).ok_or(0_u8)?;
        let (drone, drone_next) = (here.compose(&model), there.compose(&model));
        let (pose, pose_next) = (exo.compose(&drone), exo.compose(&drone_next));
        let inside = |p: &Pose| rules::inside(&camera, rules.border, p, centroid).ok_or(1_u8);
        Ok(Sample {
            frame,
            index: i,
            segment: c.segment,
            anchor: c.anchor,
            distance_m: c.distance_m,
            previous: c.previous,
            next: c.next,
            uv: inside(&pose)?,
            uv_next: inside(&pose_next)?,
            exo,
            ego: here.compose(&mount).inverse(),
            ego_next: there.compose(&mount).inverse(),
            drone,
            drone_next,
            pose,
            pose_next,
        })
    };
    let (candidates, views) = threads::install(threads, || {
        let candidates: Vec<Candidate> =
            (0..track.frames.len()).into_par_iter().map(candidate).collect();
        let views: Vec<std::result::Result<Sample, u8>> = candidates
            .par_iter()
            .enumerate()
            .filter(|(_, c)| c.passed == 3)
            .map(|(i, c)| view(i, c))
            .collect();
        (candidates, views)
    })?;
    let paired = |sample: &Sample| {
        let next = &candidates[sample.index + stride];
        next.passed == 3 && next.anchor == sample.anchor
    };
    let in_view: Vec<Sample> = views.iter().filter_map(|v| v.as_ref().ok().copied()).collect();
    let samples: Vec<Sample> = in_view.iter().filter(|s| paired(s)).copied().collect();
    let at_least = |k: u8| candidates.iter().filter(|c| c.passed >= k).count();
    let ties = candidates.iter().filter(|c| c.tie).count();
    let looked = views.iter().filter(|v| !matches!(v, Err(0))).count();
    let left = [
        candidates.len(),
        at_least(1),
        at_least(2),
        at_least(3),
        looked,
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
fn funnel(rules: &Rules, ties: usize, left: [usize; 7]) -> Vec<Step> {
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
        ("pair", "t + 1 passed up to ego-motion too, at the same anchor".to_owned()),
    ];
    let mut came_in = left[0];
    asks.into_iter()
        .zip(left)
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
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::rotation::angle;

    /// A flight along x through two anchors, with a rest in the middle.
    fn track(n: usize) -> Track {
        let x = |i: usize| 0.02 * (i.min(n / 2) + i.saturating_sub(n / 2 + 10)) as f64;
        Track {
            rate_hz: 60.0,
            frames: (100..100 + n.cast_signed() as i64).collect(),
            positions: (0..n).map(|i| DVec3::new(x(i), 0.0, 1.2)).collect(),
            rotations: (0..n).map(|i| DQuat::from_rotation_z(0.001 * i as f64)).collect(),
            lines: (2..n as u64 + 2).collect(),
            segments: vec![0..n / 3, n / 3..n],
        }
    }

    fn anchors() -> (Vec<DVec3>, Vec<String>) {
        let p = vec![DVec3::new(1.0, 1.0, 1.5), DVec3::new(4.0, 1.0, 1.5)];
        (p, vec!["a".into(), "b, \"c\"".into()])
    }

    fn made(rules: &Rules, threads: usize) -> Plan {
        let (p, names) = anchors();
        plan(&track(300), &p, &names, rules, threads).expect("sound")
    }

    fn bytes(plan: &Plan) -> Vec<u8> {
        let mut out = Vec::new();
        plan.write_csv(&mut out).expect("in memory");
        out
    }

    #[test]
    fn the_bits_do_not_depend_on_threads() {
        let rules = Rules::default();
        let one = bytes(&made(&rules, 1));
        assert!(one == bytes(&made(&rules, 2)) && one == bytes(&made(&rules, 7)));
        assert!(one != bytes(&made(&Rules { seed: 1, ..rules }, 1)));
    }

    #[test]
    fn a_rule_more_changes_no_draw_of_another_sample() {
        let all = made(&Rules::default(), 1);
        let near = made(&Rules { max_distance_m: 1.2, ..Rules::default() }, 1);
        assert!(!near.samples.is_empty() && near.samples.len() < all.samples.len());
        for s in &near.samples {
            let same = all.samples.iter().find(|o| o.frame == s.frame).expect("kept before too");
            assert_eq!((s.exo, s.pose), (same.exo, same.pose));
        }
    }

    #[test]
    fn the_funnel_adds_up() {
        let plan = made(&Rules::default(), 1);
        let names: Vec<&str> = plan.funnel.iter().map(|s| s.rule).collect();
        assert_eq!(
            names,
            ["anchor", "distance", "neighbours", "ego-motion", "look-at", "border", "pair"]
        );
        assert_eq!(plan.funnel[0].came_in, 300);
        for pair in plan.funnel.windows(2) {
            assert_eq!(pair[0].came_in - pair[0].removed, pair[1].came_in);
        }
        let last = plan.funnel.last().expect("steps");
        assert_eq!(last.came_in - last.removed, plan.samples.len());
        assert!(plan.funnel[1].removed > 0 && plan.funnel[3].removed > 0);
    }

    #[test]
    fn poses_of_a_sample_agree_with_one_another() {
        let axes = crate::synth::axes::Axes::parse("model_axes", "luf").expect("axes");
        let rules = Rules { model_axes: axes, stride: 2, ..Rules::default() };
        let (plan, track) = (made(&rules, 1), track(300));
        assert!(plan.samples.len() > 10);
        for s in &plan.samples {
            assert_eq!(s.frame, track.frames[s.index]);
            let world = Pose::new(track.rotations[s.index], track.positions[s.index]);
            // The mesh's z is the body's x.
            let ahead = world.transform_point(DVec3::X);
            assert!(s.drone.transform_point(DVec3::Z).distance(ahead) < 1e-12);
            let seen = s.exo.transform_point(ahead);
            assert!(s.pose.transform_point(DVec3::Z).distance(seen) < 1e-12);
            // What the drone sees ahead is on its camera's axis.
            assert!(s.ego.transform_point(ahead).distance(DVec3::Z) < 1e-12);
            let later = Pose::new(track.rotations[s.index + 2], track.positions[s.index + 2]);
            assert!(s.drone_next.translation.distance(later.translation) < 1e-12);
            assert!(s.ego_next.inverse().translation.distance(later.translation) < 1e-12);
            assert!((s.next.0 - world.translation.distance(later.translation)).abs() < 1e-15);
            let turned = angle(world.rotation, later.rotation).to_degrees();
            assert!((s.next.1 - turned).abs() < 1e-12);
        }
    }

    #[test]
    fn the_csv_has_a_number_for_every_column_and_quotes_names() {
        let plan = made(&Rules { prefix: "house-".into(), ..Rules::default() }, 1);
        let text = String::from_utf8(bytes(&plan)).expect("text");
        let mut lines = text.lines();
        let columns = lines.next().expect("a header").split(',').count();
        assert_eq!(columns, 2 + 15 + 7 * 7);
        assert!(text.contains("\nhouse-000") && text.contains(",\"b, \"\"c\"\"\","));
        let row = lines.next().expect("a row");
        assert_eq!(row.split(',').count(), columns);
        assert!(row.split(',').skip(2).all(|f| f.parse::<f64>().is_ok_and(f64::is_finite)));
    }

    #[test]
    fn a_rule_that_needs_pictures_keeps_what_it_says() {
        let plan = made(&Rules::default(), 1);
        let keep: Vec<bool> = (0..plan.samples.len()).map(|k| k % 2 == 0).collect();
        let half = plan.only(&keep);
        assert_eq!(half.samples.len(), plan.samples.len().div_ceil(2));
        assert_eq!(half.samples[1].frame, plan.samples[2].frame);
    }

    #[test]
    fn a_scene_without_anchors_is_refused() {
        let error = plan(&track(30), &[], &[], &Rules::default(), 1).expect_err("refused");
        assert!(error.to_string().starts_with("anchors: one at least"));
    }
}
