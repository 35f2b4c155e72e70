//! The tables as Markdown, in the form of Tables 7 and 8 of the paper, and what stands behind them.

use super::findings::{ends, seen};
use super::statistics::{Group, Quantiles};
use super::{Experiment, Search};
use crate::report::Mode;
use std::fmt::Write;

/// A figure with so many decimals, or a dash where the percentile lies among runs without an end.
pub(super) fn number(value: Option<f64>, decimals: usize) -> String {
    match value {
        Some(value) => {
            let text = format!("{value:.decimals$}");
            // no minus before nothing
            let text = if text.trim_matches(['-', '0', '.']).is_empty() { text.replace('-', "") } else { text };
            text.replace('-', "\u{2212}")
        }
        None => "\u{2013}".into(),
    }
}

/// One of the percentiles.
type Part = fn(&Quantiles) -> Option<f64>;

/// Both percentiles of a row: median and 90th.
pub(super) const ROWS: [(&str, Part); 2] = [("median", |q| q.median), ("90 %", |q| q.p90)];

/// How many runs failed, and how, in a few words.
pub(super) fn failures(group: &Group) -> String {
    let parts: Vec<_> = group
        .failures
        .each()
        .into_iter()
        .filter(|(_, runs)| *runs > 0)
        .map(|(kind, runs)| format!("{runs} {}", kind.words()))
        .collect();
    if parts.is_empty() { "0".into() } else { parts.join(", ") }
}

/// How many runs were trapped in play and confounded by the pivot; empty where that is not told.
pub(super) fn mechanisms(group: &Group) -> [String; 2] {
    let told = |n: usize, is: bool| if is { n.to_string() } else { String::new() };
    let climb = !group.of.is_robust();
    [told(group.trapped, climb), told(group.confounded, climb && group.of != Search::AngleClimbRepeaked)]
}

/// Gain with its interval, benches that are better and worse, and what that says; empty of `none`, which is compared with.
pub(super) fn gained(group: &Group) -> [String; 4] {
    let Some(verdict) = group.gain_verdict else { return Default::default() };
    let [better, worse] = group.better_worse;
    [
        number(group.gain_db.median, 3),
        ends(&group.gain_interval_db, 2).unwrap_or_else(|| number(None, 2)),
        format!("{better} / {worse}"),
        if group.can_act { seen(verdict).into() } else { "can not act: chance".into() },
    ]
}

/// All tables.
pub fn tables(experiment: &Experiment) -> String {
    let mut text = String::new();
    let best = experiment.optimum;
    let _ = writeln!(
        text,
        "{} benches. The best that they allow: worst channel {} dB (median; 90 %: {}), uniformity {} dB ({}).\n",
        experiment.seeds,
        number(best.worst_db.median, 2),
        number(best.worst_db.p90, 2),
        number(best.uniformity_db.median, 2),
        number(best.uniformity_db.p90, 2)
    );
    for (title, mode, printed) in [
        ("Table 7: without compensation", Mode::None, experiment.paper[0]),
        ("Table 8: with compensation (all)", Mode::All, experiment.paper[1]),
    ] {
        let _ = writeln!(
            text,
            "## {title}\n\nInsertion losses in dB. Paper: max {:.2} dB, uniformity {:.2} dB, {:.0} min.\n",
            printed.worst_db,
            printed.uniformity_db,
            printed.seconds / 60.0
        );
        paper_table(&mut text, experiment, mode);
    }
    let _ = writeln!(text, "## Every compensation\n");
    by_mode(&mut text, experiment);
    let _ = writeln!(text, "## Why runs failed\n");
    why(&mut text, experiment);
    let _ = writeln!(text, "## What follows\n");
    for finding in &experiment.findings {
        let _ = writeln!(text, "- {}", finding.text);
    }
    text
}

fn paper_table(text: &mut String, experiment: &Experiment, mode: Mode) {
    let groups: Vec<_> = Search::all().into_iter().filter_map(|search| experiment.group(search, mode)).collect();
    let channels = groups.first().map_or(0, |group| group.channels_db.len());
    let names: String = (1..=channels).map(|n| format!(" CH{n} |")).collect();
    let _ = writeln!(
        text,
        "| Search | |{names} max | uniformity | time, s | at 50/100 ms, s | failed of {} |",
        experiment.seeds
    );
    let _ = writeln!(text, "|---|---|{}---:|---:|---:|---:|---|", "---:|".repeat(channels));
    for group in groups {
        for (k, (name, of)) in ROWS.into_iter().enumerate() {
            let cells: String = group.channels_db.iter().map(|q| format!(" {} |", number(of(q), 2))).collect();
            let _ = writeln!(
                text,
                "| {} | {name} |{cells} {} | {} | {} | {} | {} |",
                if k == 0 { group.of.words() } else { String::new() },
                number(of(&group.worst_db), 2),
                number(of(&group.uniformity_db), 2),
                number(of(&group.seconds), 1),
                group.slow_seconds.map_or(String::new(), |q| number(of(&q), 0)),
                if k == 0 { failures(group) } else { String::new() }
            );
        }
    }
    let _ = writeln!(text);
}

fn by_mode(text: &mut String, experiment: &Experiment) {
    let _ = writeln!(
        text,
        "| Search | on | above optimum, dB | 90 % | uniformity above optimum's, dB | 90 % | gain, dB | 95 % interval | better / worse | says | time, s | 90 % | trapped in play | pivot confounding | failed |"
    );
    let _ = writeln!(text, "|---|---|---:|---:|---:|---:|---:|---:|---:|---|---:|---:|---:|---:|---|");
    for group in &experiment.groups {
        let [trapped, confounded] = mechanisms(group);
        let [gain, interval, count, says] = gained(group);
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {gain} | {interval} | {count} | {says} | {} | {} | {trapped} | {confounded} | {} |",
            group.of.words(),
            group.compensation.name(),
            number(group.above_optimum_db.median, 3),
            number(group.above_optimum_db.p90, 3),
            number(group.uniformity_above_optimum_db.median, 3),
            number(group.uniformity_above_optimum_db.p90, 3),
            number(group.seconds.median, 1),
            number(group.seconds.p90, 1),
            failures(group)
        );
    }
    let _ = writeln!(text);
}

fn why(text: &mut String, experiment: &Experiment) {
    let _ = writeln!(text, "| Search | on | failed | runs | why | first seed |\n|---|---|---|---:|---|---:|");
    for group in &experiment.groups {
        for cause in &group.causes {
            let (search, on) = (group.of.words(), group.compensation.name());
            let _ = writeln!(
                text,
                "| {search} | {on} | {} | {} | {} | {} |",
                cause.kind.words(),
                cause.runs,
                cause.cause,
                cause.seed
            );
        }
    }
    let _ = writeln!(text);
}
