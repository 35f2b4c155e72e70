//! The page: one self-contained HTML file.

use super::findings::{Finding, Topic};
use super::tables::{ROWS, failures, gained, mechanisms, number};
use super::{Experiment, PAPER, Search, plots};
use crate::report::Mode;
use crate::report::page::{Section, Swatch, caption, framed, legend};
use maud::{Markup, html};

/// What this page has beyond the style of all.
const MORE_STYLE: &str = "svg .faint { opacity: 0.45; } svg .limit { color: var(--alarm); } td.words { white-space: nowrap; } \
    tr.second td, tr.second th { color: var(--soft); }";

/// What the drawings by runs show of those without a figure.
const NO_END: &str = "In red at the right: runs that ended in an error or a collision. They have no dot and count as worse than every other one; where they are more than a tenth, the line goes on to the \
    right edge, and where they are half, there is no median.";

/// The page as HTML.
pub fn render(e: &Experiment) -> String {
    let sections = [
        summary(e),
        table(e, Mode::None, 7),
        table(e, Mode::All, 8),
        losses(e),
        gains(e),
        times(e),
        every(e),
        why(e),
        limits(e),
        scenario(e),
    ];
    let sub = html! {
        "1 \u{d7} " (e.groups.first().map_or(0, |group| group.channels_db.len())) " splitter \u{b7} " (e.seeds) " benches \u{b7} "
        (e.runs.len()) " alignments \u{b7} host-sim " (env!("CARGO_PKG_VERSION"))
    };
    framed("What compensation is worth in light", &sub, &sections, MORE_STYLE)
}

fn names() -> Vec<(String, &'static str)> {
    Mode::ALL.iter().map(|mode| (format!("c-{}", mode.name()), mode.words())).collect()
}

/// Those of which the gain is drawn; said of which it is chance.
fn acting() -> Vec<(String, &'static str)> {
    let chance = |mode: Mode| match mode {
        Mode::Coupling => "coupling (can not act here: chance)",
        Mode::Pivot => "rotation centre (can not act here: chance)",
        other => other.words(),
    };
    Mode::ALL[1..].iter().map(|mode| (format!("c-{}", mode.name()), chance(*mode))).collect()
}

fn list(findings: &[Finding], topic: Topic) -> Markup {
    html! { ul { @for finding in findings.iter().filter(|finding| finding.topic == topic) { li { (finding.text) } } } }
}

fn summary(e: &Experiment) -> Section {
    let body = html! {
        p.lead { "Every bench is a stage with errors of its own before a chip of its own; the controllers know of it what noisy measurements tell. "
            "Each is aligned by a naive climb of the host and by a robust search, with every part of the compensation on and off." }
        (list(&e.findings, Topic::Reproduced))
    };
    Section { id: "result", title: "What is reproduced", body }
}

fn table(e: &Experiment, mode: Mode, number_in_paper: usize) -> Section {
    let printed = PAPER[usize::from(mode != Mode::None)];
    let groups: Vec<_> = Search::all().into_iter().filter_map(|search| e.group(search, mode)).collect();
    let channels = groups.first().map_or(0, |group| group.channels_db.len());
    let body = html! {
        (caption("table", "Insertion losses in dB. In medians and percentiles a run that ended in an error or a collision is worse than every other one; a dash: \
            the percentile lies among those, or there are fewer than 10 runs to take a 90th percentile of. Failed besides: more than 0.5 dB above the optimum; robust search nearer to the chip than \
            the working gap, or over 20 s."))
        div.wide { table.dense {
            thead {
                tr {
                    th { "Search" } th {} @for n in 1..=channels { th { "CH" (n) } }
                    th { "max" } th { "uni\u{ad}formity" } th { "time, s" } th { "at 50/100 ms, s" } th.left { "failed of " (e.seeds) }
                }
            }
            tbody {
                @for group in &groups {
                    @for (k, (name, of)) in ROWS.into_iter().enumerate() {
                        tr class=(if k == 0 { "first" } else { "second" }) {
                            th { @if k == 0 { (group.of.words()) } }
                            td.words { (name) }
                            @for channel in &group.channels_db { td { (number(of(channel), 2)) } }
                            td { strong { (number(of(&group.worst_db), 2)) } }
                            td { (number(of(&group.uniformity_db), 2)) }
                            td { (number(of(&group.seconds), 1)) }
                            td { @if let Some(slow) = group.slow_seconds { (number(of(&slow), 0)) } }
                            td.left.words { @if k == 0 { (failures(group)) } }
                        }
                    }
                }
                tr {
                    th { "the paper" } td {} td colspan=(channels) {}
                    td { strong { (number(Some(printed.worst_db), 2)) } } td { (number(Some(printed.uniformity_db), 2)) }
                    td { (number(Some(printed.seconds), 0)) } td {} td {}
                }
            }
        } }
    };
    let (id, title) = match number_in_paper {
        7 => ("table7", "Table 7: without compensation"),
        _ => ("table8", "Table 8: with compensation"),
    };
    Section { id, title, body }
}

fn losses(e: &Experiment) -> Section {
    let body = html! {
        figure {
            (legend(Swatch::Bar, &names()))
            (plots::losses(e))
            figcaption { "A dot is a run. Bar: median; line: from the 10th to the 90th percentile (of 10 runs or more). Dashed: 0.5 dB, above which a run counts as failed. What is nearer than the left end is drawn there. " (NO_END) }
        }
    };
    Section { id: "losses", title: "Loss above the optimum", body }
}

fn gains(e: &Experiment) -> Section {
    let body = html! {
        figure {
            (legend(Swatch::Curve, &acting()))
            (plots::gains(e))
            figcaption { "By how much the worst channel is better than on the same bench without compensation. Dots: medians; thick lines: their 95 % intervals (of 6 benches or more); thin lines: from the 10th to the 90th percentile (of 10 or more). \
                The points of one step are drawn beside each other, to both sides of it. Coupling and rotation centre have nothing to correct in these climbs: their spread is what chance does." }
        }
    };
    Section { id: "gains", title: "Step of the climb against gain", body }
}

fn times(e: &Experiment) -> Section {
    let body = html! {
        figure {
            (legend(Swatch::Bar, &names()))
            (plots::times(e))
            figcaption { "Simulated time with the moves and messages as they are: stages of 2 mm/s, serial lines of 115 200 baud; on a logarithmic scale. " (NO_END) }
        }
    };
    Section { id: "times", title: "Time", body }
}

fn every(e: &Experiment) -> Section {
    let body = html! {
        (caption("table", "Medians and 90th percentiles over all benches. The mechanisms are told from the truth of the twin, run by run."))
        div.wide { table.dense {
            thead {
                tr { th rowspan="2" { "Search" } th.left rowspan="2" { "on" } th colspan="2" { "above optimum, dB" } th colspan="2" { "uniformity above optimum\u{2019}s, dB" }
                    th colspan="2" { "time, s" } th rowspan="2" { "trapped in play" } th rowspan="2" { "pivot con\u{ad}founding" }
                    th.left rowspan="2" { "failed" } }
                tr { @for _ in 0..3 { th { "median" } th { "90 %" } } }
            }
            tbody {
                @for group in &e.groups {
                    tr {
                        th { @if group.compensation == Mode::None { (group.of.words()) } }
                        td.left.words { (group.compensation.words()) }
                        @for q in [group.above_optimum_db, group.uniformity_above_optimum_db] { td { (number(q.median, 3)) } td { (number(q.p90, 3)) } }
                        td { (number(group.seconds.median, 1)) } td { (number(group.seconds.p90, 1)) }
                        @for told in mechanisms(group) { td { (told) } }
                        td.left.words { (failures(group)) }
                    }
                }
            }
        } }
    };
    let body = html! {
        (body)
        (caption("table", "What the worst channel gains against no compensation on the same bench, with the 95 % interval of the median; better / worse: benches on which it has less, more loss; \
            a gain or a loss is one whose interval lies beside 0. Where a compensation can not act, the difference is chance: messages of another length, and with them other noise of the meter."))
        div.wide { table.dense {
            thead { tr { th { "Search" } th.left { "on" } th { "gain, dB" } th { "95 % interval" } th { "better / worse" } th.left { "says" } } }
            tbody {
                @for group in e.groups.iter().filter(|group| group.compensation != Mode::None) {
                    @let [gain, interval, count, says] = gained(group);
                    tr {
                        th { @if group.compensation == Mode::ALL[1] { (group.of.words()) } }
                        td.left.words { (group.compensation.words()) }
                        td { (gain) } td.words { (interval) } td.words { (count) } td.left.words { (says) }
                    }
                }
            }
        } }
    };
    Section { id: "every", title: "Every search with every compensation", body }
}

fn why(e: &Experiment) -> Section {
    let body = html! {
        (caption("table", "Of an error or a collision: what the search said, and after or in which of its steps. Of a run that ended too far from the optimum: what has to be mended until it is within 0.5 dB, \
            told from where the stages truly stood, and the mechanism of a climb. The whole text of every run is in --json."))
        div.wide { table.dense {
            thead { tr { th { "Search" } th.left { "on" } th.left { "failed" } th { "runs" } th.left { "why" } th { "first seed" } } }
            tbody {
                @for group in e.groups.iter().filter(|group| !group.causes.is_empty()) {
                    @for cause in &group.causes {
                        tr {
                            th { (group.of.words()) } td.left.words { (group.compensation.words()) }
                            td.left.words { (cause.kind.words()) } td { (cause.runs) } td.left { (cause.cause) } td { (cause.seed) }
                        }
                    }
                }
            }
        } }
    };
    Section { id: "why", title: "Why runs failed", body }
}

fn limits(e: &Experiment) -> Section {
    let body = html! {
        p { "Nothing here is fitted to the figures of the paper, and one bench in a computer is not the one that it was written about." }
        (list(&e.findings, Topic::NotDerivable))
    };
    Section { id: "limits", title: "What cannot be derived", body }
}

fn scenario(_e: &Experiment) -> Section {
    let start = |search: Search| {
        let start = search.start();
        html! { "\u{b1}" (start.lateral_um) " um in x and y, \u{b1}" (start.angle_deg) "\u{b0} in pitch and yaw, \u{b1}" (start.roll_deg) "\u{b0} in roll, " (start.clearance_um[0])
        " to " (start.clearance_um[1]) " um between the nearest corner and the chip" }
    };
    let body = html! {
        ul {
            @for search in [Search::RobustNear, Search::AngleClimb, Search::Robust] {
                li { "Start of " @for (n, other) in Search::all().into_iter().filter(|other| other.start() == search.start()).enumerate() { @if n > 0 { "; " } (other.words()) } ": " (start(search)) "." }
            }
            li { "Climb: one coordinate after the other, up and then down, by moves of the host; the first reading that is not more ends a direction; passes until one gains less than 0.05 dB." }
            li { "Angle climb: climb of 0.5 um, then pitch and yaw by 0.1\u{b0} without going back to the peak, gap to 10 um, climb of 0.5 um. Re-peaked: back to the peak after every turn." }
            li { "Robust: the project\u{2019}s own alignment, by probes and parabolas." }
            li { "Time at 50/100 ms: 50 ms for each move and 100 ms for each reading of a climb and nothing else, in place of the simulated time. Both are assumptions on a slower bench." }
        }
        p.note { "The scenario of the climbs and of the angle climb was fixed before any figure was looked at; the re-peaked one was added afterwards, as its baseline. All of it: docs/EXPERIMENT.md; the bench: docs/BENCH.md; \
            the same figures and every run as one JSON object: host-sim experiment with --json. The paper: doi 10.1177/1687814015589503." }
    };
    Section { id: "scenario", title: "Under which assumptions", body }
}
