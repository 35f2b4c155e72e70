//! From poses to light, readings and samples.

use super::{HOME, SEGMENT, still};
use host_sim::bench_twin::{Bench, Options, Sees, Sheets, Side, Start};
use host_sim::optics::{Adc, Burst, DARK_DBM, FrontEnd, Medium, Mode, Pair};

#[test]
fn an_array_that_looks_at_the_guide_loses_less_than_one_that_looks_away() {
    let mut options = still();
    options.core_sigma_um = 0.0;
    let bench = Bench::seeded(2, &options);
    let best = bench.optimum().poses;
    let loss = |beta: f64| {
        let mut poses = best;
        // 600 um back, 30 um to the side: the guide is to the left
        poses[1][0] += 30e3;
        poses[1][2] -= 590e3;
        poses[1][4] += beta;
        bench.losses(0, &poses)[0]
    };
    assert!(loss(-5e7) < loss(0.0) && loss(0.0) < loss(5e7), "{} {} {}", loss(-5e7), loss(0.0), loss(5e7));
}

#[test]
fn the_loss_of_a_channel_is_splitter_and_both_couplings() {
    let options = Options { sheets: Sheets::EXACT, ..still() };
    let bench = Bench::seeded(6, &options);
    let pair = Pair::new(Mode::round(4.8), Mode::round(5.2), options.medium);
    let mut excess = Vec::new();
    for poses in [HOME, bench.optimum().poses] {
        let input = pair.loss_db(&bench.misalignment(Side::Input, 0, 0, &poses[0]));
        let losses = bench.losses(0, &poses);
        excess.push([0, 3, 7].map(|i| {
            losses[i]
                - input
                - pair.loss_db(&bench.misalignment(Side::Output, i, 0, &poses[1]))
                - 10.0 * 8.0_f64.log10()
        }));
    }
    for i in 0..3 {
        assert!((excess[0][i] - excess[1][i]).abs() < 1e-9, "what is left belongs to the chip: {excess:?}");
        assert!((excess[0][i] - 0.6).abs() < 0.25, "{excess:?}");
    }
}

#[test]
fn the_meter_sees_the_fibre_or_the_detector_that_it_is_put_before() {
    let mut bench = Bench::seeded(8, &still());
    let best = bench.optimum();
    bench.connect(0, Sees::Fibre(2));
    bench.connect(1, Sees::Detector);
    let light = bench.light(0, best.poses);
    assert!((light[0] + best.losses_db[2]).abs() < 1e-9, "{light:?}");
    assert!((light[1] + 0.6).abs() < 0.2, "all outputs together: {light:?}");
    // the detector needs no array
    let mut aside = best.poses;
    aside[1][0] += 100e3;
    let far = bench.light(SEGMENT, aside);
    assert!(far[0] < -100.0);
    assert!((far[1] - light[1]).abs() < 1e-12);
    bench.break_fibre(2, true);
    assert_eq!(bench.light(2 * SEGMENT, best.poses)[0], DARK_DBM);
    bench.break_fibre(2, false);
    bench.laser(None);
    let dark = bench.light(3 * SEGMENT, best.poses);
    assert!(dark.iter().all(|dbm| *dbm < -190.0), "{dark:?}");
    bench.laser(Some(3.0));
    let bright = bench.light(4 * SEGMENT, best.poses);
    assert!((bright[0] - light[0] - 3.0).abs() < 1e-9);
    bench.connect(1, Sees::Nothing);
    assert_eq!(bench.light(5 * SEGMENT, best.poses)[1], DARK_DBM);
}

#[test]
fn the_boards_read_the_power_through_either_front_end() {
    for (front_end, tolerance) in [(FrontEnd::LOGARITHMIC, 0.01), (FrontEnd::LINEAR, 0.004)] {
        let mut bench = Bench::seeded(9, &Options { front_end, ..still() });
        let best = bench.optimum();
        let light = bench.light(0, best.poses);
        for side in Side::BOTH {
            for (code, light) in bench.codes(side).into_iter().zip(light) {
                let power = front_end.power(Adc::volts(code));
                assert!((10.0 * power.log10() - light).abs() < tolerance, "{code}: {power} mW, {light} dBm");
            }
        }
        assert_eq!(bench.codes(Side::Input), bench.codes(Side::Output), "without noise both boards see the same");
    }
    let mut bench = Bench::seeded(9, &Options::default());
    bench.light(0, HOME);
    let best = bench.optimum().poses;
    let mut differ = 0;
    for k in 1..100 {
        bench.light(k * SEGMENT, best);
        assert_eq!(bench.codes(Side::Input), bench.codes(Side::Input), "a sample is not taken twice");
        differ += u32::from(bench.codes(Side::Input) != bench.codes(Side::Output));
    }
    assert!(differ > 80, "each board has a converter of its own");
}

#[test]
fn bursts_and_the_end_of_the_range_reach_the_reading() {
    let mut bench = Bench::seeded(9, &Options::default());
    let best = bench.optimum().poses;
    bench.light(0, best);
    bench.disturb(0, Some(Burst { from: 0, until: 1000 * SEGMENT, noise_db: 1.0 }));
    let mut off = [0.0_f64; 2];
    for k in 1..1000 {
        let light = bench.light(k * SEGMENT, best);
        let readings = bench.readings();
        (0..2).for_each(|i| off[i] = off[i].max((readings[i] - light[i]).abs()));
    }
    assert!(off[0] > 2.0 && off[1] < 0.1, "{off:?}");
    bench.laser(Some(16.0));
    for k in 1000..1010 {
        bench.light(k * SEGMENT, best);
    }
    assert!(bench.is_saturated(0) && bench.is_saturated(1));
    assert!(bench.readings().iter().all(|dbm| (dbm - 3.0).abs() < 1e-9));
}

#[test]
fn from_ten_micrometres_most_benches_show_light_at_once_and_from_thirty_few_do() {
    let shown = |start: Start, sees: Sees| {
        let light = |seed| Bench::seeded(seed, &Options { start, sees: [sees; 2], ..still() }).light(0, HOME)[0];
        (0..400).filter(|seed| light(*seed) > -55.0).count() as f64 / 400.0
    };
    let [near, far] =
        [Start::CAMERAS, Start::COARSE].map(|s| [Sees::Fibre(0), Sees::Detector].map(|sees| shown(s, sees)));
    println!("figure: more than -55 dBm at home in 400 benches, fibre 1 and detector: 10 um {near:?}, 30 um {far:?}");
    assert!(near[0] > 0.8 && near[1] > near[0]);
    assert!(far[0] < 0.3 && far[1] > far[0] && far[1] < 0.6);
}

#[test]
fn every_bench_has_modes_of_its_own_about_the_data_sheets_and_air_is_air() {
    let index = |index: f64| Medium { index, ..Options::default().medium };
    let loss = |seed: u64, sheets: Sheets, medium: Medium| {
        let bench = Bench::seeded(seed, &Options { sheets, medium, ..still() });
        bench.losses(0, &bench.optimum().poses)[0]
    };
    let drawn: Vec<f64> = (1..=3).map(|seed| loss(seed, Sheets::default(), index(1.5))).collect();
    for (seed, drawn) in (1..).zip(drawn) {
        assert_eq!(drawn, loss(seed, Sheets::default(), index(1.5)), "the same seed, the same modes");
        let told = (drawn - loss(seed, Sheets::EXACT, index(1.5))).abs();
        assert!(told > 1e-5 && told < 0.2, "{told}");
    }
    let medium_alone = Sheets { radius: 0.0, ..Sheets::default() };
    assert_eq!(loss(1, medium_alone, index(1.0)), loss(1, Sheets::EXACT, index(1.0)));
    assert_ne!(loss(1, medium_alone, index(1.5)), loss(1, Sheets::EXACT, index(1.5)));
}
