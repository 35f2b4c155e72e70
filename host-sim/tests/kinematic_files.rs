//! Kinematic errors in machine files: what the forms mean, and what is refused.

use host_sim::machine::{ErrorName, Function, Kinematic, Machine};
use stage_controller::units::Axis;

const PAPER: &str = include_str!("../machines/paper.toml");

fn with(kinematic: &str) -> String {
    format!("{PAPER}\n{kinematic}\n")
}

fn kinematic(text: &str) -> Kinematic {
    Machine::parse(&with(text)).unwrap_or_else(|error| panic!("{text}: {error}")).kinematic
}

/// The message that refuses it; it must name all of `names`.
fn refused(text: &str, names: &[&str]) {
    match Machine::parse(&with(text)) {
        Ok(_) => panic!("accepted: {text}"),
        Err(error) => {
            let message = error.to_string();
            assert!(names.iter().all(|name| message.contains(name)), "{text}: {message}");
        }
    }
}

fn named(iso: &str) -> ErrorName {
    ErrorName::all().find(|name| name.iso() == iso).unwrap()
}

fn value(kinematic: &Kinematic, iso: &str, position: f64) -> f64 {
    kinematic.get(named(iso)).value(position)
}

#[test]
fn a_machine_without_kinematic_errors_has_none() {
    let given = |k: &Kinematic| ErrorName::all().filter(|name| !k.get(*name).is_absent()).count();
    assert_eq!(given(&Machine::paper().kinematic), 0);
    assert_eq!(Machine::paper().kinematic.at(Axis::Beta, 2.0), [0.0; 6]);
    assert_eq!(given(&kinematic("[kinematic.X]\nEXX = {poly = [0.1]}")), 1);
}

#[test]
fn a_polynomial_begins_with_the_constant() {
    let k = kinematic("[kinematic.X]\nEYX = {poly = [0.5, 2e-4, -1e-8]}");
    for x in [-5000.0, 0.0, 1234.5, 5000.0] {
        assert!((value(&k, "EYX", x) - (0.5 + 2e-4 * x - 1e-8 * x * x)).abs() < 1e-15);
    }
}

#[test]
fn a_table_runs_straight_between_its_entries_and_stays_beyond_them() {
    let k = kinematic("[kinematic.gamma]\nECC = {table = [[-2, 1e-5], [0, 0], [1.0, -4e-5]]}");
    for (at, wanted) in
        [(-3.0, 1e-5), (-2.0, 1e-5), (-1.0, 5e-6), (0.0, 0.0), (0.25, -1e-5), (1.0, -4e-5), (2.9, -4e-5)]
    {
        assert!((value(&k, "ECC", at) - wanted).abs() < 1e-20, "{at}");
    }
}

#[test]
fn a_harmonic_has_period_cosine_and_sine() {
    let k = kinematic("[kinematic.Y]\nEYY = {fourier = [[500.0, 0.02, 0.05], [250, 0, 0.01]]}");
    let near = |at, wanted: f64| assert!((value(&k, "EYY", at) - wanted).abs() < 1e-12, "{at}");
    near(0.0, 0.02);
    near(125.0, 0.05);
    near(250.0, -0.02);
    near(62.5, (0.02 + 0.05) * 0.5_f64.sqrt() + 0.01);
    near(562.5, (0.02 + 0.05) * 0.5_f64.sqrt() + 0.01);
}

#[test]
fn several_forms_are_added() {
    let k = kinematic(
        "[kinematic.Z]\nEAZ = {poly = [1e-6], table = [[0, 2e-6], [1000, 2e-6]], fourier = [[100, 4e-6, 0]]}",
    );
    assert!((value(&k, "EAZ", 0.0) - 7e-6).abs() < 1e-20);
    let (poly, table, fourier) = k.get(named("EAZ")).parts();
    let again = Function::new(poly.to_vec(), table.to_vec(), fourier.to_vec()).unwrap();
    assert_eq!(&again, k.get(named("EAZ")));
}

#[test]
fn all_36_names_are_read_each_into_its_own_place() {
    let mut text = String::new();
    for axis in Axis::ALL {
        text += &format!("[kinematic.{}]\n", axis.name());
        for (n, name) in ErrorName::all().enumerate().filter(|(_, name)| name.axis == axis) {
            text += &format!("{} = {{poly = [{:e}]}}\n", name.iso(), 1e-4 * (n + 1) as f64);
        }
    }
    let k = kinematic(&text);
    let mut names = Vec::new();
    for (n, name) in ErrorName::all().enumerate() {
        assert!((k.get(name).value(1.0) - 1e-4 * (n + 1) as f64).abs() < 1e-18, "{}", name.iso());
        assert_eq!(k.at(name.axis, 1.0)[name.component as usize], k.get(name).value(1.0));
        names.push(name.iso());
    }
    assert_eq!(names.len(), 36);
    assert_eq!(names[..6], ["EXX", "EYX", "EZX", "EAX", "EBX", "ECX"]);
    assert_eq!(names[30..], ["EXC", "EYC", "EZC", "EAC", "EBC", "ECC"]);
}

#[test]
fn iso_names_stand_beside_those_of_the_paper() {
    assert_eq!(named("EYX").paper(), "delta_y(X)");
    assert_eq!(named("ECX").paper(), "epsilon_z(X)");
    assert_eq!(named("EBA").paper(), "epsilon_y(alpha)");
    let meaning = |iso| named(iso).meaning();
    assert_eq!([meaning("EXX"), meaning("EYX"), meaning("EAX")], ["positioning", "straightness", "roll"]);
    assert_eq!([meaning("EZC"), meaning("EXC"), meaning("ECC")], ["axial", "radial run-out", "angular positioning"]);
    assert_eq!(meaning("EAC"), "wobble");
}

#[test]
fn the_rotary_tables_may_be_called_by_their_iso_letter() {
    let k = kinematic("[kinematic.C]\nEXC = {poly = [0.25]}");
    assert_eq!(value(&k, "EXC", 0.0), 0.25);
}

#[test]
fn unknown_names_are_refused_with_line_and_value() {
    let line = with("").lines().count() + 1;
    refused("[kinematic.X]\nEYY = {poly = [0.125]}", &["EYY", "0.125", &format!("line {line}"), "EYX"]);
    refused("[kinematic.X]\nEDX = {poly = [0.125]}", &["EDX", "0.125", "line"]);
    refused("[kinematic.U]\nEXU = {poly = [0.125]}", &["U", "line", "gamma"]);
    refused("[kinematic.X]\nEXX = {polynomial = [0.125]}", &["polynomial", "line", "fourier"]);
    refused("[kinematic.X]\nEXX = 0.125", &["EXX", "0.125", "line"]);
    refused("[kinematic.X]\nEXX = {}", &["EXX", "poly", "line"]);
}

#[test]
fn what_is_no_function_is_refused_with_line_and_value() {
    refused("[kinematic.X]\nEXX = {table = [[0, 0.1], [200, 0.2], [100, 0.3]]}", &["rise", "200", "100", "line"]);
    refused("[kinematic.X]\nEXX = {table = [[0, 0.1], [0, 0.2]]}", &["rise", "line"]);
    refused("[kinematic.X]\nEXX = {table = [[0, 0.1, 7]]}", &["EXX", "7", "line"]);
    refused("[kinematic.X]\nEXX = {fourier = [[500, 0.1]]}", &["EXX", "line"]);
    refused("[kinematic.X]\nEXX = {fourier = [[0, 0.1, 0.1]]}", &["period", "0", "line"]);
    refused("[kinematic.X]\nEXX = {poly = [nan]}", &["NaN", "finite", "line"]);
    refused("[kinematic.X]\nEXX = {table = [[0, inf], [100, 0]]}", &["inf", "finite", "line"]);
}

#[test]
fn values_of_a_mistaken_unit_are_refused_with_key_and_value() {
    // nm for um
    refused("[kinematic.Y]\nEXY = {poly = [300.0]}", &["kinematic.Y.EXY", "300", "um"]);
    // urad for rad
    refused("[kinematic.alpha]\nEBA = {poly = [50.0]}", &["kinematic.alpha.EBA", "50", "rad"]);
    // coefficients per mm
    refused("[kinematic.X]\nEXX = {poly = [0, 0.1]}", &["kinematic.X.EXX", "5000", "um"]);
    // an entry beyond the travel counts as well
    refused("[kinematic.X]\nEAX = {table = [[0, 0], [9000, 0.03]]}", &["kinematic.X.EAX", "0.03"]);
    refused("[kinematic.X]\nEXX = {poly = [0, 0, 0, 0, 0, 0, 1e300]}", &["kinematic.X.EXX"]);
}

#[test]
fn positions_of_a_mistaken_unit_are_refused_with_key_and_value() {
    // mm for um, rad for degrees, nm for um
    refused("[kinematic.X]\nEXX = {table = [[-5, 0.1], [5, 0.2]]}", &["kinematic.X.EXX", "-5 to 5", "mm"]);
    refused("[kinematic.beta]\nEBB = {table = [[-0.052, 1e-5], [0.052, 2e-5]]}", &["kinematic.beta.EBB", "rad"]);
    refused("[kinematic.X]\nEXX = {table = [[-5e6, 0.1], [5e6, 0.2]]}", &["kinematic.X.EXX", "5000"]);
}

#[test]
fn errors_at_the_limit_are_still_believed() {
    let k = kinematic("[kinematic.X]\nEXX = {poly = [200.0]}\nEAX = {poly = [-0.02]}");
    assert_eq!(k.at(Axis::X, 0.0), [200.0, 0.0, 0.0, -0.02, 0.0, 0.0]);
}

#[test]
fn a_constant_is_the_same_everywhere() {
    let f = Function::constant(0.3);
    assert!([-1e9, 0.0, 7.0].iter().all(|&q| f.value(q) == 0.3));
}

#[test]
fn the_example_of_the_documentation_means_what_it_says() {
    let text = include_str!("../../docs/ERRORS.md");
    let example = text.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
    let k = kinematic(example);
    assert!((value(&k, "EXX", 125.0) - 0.05).abs() < 1e-12);
    assert!((value(&k, "EYX", -2500.0) - 0.1).abs() < 1e-12 && (value(&k, "EYX", 9000.0) + 0.1).abs() < 1e-12);
    assert!((value(&k, "EBX", 1000.0) - 2e-6).abs() < 1e-15);
}
