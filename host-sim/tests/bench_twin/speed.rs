//! What a segment costs.

use super::{SEGMENT, bench};
use host_sim::bench_twin::{Bench, Side};
use host_sim::twin::Mechanics;
use stage_controller::units::{AXES, MotorSteps};
use std::hint::black_box;
use std::time::Instant;

#[test]
fn a_segment_of_light_costs_little() {
    let mut bench = bench(1);
    let best = bench.optimum().poses;
    let count = if cfg!(debug_assertions) { 20_000 } else { 1_000_000_u64 };
    bench.light(0, best);
    let mut tick = 0;
    let mut time = |what: &mut dyn FnMut(&mut Bench, u64)| {
        let start = Instant::now();
        for _ in 0..count {
            tick += SEGMENT;
            what(&mut bench, tick);
        }
        start.elapsed().as_secs_f64() * 1e9 / count as f64
    };
    let resting = time(&mut |bench, tick| {
        black_box(bench.light(tick, best));
    });
    let moving = time(&mut |bench, tick| {
        let mut poses = best;
        poses.iter_mut().for_each(|pose| pose[0] += (tick % 4096) as f64);
        black_box(bench.light(tick, poses));
    });
    let codes = time(&mut |bench, _| {
        black_box((bench.codes(Side::Input), bench.codes(Side::Output)));
    });
    let mut mechanics = Mechanics::new(super::bench(1).machine(Side::Output), [false; AXES]);
    let mut k = 0;
    let pose = time(&mut |_, _| {
        k += 1;
        mechanics.run_to(MotorSteps([k % 100; 6]));
        black_box(mechanics.true_pose());
    });
    println!(
        "figure: light of a segment at rest {resting:.0} ns, in motion {moving:.0} ns; samples of both boards \
         {codes:.0} ns; true pose of a stage {pose:.0} ns"
    );
    if !cfg!(debug_assertions) {
        assert!(resting < 3000.0 && moving < 9000.0, "three times the aim, for busy machines");
    }
}
