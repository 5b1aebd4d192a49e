//! Breakdowns (`--by`): the samples split by distance, viewing direction, or any column.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use crate::error::{Error, Place, Result};
use crate::eval::compute::Scene;
use crate::eval::request::Request;
use crate::eval::summary::{accurate, mean};
use crate::eval::{Breakdown, Group, Samples, viewing_angles};

/// More distinct numbers than this are shown as ranges.
const MAX_VALUES: usize = 12;
/// More groups than this are no breakdown any more.
const MAX_GROUPS: usize = 200;

/// One breakdown for each name in `request.by`. `thresholds` are those of the ADD recall for each
/// sample: reference length in metres.
///
/// # Errors
/// [`Error::Mismatch`] for a column that neither file has, or one with too many values.
pub(crate) fn breakdowns(
    scene: Scene<'_>,
    s: &Samples,
    reference_m: &[f64],
    request: &Request,
) -> Result<Vec<Breakdown>> {
    request.by.iter().map(|name| breakdown(scene, s, reference_m, request, name)).collect()
}

/// Values over the ground truth; `None` where unknown.
enum Keys {
    Numbers(Vec<Option<f64>>),
    Words(Vec<Option<String>>),
}

fn breakdown(
    scene: Scene<'_>,
    s: &Samples,
    reference_m: &[f64],
    request: &Request,
    name: &str,
) -> Result<Breakdown> {
    let poses = &scene.gt.poses;
    let angles = || poses.iter().map(|p| viewing_angles(p, request.up));
    let (keys, unit, step) = match name {
        "distance" => {
            let d = poses.iter().map(|p| Some(p.translation.length()));
            (Keys::Numbers(d.collect()), "m", None)
        }
        "azimuth" => (Keys::Numbers(angles().map(|a| Some(a.0)).collect()), "deg", Some(45.0)),
        "elevation" => (Keys::Numbers(angles().map(|a| Some(a.1)).collect()), "deg", Some(30.0)),
        _ => (column(scene, s, name)?, "", None),
    };
    let mut edges = Vec::new();
    let labels: Vec<Option<Key>> = match keys {
        Keys::Words(words) => words.into_iter().map(|w| w.map(Key::Word)).collect(),
        Keys::Numbers(values) => {
            edges = ranges(&values, step);
            let bin =
                |x: f64| edges.partition_point(|&e| e <= x).saturating_sub(1).min(edges.len() - 2);
            values.into_iter().map(|v| v.map(|x| Key::Bin(bin(x)))).collect()
        }
    };
    let mut groups: BTreeMap<Key, (usize, Vec<usize>)> = BTreeMap::new();
    for key in labels.iter().flatten() {
        groups.entry(key.clone()).or_default().0 += 1;
    }
    for (i, &g) in s.gt_row.iter().enumerate() {
        if let Some(key) = &labels[g as usize] {
            groups.entry(key.clone()).or_default().1.push(i);
        }
    }
    if groups.len() > MAX_GROUPS {
        return Err(Error::Mismatch {
            place: Place::file(&scene.gt.name).column(name),
            message: format!(
                "--by {name}: found {} different values, expected at most {MAX_GROUPS}, or numbers",
                groups.len()
            ),
        });
    }
    let mut groups: Vec<_> = groups.into_iter().collect();
    // Words that are numbers go by their value: 2 before 10.
    if groups.iter().all(|(key, _)| key.number().is_some()) {
        groups.sort_by(|(a, _), (b, _)| {
            a.number().partial_cmp(&b.number()).unwrap_or(Ordering::Equal)
        });
    }
    let groups = groups.into_iter().map(|(key, (n_gt, rows))| {
        let (label, from, to) = match key {
            Key::Word(word) => (word, None, None),
            Key::Bin(k) => {
                let (from, to) = (edges[k], edges[k + 1]);
                (format!("{from} to {to}"), Some(from), Some(to))
            }
        };
        group(s, reference_m, request, (label, from, to), n_gt, &rows)
    });
    Ok(Breakdown { column: name.to_owned(), unit: unit.to_owned(), groups: groups.collect() })
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Key {
    Bin(usize),
    Word(String),
}

impl Key {
    fn number(&self) -> Option<f64> {
        match self {
            Self::Word(word) => word.parse().ok().filter(|x: &f64| x.is_finite()),
            Self::Bin(k) => Some(*k as f64),
        }
    }
}

/// Edges of "nice" ranges (1, 2 or 5 times a power of ten wide) over the values, at least two.
fn ranges(values: &[Option<f64>], step: Option<f64>) -> Vec<f64> {
    let (low, high) = values
        .iter()
        .flatten()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
    if !low.is_finite() {
        return vec![0.0, 1.0];
    }
    let step = step.unwrap_or_else(|| {
        let largest = low.abs().max(high.abs());
        let raw = match high / 6.0 - low / 6.0 {
            0.0 if largest == 0.0 => 1.0,
            0.0 => largest * 1e-2,
            spread => spread.max(largest * 1e-9),
        };
        let raw = raw.max(1e-300);
        let power = 10_f64.powf(raw.log10().floor());
        let nice = [1.0, 2.0, 5.0, 10.0].into_iter().find(|&k| k * power >= raw * 0.999);
        nice.unwrap_or(10.0) * power
    });
    // Edges as decimal numbers: 0.3, not 0.30000000000000004.
    let digits = (-step.log10().floor()).max(0.0) as usize + 1;
    let edge = |k: f64| {
        let edge: f64 = format!("{:.digits$}", k * step).parse().unwrap_or(k * step);
        edge.clamp(f64::MIN, f64::MAX)
    };
    let first = (low / step).floor();
    let count = (((high / step).floor() - first) as usize).min(1000) + 1;
    let mut edges: Vec<f64> = (0..=count).map(|k| edge(first + k as f64)).collect();
    // The upper end belongs to the last range where it is the natural limit (180, 90 degrees).
    if edges.len() > 2 && edges[edges.len() - 2] >= high {
        edges.pop();
    }
    // A single value that rounding has put on the upper edge.
    if edges.len() == 2 && edges[1] <= high {
        edges[1] = edge(first + 2.0);
    }
    edges
}

/// A column of either file, over the ground truth.
fn column(scene: Scene<'_>, s: &Samples, name: &str) -> Result<Keys> {
    let n = scene.gt.len();
    let named =
        |t: &crate::io::PoseTable| t.extra.iter().position(|c| c.name.eq_ignore_ascii_case(name));
    let mut words: Vec<Option<String>> = vec![None; n];
    if let Some(k) = named(scene.gt) {
        let values = scene.gt.extra[k].values.iter();
        words = values.map(|v| Some(v.to_owned())).collect();
    } else if let Some(k) = named(scene.predictions) {
        for (&g, &p) in s.gt_row.iter().zip(&s.pred_row) {
            let value = scene.predictions.extra[k].values.get(p as usize);
            words[g as usize] = Some(value.to_owned());
        }
    } else if let (Some(targets), "scene" | "object") = (&scene.gt.targets, name) {
        let value = |t: &crate::io::table::Target| match name {
            "scene" => t.scene.map_or("unknown".into(), |s| format!("{s:06}")),
            _ => format!("{:06}", t.object),
        };
        words = targets.iter().map(|t| Some(value(t))).collect();
    } else {
        return Err(Error::Mismatch {
            place: Place::line(&scene.gt.name, 1).column(name),
            message: format!(
                "--by {name}: neither {} nor {} has a column of this name",
                scene.gt.name, scene.predictions.name
            ),
        });
    }
    let mut distinct: Vec<&str> = words.iter().flatten().map(String::as_str).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let finite = |w: &str| w.parse::<f64>().ok().filter(|x| x.is_finite());
    let numbers = distinct.len() > MAX_VALUES && distinct.iter().all(|w| finite(w).is_some());
    if numbers {
        return Ok(Keys::Numbers(words.iter().map(|w| finite(w.as_deref()?)).collect()));
    }
    Ok(Keys::Words(words))
}

fn group(
    s: &Samples,
    reference_m: &[f64],
    request: &Request,
    (label, from, to): (String, Option<f64>, Option<f64>),
    n_gt: usize,
    rows: &[usize],
) -> Group {
    let of = |column: &[f64]| mean(&rows.iter().map(|&i| column[i]).collect::<Vec<_>>());
    let percent = |pass: &dyn Fn(usize) -> bool| {
        100.0 * rows.iter().filter(|&&i| pass(i)).count() as f64 / n_gt as f64
    };
    let acc = request
        .acc
        .iter()
        .map(|x| (x.label.clone(), percent(&|i| accurate(s.te_m[i], s.oe_rad[i], x.value))));
    let add_recall = s.add_m.iter().flat_map(|add| {
        request.add.iter().map(|k| {
            let pass = |i: usize| add[i] < k.value / 100.0 * reference_m[i];
            (k.label.clone(), percent(&pass))
        })
    });
    Group {
        label,
        from,
        to,
        n_gt,
        n_matched: rows.len(),
        npe: of(&s.npe),
        oe_deg: of(&s.oe_rad).map(f64::to_degrees),
        te_m: of(&s.te_m),
        cpe: mean(&rows.iter().map(|&i| s.cpe(i)).collect::<Vec<_>>()),
        add_m: s.add_m.as_deref().and_then(of),
        acc: acc.collect(),
        add_recall: add_recall.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_have_round_edges_and_hold_everything() {
        let edges = ranges(&[Some(0.83), Some(1.47), None], None);
        assert_eq!(edges, [0.8, 1.0, 1.2, 1.4, 1.6]);
        assert_eq!(ranges(&[Some(-180.0), Some(180.0)], Some(45.0)).len(), 9);
        assert_eq!(
            ranges(&[Some(-89.0), Some(12.0)], Some(30.0)),
            [-90.0, -60.0, -30.0, 0.0, 30.0]
        );
        let one = ranges(&[Some(2.0)], None);
        assert!(one[0] <= 2.0 && one[one.len() - 1] > 2.0, "{one:?}");
        assert_eq!(one, [2.0, 2.02]);
        assert_eq!(ranges(&[None], None), [0.0, 1.0]);
        assert_eq!(ranges(&[Some(0.0)], None), [0.0, 1.0]);
    }

    #[test]
    fn ranges_of_huge_and_tiny_numbers_are_finite_and_ascend() {
        for (low, high) in [
            (-1.7e308, 1.7e308),
            (1.7e308, 1.7e308),
            (5e-324, 5e-324),
            (-5e-324, 1e-310),
            (-0.0, 0.0),
            (-3.0, -3.0),
            (1.0, 1.0 + f64::EPSILON),
        ] {
            let edges = ranges(&[Some(low), Some(high)], None);
            assert!(edges.iter().all(|e| e.is_finite()), "{low} {high}: {edges:?}");
            assert!(edges.is_sorted_by(|a, b| a < b), "{low} {high}: {edges:?}");
            assert!(edges[0] <= low && high <= edges[edges.len() - 1], "{low} {high}: {edges:?}");
        }
    }
}
