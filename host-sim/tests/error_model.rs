//! The error model against a second one, written from the definition alone: 4x4 matrices of plain numbers, rotations
//! by the power series of the exponential, the machine read from the text of its own file by a TOML value.

use host_sim::machine::{Kinematic, Machine};
use host_sim::model::{
    Chain, Compensation, Ensemble, ErrorModel, Form, Grid, Magnitudes, Motion, Truth, compensated_field, error_field,
};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use std::cell::Cell;
use std::f64::consts::PI;
use std::fmt::Write;

type M4 = [[f64; 4]; 4];

const UNIT: M4 = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
const STAGES: [&str; 6] = ["X", "Y", "Z", "alpha", "beta", "gamma"];

fn times(a: &M4, b: &M4) -> M4 {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn shift(v: [f64; 3]) -> M4 {
    let mut m = UNIT;
    (0..3).for_each(|i| m[i][3] = v[i]);
    m
}

/// exp of the cross matrix of `v` by its power series.
fn rotation([x, y, z]: [f64; 3]) -> M4 {
    let cross = [[0.0, -z, y, 0.0], [z, 0.0, -x, 0.0], [-y, x, 0.0, 0.0], [0.0; 4]];
    let (mut sum, mut term) = (UNIT, UNIT);
    for n in 1..30 {
        term = times(&term, &cross).map(|row| row.map(|v| v / f64::from(n)));
        (0..4).for_each(|i| (0..4).for_each(|j| sum[i][j] += term[i][j]));
    }
    sum
}

/// Inverse of a rotation and a shift.
fn inverse(m: &M4) -> M4 {
    let mut out = UNIT;
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = m[j][i];
        }
        out[i][3] = -(0..3).map(|k| m[k][i] * m[k][3]).sum::<f64>();
    }
    out
}

fn numbers(value: Option<&toml::Value>) -> Vec<f64> {
    let number = |v: &toml::Value| v.as_float().or(v.as_integer().map(|i| i as f64)).unwrap();
    value.map_or(vec![], |v| v.as_array().unwrap().iter().map(number).collect())
}

fn triple(value: Option<&toml::Value>) -> [f64; 3] {
    numbers(value).try_into().unwrap_or([0.0; 3])
}

/// A function of the file at a position.
fn function(file: Option<&toml::Value>, at: f64) -> f64 {
    let Some(file) = file else { return 0.0 };
    let rows = |key: &str| -> Vec<Vec<f64>> {
        file.get(key).map_or(vec![], |v| v.as_array().unwrap().iter().map(|row| numbers(Some(row))).collect())
    };
    let mut sum: f64 = numbers(file.get("poly")).iter().enumerate().map(|(n, c)| c * at.powi(n as i32)).sum();
    sum += rows("fourier")
        .iter()
        .map(|r| r[1] * (2.0 * PI * at / r[0]).cos() + r[2] * (2.0 * PI * at / r[0]).sin())
        .sum::<f64>();
    let table = rows("table");
    if let (Some(first), Some(last)) = (table.first(), table.last()) {
        sum += if at <= first[0] {
            first[1]
        } else if at >= last[0] {
            last[1]
        } else {
            let i = (1..table.len()).find(|&i| at < table[i][0]).unwrap();
            let part = (at - table[i - 1][0]) / (table[i][0] - table[i - 1][0]);
            table[i - 1][1] * (1.0 - part) + table[i][1] * part
        };
    }
    sum
}

/// The static error of a stage: an entry for each of the nine, with the stage that has it and the axis about which.
fn statics(file: &toml::Value, order: &[&str], k: usize) -> [f64; 3] {
    let get = |name: &str| file.get("static_rad").and_then(|t| t.get(name)).map_or(0.0, |v| v.as_float().unwrap());
    let later = |a: &str, b: &str| {
        let place = |n: &str| order.iter().position(|s| *s == n).unwrap();
        if place(a) > place(b) { place(a) } else { place(b) }
    };
    let mut v = [0.0; 3];
    for (name, a, b, about) in [("S_ZX", "Z", "X", 1), ("S_ZY", "Z", "Y", 0), ("S_XY", "X", "Y", 2)] {
        if later(a, b) == k {
            v[about] += get(name);
        }
    }
    for (about, letter) in ["x", "y", "z"].iter().enumerate() {
        if !["X", "Y", "Z"].contains(&order[k]) {
            v[about] += get(&format!("e{letter}_{}", order[k]));
        }
    }
    v
}

/// Placement of the fibre array in chip axes; positions in um and degrees, axis order.
fn placed(file: &toml::Value, at: [f64; 6], with_errors: bool) -> M4 {
    let order: Vec<&str> = file["order"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
    let mount = |name: &str| {
        let mount = file.get("mount").and_then(|m| m.get(name));
        let get = |key: &str| triple(mount.and_then(|m| m.get(key)));
        if with_errors { times(&shift(get("offset_um")), &rotation(get("rot_rad"))) } else { UNIT }
    };
    let mut m = inverse(&mount("chip"));
    for (k, stage) in order.iter().enumerate() {
        let index = STAGES.iter().position(|s| s == stage).unwrap();
        let q = at[index];
        m = times(&m, &shift(triple(file.get("axis_offset_um").and_then(|t| t.get(*stage)))));
        if with_errors {
            m = times(&m, &rotation(statics(file, &order, k)));
        }
        let mut v = [0.0; 3];
        v[index % 3] = if index < 3 { q } else { q * PI / 180.0 };
        m = times(&m, &if index < 3 { shift(v) } else { rotation(v) });
        if with_errors {
            let error = |direction: char| {
                let name = format!("E{direction}{}", ['X', 'Y', 'Z', 'A', 'B', 'C'][index]);
                function(file.get("kinematic").and_then(|t| t.get(*stage)).and_then(|t| t.get(name)), q)
            };
            m = times(&m, &shift(['X', 'Y', 'Z'].map(error)));
            m = times(&m, &rotation(['A', 'B', 'C'].map(error)));
        }
    }
    times(&m, &mount("fibre"))
}

fn point(m: &M4, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| m[i][3] + (0..3).map(|j| m[i][j] * p[j]).sum::<f64>())
}

/// E of F by the second model, um.
fn second(file: &toml::Value, at: [f64; 6]) -> [f64; 3] {
    let f = triple(file.get("fibre_point_um"));
    let (actual, ideal) = (point(&placed(file, at, true), f), point(&placed(file, at, false), f));
    std::array::from_fn(|i| actual[i] - ideal[i])
}

/// Text of a random machine of any order with all kinds of errors.
fn any_machine() -> impl Strategy<Value = String> {
    let order = Just(STAGES.to_vec()).prop_shuffle();
    let unit = || -1.0..1.0_f64;
    (order, prop::collection::vec(unit(), 60), prop::collection::vec(prop::array::uniform8(unit()), 36)).prop_map(
        |(order, v, functions)| {
            let mut take = v.into_iter();
            let mut next = |scale: f64| take.next().unwrap() * scale;
            let mut text = format!("name = \"any\"\norder = {order:?}\n");
            let mut three = |scale: f64| format!("[{:?}, {:?}, {:?}]", next(scale), next(scale), next(scale));
            writeln!(text, "fibre_point_um = {}", three(40_000.0)).unwrap();
            writeln!(text, "[mount.fibre]\noffset_um = {}\nrot_rad = {}", three(100.0), three(0.015)).unwrap();
            writeln!(text, "[mount.chip]\noffset_um = {}\nrot_rad = {}", three(100.0), three(0.015)).unwrap();
            writeln!(text, "[axis_offset_um]").unwrap();
            for stage in STAGES {
                writeln!(text, "{stage} = {}", three(3000.0)).unwrap();
            }
            writeln!(text, "[static_rad]").unwrap();
            let names = ["S_ZX", "S_ZY", "S_XY", "ex_gamma", "ey_gamma", "ex_beta", "ez_beta", "ey_alpha", "ez_alpha"];
            for name in names {
                writeln!(text, "{name} = {:?}", next(0.01)).unwrap();
            }
            for (s, stage) in STAGES.iter().enumerate() {
                writeln!(text, "[kinematic.{stage}]").unwrap();
                for (d, direction) in ['X', 'Y', 'Z', 'A', 'B', 'C'].into_iter().enumerate() {
                    let [a, b, c, d0, d1, d2, p, q] = functions[6 * s + d];
                    let size = if d < 3 { 3.0 } else { 1e-3 };
                    let reach = if s < 3 { 5000.0 } else { 3.0 };
                    let name = format!("E{direction}{}", ['X', 'Y', 'Z', 'A', 'B', 'C'][s]);
                    let poly =
                        format!("poly = [{:?}, {:?}, {:?}]", a * size, b * size / reach, c * size / reach / reach);
                    let table = format!(
                        "table = [[{:?}, {:?}], [{:?}, {:?}], [{:?}, {:?}]]",
                        -0.8 * reach,
                        d0 * size,
                        0.1 * p * reach,
                        d1 * size,
                        0.7 * reach,
                        d2 * size
                    );
                    let fourier =
                        format!("fourier = [[{:?}, {:?}, {:?}]]", reach * (0.6 + 0.5 * q), p * size, a * size);
                    let forms = match (6 * s + d) % 4 {
                        0 => poly,
                        1 => table,
                        2 => format!("{fourier}, {poly}"),
                        _ => format!("{table}, {fourier}"),
                    };
                    writeln!(text, "{name} = {{{forms}}}").unwrap();
                }
            }
            let paper = include_str!("../machines/paper.toml");
            text + &paper[paper.find("[axes.X]").unwrap()..]
        },
    )
}

fn any_position() -> impl Strategy<Value = [f64; 6]> {
    (prop::array::uniform3(-5000.0..5000.0_f64), prop::array::uniform3(-3.0..3.0_f64))
        .prop_map(|([x, y, z], [a, b, g])| [x, y, z, a, b, g])
}

fn radians([x, y, z, a, b, g]: [f64; 6]) -> [f64; 6] {
    [x, y, z, a.to_radians(), b.to_radians(), g.to_radians()]
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

fn for_any(check: impl Fn(&str, [f64; 6]) -> Result<(), TestCaseError>) {
    let mut runner = TestRunner::new(Config { failure_persistence: None, cases: 200, ..Config::default() });
    runner.run(&(any_machine(), any_position()), |(text, at)| check(&text, at)).unwrap();
}

#[test]
fn the_error_at_any_pose_of_any_machine_is_that_of_the_second_model() {
    for_any(|text, at| {
        let machine = Machine::parse(text).unwrap();
        let ours = ErrorModel::of(&machine).error_at(radians(at)).position_um;
        let wanted = second(&toml::from_str(text).unwrap(), at);
        prop_assert!(wanted.iter().any(|e| e.abs() > 1.0), "an error-free machine shows nothing");
        prop_assert!(apart(ours, wanted) < 1e-7, "{ours:?} against {wanted:?}");
        Ok(())
    });
}

#[test]
fn the_orientation_error_turns_the_ideal_array_into_the_actual_one() {
    for_any(|text, at| {
        let model = ErrorModel::of(&Machine::parse(text).unwrap());
        let turn = rotation(model.error_at(radians(at)).rotation_rad);
        let file: toml::Value = toml::from_str(text).unwrap();
        let (actual, ideal) = (placed(&file, at, true), placed(&file, at, false));
        let turned = times(&turn, &ideal);
        for i in 0..3 {
            prop_assert!((0..3).all(|j| (turned[i][j] - actual[i][j]).abs() < 1e-12));
        }
        Ok(())
    });
}

#[test]
fn the_true_pose_is_that_of_the_static_chain_and_what_kinematic_errors_add() {
    let moved = Cell::new(0);
    for_any(|text, at| {
        let mut machine = Machine::parse(text).unwrap();
        let [x, y, z, a, b, g] = radians(at);
        let motors = [x * 1e3, y * 1e3, z * 1e3, a * 1e9, b * 1e9, g * 1e9];
        let (model, truth) = (ErrorModel::of(&machine), Truth::new(&machine));
        let fibre = model.actual(radians(at), Form::Exact).point(model.fibre_point_um.into());
        prop_assert!((truth.place(motors).1 * 1e-3 - fibre).norm() < 1e-9);
        let with = truth.pose(motors);
        machine.kinematic = Kinematic::default();
        let (without, chain) = (Truth::new(&machine).pose(motors), Chain::new(&machine).true_pose(motors));
        for (i, (pose, chain)) in without.into_iter().zip(chain).enumerate() {
            prop_assert!((pose - chain).abs() < 1e-5, "{i}: {pose} {chain}");
        }
        moved.set(moved.get() + u32::from(with != without));
        Ok(())
    });
    assert!(moved.get() > 0, "some have kinematic errors");
}

#[test]
fn a_field_holds_the_same_errors_pose_by_pose() {
    let mut runner = TestRunner::new(Config { failure_persistence: None, cases: 10, ..Config::default() });
    let check = |text: String| {
        let machine = Machine::parse(&text).unwrap();
        let file: toml::Value = toml::from_str(&text).unwrap();
        for motion in [Motion::Linear, Motion::Angular] {
            let field = error_field(&ErrorModel::of(&machine), &Grid::travel(&machine, motion, 3));
            assert_eq!(field.deviations.len(), 27);
            for (number, deviation) in field.deviations.iter().enumerate() {
                let [x, y, z, a, b, g] = field.grid.pose(number);
                let wanted = second(&file, [x, y, z, a.to_degrees(), b.to_degrees(), g.to_degrees()]);
                prop_assert!(apart(deviation.position_um, wanted) < 1e-7);
                prop_assert_eq!(field.at(field.grid.places(number)), deviation.position_um);
            }
        }
        Ok(())
    };
    runner.run(&any_machine(), check).unwrap();
}

#[test]
fn the_first_order_forms_miss_only_the_second_order() {
    for_any(|text, at| {
        let full = Machine::parse(text).unwrap();
        let at = radians(at);
        let scaled = |factor: f64| {
            let mut model = ErrorModel::of(&full);
            model.statics = host_sim::machine::StaticErrors::from_values(model.statics.values().map(|v| v * factor));
            for mount in [&mut model.fibre_mount, &mut model.chip_mount] {
                mount.delta_um = mount.delta_um.map(|v| v * factor);
                mount.epsilon_rad = mount.epsilon_rad.map(|v| v * factor);
            }
            for name in host_sim::machine::ErrorName::all() {
                let position = at[name.axis.index()];
                let six = ErrorModel::of(&full).kinematic_errors(name.axis, position);
                let value = [six.delta_um, six.epsilon_rad].as_flattened()[name.component as usize];
                model.kinematic.set(name, host_sim::machine::Function::constant(value * factor));
            }
            model.first_order_gap(at, model.fibre_point_um)
        };
        let (small, tenth) = (scaled(0.01), scaled(0.001));
        for (a, b) in [(small.matrices_um, tenth.matrices_um), (small.sum_um, tenth.sum_um)] {
            prop_assert!(b < 0.02 * a + 1e-9, "{a} became {b}");
        }
        Ok(())
    });
}

#[test]
fn without_errors_both_forms_give_zero_everywhere() {
    let model = ErrorModel::nominal(&Machine::paper());
    let at = radians([1000.0, -2000.0, 500.0, 1.0, -2.0, 3.0]);
    for form in [Form::Exact, Form::FirstOrder] {
        assert_eq!(model.deviation(at, [1e4, 2e4, 3e4], form).position_um, [0.0; 3]);
    }
    assert_eq!(model.first_order(at, [1e4, 2e4, 3e4]).position_um, [0.0; 3]);
}

#[test]
fn the_exact_law_leaves_nothing_of_a_machine_whose_errors_are_static() {
    let mut runner = TestRunner::new(Config { failure_persistence: None, cases: 10, ..Config::default() });
    let check = |text: String| {
        let mut machine = Machine::parse(&text).unwrap();
        machine.kinematic = Default::default();
        let model = ErrorModel::of(&machine);
        for motion in [Motion::Linear, Motion::Angular] {
            let grid = Grid::travel(&machine, motion, 3);
            let left = compensated_field(&machine, &model, &grid, Compensation::Exact).unwrap();
            let home = model.error_at([0.0; 6]);
            let before = error_field(&model, &grid).from_home(&home);
            let length = |d: &host_sim::model::Deviation| apart(d.position_um, [0.0; 3]);
            prop_assert!(before.deviations.iter().map(length).fold(0.0, f64::max) > 1.0);
            prop_assert!(left.deviations.iter().all(|d| length(d) < 1e-6), "{:?}", left.deviations[0]);
        }
        Ok(())
    };
    runner.run(&any_machine(), check).unwrap();
}

#[test]
fn what_the_controller_s_law_leaves_is_the_kinematic_part_and_half_a_step() {
    let machine = Machine::parse(include_str!("../machines/long-lever.toml")).unwrap();
    for motion in [Motion::Linear, Motion::Angular] {
        let grid = Grid::travel(&machine, motion, 5);
        let left = |model: &ErrorModel| compensated_field(&machine, model, &grid, Compensation::Controller).unwrap();
        let largest = |field: &host_sim::model::Field| {
            field.deviations.iter().map(|d| apart(d.position_um, [0.0; 3])).fold(0.0, f64::max)
        };
        let rigid = ErrorModel::of(&machine);
        // steps of 10 and 20 nm and 1 urad at a lever of 52 mm about three axes
        let bound = 0.5 * (0.01_f64.hypot(0.01).hypot(0.02) + 3.0 * 0.052) + 0.005;
        assert!(largest(&left(&rigid)) < bound, "{}", largest(&left(&rigid)));
        let drawn = Ensemble::MonteCarlo.stage(&machine, &Magnitudes::default(), &grid, 7, 0);
        let wavy = ErrorModel { kinematic: drawn.kinematic.clone(), ..rigid.clone() };
        let alone = ErrorModel { kinematic: drawn.kinematic, ..ErrorModel::nominal(&machine) };
        let kinematic = error_field(&alone, &grid);
        assert!(largest(&kinematic) > 0.3);
        for (left, alone) in left(&wavy).deviations.iter().zip(&kinematic.deviations) {
            assert!(apart(left.position_um, alone.position_um) < bound + 0.02, "{left:?} {alone:?}");
        }
    }
}

#[test]
fn an_order_that_the_controller_refuses_says_why() {
    let text = include_str!("../machines/paper.toml").replacen(r#""Y", "gamma""#, r#""gamma", "Y""#, 1);
    let machine = Machine::parse(&text).unwrap();
    let grid = Grid::travel(&machine, Motion::Linear, 2);
    let model = ErrorModel::of(&machine);
    let refused = compensated_field(&machine, &model, &grid, Compensation::Controller).unwrap_err();
    assert!(refused.contains("Y is carried by gamma"), "{refused}");
}
