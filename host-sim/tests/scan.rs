//! Scans find the peak of a spot, and end where they should.

mod light;

use host_sim::board::Interleaving;
use host_sim::machine::Machine;
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
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK);
        assert!((399..=402).contains(&outcome.samples), "{outcome:?}");
        assert!((peak * 1000.0 - bench.spot.at[0]).abs() < 20.0 && sigma < 0.01, "{outcome:?}");
        assert!((ended - peak).abs() < 0.03 && (bench.truth()[0] - bench.spot.at[0]).abs() < 60.0);
        assert!((outcome.level - bench.spot.top).abs() < 0.01);
    }
}

/// What compensates the play, and how.
const WAYS: [&str; 5] = [
    "COMP:STAT ON",
    "COMP:STAT OFF",
    "COMP:BACK:STAT OFF",
    "AXIS1:BACK:MODE OFF;:AXIS2:BACK:MODE OFF",
    "AXIS1:BACK:MODE UNIP",
];

#[test]
fn lines_and_parabolas_find_the_peak_whatever_the_play_does() {
    for seed in 0..40u64 {
        let mut bench = Bench::new(Spot::new([0.0; 3]), seed);
        bench.spot.at = [bench.between(-3000.0, 3000.0), bench.between(-500.0, 500.0), 0.0];
        let way = WAYS[seed as usize / 2 % WAYS.len()];
        let flank = if way.ends_with("UNIP") { "POS" } else { ["POS", "NEG"][seed as usize % 2] };
        bench.good(way);
        // anywhere within the play
        let away = bench.between(-3.0, 3.0);
        bench.good(&format!("AXIS1:MOVE:REL {away:.3};*OPC?"));
        bench.good(&format!("AXIS1:MOVE:REL {:.3};*OPC?", -away));
        let kind = seed / 4 % 2;
        bench.good(
            match kind {
                0 => format!("SENS:AVER 2;:SCAN:DEF:LINE 3,1,1,16,0.04,-60,PEAK,{flank}"),
                _ => format!("SENS:AVER 16;:SCAN:DEF:PAR 3,1,1,8,9,-60,PEAK,{flank}"),
            }
            .as_str(),
        );
        let outcome = bench.scan(3);
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK, "{seed}");
        // where it stands is where the light is, though the coordinate may be off by the play
        assert!((bench.truth()[0] - bench.spot.at[0]).abs() < 35.0, "{seed}: {:?} {:?}", bench.truth(), bench.spot);
        assert!(outcome.axes[0][1] < 0.03, "{seed}: {outcome:?}");
        assert!(bench.error().starts_with("0,"));
    }
}

#[test]
fn rasters_find_the_peak_of_two_axes() {
    for seed in 0..6u64 {
        let mut bench = Bench::new(Spot::new([0.0; 3]), seed);
        bench.spot.at = [bench.between(-3000.0, 3000.0), bench.between(-3000.0, 3000.0), 0.0];
        bench.good(WAYS[seed as usize % 4]);
        bench.good("SENS:AVER 1;:SCAN:DEF:RAST 1,1,1,2,14,12,0.1,1.5,-60,PEAK");
        let outcome = bench.scan(1);
        println!("{:?} {outcome:?}", bench.spot.at);
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK, "{seed}");
        for n in 0..2 {
            assert!((bench.truth()[n] - bench.spot.at[n]).abs() < 40.0, "{seed}: {:?} {:?}", bench.truth(), bench.spot);
        }
    }
}

#[test]
fn a_spiral_stops_at_first_light_or_goes_to_the_brightest_place() {
    for seed in 0..6u64 {
        for (end, within) in [("FIRS", 8600.0), ("PEAK", 3000.0)] {
            let mut bench = Bench::new(Spot::new([0.0; 3]), seed);
            bench.spot.at = [bench.between(-12000.0, 12000.0), bench.between(-12000.0, 12000.0), 0.0];
            bench.run(10);
            bench.good(&format!("SENS:AVER 1;:SCAN:DEF:SPIR 2,1,1,2,26,0.2,4,-12,{end}"));
            let outcome = bench.scan(2);
            let truth = bench.truth();
            let apart = (truth[0] - bench.spot.at[0]).hypot(truth[1] - bench.spot.at[1]);
            println!("{seed} {end}: {apart} {:?} {outcome:?}", bench.spot.at);
            assert!(outcome.status & 5 == 5 && apart < within, "{seed}: {apart} {outcome:?}");
            assert!(bench.error().starts_with("0,"));
        }
    }
}

#[test]
fn a_climb_reaches_the_top_of_two_axes() {
    for seed in 0..6u64 {
        let mut bench = Bench::new(Spot::new([0.0; 3]), seed);
        bench.spot.at = [bench.between(-4000.0, 4000.0), bench.between(-4000.0, 4000.0), 0.0];
        println!("{}", bench.line("AXIS1:BACK:STAT?;MODE?;:COMP:BACK:STAT?;:COMP:STAT?"));
        bench.good("SENS:AVER 16;:SCAN:DEF:HILL 5,1,(@1,2),30,1,0.1,1");
        let outcome = bench.scan(5);
        let truth = bench.truth();
        let apart = (truth[0] - bench.spot.at[0]).hypot(truth[1] - bench.spot.at[1]);
        println!("{seed}: {apart} {outcome:?}");
        assert!(outcome.status == DONE_WITH_PEAK && apart < 400.0, "{seed}: {apart} {outcome:?}");
    }
}

#[test]
fn a_climb_whose_steps_the_play_swallows_is_refused_with_the_least_step_that_works() {
    let mut bench = Bench::new(Spot::new([1000.0, 0.0, 0.0]), 1);
    bench.good("SCAN:DEF:HILL 0,1,(@1,2),20,0.4,0.1,1;:COMP:BACK:STAT OFF");
    bench.line("SCAN:STAR 0");
    assert_eq!(bench.error(), "-221,\"Settings conflict;AXIS1 play takes step or range: 0.100 um below 0.301 um\"");
    assert_eq!(bench.line("SCAN:STAT?"), "IDLE,0");
    // as many steps as it takes, or one that is large enough
    for definition in ["20,0.4,0.1,4", "20,0.4,0.301,1"] {
        bench.good(&format!("SCAN:DEF:HILL 0,1,(@1,2),{definition}"));
        assert_eq!(bench.scan(0).status & !32, DONE_WITH_PEAK);
        bench.good("AXIS1:MOVE 0;:AXIS2:MOVE 0;*OPC?");
    }
    for mode in ["COMP:BACK:STAT ON;:COMP:STAT OFF", "COMP:STAT ON;:AXIS1:BACK:MODE OFF"] {
        bench.good(&format!("{mode};:SCAN:DEF:HILL 0,1,(@1,2),20,0.3,0.3,1"));
        bench.line("SCAN:STAR 0");
        assert!(bench.error().starts_with("-221,"), "{mode}");
    }
    bench.good("AXIS1:BACK:MODE REV;:SCAN:DEF:HILL 0,1,(@1,2),20,0.2,0.1,1");
    assert_eq!(bench.scan(0).status & !32, DONE_WITH_PEAK);
}

#[test]
fn a_climb_whose_range_the_play_swallows_is_refused_with_the_least_range_that_works() {
    let mut bench = Bench::new(Spot::new([100.0, 0.0, 0.0]), 1);
    bench.good("AXIS1:BACK:MODE OFF;:SCAN:DEF:HILL 0,1,(@1),0.28,0.1,0.02,100");
    bench.line("SCAN:STAR 0");
    assert_eq!(bench.error(), "-221,\"Settings conflict;AXIS1 play takes step or range: 0.280 um below 0.640 um\"");
    assert_eq!(bench.line("SCAN:STAT?"), "IDLE,0");
    bench.good("SCAN:DEF:HILL 0,1,(@1),0.64,0.1,0.02,100;:SCAN:STAR 0");
    let from = bench.truth()[0];
    let mut most = 0.0f64;
    while bench.line("SCAN:STAT?") != "IDLE,0" {
        bench.run(20);
        most = most.max((bench.truth()[0] - from).abs());
    }
    assert!(most > 15.0, "it moves the stage: {most} nm");
}

#[test]
fn a_spiral_stays_within_its_turns() {
    for (range, step, reach) in [(10, 10, 10.0), (10, 5, 5.0), (11, 4, 8.0)] {
        let mut bench = Bench::new(Spot::new([0.0; 3]), 1);
        bench.good(&format!("SENS:AVER 1;:SCAN:DEF:SPIR 2,1,1,2,{range},0.5,{step},20,STAR;:SCAN:STAR 2"));
        let (mut least, mut most) = ([0.0f64; 2], [0.0f64; 2]);
        while bench.line("SCAN:STAT?") != "IDLE,0" {
            bench.run(10);
            let truth = bench.truth();
            for n in 0..2 {
                (least[n], most[n]) = (least[n].min(truth[n] / 1000.0), most[n].max(truth[n] / 1000.0));
            }
        }
        // but for the play, which is taken up before the end
        let near = |have: f64, want: f64| (have - want).abs() < 0.6;
        assert!((0..2).all(|n| near(least[n], -reach) && near(most[n], reach)), "{range} {step}: {least:?} {most:?}");
    }
}

#[test]
fn a_late_meter_moves_no_peak() {
    for late in [0, 4, 40, 390] {
        for (definition, axes, within) in [
            ("LINE 0,1,1,16,0.05,-60,STAR", 1, 12.0),
            ("LINE 0,1,1,16,0.05,-60,STAR,NEG", 1, 12.0),
            ("RAST 0,1,1,2,8,6,0.1,2,-60,STAR", 2, 30.0),
            // a spiral is as good as half its step, and half a pitch while the meter is late
            ("SPIR 0,1,1,2,10,0.5,2,-60,STAR", 2, 1250.0),
            ("SPIR 0,1,1,2,10,9,2,-60,STAR", 2, 2000.0),
            ("HILL 0,1,(@1,2),8,0.5,0.1,1,-60,STAR", 2, 400.0),
            ("PAR 0,1,1,8,5,-60,STAR", 1, 12.0),
        ] {
            let mut bench = Bench::new(Spot::new([1234.0, 0.0, 0.0]), 9);
            bench.spot.late = late;
            bench.good(&format!("SENS:AVER 1;DEL {} US;:SCAN:DEF:{definition}", 256 * late));
            let outcome = bench.scan(0);
            println!("{late} {definition}: {outcome:?}");
            let apart = [1234.0, 0.0].into_iter().zip(&outcome.axes).map(|(at, axis)| (axis[0] * 1000.0 - at).abs());
            assert!(
                outcome.axes.len() == axes && apart.fold(0.0, f64::max) < within,
                "{late} {definition}: {outcome:?}"
            );
            assert!(bench.truth()[0].abs() < 60.0, "back where it began");
            // 96 um of spiral, a sample each half um
            assert!(!definition.contains(",0.5,2,-60") || outcome.samples > 180, "{late} {definition}: {outcome:?}");
        }
    }
}

#[test]
fn an_angle_is_scanned_about_the_held_pivot_on_machines_with_levers() {
    for (n, machine) in ["paper", "long-lever"].into_iter().enumerate() {
        let path = format!("{}/machines/{machine}.toml", env!("CARGO_MANIFEST_DIR"));
        let machine = Machine::parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
        for axis in 3..6 {
            let mut spot = Spot::new([0.0; 3]);
            spot.width = [50_000.0; 3];
            spot.tilt = Some((axis, 1_500_000.0, 9_000_000.0));
            let mut bench = Bench::of(&machine, spot, n as u64, Interleaving::Jittered(3));
            for flank in ["POS", "NEG"] {
                bench.good(&format!("SENS:AVER 1;:SCAN:DEF:LINE 0,1,{},1,0.002,-60,STAR,{flank}", axis + 1));
                let outcome = bench.scan(0);
                let off = outcome.axes[0][0].to_radians() * 1e9 - 1_500_000.0;
                // a step of 4 urad, and errors of the machine that the controller does not know
                assert!(outcome.status & !32 == DONE_WITH_PEAK && off.abs() < 20_000.0, "{axis} {off}: {outcome:?}");
            }
        }
    }
}

/// Results, and what was recorded of them, of every kind of scan on a board whose halves interleave in one way or
/// another.
fn heard(interleaving: Interleaving, seed: u64, average: u32) -> Vec<String> {
    let mut bench = Bench::of(&Machine::paper(), Spot::new([700.0, -400.0, 0.0]), seed, interleaving);
    (bench.spot.noise, bench.spot.width) = (0.0, [4000.0, 3000.0, 500_000.0]);
    bench.run(10);
    bench.good(&format!("SENS:AVER {average}"));
    let mut heard = Vec::new();
    for definition in [
        "LINE 0,1,1,12,0.2,-40,PEAK",
        "LINE 0,1,2,12,0.2,-40,PEAK,NEG",
        "RAST 0,1,1,2,8,6,0.2,3,-40,STAR",
        "SPIR 0,1,1,2,12,0.3,2,-40,PEAK",
        "SPIR 0,1,1,2,8,0.3,2,-6,FIRS",
        "HILL 0,1,(@1,2),8,1.5,0.5,1,-40,STAR",
        "PAR 0,1,1,6,5,-40,PEAK",
    ] {
        let from = if definition.contains("SPIR") { 3.5 } else { 0.0 };
        bench.good(&format!("POSE {from},{from},0,0,0,0;*OPC?"));
        bench.good(&format!("SCAN:DEF:{definition};:TRAC:CONF SCAN;ARM"));
        bench.good("SCAN:STAR 0");
        assert_eq!(bench.good("*OPC?"), "1");
        let mut told =
            format!("{definition}: {}", bench.good("SCAN:RES? 0;:AXIS1:POS:MOT?;:AXIS2:POS:MOT?;:TRAC:POIN?"));
        let points: usize = told.rsplit(';').next().unwrap().parse().unwrap();
        let records = bench.good(&format!("TRAC:DATA? 0,{}", points.min(40)));
        // but for the tick
        records
            .split(',')
            .collect::<Vec<_>>()
            .chunks(9)
            .for_each(|record| told += &format!("\n{}", record[1..].join(",")));
        heard.push(told);
    }
    heard
}

#[test]
fn what_a_scan_gives_does_not_depend_on_when_the_thread_hears_of_it() {
    for average in [1, 5] {
        let expected = heard(Interleaving::Prompt, 0, average);
        for seed in 1..5 {
            for (ours, expected) in heard(Interleaving::Jittered(4), seed, average).iter().zip(&expected) {
                assert_eq!(ours, expected, "seed {seed}, average {average}");
            }
        }
    }
}
