//! How numbers are written: by significant digits, never as NaN or infinity.

/// What stands for a value that is absent or not finite.
pub(super) const ABSENT: &str = "–";

/// Significant digits of an error in a table.
const DIGITS: i32 = 4;

/// `x` with four significant digits: `0.01600`, `12.35`, `1.2e-16` becomes `1.200e-16`.
pub(super) fn significant(x: f64) -> String {
    match decimals([x]) {
        Some(d) => fixed(x, d),
        None if x.is_finite() => format!("{x:.3e}"),
        None => ABSENT.to_owned(),
    }
}

/// Decimals that show four significant digits of the smallest value that is not zero, so that a
/// column of numbers lines up; `None` if no fixed number of decimals suits them all.
pub(super) fn decimals(values: impl IntoIterator<Item = f64>) -> Option<usize> {
    let (mut smallest, mut largest) = (f64::INFINITY, 0.0_f64);
    for x in values.into_iter().map(f64::abs) {
        if !x.is_finite() {
            return None;
        }
        largest = largest.max(x);
        if x > 0.0 {
            smallest = smallest.min(x);
        }
    }
    if largest == 0.0 {
        return Some(1);
    }
    if smallest < 1e-4 || largest >= 1e7 || largest / smallest > 1e5 {
        return None;
    }
    let magnitude = smallest.log10().floor() as i32;
    Some((DIGITS - 1 - magnitude).clamp(0, 7) as usize)
}

/// `x` with the decimals of its column, see [`decimals`].
pub(super) fn aligned(x: f64, decimals: Option<usize>) -> String {
    decimals.map_or_else(|| significant(x), |d| fixed(x, d))
}

/// `x` with fixed decimals and no negative zero.
pub(super) fn fixed(x: f64, decimals: usize) -> String {
    if !x.is_finite() {
        return ABSENT.to_owned();
    }
    let s = format!("{x:.decimals$}");
    match s.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.to_owned(),
        _ => s,
    }
}

/// Percent with two decimals, without the sign.
pub(super) fn percent(x: f64) -> String {
    fixed(x, 2)
}

/// A value that may be absent.
pub(super) fn optional(x: Option<f64>, write: impl Fn(f64) -> String) -> String {
    x.map_or_else(|| ABSENT.to_owned(), write)
}

/// Signed, for differences: `+0.01200`, `-0.01200`, `0.0`.
pub(super) fn signed(x: f64) -> String {
    let s = significant(x);
    if x.is_finite() && x > 0.0 { format!("+{s}") } else { s }
}

/// A p-value; `< 0.001` instead of digits that a bootstrap cannot give.
pub(super) fn p_value(p: f64) -> String {
    if (0.0..0.001).contains(&p) { "< 0.001".to_owned() } else { fixed(p, 3) }
}

/// A count with thousands separated by commas.
pub(super) fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

/// A length or a tick without trailing zeros: `0.6089`, `5`, `0.354`.
pub(super) fn short(x: f64) -> String {
    let s = significant(x);
    if s.contains('.') && !s.contains('e') {
        s.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_digits_are_significant() {
        assert_eq!(significant(0.016), "0.01600");
        assert_eq!(significant(12.3456), "12.35");
        assert_eq!(significant(12345.6), "12346");
        assert_eq!(significant(0.0), "0.0");
        assert_eq!(significant(-0.0), "0.0");
        assert_eq!(significant(1.25e-16), "1.250e-16");
        assert_eq!(short(0.608_931), "0.6089");
        assert_eq!(short(5.0), "5");
        assert_eq!(short(120.0), "120");
    }

    #[test]
    fn nothing_infinite_is_printed() {
        for x in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for s in [significant(x), fixed(x, 2), signed(x), percent(x), short(x), p_value(x)] {
                assert_eq!(s, ABSENT);
            }
        }
    }

    #[test]
    fn a_column_lines_up_on_its_smallest_value() {
        assert_eq!(decimals([0.016, 0.12]), Some(5));
        assert_eq!(decimals([0.0, 0.0]), Some(1));
        assert_eq!(decimals([1e-16, 0.1]), None);
        assert_eq!(fixed(-0.0001, 2), "0.00");
    }

    #[test]
    fn counts_are_grouped() {
        assert_eq!(count(0), "0");
        assert_eq!(count(999), "999");
        assert_eq!(count(11_146), "11,146");
        assert_eq!(count(1_000_000), "1,000,000");
    }
}
