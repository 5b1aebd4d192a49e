//! From the errors of single samples to one number: means, quantiles, recalls, areas, scores.
//!
//! Definitions and edge conventions: comparisons are strict (`error < threshold`), standard
//! deviations are those of the population, quantiles are interpolated linearly, sums are
//! compensated so that they do not depend on the number of samples.

use crate::eval::results::{Auc, Recall, SpeedPlus, Summary};

/// SPEED+: a normalised position error below this counts as zero (Park et al., SPEC2021).
pub const SPEEDPLUS_POSITION: f64 = 2.173e-3;
/// SPEED+: an orientation error below this many degrees counts as zero.
pub const SPEEDPLUS_ORIENTATION_DEG: f64 = 0.169;
/// Upper end of the ADD curve in metres (YCB-Video).
pub const AUC_LIMIT_M: f64 = 0.1;

/// Sum with Neumaier's compensation.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    sum: f64,
    lost: f64,
}

impl Sum {
    fn add(&mut self, x: f64) {
        let next = self.sum + x;
        // Knuth's form of the rounding error: the same bits as Neumaier's, without his comparison
        // (and its mispredictions).
        let back = next - self.sum;
        self.lost += (self.sum - (next - back)) + (x - back);
        self.sum = next;
    }

    fn value(self) -> f64 {
        self.sum + self.lost
    }
}

/// Sum with Neumaier's compensation, in the order of the slice.
#[must_use]
pub fn sum(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sum = Sum::default();
    values.into_iter().for_each(|x| sum.add(x));
    sum.value()
}

/// Mean, `None` of nothing.
#[must_use]
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| sum(values.iter().copied()) / values.len() as f64)
}

/// Summary of the finite values; `None` if there is none. Infinite ones are counted as undefined.
#[must_use]
pub fn summarize(values: &[f64]) -> Option<Summary> {
    let mut finite: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    if finite.is_empty() {
        return None;
    }
    let n = finite.len() as f64;
    // Two sums in one pass: each waits for itself, not for the other.
    let (mut plain, mut square) = (Sum::default(), Sum::default());
    let (mut min, mut max) = (f64::INFINITY, f64::NEG_INFINITY);
    for &x in &finite {
        plain.add(x);
        square.add(x * x);
        min = if x < min { x } else { min };
        max = if x > max { x } else { max };
    }
    let (mean, square) = (plain.value() / n, square.value() / n);
    let variance = sum(finite.iter().map(|x| (x - mean) * (x - mean))) / n;
    let [median, p90, p95] = quantiles(&mut finite, [0.5, 0.9, 0.95]);
    Some(Summary {
        mean,
        median,
        std: variance.sqrt(),
        min,
        max,
        p90,
        p95,
        rmse: square.sqrt(),
        n_undefined: values.len() - finite.len(),
    })
}

/// Quantiles at ascending fractions, interpolated linearly between order statistics (the
/// definition of `numpy.quantile`); the slice is reordered.
///
/// # Panics
/// If the slice is empty.
pub fn quantiles<const N: usize>(values: &mut [f64], fractions: [f64; N]) -> [f64; N] {
    let last = values.len() - 1;
    let mut done = 0;
    let mut order_statistic = |k: usize| {
        if k >= done {
            values[done..].select_nth_unstable_by(k - done, f64::total_cmp);
            done = k + 1;
        }
        values[k]
    };
    fractions.map(|q| {
        let position = q * last as f64;
        let k = (position as usize).min(last);
        let low = order_statistic(k);
        let high = order_statistic((k + 1).min(last));
        low + (high - low) * (position - k as f64)
    })
}

/// A count out of the ground truth and out of the matched samples.
#[must_use]
pub fn recall(count: usize, n_matched: usize, n_gt: usize) -> Recall {
    let percent = |n: usize| 100.0 * count as f64 / n as f64;
    Recall {
        count,
        percent_of_gt: percent(n_gt),
        percent_of_matched: (n_matched > 0).then(|| percent(n_matched)),
    }
}

/// Accuracy at `x` degrees and `x` centimetres: both strictly below. The translation is compared
/// as `te * 100 < x`, as the authors do.
#[must_use]
pub fn accurate(te_m: f64, oe_rad: f64, x: f64) -> bool {
    oe_rad.to_degrees() < x && te_m * 100.0 < x
}

/// Area under the recall curve on `[0, limit]`, with missing samples (`n_gt` above the number of
/// errors) as infinitely wrong. Xiang et al., "`PoseCNN`", RSS 2018.
#[must_use]
pub fn auc(errors: &[f64], n_gt: usize, limit: f64) -> Auc {
    let n = n_gt as f64;
    if n_gt == 0 {
        return Auc { exact: 0.0, ycb: 0.0 };
    }
    let exact = sum(errors.iter().map(|&e| if e < limit { 1.0 - e / limit } else { 0.0 })) / n;
    // YCB's step form takes the right edge of each step: more by the largest counted error over n.
    let within = errors.iter().copied().filter(|&e| e <= limit);
    let largest = within.fold(0.0, |m, e| if e > m { e } else { m });
    Auc { exact, ycb: exact + largest / limit / n }
}

/// SPEED+ score over the matched samples; `None` of nothing.
#[must_use]
pub fn speedplus(npe: &[f64], oe_rad: &[f64]) -> Option<SpeedPlus> {
    if npe.is_empty() {
        return None;
    }
    let n = npe.len() as f64;
    let floor = SPEEDPLUS_ORIENTATION_DEG.to_radians();
    let e_t = sum(npe.iter().map(|&e| if e < SPEEDPLUS_POSITION { 0.0 } else { e })) / n;
    let e_q_rad = sum(oe_rad.iter().map(|&e| if e < floor { 0.0 } else { e })) / n;
    Some(SpeedPlus {
        score: e_t + e_q_rad,
        e_t,
        e_q_rad,
        zeroed_t: npe.iter().filter(|&&e| e < SPEEDPLUS_POSITION).count(),
        zeroed_q: oe_rad.iter().filter(|&&e| e < floor).count(),
    })
}

/// Mean of the means of consecutive batches: what the authors' training script prints.
#[must_use]
pub fn mean_of_batch_means(values: &[f64], batch_size: usize) -> Option<f64> {
    let means: Option<Vec<f64>> = values.chunks(batch_size.max(1)).map(mean).collect();
    mean(&means?)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_summary_of_known_numbers() {
        let s = summarize(&[4.0, 1.0, 3.0, 2.0, f64::INFINITY]).expect("four finite");
        assert_eq!((s.mean, s.median, s.min, s.max, s.n_undefined), (2.5, 2.5, 1.0, 4.0, 1));
        assert!((s.std - 1.25_f64.sqrt()).abs() < 1e-15);
        assert!((s.p90 - 3.7).abs() < 1e-15 && (s.p95 - 3.85).abs() < 1e-15);
        assert!((s.rmse - 7.5_f64.sqrt()).abs() < 1e-15);
        assert_eq!(summarize(&[]), None);
        let one = summarize(&[0.25]).expect("one");
        assert_eq!((one.median, one.p95, one.std), (0.25, 0.25, 0.0));
    }

    #[test]
    fn thresholds_are_strict() {
        assert!(!accurate(0.05, 0.0, 5.0));
        assert!(accurate(0.049_999, 0.08, 5.0));
        assert!(!accurate(0.0, 5.0_f64.to_radians(), 5.0));
        let s = speedplus(&[2.173e-3, 2.172e-3], &[0.169_f64.to_radians(), 0.0]).expect("two");
        assert_eq!((s.zeroed_t, s.zeroed_q), (1, 1));
    }

    #[test]
    fn the_area_of_a_perfect_method_is_one() {
        assert_eq!(auc(&[0.0; 5], 5, 0.1), Auc { exact: 1.0, ycb: 1.0 });
        assert_eq!(auc(&[0.2], 1, 0.1), Auc { exact: 0.0, ycb: 0.0 });
        let nine_cm = auc(&[0.09], 1, 0.1);
        assert!((nine_cm.exact - 0.1).abs() < 1e-15 && (nine_cm.ycb - 1.0).abs() < 1e-15);
        assert_eq!(auc(&[0.0], 2, 0.1), Auc { exact: 0.5, ycb: 0.5 });
        assert_eq!(auc(&[], 3, 0.1), Auc { exact: 0.0, ycb: 0.0 });
    }

    #[test]
    fn a_short_last_batch_weighs_as_much_as_a_full_one() {
        assert_eq!(mean_of_batch_means(&[1.0, 1.0, 4.0], 2), Some(2.5));
        assert_eq!(mean_of_batch_means(&[], 2), None);
    }

    proptest! {
        #[test]
        fn the_step_curve_has_the_area_of_its_rectangles(errors in prop::collection::vec(0.0..0.15_f64, 1..40), missing in 0_usize..5) {
            // The slow form: integrate the recall curve, then its right-edge variant.
            let n = errors.len() + missing;
            let mut sorted: Vec<f64> = errors.iter().copied().filter(|&e| e <= 0.1).collect();
            sorted.sort_by(f64::total_cmp);
            let (mut left, mut right, mut at) = (0.0, 0.0, 0.0);
            for (k, &e) in sorted.iter().enumerate() {
                left += (e - at) * k as f64 / n as f64;
                right += (e - at) * (k + 1) as f64 / n as f64;
                at = e;
            }
            let tail = (0.1 - at) * sorted.len() as f64 / n as f64;
            let area = auc(&errors, n, 0.1);
            prop_assert!((area.exact - (left + tail) * 10.0).abs() < 1e-12);
            prop_assert!((area.ycb - (right + tail) * 10.0).abs() < 1e-12);
        }

        #[test]
        fn quantiles_are_those_of_the_sorted_values(values in prop::collection::vec(-5.0..5.0_f64, 1..60)) {
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let got = quantiles(&mut values.clone(), [0.0, 0.5, 0.9, 0.95, 1.0]);
            for (q, got) in [0.0, 0.5, 0.9, 0.95, 1.0].into_iter().zip(got) {
                let at = q * (sorted.len() - 1) as f64;
                let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
                prop_assert!((got - (low + (high - low) * at.fract())).abs() < 1e-12);
            }
        }

        #[test]
        fn the_sum_does_not_lose_small_terms(values in prop::collection::vec(-1.0..1.0_f64, 0..50)) {
            let big = values.iter().copied().chain([1e17]).chain(values.iter().copied()).chain([-1e17]);
            let twice: f64 = 2.0 * values.iter().sum::<f64>();
            prop_assert!((sum(big) - twice).abs() < 1e-12);
        }
    }
}
