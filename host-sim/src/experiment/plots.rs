//! The drawings of the page.

use super::findings::play_um;
use super::statistics::Quantiles;
use super::tables::number;
use super::{Experiment, Kind, NEAR_ENOUGH_DB, Run, STEPS_UM, Search};
use crate::report::Mode;
use crate::report::plot::{Frame, Scale, curve, dot, drawing, line, rectangle, text};
use maud::{Markup, html};

/// Width of a drawing.
const WIDTH: f64 = 960.0;
/// Height of a row of a compensation.
const ROW: f64 = 15.0;
/// Smallest loss above the optimum that is drawn, dB.
const LEAST_DB: f64 = 0.003;

/// Loss above the optimum, of every search with every compensation: every run a dot.
pub(super) fn losses(e: &Experiment) -> Markup {
    let most = e.runs.iter().filter(|run| run.has_ended()).map(|run| run.above_optimum_db).fold(1.0, f64::max);
    strips(
        e,
        "Loss above the optimum, by search and compensation",
        "loss of the worst channel above the optimum, dB",
        Some(NEAR_ENOUGH_DB),
        |range| Scale::decades([LEAST_DB, most.min(100.0)], range),
        |run| run.above_optimum_db,
    )
}

/// Simulated time.
pub(super) fn times(e: &Experiment) -> Markup {
    let most = e.runs.iter().map(|run| run.seconds).fold(1.0, f64::max);
    strips(
        e,
        "Simulated time, by search and compensation",
        "simulated time, s",
        None,
        |range| Scale::decades([1.0, most], range),
        |run| run.seconds,
    )
}

/// A row for each search and compensation.
fn strips(
    e: &Experiment,
    title: &str,
    name: &str,
    mark: Option<f64>,
    scale: impl Fn([f64; 2]) -> Scale,
    value: impl Fn(&Run) -> f64,
) -> Markup {
    let group = Mode::ALL.len() as f64 * ROW + 12.0;
    let searches = Search::all();
    let frame = Frame { x: [190.0, WIDTH - 150.0], y: [searches.len() as f64 * group + 6.0, 0.0] };
    let across = scale(frame.x);
    let content = html! {
        @for (value, name) in across.ticks() {
            (line("grid", [across.at(value), 0.0], [across.at(value), frame.y[0]]))
            (text("tick middle", [across.at(value), frame.y[0] + 15.0], &name))
        }
        @if let Some(mark) = mark { g class="limit" { (line("dash", [across.at(mark), 0.0], [across.at(mark), frame.y[0]])) } }
        (line("axis", [frame.x[0], frame.y[0]], [frame.x[1], frame.y[0]]))
        (text("name middle", [(frame.x[0] + frame.x[1]) / 2.0, frame.y[0] + 32.0], name))
        @for (s, search) in searches.iter().enumerate() {
            @let top = s as f64 * group + 6.0;
            @if s > 0 { (line("rule", [0.0, top - 6.0], [WIDTH, top - 6.0])) }
            (text("label end", [frame.x[0] - 14.0, top + group / 2.0 - 3.0], &search.words()))
            @for (k, mode) in Mode::ALL.into_iter().enumerate() {
                (strip(&e.runs_of(*search, mode).collect::<Vec<_>>(), mode, &across, &value, top + (k as f64 + 0.5) * ROW, frame.x[1]))
            }
        }
    };
    drawing([WIDTH, frame.y[0] + 40.0], title, content)
}

fn strip(runs: &[&Run], mode: Mode, across: &Scale, value: &impl Fn(&Run) -> f64, y: f64, right: f64) -> Markup {
    let q = Quantiles::of(runs.iter().map(|run| run.has_ended().then(|| value(run))));
    let count =
        |kind| runs.iter().filter_map(|run| run.failure.as_ref()).filter(|failure| failure.kind == kind).count();
    let lost: Vec<String> = [(Kind::Error, "error"), (Kind::Collision, "collision")]
        .into_iter()
        .filter_map(|(kind, name)| match count(kind) {
            0 => None,
            1 => Some(format!("1 {name}")),
            n => Some(format!("{n} {name}s")),
        })
        .collect();
    html! {
        g class=(format!("c-{}", mode.name())) {
            g class="faint" {
                @for (n, run) in runs.iter().enumerate().filter(|(_, run)| run.has_ended()) {
                    // spread by the golden ratio, so that dots do not hide each other
                    (dot("bar", [across.at(value(run)), y + ((n as f64 * 0.618).fract() - 0.5) * 0.6 * ROW], 1.6))
                }
            }
            @if let Some(low) = q.p10 {
                // without a 90th percentile it goes on to where there is no end
                (line("thin", [across.at(low), y], [q.p90.map_or(right, |high| across.at(high)), y]))
            }
            @if let Some(median) = q.median {
                (rectangle("bar", [across.at(median) - 1.5, y - 6.0], [across.at(median) + 1.5, y + 6.0]))
            }
        }
        @if !lost.is_empty() { (text("small alarm", [right + 8.0, y + 4.0], &lost.join(", "))) }
    }
}

/// Gain by compensation against the step of the climb.
pub(super) fn gains(e: &Experiment) -> Markup {
    let modes = [Mode::Backlash, Mode::Coupling, Mode::Pivot, Mode::All];
    let gained = |mode, step_um| {
        let group = e.group(Search::Climb { step_um }, mode);
        group.map(|group| (group.gain_db, group.gain_interval_db)).unwrap_or_default()
    };
    let gain = |mode, step_um| gained(mode, step_um).0;
    let every: Vec<f64> = modes
        .into_iter()
        .flat_map(|mode| STEPS_UM.map(|step| gained(mode, step)))
        .flat_map(|(q, interval)| [q.p10, q.median, q.p90, interval.low, interval.high])
        .flatten()
        .collect();
    let ends = [every.iter().copied().fold(0.0, f64::min), every.iter().copied().fold(0.1, f64::max)];
    let frame = Frame { x: [60.0, 700.0], y: [320.0, 30.0] };
    let (across, up) = (Scale::linear([0.0, 1.1], frame.x), Scale::with_zero(ends, frame.y));
    let content = html! {
        (frame.draw(&across, &up, "step of the climb, um", "gain, dB"))
        (line("axis", [frame.x[0], up.at(0.0)], [frame.x[1], up.at(0.0)]))
        g class="limit" { (line("dash", [across.at(play_um()), frame.y[0]], [across.at(play_um()), frame.y[1]])) }
        (text("small", [across.at(play_um()) + 5.0, frame.y[1] + 4.0], "play of the stage"))
        @for (k, mode) in modes.into_iter().enumerate() {
            // none of them on the line of the play
            @let aside = (k as f64 - 1.5) * 8.0;
            g class=(format!("c-{}", mode.name())) {
                (curve("curve", STEPS_UM.iter().filter_map(|step| Some([across.at(*step) + aside, up.at(gain(mode, *step).median?)]))))
                @for step in STEPS_UM {
                    @let (q, interval) = gained(mode, step);
                    @if let Some((low, high)) = q.p10.zip(q.p90) {
                        (line("thin", [across.at(step) + aside, up.at(low)], [across.at(step) + aside, up.at(high)]))
                    }
                    @if let Some((low, high)) = interval.low.zip(interval.high) {
                        (rectangle("bar", [across.at(step) + aside - 1.5, up.at(high)], [across.at(step) + aside + 1.5, up.at(low)]))
                    }
                    @if let Some(median) = q.median { (dot("bar", [across.at(step) + aside, up.at(median)], 3.5)) }
                }
            }
        }
        @for (k, step) in STEPS_UM.into_iter().enumerate() {
            @if let Some(median) = gain(Mode::All, step).median {
                (text("small", [frame.x[1] + 30.0, frame.y[1] + 40.0 + 18.0 * k as f64], &format!("{step:.1} um: {} dB", number(Some(median), 2))))
            }
        }
        (text("label", [frame.x[1] + 30.0, frame.y[1] + 20.0], "all, medians"))
    };
    drawing([WIDTH, 360.0], "Gain by compensation against the step of the climb", content)
}
