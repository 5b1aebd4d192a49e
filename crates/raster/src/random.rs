//! Random numbers that depend on a seed and an index alone, so that neither the number of threads
//! nor the order of the work changes them.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// The generator of item `index` of a run: PCG (XSL RR 128/64, multiplicative), whose stream is
/// fixed by its definition, seeded with `seed ^ (index + 1) * 0x9e3779b97f4a7c15`.
#[must_use]
pub fn generator(seed: u64, index: u64) -> Pcg64Mcg {
    // SplitMix64's increment spreads neighbouring items over the seed space.
    Pcg64Mcg::seed_from_u64(seed ^ index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

/// Uniform in `[0, 1)`: the upper 53 bits of the next number.
#[must_use]
pub fn unit(rng: &mut Pcg64Mcg) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_item_draws_the_same_numbers_and_its_neighbour_others() {
        let draw = |seed, index| unit(&mut generator(seed, index));
        assert_eq!(draw(1, 2).to_bits(), draw(1, 2).to_bits());
        assert!((draw(1, 2) - draw(1, 3)).abs() > 1e-9);
        assert!((draw(1, 2) - draw(2, 2)).abs() > 1e-9);
    }

    #[test]
    fn numbers_of_neighbouring_items_are_uniform() {
        let n = 20_000_u64;
        let mean = (0..n).map(|i| unit(&mut generator(0, i))).sum::<f64>() / n as f64;
        // Standard error of the mean of n uniform numbers: sqrt(1 / 12 n) = 0.002.
        assert!((mean - 0.5).abs() < 0.008, "{mean}");
        assert!((0..n).all(|i| (0.0..1.0).contains(&unit(&mut generator(7, i)))));
    }
}
