//! Recognises the classic blunders from the numbers: a unit off by 10, 100 or 1000, a quaternion
//! written in another order than its columns say, a pose stored the other way round.

use glam::DQuat;

use crate::eval::summary::quantiles;
use crate::io::table::PoseTable;
use crate::rotation;

/// At most this many pairs are looked at, evenly spread.
const SAMPLE: usize = 2000;

/// Warnings about `predictions`, given the matched pairs (ground-truth row, prediction row).
#[must_use]
pub(super) fn warnings(
    predictions: &PoseTable,
    gt: &PoseTable,
    pairs: &[(u32, u32)],
) -> Vec<String> {
    let step = pairs.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<(u32, u32)> = pairs.iter().copied().step_by(step).collect();
    let mut out = Vec::new();
    out.extend(unit(predictions, gt, &sample));
    out.extend(rotation_order(predictions, gt, &sample));
    out
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() { f64::NAN } else { quantiles(&mut values, [0.5])[0] }
}

fn unit(predictions: &PoseTable, gt: &PoseTable, sample: &[(u32, u32)]) -> Option<String> {
    let norms = |table: &PoseTable, rows: &mut dyn Iterator<Item = u32>| {
        median(rows.map(|r| table.poses[r as usize].translation.length()).collect())
    };
    let distance = norms(gt, &mut sample.iter().map(|p| p.0));
    let ratio = norms(predictions, &mut sample.iter().map(|p| p.1)) / distance;
    for factor in [1000.0, 100.0, 10.0] {
        let near = |r: f64| (r / factor - 1.0).abs() < 0.25;
        if near(ratio) || near(1.0 / ratio) {
            let (more, less) = if ratio > 1.0 { (predictions, gt) } else { (gt, predictions) };
            let hint = match (factor as u32, ratio > 1.0) {
                (1000, true) => "pass --pred-unit mm",
                (1000, false) => "pass --gt-unit mm",
                _ => "convert one of them to metres",
            };
            return Some(format!(
                "the translations in {} are about {factor} times those in {}: the two files seem to \
                 have different units; {hint}",
                more.name, less.name
            ));
        }
    }
    if distance > 200.0 {
        return Some(format!(
            "{}: the median distance is {distance:.0} m; if the translations are in millimetres pass \
             --unit mm",
            gt.name
        ));
    }
    None
}

fn rotation_order(
    predictions: &PoseTable,
    gt: &PoseTable,
    sample: &[(u32, u32)],
) -> Option<String> {
    let error = |reread: &dyn Fn(DQuat) -> DQuat| {
        let angle = |&(g, p): &(u32, u32)| {
            rotation::angle(
                gt.poses[g as usize].rotation,
                reread(predictions.poses[p as usize].rotation),
            )
        };
        median(sample.iter().map(angle).collect())
    };
    let as_read = error(&|q| q);
    // Below 20 degrees nothing looks like a blunder; a few samples can do anything.
    if sample.len() < 5 || as_read.is_nan() || as_read < 20_f64.to_radians() {
        return None;
    }
    // Named w,x,y,z but written x,y,z,w: the true (w,x,y,z) is (z,w,x,y) of what was read.
    let readings: [(&str, &dyn Fn(DQuat) -> DQuat); 3] = [
        (
            "the quaternions seem to be stored as x,y,z,w under columns that say w,x,y,z (read as \
             xyzw instead of wxyz",
            &|q| DQuat::from_xyzw(q.w, q.x, q.y, q.z),
        ),
        (
            "the quaternions seem to be stored as w,x,y,z under columns that say x,y,z,w (read as \
             wxyz instead of xyzw",
            &|q| DQuat::from_xyzw(q.y, q.z, q.w, q.x),
        ),
        (
            "the rotations seem to be model_from_cam, the inverse of cam_from_model (inverted",
            &|q| q.conjugate(),
        ),
    ];
    let best = readings
        .iter()
        .map(|(text, reread)| (error(*reread), text))
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 < 0.25 * as_read).then(|| {
        format!(
            "{}: {}, the median orientation error is {:.2} instead of {:.2} degrees)",
            predictions.name,
            best.1,
            best.0.to_degrees(),
            as_read.to_degrees()
        )
    })
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use super::*;
    use crate::io::{PoseOptions, parse_poses};

    /// Rows of `header` with each pose written by `write(q, t)`.
    fn table(header: &str, write: impl Fn([f64; 4], [f64; 3]) -> String) -> PoseTable {
        let mut text = format!("{header}\n");
        for i in 0..20 {
            let a = f64::from(i);
            let q = [(a * 0.7).sin(), (a * 1.1).cos(), (a * 0.3).sin() + 0.2, (a * 2.3).cos()];
            let t = [0.1 * (a * 0.9).sin(), 0.2 * (a * 0.5).cos(), 1.0 + 0.05 * a];
            writeln!(text, "{i},{}", write(q, t)).expect("a string");
        }
        let options = PoseOptions::default();
        parse_poses("p.csv", text.into_bytes(), &options).expect("sound")
    }

    const WXYZ: &str = "id,qw,qx,qy,qz,tx,ty,tz";

    fn join(v: &[f64]) -> String {
        v.iter().map(ToString::to_string).collect::<Vec<_>>().join(",")
    }

    fn said(predictions: &PoseTable) -> String {
        let gt = table(WXYZ, |q, t| join(&[&q[..], &t].concat()));
        let pairs: Vec<_> = (0..20).map(|i| (i, i)).collect();
        warnings(predictions, &gt, &pairs).join("\n")
    }

    #[test]
    fn sound_poses_are_left_alone() {
        assert_eq!(said(&table(WXYZ, |q, t| join(&[&q[..], &t].concat()))), "");
        let hopeless = table(WXYZ, |q, t| join(&[&[q[1], -q[0], q[2], q[3]][..], &t].concat()));
        assert_eq!(said(&hopeless), "", "a bad method is no blunder");
    }

    #[test]
    fn millimetres_are_named() {
        let mm = table(WXYZ, |q, t| join(&[&q[..], &t.map(|c| c * 1000.0)].concat()));
        assert!(said(&mm).contains("about 1000 times") && said(&mm).contains("--pred-unit mm"));
    }

    #[test]
    fn both_orders_of_a_quaternion_are_told_apart() {
        let xyzw = table(WXYZ, |q, t| join(&[&[q[1], q[2], q[3], q[0]][..], &t].concat()));
        assert!(said(&xyzw).contains("xyzw instead of wxyz"), "{}", said(&xyzw));
        let wxyz = table("id,qx,qy,qz,qw,tx,ty,tz", |q, t| join(&[&q[..], &t].concat()));
        assert!(said(&wxyz).contains("wxyz instead of xyzw"), "{}", said(&wxyz));
    }

    #[test]
    fn inverted_rotations_are_named() {
        let inverse = table(WXYZ, |q, t| join(&[&[q[0], -q[1], -q[2], -q[3]][..], &t].concat()));
        assert!(said(&inverse).contains("inverse"), "{}", said(&inverse));
    }
}
