//! Time stamps as whole nanoseconds: a 64-bit float of seconds since 1970 would lose 0.2 µs.

use crate::synth::flight::TimeUnit;

impl TimeUnit {
    fn nanoseconds(self) -> i128 {
        match self {
            Self::S => 1_000_000_000,
            Self::Ms => 1_000_000,
            Self::Us => 1_000,
            Self::Ns => 1,
        }
    }

    /// The name on the command line.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::S => "s",
            Self::Ms => "ms",
            Self::Us => "us",
            Self::Ns => "ns",
        }
    }
}

/// A decimal number of a unit as nanoseconds, rounded to the nearest; `None` if it is no finite
/// number or 292 years or more.
pub(super) fn nanoseconds(field: &[u8], unit: TimeUnit) -> Option<i64> {
    let exact = decimal(field, unit);
    let value = if exact.is_some() {
        exact
    } else {
        let x: f64 = fast_float2::parse(field).ok()?;
        let ns = x * unit.nanoseconds() as f64;
        (ns.abs() < 9.2e18).then_some(ns.round() as i128)
    };
    i64::try_from(value?).ok()
}

/// Digits with at most one point and no exponent.
fn decimal(field: &[u8], unit: TimeUnit) -> Option<i128> {
    let (negative, digits) = match field {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] | rest => (false, rest),
    };
    if digits.is_empty() || digits.len() > 30 {
        return None;
    }
    let mut mantissa = 0_i128;
    let (mut scale, mut point, mut any) = (1_i128, false, false);
    for &b in digits {
        match b {
            b'.' if !point => point = true,
            b'0'..=b'9' => {
                any = true;
                // Digits behind the picosecond change nothing.
                if point && scale >= 1_000_000_000_000 {
                    continue;
                }
                mantissa = mantissa.checked_mul(10)?.checked_add(i128::from(b - b'0'))?;
                scale *= if point { 10 } else { 1 };
            }
            _ => return None,
        }
    }
    let ns = mantissa.checked_mul(unit.nanoseconds())?;
    let rounded = (ns + scale / 2).div_euclid(scale);
    any.then_some(if negative { -rounded } else { rounded })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_keep_their_nanoseconds() {
        let ns = |text: &str, unit| nanoseconds(text.as_bytes(), unit);
        assert_eq!(ns("1403715524907143168", TimeUnit::Ns), Some(1_403_715_524_907_143_168));
        assert_eq!(ns("1540821125.81599", TimeUnit::S), Some(1_540_821_125_815_990_000));
        assert_eq!(ns("1726962106112", TimeUnit::Ms), Some(1_726_962_106_112_000_000));
        assert_eq!(ns("-0.5", TimeUnit::Us), Some(-500));
        assert_eq!(ns("1.5e-3", TimeUnit::S), Some(1_500_000));
        assert_eq!(ns("0.00000000051", TimeUnit::S), Some(1));
        assert_eq!(ns("12.", TimeUnit::S), Some(12_000_000_000));
    }

    #[test]
    fn what_is_no_time_is_none() {
        for text in ["", ".", "-", "nan", "inf", "1e30", "1.2.3", "12 s", "99999999999999999999"] {
            assert_eq!(nanoseconds(text.as_bytes(), TimeUnit::Ns), None, "{text}");
        }
    }
}
