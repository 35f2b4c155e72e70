//! The f64 law against vectors made by an independent program, and what the calibration leaves of it.

use host_sim::calibrate::{Law, Refusal, angular_travel, calibrate, inverse_axes, orientation_residual};
use host_sim::machine::{Machine, MachineFile, Mounts, StaticErrors};
use host_sim::model::Chain;
use proptest::prelude::*;
use serde::Deserialize;
use stage_controller::compensation::calibration::{BLOCK_CAPACITY, Calibration};
use stage_controller::units::{AXES, Axis};
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Golden {
    machine: MachineFile,
    poses: Vec<Vector>,
}

#[derive(Deserialize)]
struct Vector {
    pose_nm_nrad: [f64; AXES],
    actuator_nm_nrad: [f64; AXES],
    motor_steps_exact: [f64; AXES],
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("host-sim lies in the workspace").to_path_buf()
}

fn files(folder: &str, extension: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join(folder)).expect(folder).map(|entry| entry.expect(folder).path());
    let mut files: Vec<_> = entries.filter(|path| path.extension().is_some_and(|e| e == extension)).collect();
    files.sort();
    assert!(!files.is_empty(), "{folder} is empty");
    files
}

/// The files of poses; the vectors of the fixed-point kernel lie beside them.
fn golden_poses() -> impl Iterator<Item = PathBuf> {
    files("tests/golden", "json").into_iter().filter(|path| !path.ends_with("fixed-point.json"))
}

fn golden_machine(name: &str) -> Machine {
    Machine::load(&root().join(format!("tests/golden/machines/{name}.toml"))).expect("a golden machine")
}

fn all_machines() -> Vec<Machine> {
    let paths = files("tests/golden/machines", "toml").into_iter().chain(files("host-sim/machines", "toml"));
    paths.map(|path| Machine::load(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))).collect()
}

fn worst(a: [f64; AXES], b: [f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

const FIVE_DEGREES: [[f64; 2]; 3] = [[-0.087_266_462_6, 0.087_266_462_6]; 3];

#[test]
fn the_exact_inverse_equals_every_golden_vector() {
    for path in golden_poses() {
        let golden: Golden = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let machine = Machine::try_from(golden.machine).unwrap();
        let chain = Chain::new(&machine);
        let mut deviation = 0.0_f64;
        assert!(golden.poses.len() >= 40);
        for vector in golden.poses {
            let actuators = chain.exact_inverse(vector.pose_nm_nrad).expect("a pose within the travel");
            deviation = deviation.max(worst(actuators, vector.actuator_nm_nrad));
            let steps: [f64; AXES] = std::array::from_fn(|i| actuators[i] / machine.drives[i].step);
            assert!(worst(steps, vector.motor_steps_exact) < 0.005, "{}: {steps:?}", path.display());
        }
        println!("{}: worst {deviation:.6} nm or nrad", machine.name);
        assert!(deviation <= 0.01, "{}: {deviation} nm or nrad", path.display());
    }
}

#[test]
fn golden_vectors_carry_the_machine_beside_them() {
    for path in golden_poses() {
        let golden: Golden = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let written = Machine::try_from(golden.machine).unwrap();
        let name = written.name.clone();
        assert_eq!(all_machines().into_iter().find(|machine| machine.name == name), Some(written), "{name}");
    }
}

#[test]
fn at_home_every_actuator_and_every_coordinate_is_zero() {
    for machine in all_machines() {
        let chain = Chain::new(&machine);
        assert!(worst(chain.true_pose([0.0; AXES]), [0.0; AXES]) < 1e-6, "{}", machine.name);
        assert!(worst(chain.exact_inverse([0.0; AXES]).unwrap(), [0.0; AXES]) < 1e-6, "{}", machine.name);
    }
}

#[test]
fn a_perfect_stage_with_its_axes_through_f_moves_only_what_is_asked() {
    let mut machine = Machine::paper();
    machine.statics = StaticErrors::default();
    machine.fibre_point_nm = [0.0; 3];
    let pose = [1e6, -2e6, 3e6, 4e7, -3e7, 2e7];
    assert!(worst(Chain::new(&machine).true_pose(pose), pose) < 1e-6);
}

#[test]
fn the_printed_sensitivities_of_the_paper_appear_at_small_angles() {
    // the paper: 50 urad about z moves F by -100 um and 875 um times 50 urad in x and y.
    let mut machine = Machine::paper();
    machine.statics = StaticErrors::default();
    let pose = Chain::new(&machine).true_pose([0.0, 0.0, 0.0, 0.0, 0.0, 50_000.0]);
    assert!((pose[0] + 5.0).abs() < 0.002 && (pose[1] - 43.75).abs() < 0.002, "{pose:?}");
}

fn order() -> impl Strategy<Value = [Axis; AXES]> {
    Just(Axis::ALL.to_vec()).prop_shuffle().prop_map(|order| order.try_into().expect("six axes"))
}

fn any_machine() -> impl Strategy<Value = Machine> {
    let statics = prop::array::uniform9(-0.008..0.008_f64);
    let offsets = prop::array::uniform6(prop::array::uniform3(-2e6..2e6_f64));
    (order(), statics, offsets, prop::array::uniform3(-4e7..4e7_f64)).prop_map(|(order, statics, offsets, fibre)| {
        Machine {
            order,
            statics: StaticErrors::from_values(statics),
            mounts: Mounts::default(),
            axis_offset_nm: offsets,
            fibre_point_nm: fibre,
            ..Machine::paper()
        }
    })
}

fn any_pose() -> impl Strategy<Value = [f64; AXES]> {
    (prop::array::uniform3(-1.25e7..1.25e7_f64), prop::array::uniform3(-8.7e7..8.7e7_f64))
        .prop_map(|([x, y, z], [a, b, g])| [x, y, z, a, b, g])
}

proptest! {
    #[test]
    fn the_forward_model_undoes_the_inverse_for_every_order_of_the_stages(machine in any_machine(), pose in any_pose()) {
        let chain = Chain::new(&machine);
        let back = chain.true_pose(chain.exact_inverse(pose).unwrap());
        prop_assert!(worst(back, pose) < 1e-5, "{back:?}");
    }

    #[test]
    fn the_controllers_law_places_f_exactly_at_the_angles_it_chooses(machine in any_machine(), pose in any_pose()) {
        // Holds for every order with the linear stages first, whatever the second-order term leaves.
        let mut machine = machine;
        machine.order.sort_by_key(|axis| axis.is_rotary());
        let chain = Chain::new(&machine);
        let slides = chain.slides_matrix().try_inverse().unwrap();
        let axes = inverse_axes(&chain).unwrap();
        let law = Law::new(&machine, &chain, slides, axes, Default::default());
        let back = chain.true_pose(law.actuators(pose));
        for i in 0..3 {
            prop_assert!((back[i] - pose[i]).abs() < 1e-5, "{back:?}");
        }
    }
}

#[test]
fn every_shipped_machine_can_be_calibrated_and_its_block_survives_the_wire() {
    for machine in all_machines() {
        let (calibration, report) = calibrate(&machine).unwrap_or_else(|e| panic!("{}: {e}", machine.name));
        let mut block = [0; BLOCK_CAPACITY];
        let length = calibration.encode(&mut block).unwrap();
        assert_eq!(Calibration::decode(&block[..length]), Ok(calibration), "{}", machine.name);
        assert_eq!(report.crc, Calibration::crc(&block[..length]));
        println!("{report}");
        for (i, quantisation) in report.quantisation.into_iter().enumerate() {
            // docs/LAW.md 3 allows 0.32 nm.
            assert!(quantisation < 0.32, "{} motor {}: {quantisation}", machine.name, Axis::ALL[i].name());
        }
    }
}

#[test]
fn the_rounded_law_reaches_every_golden_orientation_within_its_stated_residual() {
    for machine in all_machines() {
        let chain = Chain::new(&machine);
        let (calibration, report) = calibrate(&machine).unwrap();
        let held = Law::of_block(&calibration, machine.drives.map(|drive| drive.step));
        // A finer grid than the one of the fit.
        let urad = orientation_residual(&chain, angular_travel(&machine), 14, |a| held.actuator_angles(a));
        assert!(urad <= report.orientation_residual_urad * 1.001 + 0.001, "{}: {urad}", machine.name);
    }
}

/// Largest residual over ±5° of all sign patterns of nine static errors of one size.
fn worst_of_all_signs(order: &[Axis; AXES], size: f64) -> f64 {
    let mut machine = golden_machine("eight-mrad");
    machine.order = *order;
    let mut largest = 0.0_f64;
    for signs in 0..1 << 9 {
        let value = |i: usize| if signs >> i & 1 == 1 { size } else { -size };
        machine.statics = StaticErrors::from_values(std::array::from_fn(value));
        let chain = Chain::new(&machine);
        let axes = inverse_axes(&chain).unwrap();
        largest = largest.max(host_sim::calibrate::fit(&chain, &axes, FIVE_DEGREES).unwrap().residual_urad);
    }
    largest
}

#[test]
fn three_and_eight_milliradians_leave_five_and_fifteen_microradians() {
    for (name, limit) in [("three-mrad", 5.0), ("xzy-bga", 5.0), ("eight-mrad", 15.0)] {
        let (_, report) = calibrate(&golden_machine(name)).unwrap();
        println!("figure: {name}: {:.3} urad", report.orientation_residual_urad);
        assert!(report.orientation_residual_urad <= limit, "{name}: {report}");
    }
}

#[test]
fn no_signs_of_the_static_errors_exceed_the_limits_over_five_degrees() {
    // The other orders were measured too: the same figures within 0.02 urad.
    let order = Machine::paper().order;
    for (size, limit) in [(3e-3, 5.0), (8e-3, 15.0)] {
        let urad = worst_of_all_signs(&order, size);
        println!("figure: static errors of {:.0} mrad, all signs: {urad:.2} urad", size * 1e3);
        assert!(urad <= limit, "{size} rad leaves {urad} urad");
    }
}

#[test]
fn a_linear_stage_carried_by_a_rotary_one_is_refused_by_name() {
    let mut machine = Machine::paper();
    machine.order = [Axis::Z, Axis::X, Axis::Gamma, Axis::Y, Axis::Beta, Axis::Alpha];
    let refusal = calibrate(&machine).unwrap_err();
    assert_eq!(refusal, Refusal::Topology { linear: Axis::Y, rotary: Axis::Gamma });
    let text = refusal.to_string();
    assert!(text.contains("Y is carried by gamma") && text.contains("constant"), "{text}");
}

#[test]
fn travel_lever_and_tilt_beyond_the_law_are_refused_with_their_figures() {
    let mut wide = Machine::paper();
    wide.drives[Axis::Beta.index()].travel[1] = 7.6_f64.to_radians() * 1e9;
    assert!(matches!(calibrate(&wide), Err(Refusal::Travel { axis: Axis::Beta, degrees }) if degrees > 7.59));

    let mut long = Machine::paper();
    long.fibre_point_nm = [0.0, 0.0, 60.5e6];
    let text = calibrate(&long).unwrap_err().to_string();
    assert!(text.contains("60.50") && text.contains("mm from the alpha axis"), "{text}");

    let mut tilted = golden_machine("eight-mrad");
    tilted.statics = StaticErrors::from_values([0.02, 0.02, -0.02, 0.02, 0.02, -0.02, 0.02, -0.02, 0.02]);
    let text = calibrate(&tilted).unwrap_err().to_string();
    assert!(text.contains("orientation residual") && text.contains("urad"), "{text}");
}

#[test]
fn backlash_is_rounded_half_away_and_the_remainder_reported() {
    let mut machine = Machine::paper();
    machine.drives[0].backlash = 325.0;
    machine.drives[1].backlash = 324.0;
    let (calibration, report) = calibrate(&machine).unwrap();
    assert_eq!([calibration.motors[0].backlash_steps, calibration.motors[1].backlash_steps], [7, 6]);
    assert_eq!(report.backlash_remainder[..3], [-25.0, 24.0, 0.0]);
    assert_eq!(report.backlash_remainder[3], -1000.0);
}

#[test]
fn a_step_folded_into_the_coupling_gives_unity_back() {
    for machine in all_machines() {
        let (calibration, _) = calibrate(&machine).unwrap();
        let held = Law::of_block(&calibration, machine.drives.map(|drive| drive.step));
        for (i, gain) in held.rotary_gain.into_iter().enumerate() {
            // Half a unit of a coefficient of at least 2^29.
            assert!((gain - 1.0).abs() < 1e-9, "{} {i}: {gain}", machine.name);
        }
        for value in calibration.inverse_slides.as_flattened() {
            assert!(value.unsigned_abs() < 1 << 31);
        }
    }
}
