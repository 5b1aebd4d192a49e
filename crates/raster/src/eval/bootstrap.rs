//! Bootstrap confidence intervals: percentile intervals of resampled means, and the paired form
//! for the difference of two methods. Efron & Tibshirani, "An Introduction to the Bootstrap", 1993.
//!
//! Resample `r` draws from its own generator, seeded by `(seed, r)`, so that the result does not
//! depend on the number of threads.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng;
use rayon::prelude::*;

use crate::eval::results::{Difference, Interval};
use crate::eval::summary::{mean, quantiles};
use crate::random::generator;

/// Columns over the ground truth: values of the matched samples, and how many are missing.
#[derive(Debug, Clone, Default)]
pub struct Features {
    /// Names, one a column.
    pub names: Vec<String>,
    /// Whether a missing sample counts as zero (a recall) or not at all (a mean of errors).
    pub over_gt: Vec<bool>,
    /// Values, one row a matched sample.
    rows: Vec<f64>,
    /// Ground-truth poses.
    pub n_gt: usize,
}

impl Features {
    /// From columns of equal length.
    #[must_use]
    pub fn new(columns: Vec<(String, bool, Vec<f64>)>, n_gt: usize) -> Self {
        let n = columns.first().map_or(0, |c| c.2.len());
        let mut rows = Vec::with_capacity(n * columns.len());
        for i in 0..n {
            rows.extend(columns.iter().map(|c| c.2[i]));
        }
        let over_gt = columns.iter().map(|c| c.1).collect();
        Self { names: columns.into_iter().map(|c| c.0).collect(), over_gt, rows, n_gt }
    }

    fn matched(&self) -> usize {
        if self.names.is_empty() { 0 } else { self.rows.len() / self.names.len() }
    }

    /// 95 % percentile interval of the mean of every column; `None` where no resample has a
    /// defined mean.
    #[must_use]
    pub fn intervals(&self, resamples: usize, seed: u64) -> Vec<Option<Interval>> {
        let k = self.names.len();
        let means: Vec<Vec<f64>> = (0..resamples as u64)
            .into_par_iter()
            .map(|r| self.resampled_means(&mut generator(seed, r)))
            .collect();
        let interval = |c: usize| {
            let values: Vec<f64> = means.iter().map(|m| m[c]).filter(|x| x.is_finite()).collect();
            interval(values)
        };
        (0..k).map(interval).collect()
    }

    fn resampled_means(&self, rng: &mut Pcg64Mcg) -> Vec<f64> {
        let (k, m) = (self.names.len(), self.matched());
        let mut sums = vec![0.0; k];
        let mut drawn = 0_usize;
        for _ in 0..self.n_gt {
            let i = below(rng, self.n_gt);
            if i < m {
                drawn += 1;
                let row = &self.rows[i * k..(i + 1) * k];
                for (sum, x) in sums.iter_mut().zip(row) {
                    *sum += x;
                }
            }
        }
        // 0 / 0 is NaN: a resample without any matched sample has no mean error.
        for (sum, &over_gt) in sums.iter_mut().zip(&self.over_gt) {
            *sum /= if over_gt { self.n_gt } else { drawn } as f64;
        }
        sums
    }
}

/// Mean of paired differences with its 95 % interval and the two-sided p-value of "no difference"
/// (the share of resampled means on the other side of zero, doubled; at least `1 / resamples`).
/// `None` of nothing.
#[must_use]
pub fn paired(differences: &[f64], resamples: usize, seed: u64) -> Option<Difference> {
    let n = differences.len();
    let centre = mean(differences)?;
    let means: Vec<f64> = (0..resamples as u64)
        .into_par_iter()
        .map(|r| {
            let mut rng = generator(seed, r);
            (0..n).map(|_| differences[below(&mut rng, n)]).sum::<f64>() / n as f64
        })
        .collect();
    let p = (resamples > 0).then(|| {
        let at_most = means.iter().filter(|&&x| x <= 0.0).count();
        let at_least = means.iter().filter(|&&x| x >= 0.0).count();
        (2.0 * (at_most.min(at_least) + 1) as f64 / (resamples + 1) as f64).min(1.0)
    });
    Some(Difference { mean: centre, ci95: interval(means), p, n })
}

fn interval(mut means: Vec<f64>) -> Option<Interval> {
    (!means.is_empty()).then(|| quantiles(&mut means, [0.025, 0.975]))
}

/// Uniform in `0..n` (Lemire's multiply-shift; its bias of n / 2^64 is far below the noise).
fn below(rng: &mut Pcg64Mcg, n: usize) -> usize {
    ((u128::from(rng.next_u64()) * n as u128) >> 64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(n: usize) -> Vec<f64> {
        (0..n).map(|i| (i as f64 * 0.7).sin() + 1.0).collect()
    }

    #[test]
    fn the_interval_has_the_width_of_the_standard_error() {
        let x = column(2000);
        let centre = mean(&x).expect("not empty");
        let features = Features::new(vec![("x".into(), false, x)], 2000);
        let [low, high] = features.intervals(2000, 1)[0].expect("defined");
        // std = sqrt(1/2), standard error = std / sqrt(2000), the interval is 2 * 1.96 of it.
        let width = 2.0 * 1.96 * 0.5_f64.sqrt() / 2000.0_f64.sqrt();
        assert!((high - low - width).abs() < 0.1 * width, "{}", high - low);
        assert!(low < centre && centre < high);
    }

    #[test]
    fn missing_samples_lower_a_recall_and_not_a_mean() {
        let ones = || vec![1.0; 50];
        let columns = vec![("mean".into(), false, ones()), ("recall".into(), true, ones())];
        let intervals = Features::new(columns, 100).intervals(500, 3);
        assert_eq!(intervals[0], Some([1.0, 1.0]));
        let [low, high] = intervals[1].expect("defined");
        assert!(low > 0.35 && high < 0.65 && low < 0.5 && high > 0.5, "{low} {high}");
    }

    #[test]
    fn threads_change_nothing_and_seeds_do() {
        let features = Features::new(vec![("x".into(), false, column(300))], 310);
        let run = |threads, seed| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("a pool").install(|| features.intervals(200, seed))
        };
        assert_eq!(run(1, 5), run(2, 5));
        assert_eq!(run(1, 5), run(7, 5));
        assert_ne!(run(1, 5), run(1, 6));
    }

    #[test]
    fn a_clear_difference_is_significant_and_none_is_not() {
        let clear: Vec<f64> = column(200);
        let d = paired(&clear, 999, 0).expect("not empty");
        assert!(d.p.expect("resampled") < 0.01 && d.ci95.expect("resampled")[0] > 0.0);
        let none: Vec<f64> = (0..200).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        assert!(paired(&none, 999, 0).expect("not empty").p.expect("resampled") > 0.5);
        let equal = paired(&[0.0; 10], 99, 0).expect("not empty");
        assert_eq!((equal.mean, equal.p), (0.0, Some(1.0)));
        assert!(paired(&[], 10, 0).is_none());
    }
}
