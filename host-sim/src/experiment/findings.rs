//! What follows from the figures: sentences of which every number and every verdict is computed.

use super::statistics::{Group, Quantiles};
use super::tables::number;
use super::{Experiment, Run, STEPS_UM, Search};
use crate::alignment::Optics;
use crate::machine::Machine;
use crate::report::Mode;
use serde::Serialize;

/// What a sentence is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Topic {
    /// Something that the paper found too, or not.
    Reproduced,
    /// Something that no simulation can tell of the paper's bench.
    NotDerivable,
}

/// A sentence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What it is about.
    pub topic: Topic,
    /// What it says.
    pub text: String,
}

/// Play of the linear axes, um.
pub(super) fn play_um() -> f64 {
    Machine::paper().drives[0].backlash * 1e-3
}

/// All of them.
pub(super) fn findings(experiment: &Experiment) -> Vec<Finding> {
    let reproduced = [direction, parts, trap, confounding, uniformity, time, baseline, from_cameras];
    let limits = [start, floor, chance, position];
    let of = |topic, all: &[fn(&Experiment) -> Option<String>]| {
        all.iter().filter_map(|f| f(experiment)).map(|text| Finding { topic, text }).collect::<Vec<_>>()
    };
    let mut findings = of(Topic::Reproduced, &reproduced);
    findings.extend(of(Topic::NotDerivable, &limits));
    findings
}

fn climbs(within_play: bool) -> Vec<Search> {
    let play = play_um() + 1e-9;
    STEPS_UM
        .into_iter()
        .filter(|step| (*step <= play) == within_play)
        .map(|step_um| Search::Climb { step_um })
        .collect()
}

/// Figures of some searches in a row.
fn row(searches: &[Search], value: impl Fn(Search) -> String) -> String {
    searches.iter().map(|search| value(*search)).collect::<Vec<_>>().join(", ")
}

fn db(value: Option<f64>) -> String {
    number(value, 2)
}

fn direction(e: &Experiment) -> Option<String> {
    let (small, large) = (climbs(true), climbs(false));
    let gain = |search| e.group(search, Mode::All).and_then(|group| group.gain_db.median);
    let better = |search| e.group(search, Mode::All).map_or(0, |group| group.better_worse[0]);
    let steps = |searches: &[Search]| {
        row(searches, |s| if let Search::Climb { step_um } = s { format!("{step_um:.1}") } else { String::new() })
    };
    let reproduced = small.iter().all(|search| gain(*search).is_some_and(|gain| gain > 0.0));
    Some(format!(
        "Direction: with steps up to the play ({} um against {:.1} um) all compensation together lowers the loss of the worst channel by {} dB \
         in the median ({} of {} benches are better); with steps above it ({} um) by {} dB. The paper prints {:.2} dB less ({:.2} to {:.2}). \
         The direction is {}.",
        steps(&small),
        play_um(),
        row(&small, |s| db(gain(s))),
        row(&small, |s| better(s).to_string()),
        e.seeds,
        steps(&large),
        row(&large, |s| db(gain(s))),
        e.paper[0].worst_db - e.paper[1].worst_db,
        e.paper[0].worst_db,
        e.paper[1].worst_db,
        if reproduced {
            "reproduced for every step up to the play"
        } else {
            "not reproduced for every step up to the play"
        }
    ))
}

fn parts(e: &Experiment) -> Option<String> {
    let small = climbs(true);
    let gain = |mode| row(&small, |s| db(e.group(s, mode).and_then(|group| group.gain_db.median)));
    Some(format!(
        "Which part: of the climbs with steps up to the play, backlash compensation alone gains {} dB, coupling alone {} dB, the rotation centre alone {} dB.",
        gain(Mode::Backlash),
        gain(Mode::Coupling),
        gain(Mode::Pivot)
    ))
}

fn trap(e: &Experiment) -> Option<String> {
    let all: Vec<Search> = STEPS_UM.map(|step_um| Search::Climb { step_um }).into();
    let trapped = |mode| row(&all, |s| e.group(s, mode).map_or(0, |group| group.trapped).to_string());
    let (mut caught, mut free) = (Vec::new(), Vec::new());
    for run in climbs(true).into_iter().flat_map(|search| e.runs_of(search, Mode::None)) {
        let trapped = run.climb.is_some_and(|climb| climb.mechanisms.trapped_in_play);
        if trapped { &mut caught } else { &mut free }.push(ended(run));
    }
    Some(format!(
        "Why: trapped in play were, by step from {:.1} to {:.1} um, {} of {} climbs without compensation and {} with all of it. Up to the play, the \
         uncompensated climbs that were trapped end {} dB above the optimum in the median, the others {} dB.",
        STEPS_UM[0],
        STEPS_UM[STEPS_UM.len() - 1],
        trapped(Mode::None),
        e.seeds,
        trapped(Mode::All),
        db(Quantiles::of(caught).median),
        db(Quantiles::of(free).median)
    ))
}

/// Loss above the optimum, for percentiles.
fn ended(run: &Run) -> Option<f64> {
    run.has_ended().then_some(run.above_optimum_db)
}

fn confounding(e: &Experiment) -> Option<String> {
    let above = |mode| e.group(Search::AngleClimb, mode);
    let [none, backlash, pivot, all] = [Mode::None, Mode::Backlash, Mode::Pivot, Mode::All].map(above);
    let (none, backlash, pivot, all) = (none?, backlash?, pivot?, all?);
    let repeaked = e.group(Search::AngleClimbRepeaked, Mode::None)?;
    Some(format!(
        "Angle climb: {} dB above the optimum without compensation, {} dB with backlash alone, {} dB with the rotation centre alone, {} dB with all. \
         Pivot confounding was found in {}, {}, {} and {} of {} runs; the fibre point was carried at most {}, {}, {} and {} mode radii \
         sideways (medians). With going back to the peak after every turn, it is {} dB without any compensation.",
        db(none.above_optimum_db.median),
        db(backlash.above_optimum_db.median),
        db(pivot.above_optimum_db.median),
        db(all.above_optimum_db.median),
        none.confounded,
        backlash.confounded,
        pivot.confounded,
        all.confounded,
        e.seeds,
        db(none.carried_radii.median),
        db(backlash.carried_radii.median),
        db(pivot.carried_radii.median),
        db(all.carried_radii.median),
        db(repeaked.above_optimum_db.median)
    ))
}

fn uniformity(e: &Experiment) -> Option<String> {
    let mut searches = climbs(true);
    searches.push(Search::AngleClimb);
    let median = |search, mode| e.group(search, mode).and_then(|group| group.uniformity_db.median);
    let of = |mode| row(&searches, |s| db(median(s, mode)));
    let printed = e.paper[0].uniformity_db - e.paper[1].uniformity_db;
    let (off, change, nearest) = searches
        .iter()
        .filter_map(|search| Some((median(*search, Mode::None)? - median(*search, Mode::All)?, *search)))
        .map(|(change, search)| ((change - printed).abs(), change, search))
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(format!(
        "Uniformity: climbs with steps up to the play and, last, the angle climb have {} dB without and {} dB with compensation (medians); the best that the benches allow \
         is {} dB. The paper prints {:.2} and {:.2} dB. The change that comes nearest to that ({} dB, {off:.2} dB off) is that of this search: {}.",
        of(Mode::None),
        of(Mode::All),
        db(e.optimum.uniformity_db.median),
        e.paper[0].uniformity_db,
        e.paper[1].uniformity_db,
        db(Some(change)),
        nearest.words()
    ))
}

fn time(e: &Experiment) -> Option<String> {
    let searches: Vec<Search> = Search::all().into_iter().filter(|search| !search.is_robust()).collect();
    let slow = |search, mode| e.group(search, mode).and_then(|group| group.slow_seconds).and_then(|q| q.median);
    let faster: Vec<Search> = searches
        .iter()
        .copied()
        .filter(|s| slow(*s, Mode::All).zip(slow(*s, Mode::None)).is_some_and(|(all, none)| all < none))
        .collect();
    let names = row(&faster, Search::words);
    let smallest = searches.first().copied()?;
    let early = match slow(smallest, Mode::None).zip(slow(smallest, Mode::All)) {
        Some((none, all)) if none < all => " A climb that is caught gives up early: the trap shortens a run.",
        _ => "",
    };
    Some(format!(
        "Time: at 50 ms a move and 100 ms a reading the searches ({}) take {} s without and {} s with compensation in the median. The paper prints {:.0} \
         and {:.0} s. Shorter with compensation: {}.{early}",
        row(&searches, Search::words),
        row(&searches, |s| number(slow(s, Mode::None), 0)),
        row(&searches, |s| number(slow(s, Mode::All), 0)),
        e.paper[0].seconds,
        e.paper[1].seconds,
        if names.is_empty() { "none of them".into() } else { names }
    ))
}

fn baseline(e: &Experiment) -> Option<String> {
    let bare = e.group(Search::RobustNear, Mode::None)?;
    let all = e.group(Search::RobustNear, Mode::All)?;
    let climbs = STEPS_UM.map(|step_um| e.group(Search::Climb { step_um }, Mode::All));
    let best = climbs.into_iter().flatten().filter_map(|group| group.above_optimum_db.median).min_by(f64::total_cmp);
    let smallest = Search::Climb { step_um: STEPS_UM[0] };
    let naive = e.group(smallest, Mode::None)?.above_optimum_db.median?;
    let taken = |left: Option<f64>| number(left.map(|left| naive - left), 2);
    Some(format!(
        "Honest baseline: from the same start as the climb, the robust search without any compensation ends {} dB above the optimum (90 %: {}; {} failed), with all of it \
         {} dB ({}; {} failed); the best of the compensated climbs {} dB. Of the {naive:.2} dB that the uncompensated {} leaves, the better search alone takes {} dB away, \
         compensation alone at most {} dB, both {} dB.",
        number(bare.above_optimum_db.median, 3),
        number(bare.above_optimum_db.p90, 3),
        bare.failures.all(),
        number(all.above_optimum_db.median, 3),
        number(all.above_optimum_db.p90, 3),
        all.failures.all(),
        number(best, 3),
        smallest.words(),
        taken(bare.above_optimum_db.median),
        taken(best),
        taken(all.above_optimum_db.median)
    ))
}

fn from_cameras(e: &Experiment) -> Option<String> {
    let of = |mode| e.group(Search::Robust, mode);
    let all = of(Mode::All)?;
    let failed = |group: &Group| format!("{} {}", group.failures.all(), group.compensation.name());
    let lost = |mode| of(mode).map_or(0, |group| group.failures.all());
    let why = if lost(Mode::None).min(lost(Mode::Backlash)).min(lost(Mode::Coupling)) > lost(Mode::Pivot) {
        " It turns about the fibre point and relies on that: where the rotation centre is not corrected, turning through what cameras leave carries the fibre away."
    } else {
        ""
    };
    let failures: Vec<String> = Mode::ALL.into_iter().filter_map(|mode| of(mode).map(failed)).collect();
    Some(format!(
        "From what cameras leave, the robust search with all compensation ends {} dB above the optimum in the median and {} dB at 90 %, after {} s ({}); its uniformity is {} dB above the \
         optimum's at 90 %. Failed of {}: {}.{why}",
        number(all.above_optimum_db.median, 3),
        number(all.above_optimum_db.p90, 3),
        number(all.seconds.median, 1),
        number(all.seconds.p90, 1),
        number(all.uniformity_above_optimum_db.p90, 3),
        e.seeds,
        failures.join(", ")
    ))
}

fn start(e: &Experiment) -> Option<String> {
    let search = *climbs(true).first()?;
    let mut pairs: Vec<(f64, Option<f64>)> = e
        .runs_of(search, Mode::None)
        .zip(e.runs_of(search, Mode::All))
        .map(|(none, all)| (none.start_um, ended(none).zip(ended(all)).map(|(none, all)| none - all)))
        .collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (near, far) = pairs.split_at(pairs.len() / 2);
    let median = |half: &[(f64, Option<f64>)]| Quantiles::of(half.iter().map(|pair| pair.1)).median;
    let verdict = match median(near).zip(median(far)) {
        Some((near, far)) if far > near => {
            "The same errors of the stage cost more the farther away the search begins. "
        }
        _ => "",
    };
    Some(format!(
        "The size: on the half of the benches that begins nearest to the peak (up to {:.1} um, both sides together) the {} gains {} dB in the median by compensation, on the other half \
         {} dB. {verdict}Where a search begins and by which steps are assumptions here.",
        near.last()?.0,
        search.words(),
        db(median(near)),
        db(median(far))
    ))
}

fn floor(e: &Experiment) -> Option<String> {
    let channels = e.groups.first()?.channels_db.len();
    let split = 10.0 * (channels as f64).log10();
    let excess = crate::optics::SplitterSize::default().excess_db;
    Some(format!(
        "The level: of the {} dB that the benches allow at best, {split:.2} dB are the split into {channels} and {excess:.1} dB an assumption on the chip; mode radii and the gap left for the glue \
         are assumptions too. So {:.2} dB and {:.2} dB as such cannot be derived.",
        db(e.optimum.worst_db.median),
        e.paper[0].worst_db,
        e.paper[1].worst_db
    ))
}

fn chance(e: &Experiment) -> Option<String> {
    let within = |group: &&Group, value: f64| {
        let q = group.worst_db;
        q.p10.zip(q.p90).is_some_and(|(low, high)| low <= value && value <= high)
    };
    let [bare, all] = [(Mode::None, 0), (Mode::All, 1)].map(|(mode, k)| {
        let names: Vec<_> = e
            .groups
            .iter()
            .filter(|group| group.compensation == mode)
            .filter(|group| within(group, e.paper[k].worst_db))
            .map(|group| group.of.words())
            .collect();
        if names.is_empty() { "none".into() } else { names.join("; ") }
    });
    Some(format!(
        "Single runs: the paper prints one of each. {:.2} dB lies between the 10th and the 90th percentile of these searches without compensation: {bare}; {:.2} dB of these with \
         it: {all}. Where several do, the figures do not tell which search it was.",
        e.paper[0].worst_db, e.paper[1].worst_db
    ))
}

fn position(e: &Experiment) -> Option<String> {
    let each = Optics::default().lateral_db() * play_um().powi(2);
    Some(format!(
        "As an error of position alone the play of {:.1} um costs {each:.3} dB in each direction on each side, {:.3} dB in all; the {:.2} dB of the paper are not to be had \
         that way. They need a search that the play, or the way of the fibre point, leads astray.",
        play_um(),
        4.0 * each,
        e.paper[0].worst_db - e.paper[1].worst_db
    ))
}
