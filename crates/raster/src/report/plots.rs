//! The charts of the HTML report, from the single samples.
//!
//! Their size does not depend on the number of samples: curves have 200 points, histograms 40
//! bars, scatter plots at most 1500 points (every n-th sample).

mod heat;

use std::fmt::Write as _;

use super::columns::keys;
use super::escape::escape;
use super::number::{count, percent, short};
use super::svg::{Axis, Chart};
use super::{Method, Report, facts};
use crate::eval::{Recall, Samples};

/// Points of a curve.
const CURVE: usize = 200;
/// Bars of a histogram.
const BARS: usize = 40;
/// Points of a scatter plot.
const DOTS: usize = 1500;
/// Groups of the median over distance.
const GROUPS: usize = 12;

/// A chart with its heading and a remark, as HTML.
#[derive(Debug)]
pub(super) struct Figure {
    title: String,
    legend: String,
    svg: String,
    caption: String,
}

impl Figure {
    /// As an HTML `figure`.
    pub(super) fn html(&self) -> String {
        let Self { title, legend, svg, caption } = self;
        let (title, caption) = (escape(title), escape(caption));
        format!(
            "<figure><h3>{title}</h3>{legend}{svg}<figcaption>{caption}</figcaption></figure>\n"
        )
    }
}

/// Error of the samples with a name and unit.
struct Quantity {
    name: &'static str,
    unit: &'static str,
    values: fn(&Samples) -> Option<Vec<f64>>,
}

const TRANSLATION: Quantity = Quantity {
    name: "Translation error",
    unit: "cm",
    values: |s| Some(s.te_m.iter().map(|x| 100.0 * x).collect()),
};
const ORIENTATION: Quantity = Quantity {
    name: "Orientation error",
    unit: "deg",
    values: |s| Some(s.oe_rad.iter().map(|x| x.to_degrees()).collect()),
};
const ADD: Quantity = Quantity {
    name: "ADD",
    unit: "cm",
    values: |s| Some(s.add_m.as_ref()?.iter().map(|x| 100.0 * x).collect()),
};

/// Recall curves.
pub(super) fn curves(report: &Report<'_>) -> Vec<Figure> {
    let mut out = Vec::new();
    if report.methods.iter().all(|m| m.samples.is_empty() || m.n_gt == 0) {
        return out;
    }
    out.extend(vertex_curve(report));
    out.push(accuracy_curve(report));
    out
}

/// Distributions of the errors.
pub(super) fn histograms(report: &Report<'_>) -> Vec<Figure> {
    [TRANSLATION, ORIENTATION, ADD].iter().filter_map(|q| histogram(report, q)).collect()
}

/// Errors against distance.
pub(super) fn distances(report: &Report<'_>) -> Vec<Figure> {
    [TRANSLATION, ORIENTATION].iter().filter_map(|q| against_distance(report, q)).collect()
}

/// Errors against the viewing direction.
pub(super) fn directions(report: &Report<'_>) -> Vec<Figure> {
    [ORIENTATION, TRANSLATION].iter().flat_map(|q| heat::maps(report, q)).collect()
}

/// Percent of `n_gt` below each threshold; `thresholds` ascend.
fn recall_at(values: impl Iterator<Item = f64>, thresholds: &[f64], n_gt: usize) -> Vec<f64> {
    let mut first_pass = vec![0_usize; thresholds.len() + 1];
    for v in values {
        first_pass[thresholds.partition_point(|t| *t <= v)] += 1;
    }
    let mut passed = 0;
    let percent = first_pass[..thresholds.len()].iter().map(|n| {
        passed += n;
        100.0 * passed as f64 / n_gt.max(1) as f64
    });
    percent.collect()
}

fn grid(max: f64) -> Vec<f64> {
    (0..=CURVE).map(|i| max * i as f64 / CURVE as f64).collect()
}

fn largest_key<T>(map: &std::collections::BTreeMap<String, T>) -> f64 {
    map.keys().filter_map(|k| k.parse::<f64>().ok()).filter(|k| k.is_finite()).fold(0.0, f64::max)
}

fn vertex_curve(report: &Report<'_>) -> Option<Figure> {
    let recall = report.evaluation.metrics.add_recall.as_ref()?;
    // Without one length for all samples the curve is over centimetres.
    let (max, to_m, unit) = match recall.reference_m.filter(|m| *m > 0.0) {
        Some(m) => ((1.5 * largest_key(&recall.at)).max(15.0), m / 100.0, "%"),
        None => (10.0, 0.01, "cm"),
    };
    let label = match unit {
        "%" => "Threshold (% of the reference length)",
        _ => "Threshold (cm)",
    };
    let axis = Axis::to(max, label);
    let thresholds = grid(axis.max);
    let metres: Vec<f64> = thresholds.iter().map(|t| t * to_m).collect();
    let mut chart = Chart::new(
        "Recall of ADD against the threshold",
        axis,
        Axis::to(100.0, "Recall (% of ground truth)"),
    );
    let mut items = Vec::new();
    for (i, (m, s)) in report.methods.iter().zip(report.scored()).enumerate() {
        let name = prefix(report, m);
        let columns = [("ADD", "", &m.samples.add_m), ("ADD-S", "dashed", &m.samples.adds_m)];
        for (what, class, values) in columns {
            let Some(values) = values else { continue };
            let y = recall_at(values.iter().copied(), &metres, m.n_gt);
            let points: Vec<_> = thresholds.iter().copied().zip(y).collect();
            chart.line(i, class, &points);
            items.push((i, class, format!("{name}{what}")));
        }
        if unit == "%" {
            let both = [("ADD", &s.metrics.add_recall), ("ADD-S", &s.metrics.adds_recall)];
            for (what, r) in both {
                let Some(r) = r else { continue };
                markers(&mut chart, i, &r.at, |k| {
                    let cm = k.parse::<f64>().map_or(0.0, |k| k * to_m * 100.0);
                    format!("{name}{what} below {k} % ({} cm)", short(cm))
                });
            }
        }
    }
    Some(Figure {
        title: "6D Pose: recall of ADD".to_owned(),
        legend: legend(&items),
        svg: chart.finish(),
        caption: format!("Reference length: {}.", facts::reference_length(recall)),
    })
}

fn accuracy_curve(report: &Report<'_>) -> Figure {
    let max = (1.5 * largest_key(&report.evaluation.metrics.acc)).max(15.0);
    let axis = Axis::to(max, "X (degrees and centimetres)");
    let thresholds = grid(axis.max);
    let y = Axis::to(100.0, "AccX (% of ground truth)");
    let mut chart = Chart::new("AccX against X", axis, y);
    let mut items = Vec::new();
    for (i, (m, s)) in report.methods.iter().zip(report.scored()).enumerate() {
        let both = m.samples.oe_rad.iter().zip(&m.samples.te_m);
        let worse = both.map(|(oe, te)| oe.to_degrees().max(100.0 * te));
        let y = recall_at(worse, &thresholds, m.n_gt);
        let points: Vec<_> = thresholds.iter().copied().zip(y).collect();
        chart.line(i, "", &points);
        let name = prefix(report, m);
        markers(&mut chart, i, &s.metrics.acc, |x| format!("{name}Acc{x}"));
        items.push((i, "", m.name.to_owned()));
    }
    Figure {
        title: "AccX: orientation and position".to_owned(),
        legend: if items.len() > 1 { legend(&items) } else { String::new() },
        svg: chart.finish(),
        caption: "Orientation error below X degrees and translation error below X cm.".to_owned(),
    }
}

fn markers(
    chart: &mut Chart,
    series: usize,
    at: &std::collections::BTreeMap<String, Recall>,
    what: impl Fn(&str) -> String,
) {
    for k in keys(at) {
        if let Ok(x) = k.parse::<f64>() {
            let y = at[k].percent_of_gt;
            chart.marker(series, x, y, &format!("{}: {} %", what(k), percent(y)));
        }
    }
}

/// `name: ` where several methods share a chart.
fn prefix(report: &Report<'_>, m: &Method<'_>) -> String {
    if report.methods.len() > 1 { format!("{}: ", m.name) } else { String::new() }
}

fn legend(items: &[(usize, &str, String)]) -> String {
    let mut out = String::from("<ul class=\"legend\">");
    for (series, class, name) in items {
        let (s, name) = (series % 8, escape(name));
        let _ = write!(
            out,
            "<li><svg viewBox=\"0 0 24 10\" aria-hidden=\"true\">\
             <path class=\"line s{s} {class}\" d=\"M1 5H23\"/></svg>{name}</li>"
        );
    }
    out.push_str("</ul>");
    out
}

/// Where to end an axis of errors, so that a few outliers do not squeeze the rest: the 99th
/// percentile over all methods, at most twice the 90th; zero if there are no finite values.
fn end(columns: &[Vec<f64>]) -> f64 {
    let mut all: Vec<f64> = columns.iter().flatten().copied().filter(|x| x.is_finite()).collect();
    let n = all.len();
    if n == 0 {
        return 0.0;
    }
    let rank = |q: f64| ((n - 1) as f64 * q).ceil() as usize;
    let p99 = *all.select_nth_unstable_by(rank(0.99), f64::total_cmp).1;
    let p90 = *all.select_nth_unstable_by(rank(0.9), f64::total_cmp).1;
    if p90 > 0.0 { p99.min(2.0 * p90) } else { p99 }
}

/// How many lie beyond the end of an axis.
fn clipped(report: &Report<'_>, columns: &[Vec<f64>], max: f64, unit: &str) -> String {
    let mut parts = Vec::new();
    for (m, values) in report.methods.iter().zip(columns) {
        let above = values.iter().filter(|x| **x > max).count();
        if above > 0 {
            let (name, n) = (prefix(report, m), count(values.len()));
            parts.push(format!("{name}{} of {n}", count(above)));
        }
    }
    if parts.is_empty() {
        return String::new();
    }
    format!(" Beyond {} {unit} and not drawn: {}.", short(max), parts.join(", "))
}

fn columns(report: &Report<'_>, q: &Quantity) -> Option<Vec<Vec<f64>>> {
    let columns: Option<Vec<_>> = report.methods.iter().map(|m| (q.values)(m.samples)).collect();
    columns.filter(|c| c.iter().any(|c| !c.is_empty()))
}

fn histogram(report: &Report<'_>, q: &Quantity) -> Option<Figure> {
    let columns = columns(report, q)?;
    let axis = Axis::tight(end(&columns), &format!("{} ({})", q.name, q.unit));
    let max = axis.max;
    let width = max / BARS as f64;
    let counts: Vec<Vec<usize>> = columns
        .iter()
        .map(|values| {
            let mut bins = vec![0; BARS];
            for v in values.iter().filter(|v| **v <= max) {
                bins[((v / width) as usize).min(BARS - 1)] += 1;
            }
            bins
        })
        .collect();
    let heights: Vec<Vec<f64>> = counts
        .iter()
        .zip(&columns)
        .map(|(bins, v)| bins.iter().map(|n| 100.0 * *n as f64 / v.len().max(1) as f64).collect())
        .collect();
    let top = heights.iter().flatten().copied().fold(0.0, f64::max);
    let about = format!("Histogram of {}", q.name);
    let mut chart = Chart::new(&about, axis, Axis::to(top, "Matched samples (%)"));
    let mut items = Vec::new();
    for (i, (m, h)) in report.methods.iter().zip(&heights).enumerate() {
        if i == 0 {
            chart.bars(0, h, |b| {
                let (from, to) = (short(width * b as f64), short(width * (b + 1) as f64));
                let (n, share) = (count(counts[0][b]), percent(h[b]));
                format!("{from} to {to} {}: {n} samples, {share} %", q.unit)
            });
        }
        if report.methods.len() > 1 {
            chart.outline(i, h);
        }
        items.push((i, "", m.name.to_owned()));
    }
    Some(Figure {
        title: format!("{} ({})", q.name, q.unit),
        legend: if items.len() > 1 { legend(&items) } else { String::new() },
        svg: chart.finish(),
        caption: clipped(report, &columns, max, q.unit).trim_start().to_owned(),
    })
}

fn against_distance(report: &Report<'_>, q: &Quantity) -> Option<Figure> {
    let columns = columns(report, q)?;
    let all = || report.methods.iter().flat_map(|m| m.samples.distance_m.iter().copied());
    let low = all().fold(f64::INFINITY, f64::min);
    let high = all().fold(f64::NEG_INFINITY, f64::max);
    let x = Axis::around(low, high, "Distance from the camera (m)");
    let y = Axis::tight(end(&columns), &format!("{} ({})", q.name, q.unit));
    let max = y.max;
    let mut chart = Chart::new(&format!("{} against distance", q.name), x, y);
    let first = report.methods[0];
    let stride = first.samples.len().div_ceil(DOTS).max(1);
    let points = first.samples.distance_m.iter().copied().zip(columns[0].iter().copied());
    chart.dots(0, points.step_by(stride));
    let width = ((high - low) / GROUPS as f64).max(f64::MIN_POSITIVE);
    let mut items = Vec::new();
    for (i, (m, values)) in report.methods.iter().zip(&columns).enumerate() {
        let mut groups = vec![Vec::new(); GROUPS];
        for (d, v) in m.samples.distance_m.iter().zip(values) {
            groups[(((d - low) / width) as usize).min(GROUPS - 1)].push(*v);
        }
        let enough = if values.len() < 60 { 1 } else { 5 };
        let mut line = Vec::new();
        for (g, mut values) in groups.into_iter().enumerate() {
            if values.len() < enough {
                continue;
            }
            let k = values.len() / 2;
            let n = values.len();
            let median = *values.select_nth_unstable_by(k, f64::total_cmp).1;
            let p90 = *values.select_nth_unstable_by((n - 1) * 9 / 10, f64::total_cmp).1;
            line.push((low + width * (g as f64 + 0.5), median, p90, n));
        }
        let upper: Vec<_> = line.iter().map(|(x, _, p90, _)| (*x, *p90)).collect();
        chart.line(i, "dashed thin", &upper);
        let points: Vec<_> = line.iter().map(|(x, median, ..)| (*x, *median)).collect();
        chart.line(i, "strong", &points);
        for (x, y, p90, n) in line {
            let (name, at, n) = (prefix(report, m), short(x), count(n));
            let (median, p90) = (short(y), short(p90));
            let title = format!(
                "{name}median {median} {}, 90th percentile {p90} {0} at {at} m, {n} samples",
                q.unit
            );
            chart.marker(i, x, y, &title);
        }
        items.push((i, "", format!("{}median", prefix(report, m))));
        items.push((i, "dashed thin", format!("{}90th percentile", prefix(report, m))));
    }
    let share =
        if stride > 1 { format!("one sample in {stride}") } else { "all samples".to_owned() };
    let shown = format!("Points: {share}{}.", of_first(report));
    Some(Figure {
        title: format!("{} against distance", q.name),
        legend: legend(&items),
        svg: chart.finish(),
        caption: format!("{shown}{}", clipped(report, &columns, max, q.unit)),
    })
}

fn of_first(report: &Report<'_>) -> String {
    if report.methods.len() > 1 { format!(" of {}", report.methods[0].name) } else { String::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recalls_are_strict() {
        let values = [0.0, 1.0, 2.0, f64::INFINITY];
        assert_eq!(
            recall_at(values.into_iter(), &[0.0, 1.0, 1.5, 3.0], 8),
            [0.0, 12.5, 25.0, 37.5]
        );
    }
}
