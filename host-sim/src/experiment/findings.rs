//! What follows from the figures: sentences of which every number and every verdict is computed.

use super::interval::{CONFIDENCE, ENOUGH_BENCHES, Interval, Verdict};
use super::statistics::{ENOUGH_FOR_PERCENTILES, Group, Quantiles, gain};
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
    let reproduced = [statistics, direction, parts, trap, confounding, uniformity, time, baseline, from_cameras];
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

/// A median and its interval.
fn span(median: Option<f64>, interval: &Interval, decimals: usize) -> String {
    let ends = ends(interval, decimals).map_or(String::new(), |ends| format!(" ({ends})"));
    format!("{}{ends}", number(median, decimals))
}

/// The ends of an interval; none where it has none.
pub(super) fn ends(interval: &Interval, decimals: usize) -> Option<String> {
    let text = |end| number(Some(end), decimals);
    match (interval.low, interval.high) {
        (Some(low), Some(high)) => Some(format!("{} to {}", text(low), text(high))),
        (Some(low), None) => Some(format!("above {}", text(low))),
        (None, Some(high)) => Some(format!("below {}", text(high))),
        (None, None) => None,
    }
}

/// Gain of a search with a compensation against none, with its interval.
fn gained(e: &Experiment, search: Search, mode: Mode) -> String {
    e.group(search, mode).map_or_else(|| number(None, 2), |g| span(g.gain_db.median, &g.gain_interval_db, 2))
}

/// Verdicts of some things in a sentence: of all at once where they are the same.
fn verdicts(of: &[(String, Verdict)], words: fn(Verdict) -> &'static str) -> String {
    match of {
        [] => String::new(),
        [(_, first), rest @ ..] if rest.iter().all(|(_, verdict)| verdict == first) => words(*first).into(),
        _ => of.iter().map(|(name, verdict)| format!("{} for {name}", words(*verdict))).collect::<Vec<_>>().join("; "),
    }
}

/// Whether a gain is what the paper found.
const fn reproduced(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::More => "reproduced",
        Verdict::Less => "the opposite",
        Verdict::NotSeen => "not seen",
        Verdict::TooFew => "too few benches to say",
    }
}

/// Whether a gain is one.
pub(super) const fn seen(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::More => "a gain",
        Verdict::Less => "a loss",
        Verdict::NotSeen => "not seen",
        Verdict::TooFew => "too few benches to say",
    }
}

/// Median and interval of what a figure is less with a compensation than without, bench by bench.
fn paired(e: &Experiment, search: Search, mode: Mode, figure: impl Fn(&Run) -> f64) -> (Option<f64>, Interval) {
    let of = |run: &Run| if run.has_ended() { figure(run) } else { f64::INFINITY };
    let less: Vec<f64> =
        e.runs_of(search, Mode::None).zip(e.runs_of(search, mode)).map(|(bare, run)| gain(of(bare), of(run))).collect();
    (Quantiles::of(less.iter().copied().map(Some)).median, Interval::of(less))
}

fn statistics(e: &Experiment) -> Option<String> {
    let enough = |least: usize| if (e.seeds as usize) < least { "not enough" } else { "enough" };
    Some(format!(
        "How sure: {} benches. In brackets behind a median is its {:.0} % interval by the order of the values (sign test), each on its own; a verdict is that of the interval of the \
         bench-by-bench difference and needs {ENOUGH_BENCHES} benches ({}), a 10th or 90th percentile {ENOUGH_FOR_PERCENTILES} ({}). A dash: there is none, or it lies among runs that ended in an error \
         or a collision.",
        e.seeds,
        100.0 * CONFIDENCE,
        enough(ENOUGH_BENCHES),
        enough(ENOUGH_FOR_PERCENTILES)
    ))
}

fn step_words(search: Search) -> String {
    if let Search::Climb { step_um } = search { format!("{step_um:.1} um") } else { search.words() }
}

fn direction(e: &Experiment) -> Option<String> {
    let (small, large) = (climbs(true), climbs(false));
    let better = |search| e.group(search, Mode::All).map_or(0, |group| group.better_worse[0]);
    let told: Vec<_> =
        small.iter().filter_map(|s| Some((step_words(*s), e.group(*s, Mode::All)?.gain_verdict?))).collect();
    Some(format!(
        "Direction: with steps up to the play ({} against {:.1} um) all compensation together lowers the loss of the worst channel by {} dB \
         in the median ({} of {} benches are better); with steps above it ({}) by {} dB. The paper prints {:.2} dB less ({:.2} to {:.2}). \
         The direction, for steps up to the play: {}.",
        row(&small, step_words),
        play_um(),
        row(&small, |s| gained(e, s, Mode::All)),
        row(&small, |s| better(s).to_string()),
        e.seeds,
        row(&large, step_words),
        row(&large, |s| gained(e, s, Mode::All)),
        e.paper[0].worst_db - e.paper[1].worst_db,
        e.paper[0].worst_db,
        e.paper[1].worst_db,
        verdicts(&told, reproduced)
    ))
}

fn parts(e: &Experiment) -> Option<String> {
    let small = climbs(true);
    let told: Vec<_> =
        small.iter().filter_map(|s| Some((step_words(*s), e.group(*s, Mode::Backlash)?.gain_verdict?))).collect();
    let ends = |search, mode| e.runs_of(search, mode).map(|run| run.worst_db);
    let every: Vec<[f64; 3]> = small
        .iter()
        .flat_map(|&s| ends(s, Mode::None).zip(ends(s, Mode::Coupling)).zip(ends(s, Mode::Pivot)))
        .map(|((none, coupling), pivot)| [none, coupling, pivot])
        .collect();
    let same = every.iter().filter(|[_, coupling, pivot]| coupling == pivot).count();
    let toss = every.iter().map(|[none, coupling, _]| (none - coupling).abs()).fold(0.0, f64::max);
    Some(format!(
        "Which part: of the climbs with steps up to the play, backlash compensation alone gains {} dB ({}). Cross-coupling and rotation centre can not act in them, because nothing \
         turns ({same} of {} runs end alike with either), so what stands there is chance: {} dB in the median, up to {} dB on one bench. Only the message that switches them differs in length, the climb begins a fraction of a millisecond \
         later, and within the play the noise of the meter tosses otherwise.",
        row(&small, |s| gained(e, s, Mode::Backlash)),
        verdicts(&told, seen),
        every.len(),
        row(&small, |s| gained(e, s, Mode::Coupling)),
        db(Some(toss))
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
    let [caught, free] = [caught, free].map(|losses: Vec<Option<f64>>| {
        let interval = Interval::of(losses.iter().map(|loss| loss.unwrap_or(f64::INFINITY)));
        (Quantiles::of(losses).median, interval)
    });
    let told = match (caught.1.of.min(free.1.of) < ENOUGH_BENCHES, caught.1.is_above(&free.1)) {
        (true, _) => "too few of either to say more",
        (_, true) => "the intervals lie apart",
        _ => "the intervals overlap",
    };
    Some(format!(
        "Why: trapped in play were, by step from {:.1} to {:.1} um, {} of {} climbs without compensation and {} with all of it. Up to the play, the \
         uncompensated climbs that were trapped ({}) end {} dB above the optimum in the median, the others ({}) {} dB: {told}.",
        STEPS_UM[0],
        STEPS_UM[STEPS_UM.len() - 1],
        trapped(Mode::None),
        e.seeds,
        trapped(Mode::All),
        caught.1.of,
        span(caught.0, &caught.1, 2),
        free.1.of,
        span(free.0, &free.1, 2)
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
         sideways (medians). Gain against no compensation: backlash {} dB ({}), rotation centre {} dB ({}), all {} dB ({}). With going back to the peak after every turn, it is {} dB without any compensation.",
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
        gained(e, Search::AngleClimb, Mode::Backlash),
        backlash.gain_verdict.map_or("", seen),
        gained(e, Search::AngleClimb, Mode::Pivot),
        pivot.gain_verdict.map_or("", seen),
        gained(e, Search::AngleClimb, Mode::All),
        all.gain_verdict.map_or("", seen),
        db(repeaked.above_optimum_db.median)
    ))
}

fn uniformity(e: &Experiment) -> Option<String> {
    let median = |search, mode| e.group(search, mode).and_then(|group| group.uniformity_db.median);
    let each = |search: Search| {
        let (less, interval) = paired(e, search, Mode::All, |run| run.uniformity_db);
        format!(
            "{}: {} to {}, less by {}",
            search.words(),
            db(median(search, Mode::None)),
            db(median(search, Mode::All)),
            span(less, &interval, 2)
        )
    };
    Some(format!(
        "Uniformity in dB, medians without and with all compensation, and the bench-by-bench difference: {}. The best that the benches allow is {} dB. The paper prints {:.2} to {:.2} dB.",
        Search::all().into_iter().map(each).collect::<Vec<_>>().join("; "),
        db(e.optimum.uniformity_db.median),
        e.paper[0].uniformity_db,
        e.paper[1].uniformity_db
    ))
}

fn time(e: &Experiment) -> Option<String> {
    let searches: Vec<Search> = Search::all().into_iter().filter(|search| !search.is_robust()).collect();
    let slow = |search, mode| e.group(search, mode).and_then(|group| group.slow_seconds).and_then(|q| q.median);
    let saved =
        |search| paired(e, search, Mode::All, |run| run.climb.map_or(f64::NAN, |climb| climb.slow_seconds)).1.verdict();
    let each = |search: Search| {
        let told = match saved(search) {
            Verdict::More => "shorter",
            Verdict::Less => "longer",
            Verdict::NotSeen => "no difference seen",
            Verdict::TooFew => "too few benches to say",
        };
        let [none, all] = [Mode::None, Mode::All].map(|mode| number(slow(search, mode), 0));
        format!("{}: {none} to {all} ({told})", search.words())
    };
    let early = match saved(*searches.first()?) {
        Verdict::Less => " A climb that is caught gives up early: the trap shortens a run.",
        _ => "",
    };
    Some(format!(
        "Time in s at 50 ms a move and 100 ms a reading, medians without and with all compensation: {}. The paper prints {:.0} to {:.0} s.{early}",
        searches.iter().copied().map(each).collect::<Vec<_>>().join("; "),
        e.paper[0].seconds,
        e.paper[1].seconds
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
    let failed = |group: &Group| {
        let causes: Vec<String> = group
            .causes
            .iter()
            .map(|cause| format!("{} {}: {}", cause.runs, cause.kind.words(), cause.cause))
            .collect();
        let why = if causes.is_empty() { String::new() } else { format!(" ({})", causes.join(", ")) };
        format!("{} {}{why}", group.compensation.name(), group.failures.all())
    };
    let failures: Vec<String> = Mode::ALL.into_iter().filter_map(|mode| of(mode).map(failed)).collect();
    Some(format!(
        "From what cameras leave, the robust search with all compensation ends {} dB above the optimum in the median and {} dB at 90 %, after {} s ({}); its uniformity is {} dB above the \
         optimum's at 90 %. Failed of {}, and what ended these runs: {}.",
        number(all.above_optimum_db.median, 3),
        number(all.above_optimum_db.p90, 3),
        number(all.seconds.median, 1),
        number(all.seconds.p90, 1),
        number(all.uniformity_above_optimum_db.p90, 3),
        e.seeds,
        failures.join("; ")
    ))
}

fn start(e: &Experiment) -> Option<String> {
    let search = *climbs(true).first()?;
    let end = |run: &Run| ended(run).unwrap_or(f64::INFINITY);
    let mut pairs: Vec<(f64, f64)> = e
        .runs_of(search, Mode::None)
        .zip(e.runs_of(search, Mode::All))
        .map(|(none, all)| (none.start_um, gain(end(none), end(all))))
        .collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (near, far) = pairs.split_at(pairs.len() / 2);
    let median = |half: &[(f64, f64)]| Quantiles::of(half.iter().map(|pair| Some(pair.1))).median;
    let interval = |half: &[(f64, f64)]| Interval::of(half.iter().map(|pair| pair.1));
    let (one, other) = (interval(near), interval(far));
    let verdict = match one.of.min(other.of) < ENOUGH_BENCHES {
        true => "Too few benches to say whether that hangs on the start. ",
        false if other.is_above(&one) => "The same errors of the stage cost more the farther away the search begins. ",
        false => "The intervals overlap: that it hangs on the start is not seen. ",
    };
    Some(format!(
        "The size: on the half of the benches that begins nearest to the peak (up to {:.1} um, both sides together) the {} gains {} dB in the median by compensation, on the other half \
         {} dB. {verdict}Where a search begins and by which steps are assumptions here.",
        near.last()?.0,
        search.words(),
        span(median(near), &one, 2),
        span(median(far), &other, 2)
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
    if (e.seeds as usize) < ENOUGH_FOR_PERCENTILES {
        return Some("Single runs: the paper prints one of each; these are too few benches to say which searches that could have been.".into());
    }
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
