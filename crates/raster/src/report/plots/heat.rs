//! Mean errors against the viewing direction.

use std::fmt::Write as _;

use super::{Figure, Quantity, columns};
use crate::eval::Samples;
use crate::report::Report;
use crate::report::number::{count, short};
use crate::report::svg::{Cell, HEATS, Heat};

/// Methods with a heat map of their own.
const METHODS: usize = 4;
/// Rows that leave room for the label of the axis.
const MIN_ROWS: usize = 3;

/// Mean error and number of samples in cells of 30 degrees of azimuth.
fn heat_cells(
    s: &Samples,
    values: &[f64],
    low: f64,
    size: f64,
    rows: usize,
) -> Vec<[(f64, usize); 12]> {
    let mut cells = vec![[(0.0, 0); 12]; rows];
    for ((az, el), v) in s.azimuth_deg.iter().zip(&s.elevation_deg).zip(values) {
        let column = (((az + 180.0) / 30.0) as usize).min(11);
        let row = (((el - low) / size) as usize).min(rows - 1);
        let cell = &mut cells[row][column];
        cell.0 += v;
        cell.1 += 1;
    }
    cells
}

/// Heat maps of the mean error over azimuth and elevation, one for each method, on one scale.
pub(super) fn maps(report: &Report<'_>, q: &Quantity) -> Vec<Figure> {
    let Some(columns) = columns(report, q) else { return Vec::new() };
    let all = || report.methods.iter().flat_map(|m| m.samples.elevation_deg.iter().copied());
    let (low, high) =
        (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let size = if high - low <= 80.0 { 10.0 } else { 20.0 };
    let low = (low / size).floor() * size;
    let rows = (((high - low) / size).ceil() as usize).clamp(MIN_ROWS, 18);
    let low = low.min(90.0 - size * MIN_ROWS as f64);
    let maps: Vec<_> = report
        .methods
        .iter()
        .zip(&columns)
        .take(METHODS)
        .map(|(m, v)| heat_cells(m.samples, v, low, size, rows))
        .collect();
    let means = || maps.iter().flatten().flatten().filter(|c| c.1 > 0).map(|c| c.0 / c.1 as f64);
    let mut sorted: Vec<f64> = means().collect();
    sorted.sort_by(f64::total_cmp);
    // A cell or two with an outlier would leave one colour for all others.
    let (least, most) = (sorted[0], sorted[(sorted.len() - 1) * 19 / 20]);
    let more = if most < sorted[sorted.len() - 1] { " and more" } else { "" };
    let heat = |x: f64| {
        if most > least { ((x - least) / (most - least) * HEATS as f64) as usize } else { 0 }
    };
    let mut out = Vec::new();
    for (m, map) in report.methods.iter().zip(&maps) {
        let cells = map.iter().enumerate().map(|(j, row)| {
            let cell = |(i, (sum, n)): (usize, &(f64, usize))| {
                let mean = (*n > 0).then(|| sum / *n as f64)?;
                let (az, el) = (-180.0 + 30.0 * i as f64, low + size * j as f64);
                let title = format!(
                    "azimuth {az} to {} deg, elevation {el} to {} deg: mean {} {} of {} samples",
                    az + 30.0,
                    el + size,
                    short(mean),
                    q.unit,
                    count(*n)
                );
                Some(Cell { heat: heat(mean), text: three(mean), title })
            };
            row.iter().enumerate().map(cell).collect()
        });
        let x_edges = (0..=12).map(|i: i32| match i % 3 {
            0 => (30 * i - 180).to_string(),
            _ => String::new(),
        });
        let title = format!("{}: mean {} ({})", m.name, q.name.to_lowercase(), q.unit);
        let title = if report.methods.len() > 1 {
            title
        } else {
            format!("Mean {} ({})", q.name.to_lowercase(), q.unit)
        };
        out.push(Figure {
            svg: Heat {
                about: &title,
                x_edges: x_edges.collect(),
                y_edges: (0..=rows).map(|j| short(low + size * j as f64)).collect(),
                x_label: "Azimuth of the camera (deg)",
                y_label: "Elevation (deg)",
                cells: cells.collect(),
            }
            .draw(),
            legend: if most > least {
                scale(least, most, &format!("{}{more}", q.unit), q.unit)
            } else {
                String::new()
            },
            title,
            caption: String::new(),
        });
    }
    out
}

/// The colours from least to most.
fn scale(least: f64, most: f64, most_unit: &str, unit: &str) -> String {
    let mut out =
        format!("<p class=\"scale\">{} {unit} <svg viewBox=\"0 0 140 12\">", three(least));
    for i in 0..HEATS {
        let _ = write!(
            out,
            "<g class=\"h{i}\"><rect x=\"{}\" y=\"0\" width=\"20\" height=\"12\"/></g>",
            20 * i
        );
    }
    let _ = write!(out, "</svg> {} {most_unit}</p>", three(most));
    out
}

/// About three digits, for a small cell.
fn three(x: f64) -> String {
    match x {
        x if !x.is_finite() => String::new(),
        x if x >= 99.95 => format!("{x:.0}"),
        x if x >= 9.995 => format!("{x:.1}"),
        x => format!("{x:.2}"),
    }
}
