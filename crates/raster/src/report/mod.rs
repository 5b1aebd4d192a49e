//! Reports on an evaluation for people: terminal, HTML, Markdown and LaTeX; and the JSON.
//!
//! Every format shows the columns of the paper's tables first (NPE, OE, CPE, Acc5, Acc10,
//! 6D Pose-5, 6D Pose-10) and always states the reference length of 6D Pose-k. Means are over the
//! matched samples, recalls over all ground truth. No output contains NaN or infinity: what is
//! absent or undefined is printed as a dash, so that it cannot be read as a good score.
//!
//! All text that comes from the user (ids, file names, columns) is escaped for its format.

mod columns;
mod escape;
mod facts;
#[cfg(test)]
mod fixture;
mod html;
mod json;
mod latex;
mod markdown;
mod number;
mod plots;
mod svg;
#[cfg(feature = "cli")]
mod text;

pub use html::html;
pub use json::json;
pub use latex::latex;
pub use markdown::markdown;
#[cfg(feature = "cli")]
pub use text::table;

use crate::eval::{Comparison, Evaluation, Intervals, Metrics, Samples};

/// The single samples of one method, for the charts.
#[derive(Debug, Clone, Copy)]
pub struct Method<'a> {
    /// Name of the method, as in the [`Evaluation`].
    pub name: &'a str,
    /// Errors of its matched samples.
    pub samples: &'a Samples,
    /// Ground-truth poses, the denominator of every recall.
    pub n_gt: usize,
}

/// What a report is made from.
#[derive(Debug, Clone)]
pub struct Report<'a> {
    /// The numbers.
    pub evaluation: &'a Evaluation,
    /// The predictions first, then one for each of [`Evaluation::compare`]. Only the HTML report
    /// reads them; without them it has no charts.
    pub methods: Vec<Method<'a>>,
}

impl Report<'_> {
    /// The methods' numbers in one shape: the predictions first, then the comparisons.
    fn scored(&self) -> Vec<Scored<'_>> {
        let e = self.evaluation;
        let first = Scored {
            name: &e.name,
            n_predictions: e.n_predictions,
            n_matched: e.n_matched,
            metrics: &e.metrics,
            ci95: e.ci95.as_ref(),
            comparison: None,
        };
        let others = e.compare.iter().map(|c| Scored {
            name: &c.name,
            n_predictions: c.n_predictions,
            n_matched: c.n_matched,
            metrics: &c.metrics,
            ci95: c.ci95.as_ref(),
            comparison: Some(c),
        });
        std::iter::once(first).chain(others).collect()
    }
}

/// What an [`Evaluation`] and a [`Comparison`] have in common.
#[derive(Debug, Clone, Copy)]
struct Scored<'a> {
    name: &'a str,
    n_predictions: usize,
    n_matched: usize,
    metrics: &'a Metrics,
    ci95: Option<&'a Intervals>,
    comparison: Option<&'a Comparison>,
}
