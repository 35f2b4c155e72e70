//! Sensitivities against the reference tables, and the paper's printed numbers.

use host_sim::machine::{ErrorName, Function, Machine, Mount};
use host_sim::model::{Background, ErrorModel, Options, Sensitivity, UnitMotion, Verdict, paper_claims, sensitivity};
use serde_json::Value;
use stage_controller::units::Axis;

/// What the reference is met to, um; it is rounded to 1e-6 um itself.
const MET: f64 = 1e-6;

fn reference() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/error-model/sensitivity.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn paper() -> Sensitivity {
    sensitivity(&Machine::paper(), &Options::default())
}

fn vector(value: &Value) -> [f64; 3] {
    serde_json::from_value(value.clone()).unwrap()
}

fn near(ours: [f64; 3], wanted: &Value, what: &str) {
    let wanted = vector(wanted);
    assert!((0..3).all(|c| (ours[c] - wanted[c]).abs() <= MET), "{what}: {ours:?} against {wanted:?}");
}

fn latin(source: &str) -> String {
    [("δ", "delta_"), ("ε", "epsilon_"), ("α", "alpha"), ("β", "beta"), ("γ", "gamma")]
        .iter()
        .fold(source.to_string(), |text, (greek, latin)| text.replace(greek, latin))
}

#[test]
fn the_36_kinematic_rows_are_those_of_the_reference() {
    let (reference, ours) = (reference(), paper());
    let rows = reference["kinematic"].as_array().unwrap();
    assert_eq!((rows.len(), ours.kinematic.len()), (36, 36));
    for (wanted, row) in rows.iter().zip(&ours.kinematic) {
        assert_eq!(row.source, latin(wanted["source"].as_str().unwrap()));
        assert_eq!(row.kind, wanted["kind"]);
        assert_eq!(row.value, wanted["value"]);
        near(row.first_order_um, &wanted["E_first_order"], &row.source);
        near(row.no_static_um, &wanted["E_no_static"], &row.source);
        near(row.with_static_um, &wanted["E_with_static"], &row.source);
    }
}

#[test]
fn the_nine_static_and_twelve_mounting_rows_are_those_of_the_reference() {
    let (reference, ours) = (reference(), paper());
    let rows = reference["static"].as_array().unwrap();
    assert_eq!((rows.len(), ours.statics.len()), (21, 21));
    for (wanted, row) in rows.iter().zip(&ours.statics) {
        let name = latin(wanted["source"].as_str().unwrap());
        let name = name.replace("fiber mounting", "fibre mount").replace("chip mounting", "chip mount");
        let bare = match name.strip_prefix("epsilon_") {
            Some(static_error) if !name.ends_with("mount)") => format!("e{static_error}"),
            _ => name.clone(),
        };
        assert!(bare.starts_with(&row.source), "{} against {name}", row.source);
        assert_eq!(row.about, wanted["about"]);
        assert_eq!(row.value, wanted["value"]);
        near(row.at_home_um, &wanted["E_at_home"], &name);
        near(row.at_unit_pose_um, &wanted["E_at_unit_pose"], &name);
        if row.joint != "fibre" && row.joint != "chip" {
            // this column of the reference has more digits
            let wanted = vector(&wanted["dE_linear_motion_1um"]);
            assert!((0..3).all(|c| (row.linear_motion_um[c] - wanted[c]).abs() < 1e-11), "{name}");
        }
    }
}

#[test]
fn a_chip_that_is_turned_on_its_mount_sees_linear_motion_turned() {
    let table = paper();
    let row = table.statics.iter().find(|row| row.source == "epsilon_z(chip mount)").unwrap();
    // 1 um along x and y, seen from a chip turned by +50 urad
    assert!((row.linear_motion_um[0] - 50e-6).abs() < 1e-8 && (row.linear_motion_um[1] + 50e-6).abs() < 1e-8);
}

#[test]
fn the_printed_numbers_come_from_the_printed_inputs() {
    let table = paper();
    let [x, y, z] = table.background_first_order_um;
    assert!((x - 0.0600).abs() < 1e-12 && (y - 0.05625).abs() < 1e-12 && (z + 0.11625).abs() < 1e-12);
    let dz = table.kinematic.iter().find(|row| row.iso == "EZZ").unwrap();
    assert!((dz.first_order_um[2] + z - 0.18375).abs() < 1e-12);
    assert!((dz.with_static_um[2] - 0.183753).abs() < MET);
    let angular = table.kinematic.iter().filter(|row| row.kind == "angular");
    let largest = angular.map(|row| row.first_order_um[0].abs()).fold(0.0, f64::max);
    assert!((largest - 0.0250).abs() < 1e-12);
}

#[test]
fn every_claim_of_the_paper_has_its_verdict() {
    let claims = paper_claims();
    let find = |text: &str| {
        let mut found = claims.iter().filter(|claim| claim.quoted.contains(text));
        let claim = found.next().unwrap_or_else(|| panic!("{text}"));
        assert!(found.next().is_none(), "{text} is not the only one");
        claim
    };
    let number = |text: &str, ours: f64, digits: f64, verdict| {
        let claim = find(text);
        assert!((claim.ours.unwrap() - ours).abs() <= digits, "{claim:?}");
        assert_eq!(claim.verdict, verdict, "{claim:?}");
    };
    number("amplify X", 0.0600, 1e-9, Verdict::Reproduced);
    number("amplify Y", 0.05625, 1e-9, Verdict::Reproduced);
    number("amplify Z", 0.18375, 1e-9, Verdict::Reproduced);
    number("0.025 um", 0.0250, 1e-9, Verdict::Reproduced);
    number("(0.30 um)", 0.30, 1e-9, Verdict::Reproduced);
    number("0.003 deg", 0.00286, 1e-5, Verdict::Reproduced);
    number("0.1 deg", 0.0974, 1e-4, Verdict::Reproduced);
    number("0.005 deg is", 87.266, 1e-3, Verdict::Reproduced);
    number("9.03 dB", 9.0309, 1e-4, Verdict::Reproduced);
    number("more than 1 dB", 1.22, 1e-9, Verdict::Reproduced);
    number("lateral offset", 5.381, 1e-3, Verdict::Input);
    number("0.65 deg", 0.6509, 1e-4, Verdict::Reproduced);
    number("16 um of gap", 33.0, 0.05, Verdict::NotReproduced);
    number("angular backlash can", 0.0764, 1e-4, Verdict::Approximately);
    number("linear motion", 1.0207 / 1.0128, 1e-3, Verdict::Approximately);
    number("angular motion", 1.150 / 1.140, 1e-3, Verdict::Approximately);
    for text in ["about 10 um", "repeatability", "11.14 dB, 0.22"] {
        assert_eq!((find(text).verdict, find(text).ours), (Verdict::NotReproduced, None));
    }
    assert_eq!(claims.len(), 19);
    assert!(claims.iter().all(|claim| !claim.why.is_empty()));
}

#[test]
fn the_machine_s_own_static_errors_stand_behind_unless_told_otherwise() {
    let mut machine = Machine::paper();
    machine.statics.S_XY = -3e-4;
    machine.mounts.fibre = Mount { offset_nm: [2000.0, 0.0, 0.0], rotation_rad: [0.0; 3] };
    let of = |background| sensitivity(&machine, &Options { background, ..Options::default() });
    let home = |background| of(background).background_at_home_um;
    let model = |statics, mounts: bool| {
        let mut model = ErrorModel::of(&Machine { statics, ..machine.clone() });
        if !mounts {
            model.fibre_mount = Default::default();
        }
        model.error_at([0.0; 6]).position_um
    };
    assert_eq!(home(Background::Machine), model(machine.statics, false));
    assert_eq!(home(Background::Mounted), model(machine.statics, true));
    assert_eq!(home(Background::Uniform), model(Machine::paper().statics, false));
    assert_eq!(of(Background::Uniform).kinematic, paper().kinematic);
}

#[test]
fn own_errors_are_taken_from_the_machine_file_at_the_displaced_position() {
    let mut machine = Machine::paper();
    let name = |iso: &str| ErrorName::all().find(|name| name.iso() == iso).unwrap();
    machine.kinematic.set(name("EYX"), Function::new(vec![0.0, 0.02], vec![], vec![]).unwrap());
    machine.kinematic.set(name("ECC"), Function::new(vec![0.0, 1e-4], vec![], vec![]).unwrap());
    machine.mounts.chip.rotation_rad = [0.0, 2e-4, 0.0];
    let unit = UnitMotion { linear_um: 10.0, angle_rad: 0.5_f64.to_radians() };
    let table = sensitivity(&machine, &Options { own: true, unit, ..Options::default() });
    for row in &table.kinematic {
        match row.iso.as_str() {
            // 0.02 um per um at 10 um
            "EYX" => assert!((row.value - 0.2).abs() < 1e-15 && (row.no_static_um[1] - 0.2).abs() < 1e-12),
            // 1e-4 rad per degree at half a degree
            "ECC" => assert!((row.value - 5e-5).abs() < 1e-18 && (row.first_order_um[1] - 0.04375).abs() < 1e-9),
            _ => assert_eq!((row.value, row.no_static_um), (0.0, [0.0; 3]), "{}", row.iso),
        }
    }
    let chip = table.statics.iter().find(|row| row.source == "epsilon_y(chip mount)").unwrap();
    assert_eq!(chip.value, 2e-4);
    assert_eq!(table.ranking[1][0].iso, "EYX");
}

#[test]
fn the_ranking_holds_every_source_once_the_strongest_first() {
    let table = paper();
    for (c, ranks) in table.ranking.iter().enumerate() {
        assert_eq!(ranks.len(), 57);
        assert!(ranks.windows(2).all(|pair| pair[0].effect_um.abs() >= pair[1].effect_um.abs()));
        let mut names: Vec<&str> = ranks.iter().map(|rank| rank.source.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), 57);
        // six kinematic displacements and two mounts in this direction come before every rotation
        let along = ["delta_x", "delta_y", "delta_z"][c];
        assert!(ranks[..8].iter().all(|rank| rank.source.starts_with(along)), "{:?}", &ranks[..8]);
    }
}

#[test]
fn another_point_order_and_displacement_change_the_table_as_geometry_says() {
    let machine =
        Machine { order: [Axis::X, Axis::Y, Axis::Z, Axis::Alpha, Axis::Beta, Axis::Gamma], ..Machine::paper() };
    let far = Options { fibre_point_um: Some([0.0, 0.0, 50_000.0]), ..Options::default() };
    let table = sensitivity(&machine, &far);
    assert_eq!(table.kinematic[0].axis, "X");
    for row in table.kinematic.iter().filter(|row| row.iso.starts_with("EB")) {
        // 50 urad about y at 50 mm
        assert!((row.first_order_um[0] - 2.5).abs() < 1e-12, "{}", row.iso);
    }
    let place = |name: &str| table.statics.iter().find(|row| row.source == name).unwrap().joint;
    assert_eq!([place("S_ZX"), place("S_ZY"), place("S_XY")], ["Z", "Z", "Y"]);
}
