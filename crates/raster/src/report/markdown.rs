//! The report as Markdown with tables as GitHub renders them.

use std::fmt::Write as _;

use super::columns::{SUMMARIES, columns, group_keys, label, ordered_differences, summary, titled};
use super::facts;
use super::number::{aligned, count, fixed, optional, p_value, percent, signed, significant};
use super::{Report, Scored};
use crate::eval::{Breakdown, WorstSample};

/// The report as Markdown: the paper's table, details, settings and inputs.
#[must_use]
pub fn markdown(report: &Report<'_>) -> String {
    let e = report.evaluation;
    let all = report.scored();
    let mut out = format!("# Pose evaluation: {}\n\n", escape(&e.name));
    for s in &all {
        let name = if all.len() > 1 { format!("{}: ", escape(s.name)) } else { String::new() };
        let _ = writeln!(out, "- {name}{}", facts::counts(e.n_gt, s));
    }
    let sentence = facts::reference(&e.metrics).unwrap_or_else(|| facts::NO_MESH.to_owned());
    let _ = writeln!(out, "- {}\n- {}\n", escape(&sentence), facts::DENOMINATORS);
    for w in facts::warnings(report) {
        let _ = writeln!(out, "> **Warning:** {}\n", escape(&w));
    }
    main_table(&mut out, report, &all);
    if let Some(s) = facts::intervals_sentence(e) {
        let _ = writeln!(out, "{s}\n");
    }
    for s in all.iter().filter(|s| s.comparison.is_some()) {
        differences(&mut out, &e.name, s);
    }
    for s in &all {
        let name = if all.len() > 1 { format!(": {}", escape(s.name)) } else { String::new() };
        details(&mut out, &name, s, e.n_gt);
    }
    if let Some(a) = &e.authors {
        let _ = writeln!(out, "## Authors' averages\n\n{}\n", facts::authors_sentence(a));
        let (names, values): (Vec<_>, Vec<_>) = facts::authors_values(a).into_iter().unzip();
        table(&mut out, &names, &[values], 0);
    }
    for b in &e.by {
        breakdown(&mut out, b);
    }
    worst(&mut out, &e.worst);
    out.push_str("## Settings\n\n");
    let rows: Vec<_> =
        facts::settings(e).into_iter().map(|(k, v)| vec![k.to_owned(), escape(&v)]).collect();
    table(&mut out, &["Setting", "Value"], &rows, 2);
    out.push_str("## Inputs\n\n");
    let rows: Vec<_> = facts::inputs(e)
        .into_iter()
        .map(|(role, f)| {
            let bytes = count(usize::try_from(f.bytes).unwrap_or(usize::MAX));
            vec![role.to_owned(), escape(&f.path), f.format.clone(), bytes, f.sha256.clone()]
        })
        .collect();
    table(&mut out, &["File", "Path", "Format", "Bytes", "SHA-256"], &rows, 3);
    out.truncate(out.trim_end().len());
    out.push('\n');
    out
}

fn main_table(out: &mut String, report: &Report<'_>, all: &[Scored<'_>]) {
    let columns = columns(report);
    let mut head = vec!["Method".to_owned()];
    head.extend(columns.iter().map(|c| format!("{} {}", titled(&c.name, c.unit), c.arrow())));
    let mut rows = Vec::new();
    for s in all {
        let (mut values, mut intervals) = (vec![escape(s.name)], vec!["95 % CI".to_owned()]);
        for c in &columns {
            let d = c.decimals(all);
            let value = c.value(s);
            let best = c.best(all).is_some_and(|b| value == Some(b));
            let text = optional(value, |x| aligned(x, d));
            values.push(if best { format!("**{text}**") } else { text });
            let interval = c.interval(s);
            intervals.push(interval.map_or_else(String::new, |[a, b]| {
                format!("{} to {}", aligned(a, d), aligned(b, d))
            }));
        }
        rows.push(values);
        if s.ci95.is_some() {
            rows.push(intervals);
        }
    }
    table(out, &head, &rows, 1);
}

fn differences(out: &mut String, first: &str, s: &Scored<'_>) {
    let Some(c) = s.comparison.filter(|c| !c.difference.is_empty()) else { return };
    let _ = writeln!(out, "## {} minus {}\n", escape(s.name), escape(first));
    let rows: Vec<_> = ordered_differences(&c.difference)
        .into_iter()
        .map(|(key, d)| {
            let (name, unit, f) = label(key);
            let ci = d.ci95.map_or_else(
                || optional(None, significant),
                |[a, b]| format!("{} to {}", signed(a * f), signed(b * f)),
            );
            let p = optional(d.p, p_value);
            vec![escape(&titled(&name, unit)), signed(d.mean * f), ci, escape(&p), count(d.n)]
        })
        .collect();
    table(out, &["Mean of", "Difference", "95 % CI", "p", "Samples"], &rows, 1);
}

fn details(out: &mut String, name: &str, s: &Scored<'_>, n_gt: usize) {
    let rows: Vec<_> = SUMMARIES
        .iter()
        .filter_map(|key| {
            let m = summary(s.metrics, key)?;
            let (name, unit, f) = label(key);
            let values = [m.mean, m.median, m.std, m.p90, m.p95, m.max, m.rmse];
            let mut row = vec![titled(&name, unit)];
            row.extend(values.iter().map(|x| significant(x * f)));
            row.push(count(m.n_undefined));
            Some(row)
        })
        .collect();
    if !rows.is_empty() {
        let _ = writeln!(out, "## Errors{name}\n");
        let head = ["Error", "Mean", "Median", "Std", "P90", "P95", "Max", "RMSE", "Undefined"];
        table(out, &head, &rows, 1);
    }
    let rows: Vec<_> = facts::scores(s.metrics)
        .into_iter()
        .map(|(name, value, remark)| vec![name, value, escape(&remark)])
        .chain(facts::recalls_of_matched(s.metrics).into_iter().filter(|_| s.n_matched < n_gt).map(
            |(name, x)| {
                vec![name, format!("{} %", percent(x)), "of the matched samples".to_owned()]
            },
        ))
        .collect();
    if !rows.is_empty() {
        let _ = writeln!(out, "## Scores{name}\n");
        table(out, &["Score", "Value", "Remark"], &rows, 3);
    }
}

fn breakdown(out: &mut String, b: &Breakdown) {
    let title = titled(&b.column, &b.unit);
    let _ = writeln!(out, "## By {}\n", escape(&title));
    let (acc, add) = group_keys(b);
    let mut head: Vec<String> =
        [&*escape(&title), "GT", "Matched", "NPE", "OE (deg)", "TE (cm)", "CPE", "ADD (cm)"]
            .map(str::to_owned)
            .into();
    head.extend(acc.iter().map(|x| format!("Acc{x} (%)")));
    head.extend(add.iter().map(|k| format!("6D Pose-{k} (%)")));
    let rows: Vec<_> = b
        .groups
        .iter()
        .map(|g| {
            let cm = |x: Option<f64>| optional(x.map(|x| 100.0 * x), significant);
            let mut row = vec![escape(&g.label), count(g.n_gt), count(g.n_matched)];
            row.extend([optional(g.npe, significant), optional(g.oe_deg, significant)]);
            row.extend([cm(g.te_m), optional(g.cpe, significant), cm(g.add_m)]);
            row.extend(acc.iter().map(|x| optional(g.acc.get(x).copied(), percent)));
            row.extend(add.iter().map(|k| optional(g.add_recall.get(k).copied(), percent)));
            row
        })
        .collect();
    table(out, &head, &rows, 1);
}

fn worst(out: &mut String, worst: &[WorstSample]) {
    if worst.is_empty() {
        return;
    }
    out.push_str("## Worst predictions by CPE\n\n");
    let rows: Vec<_> = worst
        .iter()
        .map(|w| {
            vec![
                escape(&w.id),
                w.line.map_or_else(String::new, |l| l.to_string()),
                significant(w.cpe),
                significant(w.npe),
                significant(w.oe_deg),
                significant(100.0 * w.te_m),
                optional(w.add_m.map(|x| 100.0 * x), significant),
                fixed(w.distance_m, 3),
            ]
        })
        .collect();
    let head = ["Sample", "Line", "CPE", "NPE", "OE (deg)", "TE (cm)", "ADD (cm)", "Distance (m)"];
    table(out, &head, &rows, 1);
}

/// A table whose first `left` columns are flush left; cells are escaped already.
fn table(out: &mut String, head: &[impl AsRef<str>], rows: &[Vec<String>], left: usize) {
    let heads: Vec<&str> = head.iter().map(AsRef::as_ref).collect();
    let _ = writeln!(out, "| {} |", heads.join(" | "));
    let rule = |i: usize| if i < left { "---" } else { "---:" };
    let rules: Vec<&str> = (0..heads.len()).map(rule).collect();
    let _ = writeln!(out, "| {} |", rules.join(" | "));
    for row in rows {
        let _ = writeln!(out, "| {} |", row.join(" | "));
    }
    out.push('\n');
}

/// Text that Markdown shows as it is, in one line and in one cell.
fn escape(s: &str) -> String {
    let mut out = String::with_capacity(s.len());
    for c in facts::visible(s).chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '\\' | '`' | '*' | '_' | '[' | ']' | '|' | '#' | '~' | '$' => out.extend(['\\', c]),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture::Fixture;

    #[test]
    fn user_text_cannot_break_a_table() {
        let out = markdown(&Fixture::pair().report());
        assert!(!out.contains("<script>") && !out.contains("<b>") && !out.contains('\u{1b}'));
        assert!(out.contains(r"gauss\_0.1\|&lt;b&gt;&amp;.csv"));
        for block in out.split("\n\n").filter(|b| b.starts_with('|')) {
            let bars = |line: &str| line.replace(r"\|", "").matches('|').count();
            let expected = bars(block.lines().next().unwrap());
            assert!(block.lines().all(|line| bars(line) == expected), "{block}");
        }
    }

    #[test]
    fn every_case_is_finite_and_states_the_reference() {
        for f in Fixture::all() {
            let out = markdown(&f.report());
            for word in ["NaN", "inf ", "null", "http"] {
                assert!(!out.contains(word), "{word} in {out}");
            }
            let mesh = f.evaluation.metrics.add_recall.is_some();
            assert_eq!(out.contains("the bounding-box diagonal, 0.6089 m"), mesh);
            assert_eq!(out.contains("add --mesh FILE"), !mesh);
        }
    }
}
