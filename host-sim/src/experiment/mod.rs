//! The experiment: benches drawn by seeds, each aligned with every compensation by every search.
//!
//! docs/EXPERIMENT.md has the scenario, which was fixed before any figure was looked at. The way of the data: [`Prepared`]
//! (what the controllers of a seed believe, and its optimum) → [`Run`] (a search with a compensation; climbs keep a
//! [`Log`] of what they did and where everything truly was) → [`mechanisms`](mechanism::mechanisms) → [`Group`]
//! (percentiles of all seeds) → tables, findings, page.

mod cause;
pub mod climb;
mod findings;
mod interval;
pub mod mechanism;
mod page;
mod plots;
mod run;
mod search;
mod statistics;
mod tables;
pub mod witness;

pub use cause::{Failure, IN_TIME_S, Kind, NEAR_ENOUGH_DB};
pub use climb::Log;
pub use findings::{Finding, Topic};
pub use interval::{CONFIDENCE, ENOUGH_BENCHES, Interval, Verdict};
pub use page::render;
pub use run::{Climbed, Prepared, Run, bench};
pub use search::{NEAR, STEPS_UM, Search, TILTED, switches};
pub use statistics::{Cause, Failures, Group, Quantiles};
pub use tables::tables;

use crate::report::Mode;
use rayon::prelude::*;
use serde::Serialize;

/// Format of the JSON; raised when a figure changes its meaning or its place.
const FORMAT: u32 = 2;

/// What the paper printed, doi 10.1177/1687814015589503, Tables 7 and 8: for comparison, nothing is computed from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Printed {
    /// Insertion loss of the worst channel, dB.
    pub worst_db: f64,
    /// Uniformity, dB.
    pub uniformity_db: f64,
    /// Time, s.
    pub seconds: f64,
}

/// Without and with compensation.
pub const PAPER: [Printed; 2] = [
    Printed { worst_db: 11.14, uniformity_db: 0.22, seconds: 180.0 },
    Printed { worst_db: 9.92, uniformity_db: 0.20, seconds: 120.0 },
];

/// The optimum of all benches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Best {
    /// Insertion loss of the worst channel, dB.
    pub worst_db: Quantiles,
    /// Uniformity, dB.
    pub uniformity_db: Quantiles,
}

/// All figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Experiment {
    /// Format of this object.
    pub format: u32,
    /// Benches.
    pub seeds: u64,
    /// The best that they allow.
    pub optimum: Best,
    /// Every search with every compensation.
    pub groups: Vec<Group>,
    /// What follows from that.
    pub findings: Vec<Finding>,
    /// What the paper printed, without and with compensation.
    pub paper: [Printed; 2],
    /// Every run.
    pub runs: Vec<Run>,
}

impl Experiment {
    /// How often [`Experiment::new`] calls its `progress`.
    pub fn progress_steps(seeds: u64) -> u64 {
        seeds * (1 + (Search::all().len() * Mode::ALL.len()) as u64)
    }

    /// Runs seeds 1 to `seeds` over all cores; the result does not depend on how many there are.
    ///
    /// # Errors
    /// When a stage cannot be calibrated.
    pub fn new(seeds: u64, progress: &(dyn Fn() + Sync)) -> Result<Self, String> {
        let prepared = (1..=seeds)
            .into_par_iter()
            .map(|seed| {
                let prepared = Prepared::new(seed).map_err(|error| format!("seed {seed}: {error}"));
                progress();
                prepared
            })
            .collect::<Result<Vec<_>, _>>()?;
        let plan: Vec<(Search, Mode, &Prepared)> = Search::all()
            .into_iter()
            .flat_map(|search| Mode::ALL.map(|mode| (search, mode)))
            .flat_map(|(search, mode)| prepared.iter().map(move |prepared| (search, mode, prepared)))
            .collect();
        let runs = plan
            .par_iter()
            .map(|(search, mode, prepared)| {
                let run =
                    Run::new(prepared, *search, *mode).map_err(|error| format!("seed {}: {error}", prepared.seed));
                progress();
                run
            })
            .collect::<Result<Vec<_>, _>>()?;
        let groups = groups(&runs);
        let optimum = Best {
            worst_db: Quantiles::of(prepared.iter().map(|prepared| Some(prepared.optimum.worst_db))),
            uniformity_db: Quantiles::of(prepared.iter().map(|prepared| Some(prepared.optimum.uniformity_db))),
        };
        let mut experiment =
            Experiment { format: FORMAT, seeds, optimum, groups, findings: Vec::new(), paper: PAPER, runs };
        experiment.findings = findings::findings(&experiment);
        Ok(experiment)
    }

    /// A search with a compensation.
    pub fn group(&self, search: Search, mode: Mode) -> Option<&Group> {
        self.groups.iter().find(|group| group.of == search && group.compensation == mode)
    }

    /// Its runs, by seed.
    pub fn runs_of(&self, search: Search, mode: Mode) -> impl Iterator<Item = &Run> {
        of(&self.runs, search.name(), mode)
    }
}

fn of(runs: &[Run], search: String, mode: Mode) -> impl Iterator<Item = &Run> {
    runs.iter().filter(move |run| run.search == search && run.compensation == mode)
}

/// Groups of runs, in the order of searches and compensations.
pub fn groups(runs: &[Run]) -> Vec<Group> {
    let runs_of = |search: Search, mode| of(runs, search.name(), mode).collect::<Vec<_>>();
    let pairs = Search::all().into_iter().flat_map(|search| Mode::ALL.map(|mode| (search, mode)));
    pairs.map(|(s, mode)| Group::new(s, mode, &runs_of(s, mode), &runs_of(s, Mode::None))).collect()
}
