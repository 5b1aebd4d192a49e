//! The tables of the HTML report below its charts.

use std::fmt::Write as _;

use crate::eval::{Breakdown, Evaluation, WorstSample};
use crate::report::columns::{SUMMARIES, group_keys, label, summary, titled};
use crate::report::escape::escape;
use crate::report::number::{count, fixed, optional, percent, significant};
use crate::report::{Scored, facts};

/// Means and recalls of each group.
pub(super) fn breakdown(out: &mut String, b: &Breakdown) {
    let title = escape(&titled(&b.column, &b.unit));
    let (acc, add) = group_keys(b);
    let mesh = b.groups.iter().any(|g| g.add_m.is_some());
    let _ = write!(out, "<section>\n<h2>By {title}</h2>\n");
    let mut head: Vec<String> =
        [&*title, "GT", "Matched", "NPE", "OE (deg)", "TE (cm)", "CPE"].map(str::to_owned).into();
    head.extend(mesh.then(|| "ADD (cm)".to_owned()));
    head.extend(acc.iter().map(|x| format!("Acc{} (%)", escape(x))));
    head.extend(add.iter().map(|k| format!("6D Pose-{} (%)", escape(k))));
    let rows = b.groups.iter().map(|g| {
        let cm = |x: Option<f64>| optional(x.map(|x| 100.0 * x), significant);
        let mut row = vec![escape(&g.label), count(g.n_gt), count(g.n_matched)];
        row.extend([optional(g.npe, significant), optional(g.oe_deg, significant)]);
        row.extend([cm(g.te_m), optional(g.cpe, significant)]);
        row.extend(mesh.then(|| cm(g.add_m)));
        row.extend(acc.iter().map(|x| optional(g.acc.get(x).copied(), percent)));
        row.extend(add.iter().map(|k| optional(g.add_recall.get(k).copied(), percent)));
        row
    });
    table(out, &head, rows.collect(), 1);
    out.push_str("</section>\n");
}

/// Summaries, scores and recalls of each method.
pub(super) fn details(out: &mut String, all: &[Scored<'_>], n_gt: usize) {
    let many = all.len() > 1;
    for s in all {
        let of = if many { format!(" of {}", escape(s.name)) } else { String::new() };
        let rows: Vec<_> = SUMMARIES
            .iter()
            .filter_map(|key| {
                let m = summary(s.metrics, key)?;
                let (name, unit, f) = label(key);
                let values = [m.mean, m.median, m.std, m.min, m.p90, m.p95, m.max, m.rmse];
                let mut row = vec![titled(&name, unit)];
                row.extend(values.iter().map(|x| significant(x * f)));
                row.push(count(m.n_undefined));
                Some(row)
            })
            .collect();
        if !rows.is_empty() {
            let _ = write!(out, "<section>\n<h2>Errors{of}</h2>\n");
            let head =
                ["Error", "Mean", "Median", "Std", "Min", "P90", "P95", "Max", "RMSE", "Undefined"];
            table(out, &head.map(str::to_owned), rows, 1);
            out.push_str("</section>\n");
        }
        let rows: Vec<_> = facts::scores(s.metrics)
            .into_iter()
            .map(|(name, value, remark)| vec![escape(&name), value, escape(&remark)])
            .collect();
        let recalls: Vec<_> = facts::recalls_of_matched(s.metrics)
            .into_iter()
            .filter(|_| s.n_matched < n_gt)
            .map(|(name, x)| vec![escape(&name), percent(x)])
            .collect();
        out.push_str("<section class=\"columns\">\n");
        if !rows.is_empty() {
            let _ = write!(out, "<div>\n<h2>Scores{of}</h2>\n");
            table(out, &["Score", "Value", "Remark"].map(str::to_owned), rows, 3);
            out.push_str("</div>\n");
        }
        if !recalls.is_empty() {
            let _ = write!(out, "<div>\n<h2>Recalls of the matched{of}</h2>\n");
            table(out, &["Recall", "% of the matched samples"].map(str::to_owned), recalls, 1);
            out.push_str("</div>\n");
        }
        out.push_str("</section>\n");
    }
}

/// The averages of the authors' script.
pub(super) fn authors(out: &mut String, e: &Evaluation) {
    let Some(a) = &e.authors else { return };
    let sentence = escape(&facts::authors_sentence(a));
    let _ = write!(
        out,
        "<section>\n<h2>Authors&#39; averages</h2>\n<p class=\"soft\">{sentence}</p>\n"
    );
    let (names, values): (Vec<_>, Vec<_>) = facts::authors_values(a).into_iter().unzip();
    let names: Vec<_> = names.iter().map(|n| escape(n)).collect();
    table(out, &names, vec![values], 0);
    out.push_str("</section>\n");
}

/// The worst samples.
pub(super) fn worst(out: &mut String, worst: &[WorstSample]) {
    if worst.is_empty() {
        return;
    }
    out.push_str("<section>\n<h2>Worst predictions by CPE</h2>\n");
    let head = ["Sample", "Line", "CPE", "NPE", "OE (deg)", "TE (cm)", "ADD (cm)", "Distance (m)"];
    let rows = worst.iter().map(|w| {
        let mut row = vec![escape(&w.id), w.line.map_or_else(String::new, |l| l.to_string())];
        row.extend([w.cpe, w.npe, w.oe_deg, 100.0 * w.te_m].map(significant));
        row.push(optional(w.add_m.map(|x| 100.0 * x), significant));
        row.push(fixed(w.distance_m, 3));
        row
    });
    table(out, &head.map(str::to_owned), rows.collect(), 1);
    out.push_str("</section>\n");
}

/// What the names mean; opens the section that [`settings`] closes.
pub(super) fn definitions(out: &mut String, e: &Evaluation) {
    let mut list = vec![
        ("NPE", "normalised position error: translation error over true distance"),
        ("OE", "orientation error: angle between the true and the predicted rotation"),
        ("CPE", "combined pose error: NPE + OE in radians"),
        ("TE", "translation error"),
        ("AccX", "share with OE below X degrees and TE below X cm"),
    ];
    if e.metrics.add_m.is_some() {
        list.push(("ADD", "mean distance of corresponding vertices"));
        list.push(("ADD-S", "mean distance to the nearest vertex"));
        list.push(("6D Pose-k", "share with ADD below k % of the reference length"));
        list.push(("MSSD", "maximum symmetry-aware surface distance"));
    }
    if e.metrics.mspd_px.is_some() {
        list.push(("MSPD", "maximum symmetry-aware projection distance"));
    }
    out.push_str("<section class=\"columns\">\n<div>\n<h2>Definitions</h2>\n<dl>\n");
    for (name, text) in list {
        let _ = writeln!(out, "<dt>{name}</dt><dd>{text}</dd>");
    }
    out.push_str("</dl>\n</div>\n");
}

/// Every setting and every file; closes the section that [`definitions`] opened.
pub(super) fn settings(out: &mut String, e: &Evaluation) {
    out.push_str("<div>\n<h2>Settings</h2>\n<dl>\n");
    for (name, value) in facts::settings(e) {
        let _ = writeln!(out, "<dt>{name}</dt><dd>{}</dd>", escape(&value));
    }
    out.push_str("</dl>\n</div>\n</section>\n<section>\n<h2>Inputs</h2>\n");
    out.push_str(
        "<div class=\"table\"><table><thead><tr><th class=\"l\">File</th><th class=\"l\">Path</th>\
         <th class=\"l\">Format</th><th>Bytes</th><th class=\"l\">SHA-256</th></tr></thead><tbody>\n",
    );
    for (role, f) in facts::inputs(e) {
        let _ = writeln!(
            out,
            "<tr><td class=\"l\">{role}</td><td class=\"path\">{}</td><td class=\"l\">{}</td>\
             <td>{}</td><td class=\"hash\"><code>{}</code></td></tr>",
            escape(&f.path),
            escape(&f.format),
            count(usize::try_from(f.bytes).unwrap_or(usize::MAX)),
            escape(&f.sha256),
        );
    }
    out.push_str("</tbody></table></div>\n</section>\n");
}

/// A table of escaped cells, its first `left` columns flush left.
fn table(out: &mut String, head: &[String], rows: Vec<Vec<String>>, left: usize) {
    let class = |i: usize| if i < left { " class=\"l\"" } else { "" };
    out.push_str("<div class=\"table\"><table><thead><tr>");
    for (i, h) in head.iter().enumerate() {
        // The unit goes below the name, to save width.
        let (name, unit) = match h.rsplit_once(" (") {
            Some((name, unit)) => (name, format!("<br><small>({unit}</small>")),
            None => (h.as_str(), String::new()),
        };
        let _ = write!(out, "<th{}>{name}{unit}</th>", class(i));
    }
    out.push_str("</tr></thead><tbody>\n");
    for row in rows {
        out.push_str("<tr>");
        for (i, text) in row.iter().enumerate() {
            let class = if i == 0 && left > 0 { " class=\"name\"" } else { class(i) };
            let _ = write!(out, "<td{class}>{text}</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}
