//! What so many benches say of a median, and what they do not.

use serde::Serialize;
use statrs::distribution::{Binomial, DiscreteCDF};

/// Share of such intervals that hold the median of all benches there could be, at least.
pub const CONFIDENCE: f64 = 0.95;
/// Below so many benches nothing is said of a difference.
pub const ENOUGH_BENCHES: usize = 20;

/// An interval for the median, from the order of the values alone (the sign test turned round): whatever their
/// distribution is, it holds the median with at least [`CONFIDENCE`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Interval {
    /// Lower end; none: without end.
    pub low: Option<f64>,
    /// Upper end; none: without end.
    pub high: Option<f64>,
    /// How many values.
    pub of: usize,
}

/// What an interval of a difference says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It lies above 0.
    More,
    /// It lies below 0.
    Less,
    /// It holds 0: such a difference comes by chance too.
    NotSeen,
    /// Fewer than 20 benches.
    TooFew,
}

impl Interval {
    /// Of values; a value that is worse than every other one may be infinite.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let end = |value: Option<&f64>| value.copied().filter(|value| value.is_finite());
        match outside(sorted.len()) {
            Some(k) => Interval { low: end(sorted.get(k)), high: end(sorted.iter().nth_back(k)), of: sorted.len() },
            None => Interval { of: sorted.len(), ..Interval::default() },
        }
    }

    /// What it says of the sign.
    pub fn verdict(&self) -> Verdict {
        match (self.low, self.high) {
            _ if self.of < ENOUGH_BENCHES => Verdict::TooFew,
            (Some(low), _) if low > 0.0 => Verdict::More,
            (_, Some(high)) if high < 0.0 => Verdict::Less,
            _ => Verdict::NotSeen,
        }
    }

    /// Lies wholly above another one.
    pub fn is_above(&self, other: &Interval) -> bool {
        self.low.zip(other.high).is_some_and(|(low, high)| low > high)
    }
}

/// How many of n values lie outside of the interval at each end; none below 6, of which even the outermost say too little.
fn outside(n: usize) -> Option<usize> {
    let tosses = Binomial::new(0.5, n as u64).ok()?;
    let tail = 0.5 * (1.0 - CONFIDENCE);
    // so many values below the median, or fewer, come this rarely
    (0..n as u64 / 2).take_while(|below| tosses.cdf(*below) <= tail).last().map(|below| below as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_those_of_the_published_tables_of_the_sign_test() {
        // ranks (from 1) of the 95 % interval of a median: Conover, Practical Nonparametric Statistics, and elsewhere
        for (n, rank) in [(6, 1), (8, 1), (9, 2), (10, 2), (15, 4), (20, 6), (25, 8), (30, 10), (50, 18), (100, 40)] {
            let interval = Interval::of((1..=n).map(f64::from));
            assert_eq!((interval.low, interval.high), (Some(f64::from(rank)), Some(f64::from(n + 1 - rank))), "{n}");
        }
        assert_eq!(Interval::of([1.0, 2.0, 3.0, 4.0, 5.0]).low, None);
        assert_eq!(Interval::of([]).of, 0);
    }

    #[test]
    fn a_verdict_needs_twenty_benches_and_an_interval_beside_zero() {
        let of = |n: usize, value: f64| Interval::of(std::iter::repeat_n(value, n)).verdict();
        assert_eq!([of(0, 1.0), of(1, 1.0), of(19, 1.0)], [Verdict::TooFew; 3]);
        assert_eq!([of(20, 1.0), of(20, -1.0), of(20, 0.0)], [Verdict::More, Verdict::Less, Verdict::NotSeen]);
        let signs = |plus: usize| Interval::of((0..20).map(move |n| if n < plus { 1.0 } else { -1.0 })).verdict();
        assert_eq!([signs(14), signs(15)], [Verdict::NotSeen, Verdict::More], "as the sign test has it");
        // half of the benches have no end
        assert_eq!(
            Interval::of((0..20).map(|n| if n < 10 { f64::NEG_INFINITY } else { 1.0 })).verdict(),
            Verdict::NotSeen
        );
    }

    #[test]
    fn an_interval_holds_the_median_as_often_as_it_says() {
        use rand::{RngExt, SeedableRng};
        let mut chance = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let holds = |chance: &mut rand_chacha::ChaCha8Rng| {
            let interval = Interval::of((0..25).map(|_| chance.random::<f64>().powi(3)));
            interval.low < Some(0.125) && Some(0.125) < interval.high
        };
        let held = (0..4000).filter(|_| holds(&mut chance)).count();
        // exactly 0.9567 for 25 values; three standard deviations of 4000 tosses are 0.0097
        assert!((held as f64 / 4000.0 - 0.9567).abs() < 0.0097, "{held}");
    }
}
