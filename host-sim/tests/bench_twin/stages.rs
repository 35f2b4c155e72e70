//! The true stages: errors of the stated size, different on every bench.

use super::{HOME, SEGMENT, bench};
use host_sim::bench_twin::{Bench, Options, Side, StageErrors};
use host_sim::machine::{ErrorName, Machine, to_toml};
use stage_controller::units::Axis;

#[test]
fn a_seed_gives_one_bench_and_another_seed_another_one() {
    let poses = [[100.0, 200.0, 300.0, 4e4, 5e4, 6e4]; 2];
    let see = |seed: u64| {
        let mut bench = bench(seed);
        let machines = Side::BOTH.map(|side| to_toml(bench.machine(side)));
        bench.light(0, HOME);
        let light = bench.light(SEGMENT, poses);
        (machines, light, bench.readings(), Side::BOTH.map(|side| bench.codes(side)), bench.losses(0, &poses))
    };
    assert_eq!(see(3), see(3));
    assert_ne!(see(3).0, see(4).0);
    assert_ne!(see(3).4, see(4).4);
    let [input, output] = see(3).0;
    assert_ne!(input, output, "each side has a stage of its own");
}

#[test]
fn the_true_stages_have_errors_of_the_stated_size_that_vanish_at_home() {
    let sizes = StageErrors::default();
    let (mut offsets, mut count, mut largest) = (0.0, 0.0, [0.0_f64; 2]);
    for seed in 0..40 {
        let bench = bench(seed);
        for side in Side::BOTH {
            let machine = bench.machine(side);
            assert!(machine.statics.values().iter().all(|v| v.abs() <= sizes.static_rad && *v != 0.0));
            for name in ErrorName::all() {
                let error = machine.kinematic.get(name);
                assert!(error.value(0.0).abs() < 1e-15, "{}", name.iso());
                let [lower, upper] = machine.drives[name.axis.index()].travel;
                let unit = if name.axis.is_rotary() { 1e9 / 180.0 * std::f64::consts::PI } else { 1e3 };
                let bound = if name.component.is_angular() { sizes.kinematic_rad } else { sizes.kinematic_um };
                let screw = if name.component as usize == name.axis.index() { 2e-3 * sizes.screw_nm } else { 0.0 };
                for k in 0..=200 {
                    let at = (lower + (upper - lower) * f64::from(k) / 200.0) / unit;
                    let value = error.value(at).abs();
                    assert!(value <= bound + screw, "{} {value}", name.iso());
                    let kind = usize::from(name.component.is_angular());
                    largest[kind] = largest[kind].max(value / bound);
                }
            }
            for offset in machine.mounts.fibre.offset_nm.iter().chain(&machine.mounts.chip.offset_nm) {
                offsets += (offset * 1e-3_f64).powi(2);
                count += 1.0;
            }
            assert_eq!(machine.drives, Machine::paper().drives, "steps, play and travel are those of the drawing");
            assert_eq!(Machine::parse(&to_toml(machine)).unwrap().drives, machine.drives, "a machine file can hold it");
        }
    }
    assert!(((offsets / count).sqrt() / 200.0 - 1.0_f64).abs() < 0.1);
    assert!(largest[0] > 0.8 && largest[1] > 0.8, "the bounds are used: {largest:?}");
}

#[test]
fn the_screw_makes_an_error_with_its_lead_as_period() {
    let mut options = Options::default();
    options.stage.kinematic_um = 0.0;
    let bench = Bench::seeded(1, &options);
    let machine = bench.machine(Side::Output);
    for (axis, iso) in Axis::LINEAR.into_iter().zip(["EXX", "EYY", "EZZ"]) {
        let name = ErrorName::all().find(|name| name.iso() == iso).unwrap();
        let error = machine.kinematic.get(name);
        let values: Vec<f64> = (0..500).map(|um| error.value(f64::from(um))).collect();
        let range = values.iter().fold(0.0_f64, |m, v| m.max(*v)) - values.iter().fold(0.0_f64, |m, v| m.min(*v));
        assert!(range > 1e-4 && range <= 0.1 + 1e-9, "{} {range}", axis.name());
        assert!((error.value(137.0) - error.value(637.0)).abs() < 1e-12);
    }
}
