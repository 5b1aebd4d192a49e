//! The paper's table in LaTeX, for the package `booktabs`.

use std::fmt::Write as _;

use super::Report;
use super::columns::columns;
use super::facts;
use super::number::{aligned, optional, short};

/// A `table` environment with the paper's columns and arrows, the best values in bold where
/// methods are compared, and comments that say how the numbers came about.
#[must_use]
pub fn latex(report: &Report<'_>) -> String {
    let e = report.evaluation;
    let all = report.scored();
    let columns = columns(report);
    let mut out = format!("% dronepose-eval {}\n", comment(e.version));
    if let Some(s) = facts::reference(&e.metrics) {
        let _ = writeln!(out, "% {}", comment(&s));
    }
    for s in &all {
        let _ = writeln!(out, "% {}: {}", comment(s.name), facts::counts(e.n_gt, s));
    }
    let _ = writeln!(out, "% {}", facts::DENOMINATORS);
    match facts::intervals_sentence(e) {
        Some(s) => {
            let _ = writeln!(out, "% {s}");
        }
        None => {
            let _ = writeln!(out, "% seed {}", e.settings.seed);
        }
    }
    for (role, f) in facts::inputs(e) {
        let _ = writeln!(out, "% sha256 {}  {role}: {}", f.sha256, comment(&f.path));
    }
    for w in facts::warnings(report) {
        let _ = writeln!(out, "% warning: {}", comment(&w));
    }
    out.push_str("% Needs \\usepackage{booktabs}.\n");
    let _ = writeln!(out, "\\begin{{table}}[t]\n  \\centering");
    let _ = writeln!(out, "  \\caption{{{}}}", caption(report));
    let _ = writeln!(out, "  \\begin{{tabular}}{{l{}}}\n    \\toprule", "r".repeat(columns.len()));
    out.push_str("    Method");
    for c in &columns {
        let arrow = if c.lower { "$\\downarrow$" } else { "$\\uparrow$" };
        let _ = write!(out, " & {} {arrow}", escape(&c.name));
    }
    out.push_str(" \\\\\n    \\midrule\n");
    for s in &all {
        let _ = write!(out, "    {}", escape(s.name));
        for c in &columns {
            let decimals = c.decimals(&all);
            let value = c.value(s);
            let text = escape(&optional(value, |x| aligned(x, decimals)));
            if c.best(&all).is_some_and(|b| value == Some(b)) {
                let _ = write!(out, " & \\textbf{{{text}}}");
            } else {
                let _ = write!(out, " & {text}");
            }
        }
        out.push_str(" \\\\\n");
    }
    out.push_str("    \\bottomrule\n  \\end{tabular}\n\\end{table}\n");
    out
}

fn caption(report: &Report<'_>) -> String {
    let e = report.evaluation;
    let mut out = format!("Pose errors over {} ground-truth poses. ", e.n_gt);
    out.push_str("OE in radians, Acc");
    if e.metrics.add_recall.is_some() {
        out.push_str(" and 6D Pose");
    }
    out.push_str(" in \\% of all ground truth.");
    if let Some(r) = &e.metrics.add_recall {
        let _ = match r.reference_m {
            Some(m) => write!(
                out,
                " 6D Pose-$k$: ADD below $k$\\,\\% of {} (${}$\\,m).",
                match r.reference.as_str() {
                    "bbox-diagonal" => "the bounding-box diagonal",
                    "diameter" => "the diameter",
                    _ => "a given length",
                },
                short(m)
            ),
            None => write!(
                out,
                " 6D Pose-$k$: ADD below $k$\\,\\% of {}.",
                escape(&facts::reference_length(r))
            ),
        };
    }
    out
}

/// Text in one line, for a comment.
fn comment(s: &str) -> String {
    facts::visible(s)
}

/// Text that LaTeX typesets as it is.
fn escape(s: &str) -> String {
    let mut out = String::with_capacity(s.len());
    for c in facts::visible(s).chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '<' => out.push_str("\\textless{}"),
            '>' => out.push_str("\\textgreater{}"),
            '|' => out.push_str("\\textbar{}"),
            '"' => out.push_str("\\textquotedbl{}"),
            '–' => out.push_str("--"),
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
    fn user_text_is_escaped() {
        assert_eq!(escape(r"a_b&50%\{$}^"), r"a\_b\&50\%\textbackslash{}\{\$\}\textasciicircum{}");
        let out = latex(&Fixture::pair().report());
        assert!(out.contains(r"gauss\_0.1\textbar{}\textless{}b\textgreater{}\&.csv"), "{out}");
    }

    #[test]
    fn a_newline_in_a_name_stays_in_the_comment() {
        let mut f = Fixture::single();
        f.evaluation.name = "a\n\\input{secret}".into();
        let out = latex(&f.report());
        assert!(!out.lines().any(|l| l.starts_with("\\input")), "{out}");
    }

    #[test]
    fn the_best_value_of_each_column_is_bold() {
        let out = latex(&Fixture::pair().report());
        assert_eq!(out.matches("\\textbf").count(), 9, "{out}");
        assert!(!latex(&Fixture::single().report()).contains("\\textbf"));
    }

    #[test]
    fn every_case_is_finite_and_balanced() {
        for f in Fixture::all() {
            let out = latex(&f.report());
            for word in ["NaN", "inf ", "null", "http", "–"] {
                assert!(!out.contains(word), "{word} in {out}");
            }
            let body: String = out.lines().filter(|l| !l.starts_with('%')).collect();
            let body = body.replace("\\{", "").replace("\\}", "");
            assert_eq!(body.matches('{').count(), body.matches('}').count());
            assert!(out.contains("% sha256 9f86d081"));
        }
    }
}
