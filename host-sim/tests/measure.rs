//! The commands `measure` and `identify` as a user meets them, and what they say about bad files.

use host_sim::identify::{Options, decode, identify, parse};
use host_sim::machine::{ErrorName, Function, Machine};
use host_sim::measure::{Settings, measure, nominal};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn tool(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).args(arguments).output().expect("host-sim runs")
}

/// A directory of its own for each test, empty.
fn place(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}

fn shipped(name: &str) -> String {
    format!("{}/machines/{name}", env!("CARGO_MANIFEST_DIR"))
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a plain name")
}

#[test]
fn kinematic_errors_of_the_stage_are_in_what_is_measured() {
    let mut machine = Machine::paper();
    let quiet = Settings { noise_nm: 0.0, drift_nm_per_hour: 0.0, ..Settings::default() };
    let straightness = |machine: &Machine| -> Vec<f64> {
        let files = measure(machine, &quiet);
        let file = files.iter().find(|file| file.file == "straightness-X-y.csv").expect("it is measured");
        let rows = file.text.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit() || c == '-'));
        rows.map(|row| row.split(',').nth(3).unwrap().parse().unwrap()).collect()
    };
    let straight = straightness(&machine);
    let error = ErrorName::all().find(|name| name.iso() == "EYX").unwrap();
    let bow = 0.8e-7;
    machine.kinematic.set(error, Function::new(vec![0.0, 0.0, bow], vec![], vec![]).unwrap());
    let bent = straightness(&machine);
    let ends = [0, straight.len() / 4, straight.len() / 2 - 1].map(|k| bent[k] - straight[k]);
    let reach = 5000.0 * (1.0 - 1.0 / 11.0);
    assert!(
        (ends[0] - bow * reach * reach).abs() < 0.02 && (ends[2] - ends[0]).abs() < 0.02 && ends[1].abs() < 0.1,
        "{ends:?}"
    );
}

#[test]
fn a_stage_is_measured_identified_and_calibrated() {
    let place = place("whole-way");
    let (data, found, block) = (place.join("data"), place.join("found.toml"), place.join("found.cal"));
    let measured = tool(&["measure", "--machine", &shipped("long-lever.toml"), "-o", text(&data), "--json"]);
    assert!(measured.status.success(), "{measured:?}");
    let report: serde_json::Value = serde_json::from_slice(&measured.stdout).unwrap();
    assert_eq!(report["files"].as_array().unwrap().len(), 17);
    let pictures = place.join("pictures");
    let identified =
        tool(&["identify", "--measurements", text(&data), "-o", text(&found), "--plots", text(&pictures), "--json"]);
    assert!(identified.status.success(), "{identified:?}");
    assert!(identified.stderr.is_empty(), "no progress line where there is no terminal: {identified:?}");
    let result: serde_json::Value = serde_json::from_slice(&identified.stdout).unwrap();
    assert_eq!(result["rank"], result["unknowns"]);
    assert_eq!(result["estimates"].as_array().unwrap().len(), 30);
    assert!(result["probability"].as_f64().unwrap() > 1e-3);
    assert!(result["gauge"].as_array().unwrap().len() >= 5);

    let (machine, truth) =
        (Machine::load(&found).unwrap(), Machine::load(shipped("long-lever.toml").as_ref()).unwrap());
    for (found, truth) in machine.statics.values().into_iter().zip(truth.statics.values()) {
        assert!((found - truth).abs() < 1.5e-5, "{found} {truth}");
    }
    for (found, truth) in machine.drives.iter().zip(&truth.drives) {
        assert!((found.backlash - truth.backlash).abs() < 0.002 * truth.backlash + 20.0);
        assert_eq!((found.step, found.travel, found.jerk), (truth.step, truth.travel, truth.jerk));
    }
    assert!(tool(&["calibrate", text(&found), "-o", text(&block)]).status.success());
    let written = std::fs::read_to_string(&found).unwrap();
    assert!(written.contains("+- ") && written.contains("# Gauge: "), "{written}");

    let svg = std::fs::read_to_string(pictures.join("residuals-fibre.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    assert!(svg.matches("<circle").count() >= 900, "one for each value");
    assert_eq!(std::fs::read_dir(&pictures).unwrap().count(), 17);
}

#[test]
fn the_report_for_people_says_rank_reversal_and_gauge() {
    let place = place("report");
    let (data, found) = (place.join("data"), place.join("found.toml"));
    assert!(tool(&["measure", "--machine", "paper", "-o", text(&data), "--outliers", "2"]).status.success());
    let done = tool(&["identify", "--measurements", text(&data), "-o", text(&found)]);
    let report = String::from_utf8(done.stdout).unwrap();
    for part in
        ["rank 65 of 65", "reversal value B", "ISO 230-2", "gauge: ", "left out: fibre.csv:", " nm off, ", "chi-square"]
    {
        assert!(report.contains(part), "{part} in {report}");
    }
}

#[test]
fn the_same_seed_gives_the_same_files_and_another_one_others() {
    let machine = Machine::paper();
    let files = |seed| measure(&machine, &Settings { seed, ..Settings::default() });
    assert_eq!(files(7), files(7));
    assert_ne!(files(7)[0].text, files(8)[0].text);
}

#[test]
fn measurements_do_not_mix_with_those_that_lie_there_already() {
    let place = place("strangers");
    std::fs::write(place.join("mine.csv"), "precious").unwrap();
    let done = tool(&["measure", "--machine", "paper", "-o", text(&place)]);
    assert_eq!(done.status.code(), Some(2));
    assert!(String::from_utf8(done.stderr).unwrap().contains("mine.csv"));
    assert_eq!(std::fs::read_dir(&place).unwrap().count(), 1);
}

/// Names of what lies in a directory, sorted.
fn names(place: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(place).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = entries.collect();
    names.sort();
    names
}

fn complaint_of(arguments: &[&str], status: i32) -> String {
    let output = tool(arguments);
    assert!(output.status.code() == Some(status) && output.stdout.is_empty(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn what_cannot_be_written_leaves_nothing_half_done() {
    let place = place("half-done");
    let (data, pictures, far) = (place.join("data"), place.join("pictures"), place.join("nowhere/found.toml"));
    assert!(tool(&["measure", "--machine", "paper", "-o", text(&data)]).status.success());
    let before = names(&data);
    let fit = |output: &Path, pictures: &Path| {
        let (data, output, pictures) = (text(&data), text(output), text(pictures));
        complaint_of(&["identify", "--measurements", data, "--plots", pictures, "-o", output], 1)
    };
    says(&fit(&far, &pictures), &["nowhere/found.toml", "folder does not exist"]);
    assert_eq!(names(&place), ["data"]);
    says(&fit(&place.join("found.toml"), &data.join("fibre.csv")), &["fibre.csv", "not a folder"]);
    says(&fit(&place.join("found.toml"), &data.join("fibre.csv/deeper")), &["fibre.csv", "not a folder"]);
    assert_eq!((names(&place), names(&data)), (vec!["data".to_string()], before));
    let blocked = place.join("blocked");
    std::fs::create_dir_all(blocked.join("nominal.toml")).unwrap();
    says(&complaint_of(&["measure", "--machine", "paper", "-o", text(&blocked)], 1), &["nominal.toml", "is a folder"]);
    assert_eq!(names(&blocked), ["nominal.toml"]);
    let figure = text(&far);
    says(
        &complaint_of(&["field", "paper", "--points", "3", "--stages", "1", "-o", figure], 1),
        &["nowhere/found.toml"],
    );
}

#[test]
fn no_file_that_is_read_is_overwritten() {
    let place = place("spared");
    let data = place.join("data");
    assert!(tool(&["measure", "--machine", "paper", "-o", text(&data)]).status.success());
    let read = |name: &str| std::fs::read(data.join(name)).unwrap();
    let before = ["fibre.csv", "nominal.toml"].map(read);
    let (cases, nominal) = (["fibre.csv", "nominal.toml", "../data/fibre.csv"], data.join("nominal.toml"));
    for name in cases {
        let output = data.join(name);
        let message = complaint_of(&["identify", "--measurements", text(&data), "-o", text(&output)], 2);
        says(&message, &["would overwrite", "which is read"]);
    }
    let nominal = text(&nominal);
    for arguments in [
        ["measure", "--machine", nominal, "-o", text(&data)].as_slice(),
        &["report", nominal, "-o", nominal],
        &["field", nominal, "-o", nominal],
        &["calibrate", nominal, "-o", nominal],
    ] {
        says(&complaint_of(arguments, 2), &["would overwrite", "nominal.toml"]);
    }
    assert_eq!(["fibre.csv", "nominal.toml"].map(read), before);
}

#[test]
fn a_result_that_would_be_read_as_a_measurement_is_refused() {
    let place = place("next-run");
    let data = place.join("data");
    assert!(tool(&["measure", "--machine", "paper", "-o", text(&data)]).status.success());
    let before = names(&data);
    for name in ["new.csv", "new.CSV", "../data/new.csv"] {
        let result = data.join(name);
        let said = complaint_of(&["identify", "--measurements", text(&data), "-o", text(&result)], 2);
        says(&said, &["new.", "the next run would read it as a measurement", "name a .toml file"]);
    }
    assert_eq!(names(&data), before);
    // elsewhere a name is a name, and pictures are no measurements
    let result = place.join("new.csv");
    let beside = ["identify", "--measurements", text(&data), "-o", text(&result), "--plots", text(&data)];
    assert!(tool(&beside).status.success() && tool(&beside).status.success());
}

#[test]
fn files_that_measure_has_not_made_are_left_alone() {
    for name in ["nominal.toml", "fibre.csv"] {
        let place = place("not-made-here");
        std::fs::write(place.join(name), "# mine\n").unwrap();
        let measure = ["measure", "--machine", "paper", "-o", text(&place)];
        says(&complaint_of(&measure, 2), &[name, "was not made by"]);
        assert_eq!(names(&place), [name]);
        std::fs::remove_file(place.join(name)).unwrap();
        assert!(tool(&measure).status.success());
        let first = names(&place);
        assert!(tool(&measure).status.success(), "its own files are renewed");
        assert_eq!(names(&place), first);
    }
}

#[test]
fn a_refusal_names_file_and_line_ends_with_status_2_and_writes_nothing() {
    let place = place("refused");
    let (data, found, pictures) = (place.join("data"), place.join("found.toml"), place.join("pictures"));
    assert!(tool(&["measure", "--machine", "paper", "-o", text(&data)]).status.success());
    let fibre = data.join("fibre.csv");
    let good = std::fs::read_to_string(&fibre).unwrap();
    std::fs::write(&fibre, good.replace("approach: sequence", "approach: sideways")).unwrap();
    let arguments = ["identify", "--measurements", text(&data), "-o", text(&found), "--plots", text(&pictures)];
    let done = tool(&arguments);
    assert_eq!(done.status.code(), Some(2), "{done:?}");
    let message = String::from_utf8(done.stderr).unwrap();
    assert!(message.contains("fibre.csv:4: approach = \"sideways\": must be one of up, down, sequence"), "{message}");
    std::fs::write(&fibre, good).unwrap();
    let hold = |what: &str| tool(&[&arguments[..], &["--hold", what]].concat());
    for (what, reason) in [
        ("static_rad.S_XX", "is none of what is fitted: static_rad.S_ZX"),
        ("static_rad.S_XY=1e-4,static_rad.S_XY=2e-4", "contradictory: static_rad.S_XY is held at 0.0001 and at 0.0002"),
        ("static_rad.S_XY=0.5", "at most 0.02 rad"),
        ("static_rad.S_XY=much", "is no number"),
    ] {
        let done = hold(what);
        assert_eq!(done.status.code(), Some(2), "{done:?}");
        let message = String::from_utf8(done.stderr).unwrap();
        assert!(message.contains(reason), "{message}");
    }
    assert!(!found.exists() && !pictures.exists());
    assert!(hold("static_rad.S_XY=0.00005").status.success());
    let lost = tool(&["identify", "--measurements", "no-such-directory", "-o", text(&found), "--nominal", "paper"]);
    assert_eq!(lost.status.code(), Some(1));
}

/// What is said about the measurements of the paper's stage with one file changed.
fn complaint(file: &str, edit: impl Fn(&str) -> String) -> String {
    let truth = Machine::paper();
    let known = nominal(&truth);
    let mut series = Vec::new();
    let mut changed = false;
    for measured in measure(&truth, &Settings::default()) {
        let text = if measured.file == file { edit(&measured.text) } else { measured.text.clone() };
        changed |= text != measured.text;
        match parse(&measured.file, &text, &known.order) {
            Ok(read) => series.push(read),
            Err(error) => return error.to_string(),
        }
    }
    assert!(changed, "{file} is as before");
    match identify(&series, &known, &Options::default(), &mut |_| {}) {
        Ok(result) => format!("accepted: {:?}", result.warnings),
        Err(refusal) => refusal.to_string(),
    }
}

#[track_caller]
fn says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} in {message}");
    }
    println!("{message}");
}

/// Multiplies a column of every row.
fn scaled(text: &str, column: usize, factor: f64) -> String {
    let mut header = false;
    let row = |line: &str| {
        if line.starts_with('#') || !std::mem::replace(&mut header, true) {
            return line.to_string();
        }
        let mut fields: Vec<String> = line.split(',').map(str::to_string).collect();
        fields[column] = format!("{}", fields[column].parse::<f64>().unwrap() * factor);
        fields.join(",")
    };
    text.lines().map(row).collect::<Vec<_>>().join("\n")
}

/// Exchanges the text of one line (from 1).
fn line(text: &str, number: usize, edit: impl Fn(&str) -> String) -> String {
    let lines = text.lines().enumerate();
    lines.map(|(i, l)| if i + 1 == number { edit(l) } else { l.into() }).collect::<Vec<String>>().join("\n")
}

#[test]
fn wrong_names_and_columns_are_refused_by_file_and_line() {
    let said = complaint("positioning-X.csv", |t| t.replace("axis: X", "axis: W"));
    says(&said, &["positioning-X.csv:4:", "\"W\" is no axis", "alpha"]);
    let said = complaint("positioning-X.csv", |t| t.replace(",direction,", ",way,"));
    says(&said, &["positioning-X.csv:7:", "unknown column \"way\"", "direction"]);
    let said = complaint("fibre.csv", |t| t.replace("x_um,y_um,z_um", "x_um,note,z_um"));
    says(&said, &["fibre.csv:7:", "\"note\"", "y_um"]);
    let said = complaint("squareness.csv", |t| t.replace("XY,", "XW,"));
    says(&said, &["squareness.csv:7:", "\"W\" is no axis"]);
    let said = complaint("squareness.csv", |t| t.replace("pair,measured_urad", "pair"));
    says(&said, &["squareness.csv:6:", "missing column measured_urad"]);
    let said = complaint("positioning-alpha.csv", |t| t.replace("target_deg,", ""));
    says(&said, &["positioning-alpha.csv:7:", "missing column target_deg"]);
    let said = complaint("orientation.csv", |t| t.replace("at_alpha_deg", "alpha_deg"));
    says(&said, &["unknown column \"alpha_deg\"", "at_alpha_deg", "rx_urad"]);
    let said = complaint("fibre.csv", |t| t.replace("x_um,y_um", "x_urad,y_um"));
    says(&said, &["column x_urad: must end in one of _nm, _um, _mm"]);
    let said = complaint("fibre.csv", |t| t.replace("x_um,y_um", "x,y_um"));
    says(&said, &["column x: has no unit"]);
    let said = complaint("fibre.csv", |t| t.replace("kind: fibre", "kind: laser"));
    says(&said, &["fibre.csv:1:", "\"laser\"", "positioning"]);
    let said = complaint("fibre.csv", |t| t.replace("# noise_um", "# nose_um"));
    says(&said, &["fibre.csv:6:", "unknown key \"nose_um\""]);
    let said = complaint("fibre.csv", |t| t.replace("# noise_um: 0.05", "# noise_um: 0.05\n# noise_nm: 70"));
    says(&said, &["fibre.csv:6: noise_um: the noise is already stated in line 7"]);
    let said = complaint("fibre.csv", |t| t.replace("# kind: fibre", "# kind: fibre\n# kind: orientation"));
    says(&said, &["fibre.csv:2:", "contradicts \"fibre\" in line 1"]);
}

#[test]
fn comments_may_be_in_any_encoding_and_nothing_else() {
    let with = |bytes: &[u8]| [b"# kind: squareness\n", bytes].concat();
    let read = |bytes: &[u8]| {
        let bytes = with(bytes);
        decode("square.csv", &bytes).and_then(|text| parse("square.csv", &text, &Machine::paper().order))
    };
    let column = Machine::paper();
    let good = measure(&column, &Settings::default()).into_iter().find(|file| file.kind == "squareness").unwrap();
    let rows = good.text.lines().filter(|line| !line.starts_with('#')).collect::<Vec<_>>().join("\n");
    let latin = read(&[b"# operator: M\xfcller\n", rows.as_bytes()].concat()).unwrap();
    let plain = read(rows.as_bytes()).unwrap();
    assert_eq!(latin.readings.len(), plain.readings.len());
    let error = read(&[rows.as_bytes(), b"\nX\xfc,1\n"].concat()).unwrap_err().to_string();
    says(&error, &[&format!("square.csv:{}:", rows.lines().count() + 2), "not UTF-8"]);
    // indented comments and blank lines are none of the rows
    let indented = read(format!("  # note: shaken\n   \n{rows}\n \t# the end\n").as_bytes()).unwrap();
    assert_eq!(indented.readings.len(), plain.readings.len());
    assert_eq!(indented.readings[0].line, plain.readings[0].line + 2);
}

#[test]
fn other_separators_than_commas_get_a_hint() {
    for separator in [";", "\t"] {
        let message = complaint("fibre.csv", |text| {
            let row = |line: &str| if line.starts_with('#') { line.into() } else { line.replace(',', separator) };
            text.lines().map(row).collect::<Vec<String>>().join("\n")
        });
        says(&message, &["fibre.csv:", "separate columns by commas, with a decimal point"]);
    }
}

#[test]
fn numbers_that_are_none_are_refused_by_file_line_and_column() {
    let last =
        |value: &'static str| move |l: &str| l.rsplit_once(',').map(|(head, _)| format!("{head},{value}")).unwrap();
    let said = complaint("squareness.csv", |t| line(t, 9, last("NaN")));
    says(&said, &["squareness.csv:9: measured_urad = NaN"]);
    let said = complaint("fibre.csv", |t| line(t, 100, last("inf")));
    says(&said, &["fibre.csv:100: time_s = inf"]);
    let said = complaint("fibre.csv", |t| line(t, 100, last("ten")));
    says(&said, &["fibre.csv:100: time_s = \"ten\""]);
    let said = complaint("fibre.csv", |t| line(t, 100, last("-5")));
    says(&said, &["fibre.csv:100: time_s goes back"]);
    let said = complaint("fibre.csv", |t| line(t, 100, |l| format!("{l},7")));
    says(&said, &["fibre.csv:100: 11 fields, the header in line 7 has 10"]);
}

#[test]
fn numbers_that_no_instrument_shows_are_refused() {
    let said = complaint("fibre.csv", |t| scaled(t, 7, 1e200));
    says(&said, &["fibre.csv:8: y_um = ", "beyond 1000 km"]);
    let said = complaint("fibre.csv", |t| line(t, 8, |l| format!("{}1e30", l.strip_suffix('0').unwrap())));
    says(&said, &["fibre.csv:8: time_s = 1e30: is beyond 30 million years"]);
    let said = complaint("fibre.csv", |t| t.replace("noise_um: 0.05", "noise_um: 1e-300"));
    says(&said, &["fibre.csv:6: noise_um = 1e-300: must be positive"]);
    let said = complaint("fibre.csv", |t| t.replace("noise_um: 0.05", "noise_um: -1"));
    says(&said, &["fibre.csv:6: noise_um = -1: must be positive"]);
}

/// Whatever byte of whatever file is wrong: there is a result or a message, and never a panic.
#[test]
fn any_wrong_byte_is_borne() {
    let truth = Machine::paper();
    let known = nominal(&truth);
    let settings = Settings { fibre_poses: 40, orientation_poses: 20, ..Settings::default() };
    let good = measure(&truth, &settings);
    let mut seeded = host_sim::board::Seeded::new(5);
    let (mut unread, mut refused, mut accepted) = (0, 0, 0);
    for _ in 0..300 {
        let which = seeded.below(good.len() as u64) as usize;
        let mut text = good[which].text.clone().into_bytes();
        for _ in 0..1 + seeded.below(3) {
            let at = seeded.below(text.len() as u64) as usize;
            // digits become other digits mostly, so that many files stay readable
            let digit = text[at].is_ascii_digit() && seeded.below(10) > 0;
            text[at] = b"0123456789.,-#:\neE+x "[seeded.below(if digit { 10 } else { 21 }) as usize];
        }
        let text = String::from_utf8(text).unwrap();
        let mut series: Vec<_> = good.iter().map(|f| parse(&f.file, &f.text, &known.order).unwrap()).collect();
        match parse(&good[which].file, &text, &known.order) {
            Err(error) => {
                assert!(error.to_string().starts_with(&good[which].file), "{error}");
                unread += 1;
            }
            Ok(read) => {
                series[which] = read;
                match identify(&series, &known, &Options::default(), &mut |_| {}) {
                    Ok(result) => {
                        assert!(result.estimates.iter().all(|e| e.value.is_finite() && e.sigma.is_finite()));
                        accepted += 1;
                    }
                    Err(_) => refused += 1,
                }
            }
        }
    }
    println!("figure: of 300 damaged files {unread} could not be read, {refused} were refused, {accepted} accepted");
    assert!(unread > 50 && refused > 5 && accepted > 50);
}

#[test]
fn units_mixed_up_are_told_by_their_scale() {
    let said = complaint("positioning-X.csv", |t| t.replace("measured_um", "measured_nm"));
    says(&said, &["positioning-X.csv:8: unit:", "measured_nm", "1000", "look like um written as nm"]);
    let said = complaint("positioning-X.csv", |t| scaled(t, 3, 1e-3));
    says(&said, &["positioning-X.csv:8: unit:", "look like mm written as um"]);
    let said = complaint("positioning-alpha.csv", |t| t.replace("measured_urad", "measured_arcsec"));
    says(&said, &["positioning-alpha.csv:8: unit:", "look like urad written as arcsec"]);
    let said = complaint("positioning-X.csv", |t| t.replace("target_um", "target_mm"));
    says(
        &said,
        &["positioning-X.csv:8: unit: X at -4545450 um is beyond its travel of -5000 to 5000 um, 909.1 times as"],
    );
    let said = complaint("positioning-X.csv", |t| scaled(&scaled(t, 3, 1e-3), 0, 1e-3));
    says(&said, &["positioning-X.csv:8: unit: X covers", "of its travel"]);
    let said = complaint("fibre.csv", |t| scaled(t, 7, 1e-3));
    says(&said, &["fibre.csv:8: unit: the values of y_um", "look like mm written as um"]);
    let said = complaint("fibre.csv", |t| scaled(t, 3, 1e6));
    says(&said, &["fibre.csv:8: unit: alpha at", "beyond its travel"]);
    let said = complaint("fibre.csv", |t| scaled(t, 8, -1.0));
    says(&said, &["fibre.csv:8: z_um goes against the machine's motion"]);
    let said = complaint("orientation.csv", |t| scaled(t, 8, 1e-3));
    says(&said, &["orientation.csv:8: unit: the values of rz_urad", "look like mrad written as urad"]);
    let said = complaint("diagonal.csv", |t| scaled(t, 4, 1e-3));
    says(&said, &["diagonal.csv:8: unit: the values of distance_um", "look like mm written as um"]);
    let said = complaint("squareness.csv", |t| t.replace("measured_urad", "measured_mrad"));
    says(&said, &["squareness.csv:7:", "from square", "unit of measured_mrad"]);
    let said = complaint("fibre.csv", |t| t.replace("noise_um: 0.05", "noise_um: 50"));
    says(&said, &["accepted", "fibre.csv: the residuals are", "times smaller than the noise stated"]);
    let said = complaint("fibre.csv", |t| t.replace("noise_um: 0.05", "noise_nm: 0.05"));
    says(
        &said,
        &["accepted", "fibre.csv: the residuals are", "times the noise stated", "it looks like um written as nm"],
    );
    // a lead that is not quite right is no unit
    let said = complaint("positioning-X.csv", |t| scaled(t, 3, 1.003));
    says(&said, &["accepted", "X moves 30", "ppm more than commanded"]);
    let said = complaint("positioning-X.csv", |t| scaled(t, 3, 0.997));
    says(&said, &["accepted", "X moves 2998 ppm less than commanded"]);
}

#[test]
fn runs_that_turn_back_and_too_few_points_are_refused() {
    let said = complaint("positioning-X.csv", |t| {
        let lines: Vec<&str> = t.lines().collect();
        let (a, b) = (lines[9], lines[10]);
        t.replace(a, "swapped").replace(b, a).replace("swapped", b)
    });
    says(&said, &["positioning-X.csv:11: time_s goes back"]);
    let untimed = |t: &str| {
        t.lines()
            .map(|l| if l.starts_with('#') { l } else { l.rsplit_once(',').unwrap().0 })
            .collect::<Vec<_>>()
            .join("\n")
    };
    let said = complaint("positioning-X.csv", |t| {
        let text = untimed(t);
        let lines: Vec<&str> = text.lines().collect();
        text.replace(lines[9], "swapped").replace(lines[10], lines[9]).replace("swapped", lines[10])
    });
    says(&said, &["positioning-X.csv:11: run 1 goes up but the target goes from", "monotonic"]);
    let said = complaint("positioning-X.csv", |t| t.lines().take(12).collect::<Vec<_>>().join("\n"));
    says(&said, &["positioning-X.csv:8: unit: X covers"].map(|_| "positioning-X.csv:8:"));
    let up = |t: &str| t.lines().filter(|l| !l.contains(",down,")).collect::<Vec<_>>().join("\n");
    let said = complaint("positioning-X.csv", up);
    says(&said, &["positioning-X.csv:8: too few points: 0 targets are reached both upwards and downwards"]);
    let said = complaint("fibre.csv", |t| t.lines().take(7).collect::<Vec<_>>().join("\n"));
    says(&said, &["fibre.csv:7: too few points: no row"]);
    let said = complaint("fibre.csv", |t| t.lines().take(3).collect::<Vec<_>>().join("\n"));
    says(&said, &["fibre.csv:1: no header"]);
    let said = complaint("diagonal.csv", |t| t.replace("\n1,", "\n7,").replacen("\n7,", "\n1,", 1));
    says(&said, &["diagonal.csv:8: too few points: line 1 has 1"]);
}

#[test]
fn runs_that_go_one_way_need_the_play_held_and_tell_the_scale() {
    let truth = Machine::paper();
    let known = nominal(&truth);
    let settings = Settings { drift_nm_per_hour: 500.0, ..Settings::default() };
    let fit = |way: &str, hold: &[(&str, Option<f64>)]| {
        let one_way = |text: &str| {
            let kept = text.lines().filter(|l| !l.contains(",up,") && !l.contains(",down,") || l.contains(way));
            scaled(&kept.collect::<Vec<_>>().join("\n"), 3, 1.0002)
        };
        let files = measure(&truth, &settings);
        let text = |file: &str, all: String| if file == "positioning-X.csv" { one_way(&all) } else { all };
        let series: Vec<_> =
            files.into_iter().map(|f| parse(&f.file, &text(&f.file, f.text), &known.order).unwrap()).collect();
        let hold = hold.iter().map(|(name, value)| (name.to_string(), *value)).collect();
        identify(&series, &known, &Options { hold, ..Options::default() }, &mut |_| {})
    };
    for way in [",up,", ",down,"] {
        let said = fit(way, &[]).unwrap_err().to_string();
        says(&said, &["positioning-X.csv:8:", "0 targets are reached both", "--hold axes.X.backlash_nm"]);
        let play = truth.drives[0].backlash;
        let result = fit(way, &[("axes.X.backlash_nm", Some(play))]).unwrap();
        let x = result.reversals.iter().find(|r| r.axis == "X").unwrap();
        assert_eq!((x.reversal, x.mean_reversal, x.backlash, x.targets, x.runs), (None, None, play, 11, 5));
        assert!((x.scale_ppm - 200.0).abs() < 15.0, "{}", x.scale_ppm);
        assert!((x.noise / settings.noise_nm - 1.0).abs() < 0.01 && x.drift_per_hour.is_some());
        let warned: Vec<_> = result.warnings.iter().filter(|w| w.contains("positioning-X.csv")).collect();
        assert_eq!(warned.len(), 1, "{:?}", result.warnings);
        says(warned[0], &["from one side only", "no reversal value", "held at", "ppm"]);
        says(&result.to_string(), &["positioning-X.csv: X one way, scale +"]);
        assert_eq!(serde_json::to_value(x).unwrap()["sigma"], serde_json::Value::Null);
        assert!(result.probability.is_some_and(|p| p > 1e-3) && result.rank == result.unknowns);
        let file = result.files.iter().find(|file| file.file == "positioning-X.csv").unwrap();
        assert!(file.rejected == 0 && (0.5..1.2).contains(&(file.rms / settings.noise_nm)));
    }
}

#[test]
fn another_machine_s_measurements_and_signs_are_noticed() {
    let said = complaint("fibre.csv", |t| t.replace("order: Z X Y", "order: X Z Y"));
    says(&said, &["fibre.csv:3: contradictory gauge: order X Z Y"]);
    // the wrong axis in the header: the others tell
    let said = complaint("straightness-X-y.csv", |t| t.replace("direction: y", "direction: x"));
    says(&said, &["straightness-X-y.csv:5:", "across the axis"]);
    let said = complaint("positioning-X.csv", |t| {
        t.replace(",up,", ",way,").replace(",down,", ",up,").replace(",way,", ",down,")
    });
    says(&said, &["positioning-X.csv:9: run 1 goes down but"]);
    let said = complaint("squareness.csv", |t| scaled(t, 1, -100.0));
    says(&said, &["squareness.csv:7: ", "readings do not fit the other files"]);
}

#[test]
fn the_files_that_the_documentation_shows_are_files_that_can_be_read() {
    let text = include_str!("../../docs/CALIBRATION.md");
    let order = Machine::paper().order;
    let mut kinds = Vec::new();
    for example in text.split("    # kind: ").skip(1) {
        let lines = format!("# kind: {example}");
        let lines: Vec<&str> = lines.lines().map(str::trim).take_while(|line| !line.is_empty()).collect();
        let rows: Vec<&str> = lines.into_iter().filter(|line| *line != "...").collect();
        let read = parse("docs/CALIBRATION.md", &rows.join("\n"), &order).unwrap_or_else(|error| panic!("{error}"));
        kinds.push(read.kind.name());
    }
    kinds.sort_unstable();
    let all = ["autocollimator", "diagonal", "fibre", "orientation", "positioning", "squareness", "straightness"];
    assert_eq!(kinds, all);
}
