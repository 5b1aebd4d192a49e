//! Charts as SVG text: axes with "1-2-5" ticks, lines, dots, bars and heat maps.
//!
//! Colours are classes (`s0`, `s1`, ... for the series, `h0` to `h6` for heat), which the style
//! sheet of the page sets for light and dark. What can be pointed at has a `<title>`.

use std::fmt::Write as _;

use super::escape::escape;

const WIDTH: f64 = 520.0;
const HEIGHT: f64 = 310.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 48.0;

/// Number of heat colours.
pub(super) const HEATS: usize = 7;

/// Number of series colours.
const SERIES: usize = 8;

/// Range and label of an axis.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    /// Value at the left or bottom.
    pub(super) min: f64,
    /// Value at the right or top, above `min`.
    pub(super) max: f64,
    /// Name and unit.
    pub(super) label: String,
}

impl Axis {
    /// From zero to a round number not below `max`; to one if `max` is zero.
    pub(super) fn to(max: f64, label: &str) -> Self {
        let max = if max.is_finite() && max > 0.0 { max } else { 1.0 };
        let step = step(max);
        Self { min: 0.0, max: (max / step - 1e-9).ceil() * step, label: label.to_owned() }
    }

    /// From zero to `max`, rounded up to two digits; to one if `max` is zero.
    pub(super) fn tight(max: f64, label: &str) -> Self {
        if !max.is_finite() || max <= 0.0 {
            return Self::to(1.0, label);
        }
        let digit = 10_f64.powf(max.log10().floor() - 1.0);
        Self { min: 0.0, max: (max / digit - 1e-9).ceil() * digit, label: label.to_owned() }
    }

    /// Round numbers around `min` and `max`.
    pub(super) fn around(min: f64, max: f64, label: &str) -> Self {
        let span = if max > min { max - min } else { (max.abs() * 0.2).max(1.0) };
        let step = step(span);
        let low = (min / step).floor() * step;
        let high = (max / step).ceil() * step;
        let high = if high > low { high } else { low + step };
        Self { min: low, max: high, label: label.to_owned() }
    }

    /// Round numbers in the range, about five.
    fn ticks(&self) -> Vec<f64> {
        let step = step(self.max - self.min);
        let first = (self.min / step - 1e-9).ceil() as i64;
        let last = (self.max / step + 1e-9).floor() as i64;
        (first..=last).map(|i| i as f64 * step).collect()
    }

    fn tick_label(&self, x: f64) -> String {
        let step = step(self.max - self.min);
        let digits = -step.log10().floor();
        if x == 0.0 {
            "0".to_owned()
        } else if digits > 4.0 || step >= 1e6 {
            format!("{x:.0e}")
        } else {
            format!("{x:.*}", digits.max(0.0) as usize)
        }
    }

    fn contains(&self, x: f64) -> bool {
        x >= self.min && x <= self.max
    }
}

/// The distance of ticks for a range: 1, 2 or 5 times a power of ten.
fn step(span: f64) -> f64 {
    let raw = span / 5.0;
    let power = 10_f64.powf(raw.log10().floor());
    let factor = match raw / power {
        r if r <= 1.000_001 => 1.0,
        r if r <= 2.000_001 => 2.0,
        r if r <= 5.000_001 => 5.0,
        _ => 10.0,
    };
    factor * power
}

/// A chart with two axes.
#[derive(Debug)]
pub(super) struct Chart {
    out: String,
    x: Axis,
    y: Axis,
}

impl Chart {
    /// Axes, grid and labels; `about` is read to those who do not see it.
    pub(super) fn new(about: &str, x: Axis, y: Axis) -> Self {
        let mut c = Self { out: String::new(), x, y };
        let about = escape(about);
        let _ = write!(
            c.out,
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" \
             aria-label=\"{about}\" xmlns=\"http://www.w3.org/2000/svg\">"
        );
        let (left, right) = (LEFT, WIDTH - RIGHT);
        let (top, bottom) = (TOP, HEIGHT - BOTTOM);
        c.out.push_str("<g class=\"grid\">");
        for t in c.y.ticks() {
            let y = c.py(t);
            let _ = write!(c.out, "<path d=\"M{left} {y:.1}H{right}\"/>");
        }
        for t in c.x.ticks() {
            let x = c.px(t);
            let _ = write!(c.out, "<path d=\"M{x:.1} {top}V{bottom}\"/>");
        }
        c.out.push_str("</g><g class=\"ticks\">");
        for t in c.y.ticks() {
            let (x, y, t) = (left - 7.0, c.py(t) + 4.0, c.y.tick_label(t));
            let _ = write!(c.out, "<text x=\"{x}\" y=\"{y:.1}\" text-anchor=\"end\">{t}</text>");
        }
        for t in c.x.ticks() {
            let (x, y, t) = (c.px(t), bottom + 18.0, c.x.tick_label(t));
            let _ = write!(c.out, "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{t}</text>");
        }
        let _ = write!(c.out, "</g><path class=\"axis\" d=\"M{left} {top}V{bottom}H{right}\"/>");
        let (middle, y) = (left.midpoint(right), HEIGHT - 8.0);
        let (x_label, y_label) = (escape(&c.x.label), escape(&c.y.label));
        let _ = write!(
            c.out,
            "<text class=\"label\" x=\"{middle}\" y=\"{y}\" text-anchor=\"middle\">{x_label}</text>"
        );
        let (x, middle) = (14.0, top.midpoint(bottom));
        let _ = write!(
            c.out,
            "<text class=\"label\" text-anchor=\"middle\" \
             transform=\"translate({x} {middle}) rotate(-90)\">{y_label}</text>"
        );
        c
    }

    fn px(&self, x: f64) -> f64 {
        LEFT + (x - self.x.min) / (self.x.max - self.x.min) * (WIDTH - LEFT - RIGHT)
    }

    fn py(&self, y: f64) -> f64 {
        let y = y.clamp(self.y.min, self.y.max);
        HEIGHT - BOTTOM - (y - self.y.min) / (self.y.max - self.y.min) * (HEIGHT - TOP - BOTTOM)
    }

    /// A polyline; what lies above the axis runs along its end.
    pub(super) fn line(&mut self, series: usize, class: &str, points: &[(f64, f64)]) {
        let mut d = String::new();
        for &(x, y) in points.iter().filter(|p| self.x.contains(p.0) && p.1.is_finite()) {
            let command = if d.is_empty() { 'M' } else { 'L' };
            let _ = write!(d, "{command}{:.1} {:.1}", self.px(x), self.py(y));
        }
        if !d.is_empty() {
            let s = series % SERIES;
            let _ = write!(self.out, "<path class=\"line s{s} {class}\" d=\"{d}\"/>");
        }
    }

    /// A point to read a value from.
    pub(super) fn marker(&mut self, series: usize, x: f64, y: f64, title: &str) {
        if !self.x.contains(x) || !y.is_finite() {
            return;
        }
        let (cx, cy, s, title) = (self.px(x), self.py(y), series % SERIES, escape(title));
        let _ = write!(
            self.out,
            "<circle class=\"marker s{s}\" cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"4.5\">\
             <title>{title}</title></circle>"
        );
    }

    /// Many small points in one path; those outside the axes are left out.
    pub(super) fn dots(&mut self, series: usize, points: impl Iterator<Item = (f64, f64)>) {
        let mut d = String::new();
        for (x, y) in points.filter(|p| self.x.contains(p.0) && self.y.contains(p.1)) {
            let _ = write!(d, "M{:.1} {:.1}h0", self.px(x), self.py(y));
        }
        let _ = write!(self.out, "<path class=\"dots s{}\" d=\"{d}\"/>", series % SERIES);
    }

    /// Bars of equal width from zero to `heights`, with what to say about each.
    pub(super) fn bars(&mut self, series: usize, heights: &[f64], title: impl Fn(usize) -> String) {
        let width = (self.x.max - self.x.min) / heights.len() as f64;
        for (i, &h) in heights.iter().enumerate().filter(|(_, h)| **h > 0.0) {
            let x = self.px(self.x.min + width * i as f64);
            let (w, y) = (self.px(self.x.min + width) - LEFT, self.py(h));
            let (h, w) = (HEIGHT - BOTTOM - y, (w - 1.0).max(0.5));
            let (s, title) = (series % SERIES, escape(&title(i)));
            let _ = write!(
                self.out,
                "<rect class=\"bar s{s}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" \
                 height=\"{h:.1}\"><title>{title}</title></rect>"
            );
        }
    }

    /// The outline of a histogram.
    pub(super) fn outline(&mut self, series: usize, heights: &[f64]) {
        let width = (self.x.max - self.x.min) / heights.len() as f64;
        let mut d = format!("M{LEFT} {}", HEIGHT - BOTTOM);
        for (i, &h) in heights.iter().enumerate() {
            let (y, x) = (self.py(h), self.px(self.x.min + width * (i + 1) as f64));
            let _ = write!(d, "V{y:.1}H{x:.1}");
        }
        let _ = write!(self.out, "<path class=\"line s{}\" d=\"{d}\"/>", series % SERIES);
    }

    /// The chart.
    pub(super) fn finish(mut self) -> String {
        self.out.push_str("</svg>");
        self.out
    }
}

/// One cell of a heat map: what it shows and says.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// Colour, below [`HEATS`].
    pub(super) heat: usize,
    /// Number in the cell.
    pub(super) text: String,
    /// What the pointer shows.
    pub(super) title: String,
}

/// A heat map.
#[derive(Debug)]
pub(super) struct Heat<'a> {
    /// Read to those who do not see it.
    pub(super) about: &'a str,
    /// Labels of the edges between columns, one more than columns; empty ones are not drawn.
    pub(super) x_edges: Vec<String>,
    /// Labels of the edges between rows, from the bottom.
    pub(super) y_edges: Vec<String>,
    /// Label of the horizontal axis.
    pub(super) x_label: &'a str,
    /// Label of the vertical axis.
    pub(super) y_label: &'a str,
    /// Rows from the bottom; `None` stays blank.
    pub(super) cells: Vec<Vec<Option<Cell>>>,
}

impl Heat<'_> {
    /// The heat map.
    pub(super) fn draw(&self) -> String {
        let rows = self.cells.len().max(1) as f64;
        let columns = self.x_edges.len().saturating_sub(1).max(1) as f64;
        let w = (WIDTH - LEFT - RIGHT) / columns;
        let h = 30.0;
        let height = TOP + BOTTOM + rows * h;
        let bottom = height - BOTTOM;
        let mut out = format!(
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" \
             aria-label=\"{}\" xmlns=\"http://www.w3.org/2000/svg\">",
            escape(self.about)
        );
        let _ = write!(
            out,
            "<rect class=\"blank\" x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\"/>",
            WIDTH - LEFT - RIGHT,
            rows * h
        );
        for (j, row) in self.cells.iter().enumerate() {
            for (i, cell) in row.iter().enumerate() {
                let Some(cell) = cell else { continue };
                let (x, y) = (LEFT + w * i as f64, bottom - h * (j + 1) as f64);
                let (cx, cy) = (x + w / 2.0, y + h / 2.0 + 4.0);
                let (heat, text) = (cell.heat.min(HEATS - 1), escape(&cell.text));
                let _ = write!(
                    out,
                    "<g class=\"h{heat}\"><title>{}</title><rect x=\"{x:.1}\" y=\"{y:.1}\" \
                     width=\"{:.1}\" height=\"{:.1}\"/><text x=\"{cx:.1}\" y=\"{cy:.1}\" \
                     text-anchor=\"middle\">{text}</text></g>",
                    escape(&cell.title),
                    w - 1.0,
                    h - 1.0,
                );
            }
        }
        out.push_str("<g class=\"ticks\">");
        for (i, label) in self.x_edges.iter().enumerate().filter(|(_, l)| !l.is_empty()) {
            let (x, y) = (LEFT + w * i as f64, bottom + 18.0);
            let anchor = if i + 1 == self.x_edges.len() { "end" } else { "middle" };
            let _ = write!(
                out,
                "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"{anchor}\">{}</text>",
                escape(label)
            );
        }
        for (j, label) in self.y_edges.iter().enumerate().filter(|(_, l)| !l.is_empty()) {
            let (x, y) = (LEFT - 7.0, bottom - h * j as f64 + 4.0);
            let label = escape(label);
            let _ = write!(out, "<text x=\"{x}\" y=\"{y:.1}\" text-anchor=\"end\">{label}</text>");
        }
        let (middle, y) = (LEFT.midpoint(WIDTH - RIGHT), height - 8.0);
        let _ = write!(
            out,
            "</g><text class=\"label\" x=\"{middle}\" y=\"{y}\" text-anchor=\"middle\">{}</text>",
            escape(self.x_label)
        );
        let _ = write!(
            out,
            "<text class=\"label\" text-anchor=\"middle\" transform=\"translate(14 {}) \
             rotate(-90)\">{}</text></svg>",
            TOP.midpoint(bottom),
            escape(self.y_label)
        );
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_one_two_five() {
        let labels = |a: &Axis| a.ticks().iter().map(|t| a.tick_label(*t)).collect::<Vec<_>>();
        assert_eq!(labels(&Axis::to(9.3, "")), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(&Axis::to(0.042, "")), ["0", "0.01", "0.02", "0.03", "0.04", "0.05"]);
        assert_eq!(labels(&Axis::to(100.0, "")), ["0", "20", "40", "60", "80", "100"]);
        assert_eq!(labels(&Axis::around(-20.0, 48.0, "")), ["-20", "0", "20", "40", "60"]);
    }

    #[test]
    fn an_axis_is_never_empty() {
        let cases = [(0.0, 0.0), (3.0, 3.0), (-5.0, -5.0), (1e-16, 2e-16), (1e9, 1e9 + 1.0)];
        for a in cases.map(|(low, high)| Axis::around(low, high, "")) {
            assert!(a.max > a.min && (2..20).contains(&a.ticks().len()), "{a:?}");
        }
        for max in [0.0, 1e-15, 7.0, 3e8, f64::INFINITY] {
            for a in [Axis::to(max, ""), Axis::tight(max, "")] {
                assert!(a.max > 0.0 && (2..20).contains(&a.ticks().len()), "{a:?}");
            }
        }
    }

    #[test]
    fn text_and_values_cannot_break_the_chart() {
        let mut c = Chart::new("a<b", Axis::to(1.0, "x & y"), Axis::to(1.0, "<y>"));
        c.line(0, "", &[(0.0, f64::NAN), (0.5, 0.5), (2.0, 0.1)]);
        c.marker(9, 0.5, f64::INFINITY, "never");
        c.marker(9, 0.5, 0.5, "<t>");
        let out = c.finish();
        for word in ["NaN", "inf", "never", "<y>", "<t>"] {
            assert!(!out.contains(word), "{word} in {out}");
        }
        assert!(out.contains("x &amp; y") && out.contains("marker s1"));
    }
}
