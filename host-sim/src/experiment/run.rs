//! One run: a bench, a compensation, a search.

use super::cause::{Failure, IN_TIME_S, Kind, NEAR_ENOUGH_DB, what_is_left, with_mechanism};
use super::climb::{Log, angle_climb, climb};
use super::mechanism::{Mechanisms, carried_um, mechanisms};
use super::search::{Search, switches};
use crate::alignment::{self, Lab, align};
use crate::bench_twin::{Bench, Optimum, Options, Side};
use crate::machine::Machine;
use crate::optics::{uniformity_db, worst_db};
use crate::report::Mode;
use serde::Serialize;

/// Time of a move on the slow bench, s.
const SLOW_MOVE_S: f64 = 0.05;
/// Time of a reading on it, s.
const SLOW_READING_S: f64 = 0.1;

/// What is the same in all runs of a seed.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The seed.
    pub seed: u64,
    /// What the controllers believe of their stages.
    pub calibrated: [Machine; 2],
    /// The best that the bench allows.
    pub optimum: Optimum,
}

impl Prepared {
    /// Measures the stages of a seed, and finds its optimum.
    ///
    /// # Errors
    /// When the measurements do not tell all constants.
    #[inline(never)]
    pub fn new(seed: u64) -> Result<Self, String> {
        // stages, chip and array do not depend on the start; neither does the optimum, which is sought from the chip
        let bench = bench(seed, Search::Robust);
        let believed = |side| bench.calibrated(side).map(|found| found.machine).map_err(|error| error.to_string());
        Ok(Prepared { seed, calibrated: [believed(Side::Input)?, believed(Side::Output)?], optimum: bench.optimum() })
    }
}

/// The bench of a seed as a search finds it.
pub fn bench(seed: u64, search: Search) -> Bench {
    Bench::seeded(seed, &Options { start: search.start(), ..Options::default() })
}

/// What a climb has besides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Climbed {
    /// Moves.
    pub moves: usize,
    /// Readings of the light.
    pub readings: usize,
    /// Time with 50 ms a move and 100 ms a reading, s.
    pub slow_seconds: f64,
    /// What kept it from its peak.
    #[serde(flatten)]
    pub mechanisms: Mechanisms,
    /// How far the angle climb carried the fibre point sideways at most, mode radii of the guide.
    pub carried_radii: f64,
}

/// One run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Of the bench.
    pub seed: u64,
    /// Name of the search.
    pub search: String,
    /// What was on.
    pub compensation: Mode,
    /// Offset of both sides in the beginning, root of the sum of squares, um.
    pub start_um: f64,
    /// Insertion losses where the stages stand in the end, dB.
    pub losses_db: Vec<f64>,
    /// The largest.
    pub worst_db: f64,
    /// The largest less that of the optimum, dB.
    pub above_optimum_db: f64,
    /// Largest less least, dB.
    pub uniformity_db: f64,
    /// The same less that of the optimum, dB.
    pub uniformity_above_optimum_db: f64,
    /// Least distance of the corners of either side from the chip in the end, um.
    pub clearance_um: f64,
    /// Simulated time to the end, s.
    pub seconds: f64,
    /// Why it counts as failed.
    pub failure: Option<Failure>,
    /// Of the climbs.
    pub climb: Option<Climbed>,
}

impl Run {
    /// It came to an end, good or bad.
    pub fn has_ended(&self) -> bool {
        self.failure.as_ref().is_none_or(|failure| failure.kind.has_ended())
    }

    /// Runs.
    ///
    /// # Errors
    /// When the controllers refuse the calibration.
    // inlined, the bench would lie on the stack of each level of whoever shares the runs out among the cores
    #[inline(never)]
    pub fn new(prepared: &Prepared, search: Search, mode: Mode) -> Result<Self, String> {
        let bench = bench(prepared.seed, search);
        let mut lab = Lab::new(bench, &prepared.calibrated, prepared.seed)?;
        let start = lab.poses();
        let aside = Side::BOTH.map(|side| lab.bench().misalignment(side, 0, 0, &start[side.index()]).offset_um);
        let mut log = Log::default();
        let (end, seconds) = go(&mut lab, search, mode, &mut log);
        let (losses_db, optimum) = (lab.losses(), &prepared.optimum);
        let (worst_db, uniformity_db) = (worst_db(&losses_db), uniformity_db(&losses_db));
        let above_optimum_db = worst_db - optimum.worst_db;
        let climb = (!search.is_robust()).then(|| climbed(&lab, &log));
        let (tick, poses, bench) = (lab.tick(), lab.poses(), lab.bench());
        let clearance_um = Side::BOTH
            .map(|side| bench.clearance_um(side, tick, &poses[side.index()]))
            .into_iter()
            .fold(f64::MAX, f64::min);
        let failure = match end {
            Err(failure) => Some(failure),
            Ok(()) if above_optimum_db > NEAR_ENOUGH_DB => {
                let left = what_is_left(bench, tick, &poses, optimum);
                Some(Failure::of_end(Kind::Far, with_mechanism(left, climb.map(|climb| climb.mechanisms))))
            }
            Ok(()) if search.is_robust() && clearance_um < bench.options().working_gap_um => {
                Some(Failure::of_end(Kind::Close, "nearer to the chip than the working gap"))
            }
            Ok(()) if search.is_robust() && seconds > IN_TIME_S => Some(Failure::of_end(Kind::Late, "took too long")),
            Ok(()) => None,
        };
        Ok(Run {
            seed: prepared.seed,
            search: search.name(),
            compensation: mode,
            start_um: aside.iter().flatten().map(|um| um * um).sum::<f64>().sqrt(),
            worst_db,
            above_optimum_db,
            uniformity_db,
            uniformity_above_optimum_db: uniformity_db - optimum.uniformity_db,
            losses_db,
            clearance_um,
            seconds,
            failure,
            climb,
        })
    }
}

/// To the end, or why not; when that was, s.
fn go(lab: &mut Lab, search: Search, mode: Mode, log: &mut Log) -> (Result<(), Failure>, f64) {
    let mut options = alignment::Options::default();
    options.setup.extend(switches(mode));
    // without the rotation centre turns may tell nothing: what the start leaves is known
    options.untold_deg = Some(search.start().angle_deg);
    let end = match search {
        Search::Climb { step_um } => climb(lab, &options.setup, step_um, log),
        Search::AngleClimb => angle_climb(lab, &options.setup, false, log),
        Search::AngleClimbRepeaked => angle_climb(lab, &options.setup, true, log),
        Search::Robust | Search::RobustNear => {
            let end = align(lab, &options, &mut |_| ()).map(|_| ()).map_err(|ended| Failure::of_alignment(&ended));
            return (end, alignment::Bus::seconds(lab));
        }
    };
    let end = end.map_err(|error| Failure::of_climb(error, log.step));
    // nothing ran before the search began
    (end, alignment::Bus::seconds(lab))
}

fn climbed(lab: &Lab, log: &Log) -> Climbed {
    let bench = lab.bench();
    let loss = |tick: u64, poses: &[[f64; 6]; 2]| bench.losses(tick, poses)[0];
    Climbed {
        moves: log.moves,
        readings: log.readings,
        slow_seconds: log.moves as f64 * SLOW_MOVE_S + log.readings as f64 * SLOW_READING_S,
        mechanisms: mechanisms(log, &loss, bench.options().meter.noise_db),
        carried_radii: carried_um(log) / bench.options().guide.radius_um[0],
    }
}
