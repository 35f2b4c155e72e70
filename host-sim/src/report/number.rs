//! Numbers on the page: significant digits, and where each stands in the JSON.

use crate::model::percentile;
use maud::{Markup, html};

/// Digits that a number on the page has.
const DIGITS: i32 = 3;
/// What is smaller is 0 on the page: a picometre where the unit is um.
const NOTHING: f64 = 1e-6;

/// A number with three significant digits, whole from 100 on; below a millionth of its unit it is 0.
pub fn short(value: f64) -> String {
    digits(value, DIGITS)
}

/// A number with `count` significant digits, as [`short`].
fn digits(value: f64, count: i32) -> String {
    if value.abs() < NOTHING {
        return "0".into();
    }
    // rounded first: 9.996 is 10.0
    let rounded = format!("{value:.*e}", count as usize - 1);
    let magnitude: i32 = rounded.split_once('e').and_then(|(_, power)| power.parse().ok()).unwrap_or(0);
    let decimals = (count - 1 - magnitude).max(0) as usize;
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}

/// A number of the page that the JSON holds at `pointer`.
pub fn figure(pointer: impl AsRef<str>, value: f64) -> Markup {
    html! { span data-figure=(pointer.as_ref()) { (short(value)) } }
}

/// The same with five digits, for what is compared digit by digit.
pub fn long_figure(pointer: impl AsRef<str>, value: f64) -> Markup {
    html! { span data-figure=(pointer.as_ref()) { (digits(value, 5)) } }
}

/// Maximum, root mean square and percentiles of magnitudes.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Spread {
    /// Largest.
    pub max: f64,
    /// Root mean square.
    pub rms: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl Spread {
    /// Of magnitudes; percentiles lie straight between neighbours. All zero when there are none.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let part = |part| percentile(&sorted, part);
        let rms = (sorted.iter().map(|v| v * v).sum::<f64>() / sorted.len().max(1) as f64).sqrt();
        Spread { max: part(1.0), rms, p50: part(0.5), p95: part(0.95), p99: part(0.99) }
    }
}

#[cfg(test)]
mod tests {
    use super::{Spread, short};

    #[test]
    fn numbers_have_three_digits() {
        let written = [0.0, 9.996, 0.06, 0.018375, 12.345, 862.4, 12345.6, -0.30004, 3e-9].map(short);
        assert_eq!(written, ["0", "10.0", "0.0600", "0.0184", "12.3", "862", "12346", "\u{2212}0.300", "0"]);
    }

    #[test]
    fn a_spread_is_that_of_its_values() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        let spread = Spread::of(&values);
        assert_eq!((spread.p50, spread.max), (50.5, 100.0));
        assert!((spread.rms - 3383.5_f64.sqrt()).abs() < 1e-9);
        assert_eq!(Spread::of(&[]), Spread::default());
    }
}
