//! The page's section on what each compensation buys: one table for all axes together, ranges, curves, one table of all.

use super::{Kind, Mode, Result, Run, Travel};
use crate::report::number::{figure, short};
use crate::report::page::{Section, Swatch, caption, legend};
use crate::report::plot::{Frame, Scale, curve, dot, drawing, line, px, rectangle, text};
use maud::{Markup, html};

/// Height of one run in the drawing of ranges.
const ROW: f64 = 13.0;
/// Width of all drawings.
const WIDTH: f64 = 960.0;

impl Mode {
    /// What is switched on, in words.
    pub fn words(self) -> &'static str {
        match self {
            Mode::None => "nothing",
            Mode::Backlash => "backlash",
            Mode::Coupling => "coupling",
            Mode::Pivot => "rotation centre",
            Mode::All => "all three",
        }
    }
}

/// The section; `refusal` when there is no calibration to compensate with.
pub fn section(travel: std::result::Result<&Travel, &str>) -> Section {
    let body = match travel {
        Ok(travel) => body(travel),
        Err(refusal) => html! { p.warning { "Nothing can be compensated on this machine: " (refusal) "." } },
    };
    Section { id: "travel", title: "What each compensation buys", body }
}

fn body(travel: &Travel) -> Markup {
    let names: Vec<_> = Mode::ALL.iter().map(|mode| (format!("c-{}", mode.name()), mode.words())).collect();
    html! {
        (headline(travel))
        (caption("table", "The poses of the sequence visited one after the other: distance of the fibre point from where \
            it was commanded (um) and rotation of the array against the commanded orientation (urad). p: percentiles."))
        (whole(travel))
        figure {
            (legend(Swatch::Bar, &names))
            (ranges(travel))
            figcaption { "Position error of the fibre point along each move, um, on a logarithmic scale. Bar: from the \
                median to the 95th percentile of all stops; tick: root mean square; dot: largest. Errors below 0.001 um are drawn at the left edge." }
        }
        figure {
            (legend(Swatch::Curve, &names))
            (curves(travel))
            figcaption { "Position error of the fibre point at every stop, um, on a logarithmic scale, over where it was \
                commanded to be; each move goes there and back, which is why a curve with backlash has two branches. \
                Errors below 0.001 um are drawn at the lower edge." }
        }
        (caption("table", "Root mean square and largest position error along each move, um. Share: how much of the travel \
            the move uses; less than 100 % where a compensated motor would leave its own travel."))
        (all(travel))
        p.note {
            "At each stop the motors stand where the controller\u{2019}s fixed-point law and its reversal rule put them, and \
            the stage where its play and all errors of the machine file put it; the law knows nothing of the 36 errors of the \
            stages, which stay. All stops are at rest, each move begins at home on the positive flank; axes that do \
            not move stay there, or a little inside their travel where home is at its end. After a motor turns, \
            a step or two within the dead band of the reversal rule are not yet taken up: that shows where a coupled motor \
            moves slowly. Coupling: squarenesses and axis tilts (D\u{207b}\u{b9}, \
            W\u{207b}\u{b9} and the second-order term). Rotation centre: the fibre point stays where it is when an angle \
            changes; without it the stage turns about its own axes and carries the fibre point along."
        }
    }
}

/// The result in one sentence.
fn headline(travel: &Travel) -> Markup {
    let last = travel.tracks.len() - 1;
    let rms = |mode: Mode| {
        let value = travel.tracks[last].runs[mode as usize].position_um.rms;
        figure(format!("/travel/tracks/{last}/runs/{}/position_um/rms", mode as usize), value)
    };
    let share = travel.tracks[last].track.share_of_travel;
    let reach = if share < 1.0 {
        format!(
            "Over the middle {:.0} % of the travel (beyond, a compensated motor would leave its own)",
            share * 100.0
        )
    } else {
        "Over the whole travel".into()
    };
    html! {
        p.lead {
            (reach) " the fibre point is off by " strong { (rms(Mode::None)) " um" }
            " (root mean square) without compensation and by " strong { (rms(Mode::All)) " um" } " with all of it; backlash \
            alone leaves " (rms(Mode::Backlash)) " um, coupling alone " (rms(Mode::Coupling)) " um, the rotation centre \
            alone " (rms(Mode::Pivot)) " um."
        }
    }
}

fn whole(travel: &Travel) -> Markup {
    let last = travel.tracks.len() - 1;
    html! {
        table {
            thead {
                tr { th rowspan="2" { "On" } th colspan="5" { "position error, um" } th colspan="2" { "orientation error, urad" } }
                tr { @for name in ["max", "rms", "p50", "p95", "p99", "max", "rms"] { th { (name) } } }
            }
            tbody {
                @for (k, run) in travel.tracks[last].runs.iter().enumerate() {
                    @let at = |name: &str| format!("/travel/tracks/{last}/runs/{k}/{name}");
                    @let (p, o) = (run.position_um, run.orientation_urad);
                    tr {
                        th { (run.mode.words()) }
                        @for (name, value) in [("max", p.max), ("rms", p.rms), ("p50", p.p50), ("p95", p.p95), ("p99", p.p99)] {
                            td { (figure(at(&format!("position_um/{name}")), value)) }
                        }
                        td { (figure(at("orientation_urad/max"), o.max)) }
                        td { (figure(at("orientation_urad/rms"), o.rms)) }
                    }
                }
            }
        }
    }
}

fn all(travel: &Travel) -> Markup {
    html! {
        table.dense {
            thead {
                tr {
                    th rowspan="2" { "Move" } th rowspan="2" { "share, %" }
                    @for mode in Mode::ALL { th colspan="2" { (mode.words()) } }
                }
                tr { @for _ in Mode::ALL { th { "rms" } th { "max" } } }
            }
            tbody {
                @for (t, result) in travel.tracks.iter().enumerate() {
                    tr {
                        th { (result.track.name) }
                        td { (short(result.track.share_of_travel * 100.0)) }
                        @for (k, run) in result.runs.iter().enumerate() {
                            td { (figure(format!("/travel/tracks/{t}/runs/{k}/position_um/rms"), run.position_um.rms)) }
                            td { (figure(format!("/travel/tracks/{t}/runs/{k}/position_um/max"), run.position_um.max)) }
                        }
                    }
                }
            }
        }
    }
}

/// Extremes of what is drawn, um.
fn domain(travel: &Travel) -> [f64; 2] {
    let spreads = || travel.tracks.iter().flat_map(|result| &result.runs).map(|run| run.position_um);
    let least = spreads().map(|s| s.p50).filter(|v| *v > 0.0).fold(f64::MAX, f64::min);
    [least.clamp(1e-3, 1e3), spreads().map(|s| s.max).fold(1e-2, f64::max)]
}

fn ranges(travel: &Travel) -> Markup {
    let group = Mode::ALL.len() as f64 * ROW + 12.0;
    let frame = Frame { x: [205.0, WIDTH - 70.0], y: [travel.tracks.len() as f64 * group + 6.0, 0.0] };
    let across = Scale::decades(domain(travel), frame.x);
    let content = html! {
        @for (value, name) in across.ticks() {
            (line("grid", [across.at(value), 0.0], [across.at(value), frame.y[0]]))
            (text("tick middle", [across.at(value), frame.y[0] + 15.0], &name))
        }
        (line("axis", [frame.x[0], frame.y[0]], [frame.x[1], frame.y[0]]))
        (text("name middle", [(frame.x[0] + frame.x[1]) / 2.0, frame.y[0] + 32.0], "position error of the fibre point, um"))
        @for (t, result) in travel.tracks.iter().enumerate() {
            @let top = t as f64 * group + 6.0;
            @if t > 0 { (line("rule", [0.0, top - 6.0], [WIDTH, top - 6.0])) }
            (text("label end", [193.0, top + group / 2.0 - 3.0], &result.track.name))
            @for (k, run) in result.runs.iter().enumerate() { (range(run, &across, top + (k as f64 + 0.5) * ROW)) }
        }
    };
    drawing([WIDTH, frame.y[0] + 40.0], "Position error along each move with each part of the compensation", content)
}

fn range(run: &Run, across: &Scale, y: f64) -> Markup {
    let class = format!("c-{}", run.mode.name());
    let s = run.position_um;
    let (p50, p95, rms, max) = (across.at(s.p50), across.at(s.p95), across.at(s.rms), across.at(s.max));
    html! {
        g class=(class) {
            (rectangle("bar", [p50, y - 3.0], [p95.max(p50 + 1.0), y + 3.0]))
            (line("thin", [p95, y], [max, y]))
            (line("stroke", [rms, y - 5.0], [rms, y + 5.0]))
            (dot("bar", [max, y], 3.5))
        }
        (text("tick", [max + 8.0, y + 3.5], &short(s.max)))
    }
}

fn curves(travel: &Travel) -> Markup {
    const COLUMNS: usize = 3;
    let (cell, height) = (WIDTH / COLUMNS as f64, 190.0);
    let lines: Vec<_> = travel.tracks.iter().filter(|result| result.track.kind == Kind::Line).collect();
    let rows = lines.len().div_ceil(COLUMNS);
    let content = html! {
        @for (n, result) in lines.iter().enumerate() {
            @let (column, row) = (n % COLUMNS, n / COLUMNS);
            g transform=(format!("translate({} {})", px(column as f64 * cell), px(row as f64 * height))) {
                (panel(result, domain(travel), cell, height))
            }
        }
    };
    drawing([WIDTH, rows as f64 * height], "Position error over the travel, one panel for each move", content)
}

fn panel(result: &Result, domain: [f64; 2], width: f64, height: f64) -> Markup {
    let along = &result.track.along;
    let ends = [along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(f64::MIN, f64::max)];
    let frame = Frame { x: [48.0, width - 12.0], y: [height - 42.0, 24.0] };
    let (across, up) = (Scale::linear(ends, frame.x), Scale::decades(domain, frame.y));
    let unit = if result.track.unit == "%" { "% of the travel" } else { result.track.unit };
    html! {
        (frame.draw(&across, &up, unit, "um"))
        (text("label middle", [(frame.x[0] + frame.x[1]) / 2.0, 14.0], &result.track.name))
        @for run in &result.runs {
            (curve(&format!("curve c-{}", run.mode.name()),
                along.iter().zip(&run.stops_um).map(|(at, error)| [across.at(*at), up.at(*error)])))
        }
    }
}
