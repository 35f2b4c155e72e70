//! Identification: a file that was misread is refused by name and not taken for a noisy one.

mod stage;

use host_sim::identify::{Constant, Identification, Options, identify, parse};
use host_sim::machine::{ErrorName, Function, Machine, StaticErrors};
use host_sim::measure::{Settings, measure, nominal};
use stage::Dice;
use stage_controller::units::Axis;

/// urad to arcsec.
const PER_URAD: f64 = 648_000.0 / std::f64::consts::PI * 1e-6;

/// The rows of a file with its numbers changed: `change` gets the row's number and its fields; text fields are NaN.
fn rows(text: &str, mut change: impl FnMut(usize, &mut [f64])) -> String {
    let mut number = 0;
    let line = |line: &str| {
        if line.starts_with('#') || !line.contains(',') || line.contains('_') {
            return line.to_string();
        }
        let mut fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap_or(f64::NAN)).collect();
        change(number, &mut fields);
        number += 1;
        let back = |(field, before): (&f64, &str)| if field.is_nan() { before.into() } else { field.to_string() };
        fields.iter().zip(line.split(',')).map(back).collect::<Vec<String>>().join(",")
    };
    text.lines().map(line).collect::<Vec<_>>().join("\n")
}

/// Multiplies columns.
fn times(text: &str, columns: &[&str], factor: f64) -> String {
    let header = text.lines().find(|line| !line.starts_with('#')).expect("a header");
    let found: Vec<usize> =
        columns.iter().map(|name| header.split(',').position(|c| c == *name).expect("a column")).collect();
    rows(text, |_, fields| found.iter().for_each(|column| fields[*column] *= factor))
}

/// Measures a stage, changes one file and fits.
fn fit(
    truth: &Machine,
    settings: &Settings,
    file: &str,
    change: impl Fn(&str) -> String,
) -> Result<Identification, String> {
    let known = nominal(truth);
    let mut changed = false;
    let read = |measured: &host_sim::measure::MeasuredFile| {
        let text = if measured.file == file { change(&measured.text) } else { measured.text.clone() };
        changed |= text != measured.text;
        parse(&measured.file, &text, &known.order).expect("a readable file")
    };
    let series: Vec<_> = measure(truth, settings).iter().map(read).collect();
    assert!(changed || file.is_empty(), "{file} is there and was changed");
    identify(&series, &known, &Options::default(), &mut |_| {}).map_err(|refusal| refusal.to_string())
}

fn settings(state_noise: bool, seed: u64) -> Settings {
    Settings { state_noise, seed, ..Settings::default() }
}

fn stated() -> Settings {
    settings(true, 3)
}

fn unstated() -> Settings {
    settings(false, 3)
}

/// Every word is in the message.
fn says(said: &Result<Identification, String>, words: &[&str]) {
    let said = match said {
        Ok(result) => format!("accepted: {:?}", result.warnings),
        Err(message) => message.clone(),
    };
    println!("{said}");
    words.iter().for_each(|word| assert!(said.contains(word), "{word:?} in {said:?}"));
}

#[test]
fn a_motor_that_counts_backwards_in_one_file_is_named_however_short_its_lever() {
    let paper = Machine::paper();
    for settings in [stated(), unstated()] {
        for axis in [Axis::Beta, Axis::Gamma] {
            let column = format!("at_{}", axis.name());
            let said = fit(&paper, &settings, "fibre.csv", |text| times(text, &[&format!("{column}_deg")], -1.0));
            let reason = format!("the readings fit with {column} counted the other way: residuals of ");
            says(&said, &["fibre.csv:", &reason, " um become 0.05"]);
        }
        let said = fit(&paper, &settings, "autocollimator-z.csv", |text| times(text, &["at_gamma_deg"], -1.0));
        says(&said, &["autocollimator-z.csv:", "at_gamma counted the other way"]);
    }
}

#[test]
fn a_value_of_another_unit_or_sign_is_named_where_no_noise_is_stated() {
    let paper = Machine::paper();
    for settings in [stated(), unstated()] {
        let squareness =
            |factor: f64| fit(&paper, &settings, "squareness.csv", move |text| times(text, &["measured_urad"], factor));
        says(
            &squareness(PER_URAD),
            &["squareness.csv:", "measured_urad in arcsec", "look like arcsec written as urad"],
        );
        says(&squareness(-1.0), &["squareness.csv:", "measured_urad of the other sign"]);
    }
    let said = fit(&paper, &unstated(), "straightness-X-y.csv", |text| times(text, &["measured_um"], 1000.0));
    says(&said, &["straightness-X-y.csv:", "no noise of straightness", "in nm it would be 0.0"]);
}

/// A stage that turns so far that the scale of the machine's motion does not tell the columns apart.
#[test]
fn columns_that_were_exchanged_are_named() {
    let mut far = Machine::paper();
    for drive in &mut far.drives[3..] {
        drive.travel = [-2.5e8, 2.5e8];
        drive.switches = [-2.6e8, 2.6e8];
    }
    let exchanged = |text: &str| rows(text, |_, fields| fields.swap(3, 4));
    for settings in [stated(), unstated()] {
        let said = fit(&far, &settings, "autocollimator-z.csv", exchanged);
        says(&said, &["autocollimator-z.csv:", "about_x_urad and about_y_urad exchanged"]);
    }
}

#[test]
fn readings_of_which_a_third_is_grossly_wrong_are_refused_with_their_number() {
    let paper = Machine::paper();
    for (size, columns) in [(20.0, 3), (50.0, 3), (50.0, 1), (5.0, 3), (5.0, 1)] {
        let mut wrong = 0;
        let mut dice = Dice::new(8);
        let text = measure(&paper, &stated()).into_iter().find(|file| file.file == "fibre.csv").unwrap().text;
        let spoiled = rows(&text, |_, fields| {
            if dice.between(0.0, 1.0) < 1.0 / 3.0 {
                wrong += 1;
                fields[6..6 + columns].iter_mut().for_each(|value| *value += dice.between(-size, size));
            }
        });
        let said = fit(&paper, &stated(), "fibre.csv", |_| spoiled.clone());
        if size < 10.0 {
            // errors of a stage can be as large: the file is believed less, and that is said
            says(&said, &["accepted", "fibre.csv: the residuals are", "times the noise stated"]);
            continue;
        }
        says(
            &said,
            &["fibre.csv:", " of 300 readings do not fit the others of the file, which keep to its noise of 50"],
        );
        let message = said.unwrap_err();
        let named: i32 = message.split(' ').find_map(|word| word.parse().ok()).expect("a number");
        assert!((85..115).contains(&wrong) && (wrong - named).abs() <= 7, "{wrong} wrong, {named} named");
    }
}

#[test]
fn a_tenth_of_wrong_readings_is_left_out_by_name_with_the_stated_noise_kept() {
    let mut dice = Dice::new(8);
    let draws: Vec<f64> = (0..300).map(|_| dice.between(-20.0, 20.0)).collect();
    let spoil = |text: &str| {
        rows(text, |number, fields| {
            if number % 10 == 3 {
                fields[7] += draws[number];
            }
        })
    };
    let result = fit(&Machine::paper(), &stated(), "fibre.csv", spoil).unwrap();
    let file = result.files.iter().find(|file| file.file == "fibre.csv").unwrap();
    assert!(file.noise_stated && (28..=30).contains(&file.rejected), "{file:?}");
    assert!(result.warnings.is_empty() && result.probability.unwrap() > 1e-3, "{:?}", result.warnings);
}

/// Errors of 0.5 to 2 um that depend on the position are a stage's own, with a probe of 50 nm.
#[test]
fn errors_of_the_stage_itself_are_warned_of_and_not_refused() {
    let waves = |amplitude: f64| {
        move |text: &str| {
            rows(text, |_, fields| {
                let [x, y, z] = [fields[0], fields[1], fields[2]].map(|motor| motor / 5000.0);
                fields[6] += amplitude * (20.0 * x).sin() + 0.3 * amplitude * (17.0 * y).sin();
                fields[7] += amplitude * (23.0 * z).cos();
                fields[8] += 0.7 * amplitude * (19.0 * z + 7.0 * x).cos();
            })
        }
    };
    for amplitude in [0.5, 1.0, 2.0] {
        let result = fit(&Machine::paper(), &stated(), "fibre.csv", waves(amplitude)).unwrap();
        println!("{amplitude} um: {:?}", result.warnings);
        assert!(result.warnings.iter().any(|warning| warning.starts_with("fibre.csv: the residuals are")));
        assert!(result.outliers.is_empty(), "{:?}", result.outliers);
        assert_eq!((result.probability, result.noise_from_residuals), (None, vec!["fibre.csv".to_string()]));
    }
    let said = fit(&Machine::paper(), &stated(), "fibre.csv", waves(30.0));
    says(&said, &["fibre.csv:", "times the noise stated", "wrong unit"]);
}

#[test]
fn the_report_calls_no_probability_what_is_none() {
    let known = fit(&Machine::paper(), &stated(), "", str::to_string).unwrap();
    let estimated = fit(&Machine::paper(), &unstated(), "", str::to_string).unwrap();
    let (known, estimated) = (known.to_string(), estimated.to_string());
    assert!(known.contains("(p = 0.") && !known.contains("no test of the model"));
    assert!(
        !estimated.contains("(p = ") && estimated.contains("(no test of the model: the noise of 17 files was taken")
    );
}

#[test]
fn a_file_whose_noise_leaves_it_no_weight_is_named() {
    let mut dice = Dice::new(4);
    let draws: Vec<f64> = (0..15).map(|_| dice.between(-150.0, 150.0)).collect();
    let said = fit(&Machine::paper(), &unstated(), "squareness.csv", |text| {
        rows(text, |number, fields| fields[1] += draws[number])
    });
    says(&said, &["accepted", "squareness.csv: with a noise of", "next to no weight in the result"]);
}

/// So many stages; a debug build takes a quarter of them.
const fn stages(full: u64) -> u64 {
    if cfg!(debug_assertions) { full / 4 } else { full }
}

/// Clean files of twenty random stages, with and without stated noise: nothing is suspected.
#[test]
fn clean_files_of_random_stages_are_never_suspected() {
    let mut dice = Dice::new(20);
    for seed in 0..stages(20) {
        let mut truth = Machine::paper();
        truth.order = dice.stage().machine.order;
        truth.statics = StaticErrors::from_values([0.0; 9].map(|_| dice.between(-1e-3, 1e-3)));
        for constant in Constant::all(&truth.order).into_iter().skip(9) {
            let reach = if constant.is_angle() { 1e-3 } else { 3e5 };
            constant.set(&mut truth, dice.between(-reach, reach));
        }
        truth.fibre_point_nm = (dice.direction() * dice.between(5e5, 50e6)).into();
        for factor in [1.0, 5.0] {
            for stated in [true, false] {
                let mut settings = settings(stated, seed);
                settings.noise_nm *= factor;
                settings.noise_nrad *= factor;
                let result = fit(&truth, &settings, "", str::to_string).unwrap_or_else(|said| panic!("{seed}: {said}"));
                assert!(result.warnings.is_empty(), "{seed}: {:?}", result.warnings);
            }
        }
    }
}

/// Stages with a mistake each: refused with the right name. A squareness that is stated as better than all else can win
/// against them with an error of some urad; then the others are warned of.
#[test]
fn mistakes_in_the_files_of_random_stages_are_named() {
    let mut dice = Dice::new(21);
    let (mut named, mut warned) = (0, 0);
    for seed in 0..stages(20) {
        let mut truth = Machine::paper();
        truth.statics = StaticErrors::from_values([0.0; 9].map(|_| dice.between(-2e-4, 2e-4)));
        truth.fibre_point_nm = (dice.direction() * dice.between(8e5, 5e6)).into();
        let motor = ["alpha", "beta", "gamma"][seed as usize % 3];
        let column = format!("at_{motor}_deg");
        let backwards = |text: &str| times(text, &[&column], -1.0);
        let arcsec = |text: &str| times(text, &["measured_urad"], PER_URAD);
        for state_noise in [true, false] {
            let settings = settings(state_noise, seed);
            let tries = [
                (fit(&truth, &settings, "fibre.csv", backwards), "fibre.csv", format!("at_{motor} ")),
                (fit(&truth, &settings, "squareness.csv", arcsec), "squareness.csv", "arcsec".into()),
            ];
            for (said, file, word) in tries {
                match said {
                    Err(message) => {
                        let right = message.starts_with(file)
                            && (message.contains(&word) || message.contains("goes against the machine's motion"));
                        assert!(right, "{seed}: {message}");
                        named += 1;
                    }
                    Ok(result) => {
                        warned += 1;
                        println!("{seed} {file} {word}: {:?}", result.warnings);
                        assert!(file == "squareness.csv" && state_noise && !result.warnings.is_empty(), "{seed}");
                    }
                }
            }
        }
    }
    let mistakes = 4 * stages(20);
    println!("figure: of {mistakes} mistakes {named} refused with the right name, {warned} only warned of");
    assert!(warned <= 3 && named + warned == mistakes);
}

fn long_lever() -> Machine {
    Machine::parse(include_str!("../machines/long-lever.toml")).expect("a machine")
}

/// Where an axis ends, in the unit of its kinematic errors (um or deg).
fn reach(machine: &Machine, axis: Axis) -> f64 {
    let unit = if axis.is_rotary() { std::f64::consts::PI / 180.0 * 1e9 } else { 1e3 };
    machine.drives[axis.index()].travel[1] / unit
}

/// A straightness of 0.5 um over 12.5 mm makes one of three squares wrong: that is the stage.
#[test]
fn a_pair_of_axes_that_stands_apart_is_warned_of_and_not_refused() {
    let mut truth = long_lever();
    let end = reach(&truth, Axis::X);
    let name = ErrorName::all().find(|name| name.iso() == "EYX").expect("a straightness of X");
    truth.kinematic.set(name, Function::new(vec![0.0, 0.0, 0.0, 0.5 / end.powi(3)], vec![], vec![]).unwrap());
    let result = fit(&truth, &settings(true, 1), "", str::to_string).unwrap();
    let warned = |word: &str| result.warnings.iter().any(|warning| warning.starts_with(word));
    assert!(warned("squareness.csv: the residuals are"), "{:?}", result.warnings);
    let file = result.files.iter().find(|file| file.file == "squareness.csv").unwrap();
    assert!(file.rejected == 0 && !file.noise_stated, "{file:?}");
}

/// All 36 errors of a stage at once, smooth and of ordinary size, with and without stated noise.
#[test]
fn stages_with_all_errors_that_stages_have_are_never_refused() {
    let mut dice = Dice::new(36);
    let (mut warned, mut doubted) = (0, 0_u64);
    for seed in 0..stages(60) {
        let mut truth = if seed % 2 == 0 { long_lever() } else { Machine::paper() };
        truth.statics = StaticErrors::from_values([0.0; 9].map(|_| dice.between(-1e-3, 1e-3)));
        let (length, angle) = if seed % 4 < 2 { (0.5, 20e-6) } else { (0.2, 5e-6) };
        for name in ErrorName::all() {
            let size = if name.component.is_angular() { angle } else { length };
            let end = reach(&truth, name.axis);
            let mut poly = vec![0.0, 0.0];
            poly.extend([2, 3].map(|power| dice.between(-size, size) / 2.0_f64.sqrt() / end.powi(power)));
            truth.kinematic.set(name, Function::new(poly, vec![], vec![]).unwrap());
        }
        let result = fit(&truth, &settings(seed % 5 != 0, seed), "", str::to_string);
        let result = result.unwrap_or_else(|said| panic!("{seed}: {said}"));
        doubted += u64::from(result.warnings.iter().any(|warning| warning.contains("misread")));
        warned += u64::from(!result.warnings.is_empty());
    }
    let count = stages(60);
    println!(
        "figure: of {count} stages with position-dependent errors 0 refused, {warned} warned of, {doubted} doubted"
    );
    // the sign of one pair, which may be wrong by chance
    assert!(6 * warned > 5 * count && doubted <= 3);
}

#[test]
fn a_distance_of_the_other_sign_is_no_explanation_of_a_square_that_is_wrong() {
    let paper = Machine::paper();
    for seed in 0..5 {
        let said = fit(&paper, &settings(true, seed), "squareness.csv", |text| times(text, &["measured_urad"], -1.0));
        says(&said, &["squareness.csv:", "measured_urad of the other sign"]);
    }
}

#[test]
fn exchanged_columns_of_values_are_named_by_the_motion_already() {
    let exchanged = |text: &str| rows(text, |_, fields| fields.swap(6, 7));
    let said = fit(&Machine::paper(), &stated(), "fibre.csv", exchanged);
    says(&said, &["fibre.csv:8:", "x_um does not follow the machine's motion", "x_um and y_um exchanged"]);
}
