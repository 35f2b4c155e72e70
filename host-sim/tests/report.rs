//! The command `host-sim report` as a user meets it, and its figures against the virtual board.

use host_sim::board::{Board, Interleaving};
use host_sim::calibrate::calibrate;
use host_sim::machine::{Machine, StaticErrors};
use host_sim::report::{CompensatedStage, Mode, Report, render, short};
use host_sim::session::power_up;
use scraper::{ElementRef, Html, Selector};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

const SECTIONS: [&str; 7] = ["stage", "sensitivity", "field", "travel", "budget", "paper", "provenance"];
const SHIPPED: [&str; 3] = ["paper", "long-lever", "bench"];

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("machines").join(name).with_extension("toml")
}

fn machine(name: &str) -> Machine {
    Machine::load(&shipped(name)).unwrap()
}

/// The paper's machine with one change.
fn changed(from: &str, to: &str) -> String {
    let text = std::fs::read_to_string(shipped("paper")).unwrap();
    assert!(text.contains(from));
    text.replacen(from, to, 1)
}

/// The paper's machine with its Y stage carried by gamma.
fn carried() -> Machine {
    Machine::parse(&changed(r#""Y", "gamma""#, r#""gamma", "Y""#)).unwrap()
}

/// The paper's machine with two of the 36 errors of the stages.
fn with_kinematic_errors() -> Machine {
    let more =
        "[kinematic.X]\nEYX = { fourier = [[5000.0, 0.0, 0.25]] }\n[kinematic.gamma]\nEXC = { poly = [0.0, 0.1] }\n";
    Machine::parse(&(changed("name = \"paper\"", "name = \"wavy\"") + more)).unwrap()
}

/// The shipped machines with their reports.
fn reports() -> &'static [(Machine, Report)] {
    static REPORTS: LazyLock<Vec<(Machine, Report)>> =
        LazyLock::new(|| SHIPPED.map(machine).into_iter().map(|machine| (machine.clone(), report(&machine))).collect());
    &REPORTS
}

/// A machine without errors and backlash whose name has letters that HTML gives a meaning.
fn perfect() -> Machine {
    let text = changed("name = \"paper\"", "name = \"<p> & 'c'\"");
    let text: Vec<String> = text
        .lines()
        .map(|line| match line.split_once(" = ") {
            Some((key, _)) if StaticErrors::NAMES.contains(&key) || key.starts_with("backlash") => {
                format!("{key} = 0.0")
            }
            _ => line.into(),
        })
        .collect();
    Machine::parse(&text.join("\n")).unwrap()
}

/// A machine whose travel lies to one side, for X even beside home, and with F on all its axes.
fn lopsided() -> Machine {
    let text = changed("travel_um = [-5000.0, 5000.0]", "travel_um = [1000.0, 9000.0]");
    let text = text.replace("travel_deg = [-3.0, 3.0]", "travel_deg = [0.0, 0.3]");
    Machine::parse(&text.replace("[875.0, 100.0, 500.0]", "[0.0, 0.0, 0.0]")).unwrap()
}

/// Those of machines out of the ordinary: one that nothing can compensate, one with errors that the law does not know,
/// one without errors, one with its travel to one side.
fn odd_reports() -> &'static [Report; 4] {
    static REPORTS: LazyLock<[Report; 4]> =
        LazyLock::new(|| [carried(), with_kinematic_errors(), perfect(), lopsided()].map(|machine| report(&machine)));
    &REPORTS
}

fn all_reports() -> impl Iterator<Item = &'static Report> {
    reports().iter().map(|(_, report)| report).chain(odd_reports())
}

fn report(machine: &Machine) -> Report {
    Report::new(machine, "stage.toml", Some("2026-11-22"), &|| ())
}

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).arg("report").args(args).output().expect("host-sim runs")
}

fn select<'a>(page: &'a Html, selector: &str) -> Vec<ElementRef<'a>> {
    page.select(&Selector::parse(selector).unwrap()).collect()
}

fn words(element: ElementRef) -> String {
    element.text().collect()
}

#[test]
fn rounding_stays_within_its_bounds() {
    for (machine, report) in reports() {
        let budget = report.budget.as_ref().unwrap();
        let [second_order, coefficients, arithmetic, steps, all] =
            [0, 1, 2, 3, 4].map(|n| budget.stages[n].position_nm);
        // the pivot follows the angles that the motors really take: the position does not see the second-order term
        assert!(second_order.max < 1e-6, "{}", machine.name);
        // three linear motors of 0.32 nm each, and the points of the rotary axes in sixteenths of a nanometre
        assert!(coefficients.max > 0.0 && coefficients.max < 1.0, "{}: {coefficients:?}", machine.name);
        assert!(arithmetic.max < 1.0, "{}: {arithmetic:?}", machine.name);
        let half = |i: usize| budget.motors[i].half_step_at_fibre_nm;
        let linear = (0..3).map(|i| half(i).powi(2)).sum::<f64>().sqrt();
        let bound = 1.01 * (linear + (3..6).map(half).sum::<f64>());
        assert!(steps.max < bound && steps.max > 0.5 * linear, "{}: {steps:?} {bound}", machine.name);
        assert!((all.rms - steps.rms).abs() < 1.0, "{}", machine.name);
    }
}

#[test]
fn the_page_is_well_formed_and_holds_every_section() {
    assert!(!Html::parse_document("<!DOCTYPE html><p>left open</b>").errors.is_empty(), "the parser would tell");
    for report in all_reports() {
        let (text, name) = (render(report), &report.provenance.machine);
        let page = Html::parse_document(&text);
        assert!(page.errors.is_empty(), "{name}: {:?}", page.errors);
        let ids: Vec<_> = select(&page, "main > section").iter().map(|s| s.attr("id").unwrap()).collect();
        assert_eq!(ids, SECTIONS, "{name}");
        for id in SECTIONS {
            assert_eq!(select(&page, &format!("nav a[href='#{id}']")).len(), 1, "{id}");
        }
        let captions = select(&page, "figure > figcaption").len();
        assert!(captions >= 5 && captions == select(&page, "figure").len(), "every figure says what is seen");
        for caption in select(&page, "figcaption") {
            assert!(words(caption).len() > 60, "{}", words(caption));
        }
    }
}

#[test]
fn the_page_needs_nothing_from_elsewhere() {
    let text = render(&reports()[0].1);
    for foreign in ["<script", "http://", "https://", "url(", "@import", "<img", "<link", " src="] {
        assert!(!text.contains(foreign), "{foreign}");
    }
    assert!(text.contains("prefers-color-scheme: dark") && text.contains("@media print") && text.contains("size: A4"));
}

#[test]
fn no_figure_is_not_a_number() {
    for report in all_reports() {
        let (text, name) = (render(report), &report.provenance.machine);
        for bad in ["NaN", "inf ", "inf<", "null", "undefined"] {
            assert!(!text.contains(bad), "{name}: {bad}");
        }
        // serde writes NaN as null: only what may be absent is null
        let allowed: BTreeSet<&str> =
            ["block_crc", "refusal", "travel", "budget", "after", "after_exact", "lever_mm", "point_mm"]
                .into_iter()
                .chain(["coordinate", "printed", "ours"])
                .collect();
        nulls(&serde_json::to_value(report).unwrap(), "", &mut |key| {
            assert!(allowed.contains(key), "{name}: {key} is null");
        });
    }
}

fn nulls(value: &Value, key: &str, found: &mut impl FnMut(&str)) {
    match value {
        Value::Null => found(key),
        Value::Array(items) => items.iter().for_each(|item| nulls(item, key, found)),
        Value::Object(entries) => entries.iter().for_each(|(key, item)| nulls(item, key, found)),
        _ => {}
    }
}

#[test]
fn every_number_of_the_page_is_that_of_the_json() {
    for (_, report) in reports() {
        let json = serde_json::to_value(report).unwrap();
        let page = Html::parse_document(&render(report));
        let mut sections = BTreeSet::new();
        let figures = select(&page, "[data-figure]");
        for figure in &figures {
            let pointer = figure.attr("data-figure").unwrap();
            let value =
                json.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} is no figure"));
            let text = words(*figure).replace('\u{2212}', "-");
            let shown: f64 = text.parse().unwrap_or_else(|_| panic!("{pointer}: {text}"));
            let decimals = text.split_once('.').map_or(0, |(_, digits)| digits.len() as i32);
            let allowed = if text == "0" { 1e-6 } else { 0.5 * 10f64.powi(-decimals) };
            assert!((shown - value).abs() <= allowed * (1.0 + 1e-6), "{pointer}: {text} for {value}");
            sections.insert(pointer.split('/').nth(1).unwrap().to_string());
        }
        assert!(figures.len() > 700, "{}", figures.len());
        assert_eq!(Vec::from_iter(sections), ["budget", "field", "paper", "sensitivity", "stage", "travel"]);
    }
}

#[test]
fn the_same_input_gives_the_same_bytes_and_another_machine_another_page() {
    let pages: Vec<String> = reports().iter().map(|(_, report)| render(report)).collect();
    assert!(render(&report(&machine("paper"))) == pages[0]);
    assert_eq!(pages.iter().collect::<BTreeSet<_>>().len(), pages.len());
    // one static error more shows in the figures, not only in the tables of constants
    let other = Machine::parse(&changed("S_XY = 5.0e-05", "S_XY = 6.0e-05")).unwrap();
    let (a, b) = (&reports()[0].1, report(&other));
    assert_ne!(a.travel, b.travel);
    assert_ne!(a.field, b.field);
    assert_ne!(a.budget, b.budget);
}

#[test]
fn compensated_stops_are_those_of_the_board_and_its_twin() {
    // there and back with motors that turn on the way: linear, angular, together
    let poses: [[i64; 6]; 6] = [
        [400_000, -300_000, 200_000, 0, 0, 0],
        [100_000, 50_000, -20_000, 8_000_000, -5_000_000, 3_000_000],
        [100_000, 50_000, -20_000, -8_000_000, 5_000_000, -3_000_000],
        [-200_000, -100_000, 10_000, 0, 0, 9_000_000],
        [-198_000, -101_000, 12_000, 0, 0, 9_000_000],
        [-199_000, -100_500, 11_000, 1_000_000, 0, 9_000_000],
    ];
    for name in ["paper", "long-lever"] {
        let machine = machine(name);
        let (calibration, _) = calibrate(&machine).unwrap();
        for mode in Mode::ALL {
            let mut stage = CompensatedStage::new(&machine, &calibration, mode);
            let mut board = Board::new(&machine, power_up(&machine, false).unwrap(), Interleaving::Prompt, 0);
            assert!(board.settle());
            board.front.set_switches(mode.switches()).unwrap();
            assert!(board.settle());
            for pose in poses {
                board.front.pose_absolute(pose).unwrap();
                assert!(board.settle());
                let miss = stage.go(pose.map(|u| u as f64));
                assert_eq!(stage.motors(), board.twin().motors(), "{name} {mode:?} {pose:?}");
                let truth = board.twin().true_pose();
                for (a, b) in stage.true_pose().into_iter().zip(truth) {
                    assert!((a - b).abs() < 1e-4, "{name} {mode:?} {pose:?}: {a} {b}");
                }
                let off = (0..3).map(|i| (truth[i] - pose[i] as f64).powi(2)).sum::<f64>().sqrt();
                assert!((miss.position_nm - off).abs() < 1e-4, "{name} {mode:?} {pose:?}");
            }
        }
    }
}

#[test]
fn all_of_the_compensation_leaves_less_than_any_part_of_it() {
    for (machine, report) in reports() {
        let (travel, name) = (report.travel.as_ref().unwrap(), &machine.name);
        let whole = travel.tracks.last().unwrap();
        let [none, backlash, coupling, pivot, all] = [0, 1, 2, 3, 4].map(|k| whole.runs[k].position_um.rms);
        assert!(all < 0.1 * backlash.min(coupling).min(pivot).min(none), "{name}: {none} {all}");
        // on a small scan nothing but backlash counts: the width of the play of three motors
        let scan = travel.tracks.iter().find(|result| result.track.name.starts_with("small scan")).unwrap();
        let play = (0..3).map(|i| machine.drives[i].backlash.powi(2)).sum::<f64>().sqrt() * 1e-3;
        assert!((scan.runs[0].position_um.max - play).abs() < 0.1 * play, "{name}");
        assert!(scan.runs[1].position_um.max < 0.1 * play, "{name}");
    }
}

#[test]
fn a_machine_without_errors_needs_no_more_than_its_rotation_centre() {
    let travel = odd_reports()[2].travel.as_ref().unwrap();
    for result in &travel.tracks {
        let [none, backlash, coupling, pivot, all] = [0, 1, 2, 3, 4].map(|k| result.runs[k].position_um.max);
        assert_eq!(pivot, all, "{}", result.track.name);
        // no play: the overlay does nothing, and neither does a coupling of nothing but for whole steps
        assert_eq!(none, backlash, "{}", result.track.name);
        assert!((none - coupling).abs() < 0.05, "{}", result.track.name);
        assert!(all < 0.05, "{}", result.track.name);
    }
}

#[test]
fn every_stop_lies_within_the_travel() {
    for report in [&odd_reports()[3], &reports()[0].1] {
        for result in &report.travel.as_ref().unwrap().tracks[..6] {
            let axis = report.stage.axes.iter().find(|axis| axis.name == result.track.name).unwrap();
            let along = &result.track.along;
            let ends = [along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(f64::MIN, f64::max)];
            let [lower, upper] = axis.travel;
            assert!(ends[0] >= lower - 1e-9 && ends[1] <= upper + 1e-9, "{}: {ends:?}", axis.name);
            assert!(result.track.share_of_travel > 0.9 && ends[1] - ends[0] > 0.9 * (upper - lower), "{}", axis.name);
        }
    }
}

#[test]
fn the_page_says_over_what_share_of_the_travel_its_headline_is() {
    let mut shares = std::collections::BTreeSet::new();
    for report in all_reports() {
        let Some(travel) = &report.travel else { continue };
        let track = &travel.tracks.last().unwrap().track;
        let percent = (track.share_of_travel * 100.0).round();
        let page = Html::parse_document(&render(report));
        let lead = words(select(&page, "#travel p.lead")[0]);
        if percent < 100.0 {
            assert!(lead.starts_with(&format!("Over the middle {percent} % of the travel")), "{lead}");
            assert!(track.name.contains(&format!("{percent} % of the travel")), "{}", track.name);
        } else {
            assert!(lead.starts_with("Over the whole travel") && track.name.ends_with("over the travel"), "{lead}");
        }
        shares.insert(percent as u32);
    }
    assert!(shares.iter().any(|share| *share < 100), "{shares:?}");
}

#[test]
fn the_caption_of_a_map_says_where_its_third_axis_stands() {
    let captions = |report: &Report| -> Vec<String> {
        let page = Html::parse_document(&render(report));
        select(&page, "#field figcaption").into_iter().map(words).collect()
    };
    let (plain, aside) = (captions(&reports()[0].1), captions(&odd_reports()[3]));
    assert!(!plain.is_empty() && plain.iter().all(|caption| caption.contains("of each plane is at home")), "{plain:?}");
    // the travel of X begins at 1000 um
    assert!(
        aside[0].contains("as near to home as a computed pose: Z at ") && aside[0].contains("X at 1000 um"),
        "{aside:?}"
    );
}

#[test]
fn errors_that_the_law_does_not_know_stay() {
    let (plain, wavy) = (&reports()[0].1, &odd_reports()[1]);
    let along_x = |report: &Report| report.travel.as_ref().unwrap().tracks[0].runs[4].position_um;
    // a quarter of a micrometre of straightness over X
    assert!((along_x(wavy).max - 0.25).abs() < 0.1, "{:?}", along_x(wavy));
    assert!(along_x(plain).max < 0.1);
    assert_eq!(wavy.field.kinematic_errors_given, 2);
    let after = |report: &Report| report.field.accuracy.motions[0].after.unwrap().norm_um.max;
    assert!(after(wavy) > 0.2 && after(plain) < 0.1);
}

#[test]
fn a_linear_stage_behind_a_rotary_one_is_named_and_nothing_is_compensated() {
    let report = &odd_reports()[0];
    let text = render(report);
    assert!(report.travel.is_none() && report.budget.is_none() && report.provenance.block_crc.is_none());
    let page = Html::parse_document(&text);
    let warnings: Vec<String> = select(&page, ".warning").into_iter().map(words).collect();
    assert_eq!(warnings.len(), 4, "{warnings:?}");
    assert!(warnings.iter().all(|warning| warning.contains('Y') && warning.contains("gamma")), "{warnings:?}");
    assert!(text.contains("turned by a rotary stage"));
    assert!(!render(&reports()[0].1).contains("class=\"warning\""));
}

#[test]
fn the_command_writes_the_page_and_prints_one_json_object() {
    let page = file("report.html");
    let path = page.to_str().unwrap();
    let machine = shipped("paper");
    let done = run(&[machine.to_str().unwrap(), "-o", path, "--json", "--date", "a day"]);
    assert!(done.status.success(), "{done:?}");
    let json: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(json["provenance"]["file"], "paper.toml");
    assert_eq!(json["provenance"]["date"], "a day");
    let text = std::fs::read_to_string(&page).unwrap();
    let crc = json["provenance"]["block_crc"].as_u64().unwrap();
    assert!(text.contains(&format!("{crc} (0x{crc:08X})")) && text.contains("a day"));
    let rms = json.pointer("/travel/tracks/9/runs/4/position_um/rms").and_then(Value::as_f64).unwrap();
    assert!(text.contains(&format!(">{}</span>", short(rms))));
    // without a date the page bears none
    assert!(run(&["paper", "-o", path]).status.success());
    assert!(std::fs::read_to_string(&page).unwrap().contains("not given"));
}

#[test]
fn bad_input_is_refused_and_leaves_the_old_page() {
    let folder = file("report-refused");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let (broken, page) = (folder.join("broken.toml"), folder.join("page.html"));
    std::fs::write(&broken, changed("S_XY = 5.0e-05", "S_XY = nan")).unwrap();
    std::fs::write(&page, "the old page").unwrap();
    let (broken, path) = (broken.to_str().unwrap(), page.to_str().unwrap());
    let cases: [(&[&str], i32, &[&str]); 5] = [
        (&[broken, "-o", path], 2, &["broken.toml", "S_XY", "NaN"]),
        (&["no-such.toml", "-o", path], 1, &["no-such.toml"]),
        (&["paper", "-o", folder.to_str().unwrap()], 1, &["report-refused", "folder"]),
        (&["paper", "-o", "/no/such/folder/page.html"], 1, &["/no/such/folder/page.html", "folder does not exist"]),
        (&["paper"], 2, &["--output"]),
    ];
    for (args, status, told) in cases {
        let done = run(args);
        let message = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(status), "{args:?}: {message}");
        for part in told {
            assert!(message.contains(part), "{args:?}: {message}");
        }
        assert!(done.stdout.is_empty());
    }
    assert_eq!(std::fs::read_to_string(&page).unwrap(), "the old page");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2, "no part of a page is left behind");
}
