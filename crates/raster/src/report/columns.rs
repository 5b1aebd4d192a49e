//! The columns of the paper's tables, and the labels and units of all metrics.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::number;
use super::{Report, Scored};
use crate::eval::{Breakdown, Group, Metrics, Summary};

/// Where the value of a [`Column`] is found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Key {
    /// A mean: key of the metric.
    Mean(&'static str),
    /// An accuracy: X as written.
    Acc(String),
    /// A recall of ADD: k as written.
    Add(String),
}

impl Key {
    /// Key of the difference between two methods.
    pub(super) fn of_difference(&self) -> String {
        match self {
            Self::Mean(key) => (*key).to_owned(),
            Self::Acc(x) => format!("acc_{x}"),
            Self::Add(k) => format!("add_recall_{k}"),
        }
    }
}

/// A column of the main table.
#[derive(Debug, Clone)]
pub(super) struct Column {
    /// What it shows.
    pub(super) key: Key,
    /// Name as in the paper, such as `6D Pose-5`.
    pub(super) name: String,
    /// `rad`, `%` or empty.
    pub(super) unit: &'static str,
    /// Whether small values are good.
    pub(super) lower: bool,
    /// Whether the paper's tables have it.
    pub(super) paper: bool,
}

impl Column {
    /// Down or up, towards the better values.
    pub(super) fn arrow(&self) -> &'static str {
        if self.lower { "↓" } else { "↑" }
    }

    /// The value for a method.
    pub(super) fn value(&self, s: &Scored<'_>) -> Option<f64> {
        let m = s.metrics;
        match &self.key {
            Key::Mean(key) => summary(m, key).map(|s| s.mean),
            Key::Acc(x) => m.acc.get(x).map(|r| r.percent_of_gt),
            Key::Add(k) => m.add_recall.as_ref()?.at.get(k).map(|r| r.percent_of_gt),
        }
    }

    /// The 95 % interval for a method.
    pub(super) fn interval(&self, s: &Scored<'_>) -> Option<[f64; 2]> {
        let ci = s.ci95?;
        match &self.key {
            Key::Mean(key) => ci.mean.get(*key),
            Key::Acc(x) => ci.acc.get(x),
            Key::Add(k) => ci.add_recall.get(k),
        }
        .copied()
    }

    /// Decimals that suit all methods, see [`number::decimals`].
    pub(super) fn decimals(&self, all: &[Scored<'_>]) -> Option<usize> {
        if self.unit == "%" {
            return Some(2);
        }
        number::decimals(all.iter().filter_map(|s| self.value(s)))
    }

    /// The best value, if there is something to compare.
    pub(super) fn best(&self, all: &[Scored<'_>]) -> Option<f64> {
        if all.len() < 2 {
            return None;
        }
        let values = all.iter().filter_map(|s| self.value(s));
        if self.lower { values.reduce(f64::min) } else { values.reduce(f64::max) }
    }
}

/// The columns of the main table: the paper's first, then the other accuracies and recalls.
pub(super) fn columns(report: &Report<'_>) -> Vec<Column> {
    let mut out: Vec<Column> = [("npe", ""), ("oe_rad", "rad"), ("cpe", "")]
        .into_iter()
        .map(|(key, unit)| Column {
            key: Key::Mean(key),
            name: label(key).0.into_owned(),
            unit,
            lower: true,
            paper: true,
        })
        .collect();
    let m = &report.evaluation.metrics;
    let recalls = keys(&m.acc)
        .into_iter()
        .map(|x| (format!("Acc{x}"), x == "5" || x == "10", Key::Acc(x.to_owned())));
    let add = m.add_recall.iter().flat_map(|r| keys(&r.at));
    let add = add.map(|k| (format!("6D Pose-{k}"), k == "5" || k == "10", Key::Add(k.to_owned())));
    let mut rest = Vec::new();
    for (name, paper, key) in recalls.chain(add) {
        let column = Column { key, name, unit: "%", lower: false, paper };
        if paper { out.push(column) } else { rest.push(column) }
    }
    out.append(&mut rest);
    out
}

/// Keys of a map of recalls in numerical order.
pub(super) fn keys<T>(map: &BTreeMap<String, T>) -> Vec<&str> {
    let mut keys: Vec<&str> = map.keys().map(String::as_str).collect();
    let number = |k: &str| k.parse::<f64>().unwrap_or(f64::MAX);
    keys.sort_by(|a, b| number(a).total_cmp(&number(b)).then_with(|| a.cmp(b)));
    keys
}

/// Keys of the accuracies and of the recalls of ADD that any group of a breakdown has.
pub(super) fn group_keys(b: &Breakdown) -> (Vec<String>, Vec<String>) {
    let all = |map: fn(&Group) -> &BTreeMap<String, f64>| {
        let union: BTreeMap<String, f64> = b.groups.iter().flat_map(|g| map(g).clone()).collect();
        keys(&union).into_iter().map(str::to_owned).collect()
    };
    (all(|g| &g.acc), all(|g| &g.add_recall))
}

/// The metrics with a summary, in the order of the reports.
pub(super) const SUMMARIES: [&str; 11] = [
    "npe",
    "oe_rad",
    "cpe",
    "te_m",
    "oe_deg",
    "oe_sym_deg",
    "add_m",
    "adds_m",
    "mssd_m",
    "mspd_px",
    "proj_px",
];

/// The summary of a metric.
pub(super) fn summary<'a>(m: &'a Metrics, key: &str) -> Option<&'a Summary> {
    match key {
        "npe" => m.npe.as_ref(),
        "oe_rad" => m.oe_rad.as_ref(),
        "oe_deg" => m.oe_deg.as_ref(),
        "te_m" => m.te_m.as_ref(),
        "cpe" => m.cpe.as_ref(),
        "oe_sym_deg" => m.oe_sym_deg.as_ref(),
        "add_m" => m.add_m.as_ref(),
        "adds_m" => m.adds_m.as_ref(),
        "mssd_m" => m.mssd_m.as_ref(),
        "mspd_px" => m.mspd_px.as_ref(),
        "proj_px" => m.proj_px.as_ref(),
        _ => None,
    }
}

/// Name, printed unit and factor to that unit of a metric. Lengths are printed in centimetres.
pub(super) fn label(key: &str) -> (Cow<'_, str>, &'static str, f64) {
    for (prefix, before, after) in RECALLS {
        if let Some(level) = key.strip_prefix(prefix) {
            return (format!("{before}{level}{after}").into(), "%", 1.0);
        }
    }
    let (name, unit, factor) = match key {
        "npe" => ("NPE", "", 1.0),
        "oe_rad" => ("OE", "rad", 1.0),
        "oe_deg" => ("OE", "deg", 1.0),
        "te_m" => ("TE", "cm", 100.0),
        "cpe" => ("CPE", "", 1.0),
        "oe_sym_deg" => ("OE, symmetric", "deg", 1.0),
        "add_m" => ("ADD", "cm", 100.0),
        "adds_m" => ("ADD-S", "cm", 100.0),
        "mssd_m" => ("MSSD", "cm", 100.0),
        "mspd_px" => ("MSPD", "px", 1.0),
        "proj_px" => ("Projection", "px", 1.0),
        other => (other, "", 1.0),
    };
    (name.into(), unit, factor)
}

/// Keys of recalls in [`crate::eval::Comparison::difference`], and how they are named.
const RECALLS: [(&str, &str, &str); 3] = [
    ("acc_", "Acc", ""),
    ("add_recall_", "6D Pose-", ""),
    ("adds_recall_", "ADD-S recall at ", " %"),
];

/// The key of a difference is that of a recall: more is better.
pub(super) fn is_recall(key: &str) -> bool {
    RECALLS.iter().any(|r| key.starts_with(r.0))
}

/// A name with its unit: `TE (cm)`.
pub(super) fn titled(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_owned() } else { format!("{name} ({unit})") }
}

/// Keys of the differences in the order of the reports: errors, then recalls by level.
pub(super) fn ordered_differences<T>(map: &BTreeMap<String, T>) -> Vec<(&str, &T)> {
    let rank = |k: &str| {
        let recall = RECALLS.iter().position(|r| k.starts_with(r.0));
        let level = k.rsplit('_').next().and_then(|l| l.parse().ok()).unwrap_or(0.0_f64);
        match recall {
            Some(i) => (SUMMARIES.len() + i, level),
            None => (SUMMARIES.iter().position(|s| *s == k).unwrap_or(SUMMARIES.len() + 3), 0.0),
        }
    };
    let mut out: Vec<_> = map.iter().map(|(k, v)| (k.as_str(), v)).collect();
    out.sort_by(|(a, _), (b, _)| {
        let (a, b) = (rank(a), rank(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture::Fixture;

    #[test]
    fn the_columns_of_the_paper_come_first() {
        let f = Fixture::pair();
        let names: Vec<_> = columns(&f.report()).into_iter().map(|c| c.name).collect();
        let expected =
            ["NPE", "OE", "CPE", "Acc5", "Acc10", "6D Pose-5", "6D Pose-10", "Acc2", "6D Pose-2"];
        assert_eq!(names, expected);
    }

    #[test]
    fn the_best_value_follows_the_arrow() {
        let f = Fixture::pair();
        let report = f.report();
        let all = report.scored();
        for c in columns(&report) {
            let values: Vec<f64> = all.iter().filter_map(|s| c.value(s)).collect();
            let best = c.best(&all).unwrap();
            assert!(values.iter().all(|v| if c.lower { best <= *v } else { best >= *v }));
        }
    }
}
