//! Medians and percentiles of runs of which some never came to an end.

use super::cause::Kind;
use super::interval::{Interval, Verdict};
use super::run::Run;
use super::search::Search;
use crate::report::Mode;
use serde::Serialize;

/// Values below which there is no 10th and no 90th percentile.
pub const ENOUGH_FOR_PERCENTILES: usize = 10;

/// Median, 10th and 90th percentile; none where it lies among runs without an end, and no 10th and 90th of fewer than
/// ten values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quantiles {
    /// 10th percentile.
    pub p10: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// 90th percentile.
    pub p90: Option<f64>,
}

impl Quantiles {
    /// Of values, of which those without an end are none and worse than every other one.
    pub fn of(values: impl IntoIterator<Item = Option<f64>>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().map(|value| value.unwrap_or(f64::INFINITY)).collect();
        sorted.sort_by(f64::total_cmp);
        let part = |part: f64| {
            let place = part * sorted.len().checked_sub(1)? as f64;
            let (below, share) = (place.floor() as usize, place.fract());
            let (low, high) = (sorted[below], sorted[place.ceil() as usize]);
            // infinity times 0 is no number
            let value = if share == 0.0 { low } else { low + (high - low) * share };
            value.is_finite().then_some(value)
        };
        let outer = |p: f64| (sorted.len() >= ENOUGH_FOR_PERCENTILES).then(|| part(p)).flatten();
        Quantiles { p10: outer(0.1), median: part(0.5), p90: outer(0.9) }
    }
}

/// How many runs failed, and how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Failures {
    /// By an error.
    pub error: usize,
    /// By a collision.
    pub collision: usize,
    /// More than 0.5 dB above the optimum.
    pub far: usize,
    /// Nearer to the chip than the working gap.
    pub close: usize,
    /// More than 20 s.
    pub late: usize,
}

impl Failures {
    fn of(runs: &[&Run]) -> Self {
        let [error, collision, far, close, late] = Kind::ALL.map(|kind| {
            runs.iter().filter_map(|run| run.failure.as_ref()).filter(|failure| failure.kind == kind).count()
        });
        Failures { error, collision, far, close, late }
    }

    /// All.
    pub fn all(&self) -> usize {
        self.each().map(|(_, runs)| runs).iter().sum()
    }

    /// One kind after the other.
    pub const fn each(&self) -> [(Kind, usize); 5] {
        let Failures { error, collision, far, close, late } = *self;
        [(Kind::Error, error), (Kind::Collision, collision), (Kind::Far, far), (Kind::Close, close), (Kind::Late, late)]
    }
}

/// Failures of the same kind for the same reason after the same step.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Cause {
    /// How.
    pub kind: Kind,
    /// Why, and after which step.
    pub cause: String,
    /// How many runs.
    pub runs: usize,
    /// The first of these benches.
    pub seed: u64,
}

impl Cause {
    /// Of runs, the most frequent first.
    fn of(runs: &[&Run]) -> Vec<Self> {
        let mut causes: Vec<Cause> = Vec::new();
        for run in runs {
            let Some(failure) = &run.failure else { continue };
            let words = failure.words();
            match causes.iter_mut().find(|cause| cause.kind == failure.kind && cause.cause == words) {
                Some(cause) => cause.runs += 1,
                None => causes.push(Cause { kind: failure.kind, cause: words, runs: 1, seed: run.seed }),
            }
        }
        causes.sort_by_key(|cause| (cause.kind, std::cmp::Reverse(cause.runs)));
        causes
    }
}

/// All runs of a search with a compensation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Group {
    /// Name of the search.
    pub search: String,
    /// The search.
    #[serde(skip)]
    pub of: Search,
    /// What was on.
    pub compensation: Mode,
    /// How many runs.
    pub runs: usize,
    /// How many of them failed.
    pub failures: Failures,
    /// And why.
    pub causes: Vec<Cause>,
    /// Insertion loss of each channel, dB.
    pub channels_db: Vec<Quantiles>,
    /// Of the worst channel, dB.
    pub worst_db: Quantiles,
    /// That above the optimum, dB.
    pub above_optimum_db: Quantiles,
    /// Uniformity, dB.
    pub uniformity_db: Quantiles,
    /// That above the optimum's, dB.
    pub uniformity_above_optimum_db: Quantiles,
    /// Simulated time, s.
    pub seconds: Quantiles,
    /// Of a climb: time with 50 ms a move and 100 ms a reading, s.
    pub slow_seconds: Option<Quantiles>,
    /// By how much the worst channel is better than with nothing on, bench by bench, dB. Where only one of the two has an
    /// end it is infinite, and nothing where neither has.
    pub gain_db: Quantiles,
    /// Interval of its median.
    pub gain_interval_db: Interval,
    /// What that says; nothing of `none` itself.
    pub gain_verdict: Option<Verdict>,
    /// The compensation has something to correct in this search; else its gain is chance.
    pub can_act: bool,
    /// On how many benches it is better than with nothing on, and on how many it is worse.
    pub better_worse: [usize; 2],
    /// Climbs that were trapped in play.
    pub trapped: usize,
    /// Climbs in which an angle was judged by the way of the fibre point.
    pub confounded: usize,
    /// Farthest way of the fibre point in an angle climb, mode radii.
    pub carried_radii: Quantiles,
}

impl Group {
    /// Of the runs of a search with a compensation; `bare`: those with nothing on, in the same order of seeds.
    pub fn new(of: Search, compensation: Mode, runs: &[&Run], bare: &[&Run]) -> Self {
        let quantiles =
            |value: &dyn Fn(&Run) -> f64| Quantiles::of(runs.iter().map(|run| run.has_ended().then(|| value(run))));
        let climbs = || runs.iter().filter_map(|run| run.climb);
        let worst = |run: &Run| if run.has_ended() { run.worst_db } else { f64::INFINITY };
        let pairs = || runs.iter().zip(bare).map(|(run, bare)| (worst(run), worst(bare)));
        let gains: Vec<f64> = pairs().map(|(run, bare)| gain(bare, run)).collect();
        // the worst gain is the lowest
        let loss = Quantiles::of(gains.iter().map(|gain| Some(-gain)));
        let interval = Interval::of(gains);
        let channels = runs.first().map_or(0, |run| run.losses_db.len());
        Group {
            search: of.name(),
            of,
            compensation,
            runs: runs.len(),
            failures: Failures::of(runs),
            causes: Cause::of(runs),
            channels_db: (0..channels).map(|channel| quantiles(&|run| run.losses_db[channel])).collect(),
            worst_db: quantiles(&|run| run.worst_db),
            above_optimum_db: quantiles(&|run| run.above_optimum_db),
            uniformity_db: quantiles(&|run| run.uniformity_db),
            uniformity_above_optimum_db: quantiles(&|run| run.uniformity_above_optimum_db),
            seconds: quantiles(&|run| run.seconds),
            slow_seconds: (!of.is_robust())
                .then(|| quantiles(&|run| run.climb.map_or(0.0, |climb| climb.slow_seconds))),
            gain_db: Quantiles {
                p10: loss.p90.map(|v| -v),
                median: loss.median.map(|v| -v),
                p90: loss.p10.map(|v| -v),
            },
            gain_interval_db: interval,
            gain_verdict: (compensation != Mode::None).then(|| interval.verdict()),
            can_act: of.is_touched_by(compensation),
            better_worse: [
                pairs().filter(|(run, bare)| run < bare).count(),
                pairs().filter(|(run, bare)| run > bare).count(),
            ],
            trapped: climbs().filter(|climb| climb.mechanisms.trapped_in_play).count(),
            confounded: climbs().filter(|climb| climb.mechanisms.pivot_confounding).count(),
            carried_radii: Quantiles::of(climbs().map(|climb| Some(climb.carried_radii))),
        }
    }
}

/// By how much the second is less; two without an end differ by nothing.
pub fn gain(first: f64, second: f64) -> f64 {
    let gain = first - second;
    if gain.is_nan() { 0.0 } else { gain }
}

#[cfg(test)]
mod tests {
    use super::{Quantiles, gain};

    #[test]
    fn a_bench_that_ends_only_with_compensation_is_a_gain_and_one_that_ends_only_without_a_loss() {
        let never = f64::INFINITY;
        assert_eq!([gain(never, 10.0), gain(10.0, never), gain(never, never)], [never, -never, 0.0]);
        assert_eq!(gain(11.0, 10.0), 1.0);
    }

    #[test]
    fn runs_without_an_end_are_worse_than_every_other_one_and_never_dropped() {
        let values = |without: usize| (0..11).map(move |n| (n < 11 - without).then_some(n as f64));
        let all = Quantiles::of(values(0));
        assert_eq!((all.p10, all.median, all.p90), (Some(1.0), Some(5.0), Some(9.0)));
        let some = Quantiles::of(values(2));
        assert_eq!((some.median, some.p90), (Some(5.0), None), "the median stays where it was");
        assert_eq!(Quantiles::of(values(6)).median, None);
        assert_eq!(Quantiles::of([]), Quantiles::default());
        assert_eq!(Quantiles::of([Some(2.0), None]).median, None, "half way to nowhere");
        let few = Quantiles::of((0..9).map(|n| Some(f64::from(n))));
        assert_eq!((few.p10, few.median, few.p90), (None, Some(4.0), None), "nine have no tenth part");
    }
}
