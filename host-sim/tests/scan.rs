//! Scans find the peak of a spot, and end where they should.

mod light;

use light::{Bench, DONE_WITH_PEAK, Spot};

#[test]
fn a_line_finds_the_peak_on_either_flank_and_goes_there() {
    for (seed, flank) in [(1, "POS"), (2, "NEG"), (3, "POS"), (4, "NEG")] {
        let mut bench = Bench::new(Spot::new([0.0; 3]), seed);
        bench.spot.at = [bench.between(-4000.0, 4000.0), 0.0, 0.0];
        bench.good("SENS:AVER 1");
        bench.good(&format!("SCAN:DEF:LINE 0,1,1,20,0.05,-60,PEAK,{flank}"));
        let outcome = bench.scan(0);
        assert!(bench.error().starts_with("0,"));
        let [peak, sigma, ended] = outcome.axes[0];
        println!("{seed} {flank}: spot {:?}, {outcome:?}, stands {:?}", bench.spot.at, bench.truth());
        assert_eq!(outcome.status, DONE_WITH_PEAK);
        assert!((399..=402).contains(&outcome.samples), "{outcome:?}");
        assert!((peak * 1000.0 - bench.spot.at[0]).abs() < 20.0 && sigma < 0.01, "{outcome:?}");
        assert!((ended - peak).abs() < 0.03 && (bench.truth()[0] - bench.spot.at[0]).abs() < 60.0);
        assert!((outcome.level - bench.spot.top).abs() < 0.01);
    }
}
