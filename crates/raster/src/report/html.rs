//! The report as one HTML file: no scripts, no network, light and dark, fit for print.

mod tables;

use std::fmt::Write as _;

use super::columns::{Column, columns, is_recall, label, ordered_differences, summary, titled};
use super::escape::escape;
use super::number::{ABSENT, aligned, count, fixed, optional, p_value, percent, signed};
use super::{Report, Scored, facts, plots};
use crate::eval::Difference;

/// The report as a self-contained page. With a million samples it is as small as with a thousand.
#[must_use]
pub fn html(report: &Report<'_>) -> String {
    let e = report.evaluation;
    let all = report.scored();
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"generator\" content=\"dronepose-eval {}\">\n\
         <title>{} – pose evaluation</title>\n<style>\n{}</style>\n</head>\n<body>\n<main>\n",
        escape(e.version),
        escape(&e.name),
        include_str!("style.css"),
    );
    header(&mut out, report, &all);
    if all.len() == 1 {
        cards(&mut out, report, &all[0]);
    }
    leaderboard(&mut out, report, &all);
    differences(&mut out, report, &all);
    if e.n_matched == 0 {
        out.push_str(
            "<p>No prediction matches a ground-truth pose: there is nothing to draw.</p>\n",
        );
    }
    figures(&mut out, "Recall against the threshold", "", &plots::curves(report));
    figures(&mut out, "Distribution of the errors", "", &plots::histograms(report));
    figures(&mut out, "Error against distance", "", &plots::distances(report));
    let remark = "Where the camera stands, seen from the drone. Blank cells have no sample; point \
                  at a cell for its count.";
    figures(&mut out, "Error against viewing direction", remark, &plots::directions(report));
    for b in &e.by {
        tables::breakdown(&mut out, b);
    }
    tables::details(&mut out, &all, e.n_gt);
    tables::authors(&mut out, e);
    tables::worst(&mut out, &e.worst);
    tables::definitions(&mut out, e);
    tables::settings(&mut out, e);
    let _ = write!(
        out,
        "<footer>Made by dronepose-eval {}, JSON schema {}.</footer>\n</main>\n</body>\n</html>\n",
        escape(e.version),
        escape(e.schema),
    );
    out
}

/// A name that may be broken after its separators.
fn breakable(name: &str) -> String {
    let mut out = escape(name);
    for separator in ["_", "-", "/", "."] {
        out = out.replace(separator, &format!("{separator}<wbr>"));
    }
    out
}

fn header(out: &mut String, report: &Report<'_>, all: &[Scored<'_>]) {
    let e = report.evaluation;
    let _ = write!(
        out,
        "<header>\n<p class=\"eyebrow\">6D pose evaluation, preset {}</p>\n<h1>{}</h1>\n",
        escape(&e.settings.preset),
        escape(&e.name),
    );
    let _ = writeln!(out, "<p class=\"counts\">{}</p>", facts::counts(e.n_gt, &all[0]));
    let share = 100.0 * e.n_matched as f64 / e.n_gt.max(1) as f64;
    let _ = writeln!(
        out,
        "<div class=\"coverage\" role=\"img\" aria-label=\"{0} % matched\" title=\"{0} % \
         matched\"><span style=\"width:{0}%\"></span></div>",
        percent(share),
    );
    let reference = facts::reference(&e.metrics).unwrap_or_else(|| facts::NO_MESH.to_owned());
    let _ = writeln!(out, "<p class=\"reference\">{}</p>", escape(&reference));
    let _ = writeln!(out, "<p class=\"soft\">{}</p>", facts::DENOMINATORS);
    let warnings = facts::warnings(report);
    if !warnings.is_empty() {
        let title = if warnings.len() == 1 { "Warning" } else { "Warnings" };
        let _ = write!(out, "<div class=\"warnings\"><strong>{title}</strong><ul>");
        for w in warnings {
            let _ = write!(out, "<li>{}</li>", escape(&w));
        }
        out.push_str("</ul></div>\n");
    }
    out.push_str("</header>\n");
}

fn cards(out: &mut String, report: &Report<'_>, s: &Scored<'_>) {
    out.push_str("<section class=\"cards\" aria-label=\"Summary\">\n");
    for c in columns(report).iter().filter(|c| c.paper) {
        let decimals = if c.unit == "%" { Some(2) } else { None };
        let value = c.value(s);
        let text = optional(value, |x| aligned(x, decimals));
        let unit = if value.is_some() && c.unit == "%" { "%" } else { "" };
        let name = if c.unit == "%" { c.name.clone() } else { titled(&c.name, c.unit) };
        let _ = write!(
            out,
            "<div class=\"card\"><div class=\"name\">{} {}</div>\
             <div class=\"value\">{text} <small>{unit}</small></div>",
            escape(&name),
            c.arrow(),
        );
        if let Some([a, b]) = c.interval(s) {
            let (a, b) = (aligned(a, decimals), aligned(b, decimals));
            let _ = write!(out, "<div class=\"ci\">{a}–{b}</div>");
        }
        if let Some(x) = value.filter(|_| c.unit == "%") {
            let x = percent(x.clamp(0.0, 100.0));
            let _ = write!(out, "<div class=\"meter\"><span style=\"width:{x}%\"></span></div>");
        }
        out.push_str("</div>\n");
    }
    out.push_str("</section>\n");
}

/// The paper's table with intervals and, where methods are compared, differences.
fn leaderboard(out: &mut String, report: &Report<'_>, all: &[Scored<'_>]) {
    let title = if all.len() > 1 { "Leaderboard" } else { "The paper's table" };
    let _ = write!(out, "<section>\n<h2>{title}</h2>\n");
    let columns = columns(report);
    out.push_str("<div class=\"table\"><table><thead><tr><th class=\"l\">Method</th>");
    for c in &columns {
        let name = escape(&c.name).replace(' ', "&nbsp;");
        let _ = write!(out, "<th>{name}<br><small>{}&nbsp;{}</small></th>", c.unit, c.arrow());
    }
    out.push_str("</tr></thead><tbody>\n");
    for s in all {
        let _ = write!(out, "<tr><th scope=\"row\">{}", breakable(s.name));
        if all.len() > 1 {
            let missing = report.evaluation.n_gt.saturating_sub(s.n_matched);
            let (n, missing) = (count(s.n_matched), count(missing));
            let _ = write!(out, "<span class=\"ci\"><br>{n} matched, {missing} missing</span>");
        }
        out.push_str("</th>");
        for c in &columns {
            cell(out, c, s, all);
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
    let mut remarks: Vec<String> =
        facts::intervals_sentence(report.evaluation).into_iter().collect();
    if all.len() > 1 {
        remarks.push("Best value of each column in bold.".to_owned());
    }
    let _ = write!(out, "<p class=\"soft\">{}</p>\n</section>\n", escape(&remarks.join(" ")));
}

fn cell(out: &mut String, c: &Column, s: &Scored<'_>, all: &[Scored<'_>]) {
    let decimals = c.decimals(all);
    let value = c.value(s);
    let best = c.best(all).is_some_and(|b| value == Some(b));
    let class = if best { " class=\"best\"" } else { "" };
    let text = optional(value, |x| aligned(x, decimals));
    let _ = write!(out, "<td><span{class}>{text}</span>");
    if let Some([a, b]) = c.interval(s) {
        // One digit less than the value: enough for an interval, and the table fits its page.
        let decimals = decimals.map(|d| d.saturating_sub(1));
        let (a, b) = (aligned(a, decimals), aligned(b, decimals));
        let _ = write!(out, "<span class=\"ci\">{a}–<wbr>{b}</span>");
    }
    let key = c.key.of_difference();
    if let Some(d) = s.comparison.and_then(|c| c.difference.get(&key)) {
        let class = verdict(d, &key).0;
        let _ = write!(out, "<span class=\"ci {class}\">{}</span>", minus(&signed(d.mean)));
    }
    out.push_str("</td>");
}

/// Class and word for a difference, this method minus the first: of errors, for which less is
/// better, or of recalls, for which more is.
fn verdict(d: &Difference, key: &str) -> (&'static str, &'static str) {
    let (lower, higher) = if is_recall(key) {
        (("worse", "worse"), ("better", "better"))
    } else {
        (("better", "better"), ("worse", "worse"))
    };
    match d.ci95 {
        Some([_, b]) if b < 0.0 => lower,
        Some([a, _]) if a > 0.0 => higher,
        Some(_) => ("", "not shown to differ"),
        None => ("", ABSENT),
    }
}

/// A proper minus sign.
fn minus(s: &str) -> String {
    s.strip_prefix('-').map_or_else(|| s.to_owned(), |rest| format!("−{rest}"))
}

fn differences(out: &mut String, report: &Report<'_>, all: &[Scored<'_>]) {
    let e = report.evaluation;
    // Differences relative to the first method's mean share one scale.
    let rows: Vec<_> = all
        .iter()
        .filter_map(|s| s.comparison)
        .flat_map(|c| ordered_differences(&c.difference).into_iter().map(move |d| (c, d)))
        .map(|(c, (key, d))| {
            let base = summary(&e.metrics, key).map(|s| s.mean).filter(|m| *m > 0.0);
            let relative = base.map(|m| (d.mean / m, d.ci95.map(|ci| ci.map(|x| x / m))));
            (c, key, d, relative)
        })
        .collect();
    if rows.is_empty() {
        return;
    }
    let span = rows
        .iter()
        .filter_map(|r| r.3)
        .flat_map(|(m, ci)| ci.map_or([m, m], |[a, b]| [a, b]))
        .map(f64::abs)
        .fold(0.0, f64::max)
        .clamp(1e-6, 2.0);
    let _ = write!(
        out,
        "<section>\n<h2>Differences to {}</h2>\n<p class=\"soft\">Mean of the paired differences \
         over the samples that both predict, and of recalls in percent of the ground truth. Less error \
         and more recall is better than {0}. The whiskers are 95 % intervals relative to the mean of {0}, from −{1} % to +{1} %.</p>\n\
         <div class=\"table\"><table><thead><tr><th class=\"l\">Method</th><th class=\"l\">Mean \
         of</th><th>Difference</th><th>95 % CI</th><th class=\"l\">Relative</th><th>p</th>\
         <th>Samples</th><th class=\"l\">Verdict</th></tr></thead><tbody>\n",
        escape(&e.name),
        fixed(100.0 * span, 0),
    );
    let mut last = "";
    for (c, key, d, relative) in rows {
        let (name, unit, f) = label(key);
        let method = if c.name == last { String::new() } else { breakable(&c.name) };
        last = &c.name;
        let ci = d.ci95.map_or_else(
            || ABSENT.to_owned(),
            |[a, b]| format!("{} to {}", minus(&signed(a * f)), minus(&signed(b * f))),
        );
        let (class, word) = verdict(d, key);
        let _ = writeln!(
            out,
            "<tr><td class=\"name\">{method}</td><td class=\"l\">{}</td><td>{}</td><td>{ci}</td>\
             <td class=\"l {class}\">{}</td><td>{}</td><td>{}</td><td class=\"l {class}\">{word}\
             </td></tr>",
            escape(&titled(&name, unit)),
            minus(&signed(d.mean * f)),
            relative.map_or_else(String::new, |(m, ci)| whisker(m, ci, span)),
            escape(&optional(d.p, p_value)),
            count(d.n),
        );
    }
    out.push_str("</tbody></table></div>\n</section>\n");
}

fn whisker(mean: f64, ci: Option<[f64; 2]>, span: f64) -> String {
    let x = |v: f64| 95.0 + 90.0 * (v / span).clamp(-1.0, 1.0);
    let mut out = String::from(
        "<svg class=\"whisker\" viewBox=\"0 0 190 18\"><path class=\"zero\" d=\"M95 0V18\"/>",
    );
    let mut title = format!("{} %", minus(&signed(100.0 * mean)));
    if let Some([a, b]) = ci {
        let _ = write!(out, "<path class=\"range\" d=\"M{:.1} 9H{:.1}\"/>", x(a), x(b));
        let (a, b) = (minus(&signed(100.0 * a)), minus(&signed(100.0 * b)));
        let _ = write!(title, ", {a} to {b} %");
    }
    let title = escape(&title);
    let _ = write!(
        out,
        "<circle cx=\"{:.1}\" cy=\"9\" r=\"4\"><title>{title}</title></circle></svg>",
        x(mean)
    );
    out
}

fn figures(out: &mut String, title: &str, remark: &str, figures: &[plots::Figure]) {
    if figures.is_empty() {
        return;
    }
    let _ = write!(out, "<section>\n<h2>{title}</h2>\n");
    if !remark.is_empty() {
        let _ = writeln!(out, "<p class=\"soft\">{remark}</p>");
    }
    let class = if figures.len() == 3 { "figures three" } else { "figures" };
    let _ = writeln!(out, "<div class=\"{class}\">");
    for f in figures {
        out.push_str(&f.html());
    }
    out.push_str("</div>\n</section>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture::Fixture;

    #[test]
    fn user_text_cannot_become_markup() {
        let out = html(&Fixture::pair().report());
        assert!(!out.contains("<script") && !out.contains("<b>") && !out.contains("<i>"));
        assert!(!out.contains("<wrong>") && !out.contains('\u{1b}'));
        assert!(out.contains("gauss_0.1|&lt;b&gt;&amp;.csv"));
    }

    #[test]
    fn every_case_is_finite_and_alone() {
        for f in Fixture::all() {
            let out = html(&f.report());
            for word in ["NaN", "inf\"", "inf ", "inf<", ">inf", "null", "url(", "@import", "src="]
            {
                assert!(!out.contains(word), "{word} in {}", f.evaluation.name);
            }
            let local = out.replace("http://www.w3.org/2000/svg", "");
            assert!(!local.contains("http"), "{}", f.evaluation.name);
            let mesh = f.evaluation.metrics.add_recall.is_some();
            assert_eq!(out.contains("of the bounding-box diagonal, 0.6089 m"), mesh);
            assert_eq!(out.contains("add --mesh FILE"), !mesh);
        }
    }

    #[test]
    fn every_element_is_closed() {
        for f in Fixture::all() {
            let out = html(&f.report());
            let tags =
                ["section", "div", "table", "tr", "td", "th", "svg", "g", "figure", "dl", "ul"];
            for tag in tags.iter().chain(&["li", "p", "span", "title", "text", "main", "header"]) {
                let opened = out.matches(&format!("<{tag} ")).count()
                    + out.matches(&format!("<{tag}>")).count();
                assert_eq!(opened, out.matches(&format!("</{tag}>")).count(), "{tag}");
            }
        }
    }

    #[test]
    fn a_page_without_samples_has_no_charts() {
        let out = html(&Fixture::empty().report());
        assert!(!out.contains("class=\"chart\""));
        let f = Fixture::single();
        let bare = Report { evaluation: &f.evaluation, methods: vec![] };
        assert!(!html(&bare).contains("class=\"chart\""));
    }

    #[test]
    fn many_samples_make_no_large_page() {
        let out = html(&Fixture::pair_of(100_000, 100_000).report());
        assert!(out.len() < 300_000, "{}", out.len());
    }

    #[test]
    #[ignore = "writes the pages to the folder REPORT_DIR, to look at"]
    fn write_pages() {
        let folder = std::path::PathBuf::from(std::env::var_os("REPORT_DIR").unwrap());
        let names = ["pair", "single", "perfect", "one", "empty", "no_mesh"];
        for (name, f) in names.iter().zip(Fixture::all()) {
            std::fs::write(folder.join(format!("{name}.html")), html(&f.report())).unwrap();
        }
        let f = Fixture::pair_of(1_000_000, 1_000_000);
        let start = std::time::Instant::now();
        let page = html(&f.report());
        std::fs::write(
            folder.join("million.txt"),
            format!("{} bytes, {:?}\n", page.len(), start.elapsed()),
        )
        .unwrap();
    }
}
