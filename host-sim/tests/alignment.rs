//! The alignment from what the cameras leave to the best that the bench allows.

use host_sim::alignment::{Lab, Options, align};
use host_sim::bench_twin::{self, Bench, Side};
use std::time::Instant;

#[test]
fn an_alignment_comes_to_the_best_that_the_bench_allows() {
    let from = |name: &str, or: u64| std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(or);
    for seed in from("FIRST_SEED", 1)..from("FIRST_SEED", 1) + from("SEEDS", 3) {
        let bench = Bench::seeded(seed, &bench_twin::Options::default());
        let optimum = bench.optimum();
        let calibrated = Side::BOTH.map(|side| bench.calibrated(side).unwrap().machine);
        let mut lab = Lab::new(bench, &calibrated, seed).unwrap();
        let start = Instant::now();
        let result = align(&mut lab, &Options::default(), &mut |step| println!("{step:?}"));
        let wall = start.elapsed().as_secs_f64();
        let losses = lab.losses();
        let worst = losses.iter().copied().fold(0.0, f64::max);
        let least = losses.iter().copied().fold(f64::INFINITY, f64::min);
        println!(
            "{seed}: worst {worst:.4} best {:.4} excess {:.4}, uniformity {:.4} best {:.4}, {:?} s, wall {wall:.2} s",
            optimum.worst_db,
            worst - optimum.worst_db,
            worst - least,
            optimum.uniformity_db,
            result.as_ref().map(|result| result.seconds)
        );
        for side in Side::BOTH {
            let (tick, poses) = (lab.tick(), lab.poses());
            println!(
                "  {side:?} {:?} clearance {:.2}",
                lab.bench().misalignment(side, 0, tick, &poses[side.index()]),
                lab.bench().clearance_um(side, tick, &poses[side.index()])
            );
        }
        if let Err(error) = result {
            println!("{seed}: {error}");
        }
    }
}
