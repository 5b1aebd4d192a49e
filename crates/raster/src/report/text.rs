//! The report for the terminal: the paper's table first, then what the numbers mean, then details.
//! Fits 80 columns; narrower terminals get the lines as they are.

use std::fmt::Write as _;

use comfy_table::{CellAlignment, ContentLineStyle, LineStyle, Table, TableStyle};

use super::columns::{
    Column, SUMMARIES, columns, group_keys, label, ordered_differences, summary, titled,
};
use super::facts::{self, visible};
use super::number::{
    ABSENT, aligned, count, fixed, optional, p_value, percent, signed, significant,
};
use super::{Report, Scored};
use crate::eval::{Breakdown, WorstSample};

/// Samples in the list of the worst.
const WORST: usize = 5;

/// The report as text with a newline at the end.
///
/// * `width`: columns of the terminal; `None` writes names in full.
/// * `color`: whether to use bold and dim letters (ANSI).
///
/// Warnings are not part of it; the caller prints them where errors go.
#[must_use]
pub fn table(report: &Report<'_>, width: Option<u16>, color: bool) -> String {
    let mut p = Printer { out: String::new(), width: width.map(usize::from), color };
    let e = report.evaluation;
    let all = report.scored();
    p.main(report, &all);
    for s in &all {
        let counts = facts::counts(e.n_gt, s);
        if all.len() > 1 {
            p.paragraph(&format!("{}: {counts}", visible(s.name)));
        } else {
            p.paragraph(&counts);
        }
    }
    p.paragraph(facts::DENOMINATORS);
    p.paragraph(&facts::reference(&e.metrics).unwrap_or_else(|| facts::NO_MESH.to_owned()));
    if let Some(s) = facts::intervals_sentence(e) {
        p.paragraph(&s);
    }
    for s in &all {
        p.differences(&e.name, s);
    }
    for s in &all {
        let of = if all.len() > 1 { format!(" of {}", visible(s.name)) } else { String::new() };
        p.details(&of, s, e.n_gt);
    }
    if let Some(a) = &e.authors {
        p.title("Authors' averages");
        let (names, values): (Vec<_>, Vec<_>) = facts::authors_values(a).into_iter().unzip();
        let names = names.into_iter().map(|n| n.replacen(" (", "\n(", 1)).collect();
        p.table(names, vec![values], 0, &[]);
        p.paragraph(&facts::authors_sentence(a));
    }
    for b in &e.by {
        p.breakdown(b);
    }
    p.worst(&e.worst);
    p.out
}

/// Text under construction.
struct Printer {
    out: String,
    width: Option<usize>,
    color: bool,
}

impl Printer {
    /// The paper's table; columns that do not fit go to a second one.
    fn main(&mut self, report: &Report<'_>, all: &[Scored<'_>]) {
        let columns = columns(report);
        let room = self.width.unwrap_or(usize::MAX);
        let name_width = all.iter().map(|s| s.name.chars().count()).max().unwrap_or(0).min(12);
        let needed: usize = columns.iter().map(|c| column_width(c, all) + 2).sum();
        let split = if needed + name_width > room {
            columns.iter().position(|c| !c.paper).unwrap_or(columns.len())
        } else {
            columns.len()
        };
        for part in [&columns[..split], &columns[split..]] {
            if part.is_empty() {
                continue;
            }
            let used: usize = part.iter().map(|c| column_width(c, all) + 2).sum();
            let name_room = room.saturating_sub(used).max(11);
            let mut head = vec!["Method".to_owned()];
            head.extend(part.iter().map(|c| {
                let unit = if c.unit.is_empty() { String::new() } else { format!("{} ", c.unit) };
                format!("{}\n{unit}{}", c.name, c.arrow())
            }));
            let (mut rows, mut dim) = (Vec::new(), Vec::new());
            for s in all {
                let mut row = vec![shorten(&visible(s.name), name_room)];
                row.extend(
                    part.iter().map(|c| optional(c.value(s), |x| aligned(x, c.decimals(all)))),
                );
                rows.push(row);
                if part.iter().all(|c| c.interval(s).is_none()) {
                    continue;
                }
                for (end, title) in ["  95 % from", "         to"].into_iter().enumerate() {
                    let mut row = vec![title.to_owned()];
                    row.extend(part.iter().map(|c| {
                        optional(c.interval(s).map(|i| i[end]), |x| aligned(x, c.decimals(all)))
                    }));
                    dim.push(rows.len());
                    rows.push(row);
                }
            }
            self.table(head, rows, 1, &dim);
            self.out.push('\n');
        }
    }

    fn differences(&mut self, first: &str, s: &Scored<'_>) {
        let Some(c) = s.comparison.filter(|c| !c.difference.is_empty()) else { return };
        self.title(&format!("{} minus {}", visible(s.name), visible(first)));
        let rows = ordered_differences(&c.difference)
            .into_iter()
            .map(|(key, d)| {
                let (name, unit, f) = label(key);
                let [from, to] =
                    d.ci95.map_or([ABSENT; 2].map(str::to_owned), |ci| ci.map(|x| signed(x * f)));
                let p = optional(d.p, p_value);
                vec![titled(&name, unit), signed(d.mean * f), from, to, p, count(d.n)]
            })
            .collect();
        let head = ["Mean of", "Difference", "95 % from", "to", "p", "Samples"];
        self.table(head.map(str::to_owned).into(), rows, 1, &[]);
    }

    fn details(&mut self, of: &str, s: &Scored<'_>, n_gt: usize) {
        let mut undefined = Vec::new();
        let rows: Vec<_> = SUMMARIES
            .iter()
            .filter_map(|key| {
                let m = summary(s.metrics, key)?;
                let (name, unit, f) = label(key);
                if m.n_undefined > 0 {
                    undefined.push(format!("{name} {}", count(m.n_undefined)));
                }
                let values = [m.mean, m.median, m.std, m.p90, m.p95, m.max];
                let mut row = vec![titled(&name, unit)];
                row.extend(values.iter().map(|x| significant(x * f)));
                Some(row)
            })
            .collect();
        if !rows.is_empty() {
            self.title(&format!("Errors{of}"));
            let head = ["", "mean", "median", "std", "p90", "p95", "max"].map(str::to_owned);
            self.table(head.into(), rows, 1, &[]);
            if !undefined.is_empty() {
                self.paragraph(&format!(
                    "Left out, because points lie at or behind the camera: {}.",
                    undefined.join(", ")
                ));
            }
        }
        let mut rows: Vec<_> = facts::scores(s.metrics)
            .into_iter()
            .map(|(name, value, remark)| vec![name, value, visible(&remark)])
            .collect();
        if s.n_matched < n_gt {
            let recalls = facts::recalls_of_matched(s.metrics);
            rows.extend(recalls.into_iter().map(|(name, x)| {
                vec![name, format!("{} %", percent(x)), "of the matched samples".to_owned()]
            }));
        }
        if !rows.is_empty() {
            self.title(&format!("Scores{of}"));
            for mut row in rows {
                let remark = row.pop().unwrap_or_default();
                self.scored_line(&row[0], &row[1], &remark);
            }
        }
    }

    /// Name, value and remark in columns; a remark too long for the line goes to the next ones.
    fn scored_line(&mut self, name: &str, value: &str, remark: &str) {
        let start = format!("{name:<22}{value:>10}  ");
        let indent = " ".repeat(start.chars().count());
        let room = self.width.unwrap_or(100).saturating_sub(indent.len()).max(20);
        for (i, line) in wrap(remark, room).iter().enumerate() {
            let start = if i == 0 { &start } else { &indent };
            let _ = writeln!(self.out, "{start}{line}");
        }
    }

    fn breakdown(&mut self, b: &Breakdown) {
        let title = visible(&titled(&b.column, &b.unit));
        self.title(&format!("By {title}"));
        let (acc, add) = group_keys(b);
        let paper = |mut keys: Vec<String>| {
            let is_paper = |k: &String| k == "5" || k == "10";
            if keys.iter().any(is_paper) {
                keys.retain(is_paper);
            } else {
                keys.truncate(2);
            }
            keys
        };
        let (acc, add) = (paper(acc), paper(add));
        let mut head: Vec<String> =
            ["", "GT", "matched", "NPE", "OE\ndeg", "CPE"].map(str::to_owned).into();
        head.extend(acc.iter().map(|x| format!("Acc{x}\n%")));
        head.extend(add.iter().map(|k| format!("6D\nPose-{k}")));
        let mut rows: Vec<Vec<String>> = b
            .groups
            .iter()
            .map(|g| {
                let mut row = vec![visible(&g.label), count(g.n_gt), count(g.n_matched)];
                row.extend([g.npe, g.oe_deg, g.cpe].map(|x| optional(x, significant)));
                row.extend(acc.iter().map(|x| optional(g.acc.get(x).copied(), percent)));
                row.extend(add.iter().map(|k| optional(g.add_recall.get(k).copied(), percent)));
                row
            })
            .collect();
        let width = |i: usize| {
            let cells = rows.iter().map(|r| r[i].as_str()).chain(head[i].lines());
            2 + cells.map(|c| c.chars().count()).max().unwrap_or(0)
        };
        let others: usize = (1..head.len()).map(width).sum();
        let room = self.width.unwrap_or(usize::MAX).saturating_sub(others).max(8);
        for row in &mut rows {
            row[0] = shorten(&row[0], room);
        }
        self.table(head, rows, 1, &[]);
    }

    fn worst(&mut self, worst: &[WorstSample]) {
        if worst.is_empty() {
            return;
        }
        self.title("Worst predictions by CPE");
        let lines = worst.iter().take(WORST).any(|w| w.line.is_some());
        let mut head = vec!["Sample".to_owned()];
        head.extend(lines.then(|| "line".to_owned()));
        head.extend(["CPE", "NPE", "OE (deg)", "TE (cm)", "dist. (m)"].map(str::to_owned));
        let room = self.width.unwrap_or(usize::MAX).saturating_sub(55).max(12);
        let rows = worst
            .iter()
            .take(WORST)
            .map(|w| {
                let mut row = vec![shorten(&visible(&w.id), room)];
                row.extend(lines.then(|| w.line.map_or_else(String::new, |l| l.to_string())));
                row.extend([w.cpe, w.npe, w.oe_deg, 100.0 * w.te_m].map(significant));
                row.push(fixed(w.distance_m, 3));
                row
            })
            .collect();
        self.table(head, rows, 1, &[]);
    }

    fn title(&mut self, title: &str) {
        let title = shorten(title, self.width.unwrap_or(usize::MAX).max(20));
        let title = if self.color { format!("\x1b[1m{title}\x1b[0m") } else { title };
        let _ = writeln!(self.out, "\n{title}");
    }

    fn paragraph(&mut self, text: &str) {
        for line in wrap(text, self.width.unwrap_or(usize::MAX).max(40)) {
            self.out.push_str(&line);
            self.out.push('\n');
        }
    }

    /// A table with its first `left` columns flush left; `dim` are rows of lesser weight.
    fn table(&mut self, head: Vec<String>, rows: Vec<Vec<String>>, left: usize, dim: &[usize]) {
        let head_lines = head.iter().map(|h| h.lines().count()).max().unwrap_or(1);
        let columns = head.len();
        let mut table = Table::new();
        table.load_style(
            TableStyle::new()
                .header_lines(ContentLineStyle::none())
                .header_separator(LineStyle::none().fill('─'))
                .content_lines(ContentLineStyle::none()),
        );
        table.set_header(head);
        table.add_rows(rows);
        for (i, column) in table.column_iter_mut().enumerate() {
            column.set_padding((0, if i + 1 < columns { 2 } else { 0 }));
            if i >= left {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        for (i, line) in table.lines().enumerate() {
            let line = line.trim_end();
            let is_dim = i > head_lines && dim.contains(&(i - head_lines - 1));
            let code = match () {
                () if i < head_lines => "1",
                () if i == head_lines || is_dim => "2",
                () => "",
            };
            if self.color && !code.is_empty() {
                let _ = writeln!(self.out, "\x1b[{code}m{line}\x1b[0m");
            } else {
                self.out.push_str(line);
                self.out.push('\n');
            }
        }
    }
}

/// Letters that a column of the main table takes.
fn column_width(c: &Column, all: &[Scored<'_>]) -> usize {
    let d = c.decimals(all);
    let mut width = c.name.chars().count().max(c.unit.chars().count() + 2);
    for s in all {
        let numbers = c.value(s).into_iter().chain(c.interval(s).into_iter().flatten());
        width = numbers.map(|x| aligned(x, d).chars().count()).fold(width, usize::max);
    }
    width
}

/// `s` in at most `room` letters, the middle left out if it is longer.
fn shorten(s: &str, room: usize) -> String {
    let n = s.chars().count();
    if n <= room {
        return s.to_owned();
    }
    let tail = (room - 1) / 2;
    let head: String = s.chars().take(room - 1 - tail).collect();
    let tail: String = s.chars().skip(n - tail).collect();
    format!("{head}…{tail}")
}

/// `text` in lines of at most `room` letters, broken at spaces.
fn wrap(text: &str, room: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    let mut used = 0;
    for word in text.split(' ') {
        let n = word.chars().count();
        if used > 0 && used + 1 + n > room {
            lines.push(String::new());
            used = 0;
        }
        if let Some(line) = lines.last_mut() {
            if used > 0 {
                line.push(' ');
                used += 1;
            }
            line.push_str(word);
            used += n;
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture::Fixture;

    #[test]
    fn eighty_columns_are_enough() {
        for f in Fixture::all() {
            let out = table(&f.report(), Some(80), false);
            for line in out.lines() {
                assert!(line.chars().count() <= 80, "{line}\n{out}");
            }
        }
    }

    #[test]
    fn every_case_is_finite_and_states_the_reference() {
        for f in Fixture::all() {
            let out = table(&f.report(), None, false);
            for word in ["NaN", "inf ", "inf\n", "null", "\u{1b}"] {
                assert!(!out.contains(word), "{word} in {out}");
            }
            let mesh = f.evaluation.metrics.add_recall.is_some();
            assert_eq!(out.contains("of the bounding-box diagonal, 0.6089 m"), mesh);
            assert_eq!(out.contains(facts::NO_MESH), !mesh);
        }
    }

    #[test]
    fn counts_are_stated_and_warnings_are_not() {
        let out = table(&Fixture::pair().report(), Some(80), false);
        assert!(
            out.contains("500 ground truth, 430 predictions, 430 matched, 70 missing"),
            "{out}"
        );
        assert!(!out.contains("count as"));
    }

    #[test]
    fn colour_adds_nothing_but_codes() {
        let f = Fixture::pair();
        let plain = table(&f.report(), Some(80), false);
        let mut colored = table(&f.report(), Some(80), true);
        for code in ["\u{1b}[0m", "\u{1b}[1m", "\u{1b}[2m"] {
            assert!(colored.contains(code));
            colored = colored.replace(code, "");
        }
        assert_eq!(plain, colored);
    }

    #[test]
    fn long_names_lose_their_middle() {
        assert_eq!(shorten("abcdefghij", 5), "ab…ij");
        assert_eq!(shorten("abc", 5), "abc");
        assert_eq!(wrap("aa bb cc", 5), ["aa bb", "cc"]);
    }
}
