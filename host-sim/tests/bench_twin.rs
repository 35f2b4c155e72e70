//! scratch
use host_sim::bench_twin::*;
use std::time::Instant;
#[test]
fn scratch() {
    for seed in 0..5 {
        let bench = Bench::seeded(seed, &Options::default());
        let t = Instant::now();
        let o = bench.optimum();
        println!("{seed} {:?} {o:?}", t.elapsed());
        println!("clear {:?}", Side::BOTH.map(|s| bench.clearance_um(s, 0, &o.poses[s.index()])));
        println!("mis {:?}", bench.misalignment(Side::Output, 0, 0, &o.poses[1]));
        println!("mis {:?}", bench.misalignment(Side::Input, 0, 0, &o.poses[0]));
        for side in Side::BOTH {
            let t = Instant::now();
            match bench.calibrated(side) {
                Ok(i) => println!("cal {:?} {:?} lever/kin chi {} prob {} {:?}", t.elapsed(), i.warnings, i.chi_square, i.probability, i.outliers.len()),
                Err(e) => println!("cal {:?} {e}", t.elapsed()),
            }
        }
    }
}
