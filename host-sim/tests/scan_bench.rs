//! What goes wrong in a scan on the bench: it ends in a stated state, with one error and the stage where the manual says.

mod trouble;

use host_sim::alignment::{Bus, BusError, Lab};
use host_sim::bench_twin::{self, Sees, Side};
use host_sim::experiment::climb::{Log, climb};
use stage_controller::units::Axis;
use trouble::{Haunted, noisy};

/// Bits of the status of a scan.
const ENDED: u16 = 1;
const PEAK: u16 = 2;
const SATURATED: u16 = 16;
const LEFT_OUT: u16 = 32;
const STOPPED: u16 = 128;
const ERROR: u16 = 256;

/// Benches of a case: one while debugging.
fn seeds() -> std::ops::RangeInclusive<u64> {
    let count = if cfg!(debug_assertions) { 1 } else { 4 };
    println!("figure: {count} of 4 benches");
    1..=count
}

/// Every kind, about the place of the stage.
const KINDS: [&str; 5] = [
    "SCAN:DEF:LINE 0,1,1,26,0.2,-52",
    "SCAN:DEF:RAST 0,1,1,2,20,20,0.5,4,-52",
    "SCAN:DEF:SPIR 0,1,1,2,16,0.4,4,-52",
    "SCAN:DEF:HILL 0,1,(@1,2),30,1,0.2,2,-52",
    "SCAN:DEF:PAR 0,1,1,8,7,-52",
];

/// A bench whose first input sees the light behind the chip, which the input side brings in: up to 10 um aside.
fn bench(seed: u64, options: &bench_twin::Options) -> Haunted {
    let mut bench = Haunted::new(seed, options);
    bench.look(0, Sees::Detector);
    for side in Side::BOTH {
        let meter = "SENS1:INP LOG,20,-60;RANG 2.9;DEL 36 US;AVER 4;:SENS2:INP LOG,20,-60;RANG 2.9;DEL 36 US";
        bench.at_side(side).run(meter, 1.0).unwrap();
    }
    bench.pause(0.05).unwrap();
    bench
}

fn standard(seed: u64) -> Haunted {
    bench(seed, &bench_twin::Options::default())
}

/// Runs a scan of the input side to its end: the errors in the queue, status, and the whole result.
fn scan(bench: &mut Haunted, definition: &str) -> (Vec<String>, u16, Vec<f64>) {
    let mut controller = bench.at_side(Side::Input);
    let result = controller.run(&format!("{definition};:SCAN:STAR 0"), 60.0);
    let errors = match result {
        Ok(()) => Vec::new(),
        Err(BusError::Refused { error, .. }) => vec![error],
        Err(other) => panic!("{definition}: {other}"),
    };
    let result = controller.numbers("SCAN:RES? 0").unwrap();
    (errors, result[0] as u16, result)
}

/// To the light, so that kinds that climb have something to climb on.
fn near_the_peak(bench: &mut Haunted) {
    for axis in [1, 2] {
        let (errors, status, _) = scan(bench, &format!("SCAN:DEF:LINE 0,1,{axis},26,0.2,-58"));
        assert!(errors.is_empty() && status & (ENDED | PEAK) == ENDED | PEAK, "{errors:?} {status}");
    }
    bench.at_side(Side::Input).move_by([1.0, -1.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
}

/// A scan of every kind fails with this error and the stage is back.
fn all_fail(seed: u64, prepare: impl Fn(&mut Haunted), error: &str) -> u16 {
    let mut all = 0xffff;
    for definition in KINDS {
        let mut bench = standard(seed);
        near_the_peak(&mut bench);
        prepare(&mut bench);
        bench.pause(0.05).unwrap();
        let start = bench.at_side(Side::Input).pose().unwrap();
        let (errors, status, result) = scan(&mut bench, definition);
        assert_eq!(errors, [error], "{seed} {definition}: {result:?}");
        assert_eq!(status & (ENDED | PEAK | ERROR), ERROR, "{seed} {definition}: {result:?}");
        let end = bench.at_side(Side::Input).pose().unwrap();
        assert!(
            start.iter().zip(end).all(|(start, end)| (start - end).abs() < 0.03),
            "{definition}: {start:?} {end:?}"
        );
        bench.is_well();
        all &= status;
    }
    all
}

#[test]
fn without_light_the_stage_is_back_where_the_scan_began() {
    for seed in seeds() {
        all_fail(
            seed,
            |bench| bench.lab.bench_mut().laser(None),
            "113,\"Scan without result;no light above the threshold\"",
        );
    }
}

#[test]
fn a_dead_channel_gives_no_peak_and_the_other_input_still_does() {
    for seed in seeds() {
        let dead = |bench: &mut Haunted| {
            bench.lab.bench_mut().break_fibre(3, true);
            bench.look(1, Sees::Detector);
            bench.look(0, Sees::Fibre(3));
        };
        all_fail(seed, dead, "113,\"Scan without result;no light above the threshold\"");
        let mut bench = standard(seed);
        near_the_peak(&mut bench);
        dead(&mut bench);
        let (errors, status, _) = scan(&mut bench, "SENS2:AVER 4;:SCAN:DEF:LINE 0,2,1,10,0.1,-52");
        assert!(errors.is_empty() && status & PEAK != 0, "{errors:?} {status}");
    }
}

#[test]
fn a_saturated_meter_gives_no_peak() {
    for seed in seeds() {
        let much = |bench: &mut Haunted| bench.lab.bench_mut().laser(Some(25.0));
        let status = all_fail(seed, much, "113,\"Scan without result;power saturated\"");
        assert!(status & SATURATED != 0);
    }
}

#[test]
fn bursts_of_noise_move_no_peak_of_a_line() {
    for seed in seeds() {
        let place = |bursts: bool| {
            let mut bench = standard(seed);
            // a burst of full light would be more than the meter can tell, and end the scan
            bench.lab.bench_mut().laser(Some(-10.0));
            near_the_peak(&mut bench);
            if bursts {
                // two or three samples in sixty
                for n in 0..2000u64 {
                    bench = bench.at(f64::from(n as u32) * 0.016, |lab| noisy(lab, 0.0005, 3.0));
                }
            }
            let (errors, status, result) = scan(&mut bench, "SENS1:AVER 1;:SCAN:DEF:LINE 0,1,1,20,0.05,-52,STAR");
            assert!(errors.is_empty() && status & PEAK != 0, "{errors:?} {status}");
            assert_eq!(status & LEFT_OUT != 0, bursts, "{seed}: {status}");
            bench.is_well();
            result[3]
        };
        let off_nm = (place(true) - place(false)) * 1e3;
        println!("figure: {seed}: bursts move the peak by {off_nm:.1} nm");
        assert!(off_nm.abs() < 30.0, "{seed}: {off_nm}");
    }
}

#[test]
fn noise_without_an_end_is_told_by_the_uncertainty_or_by_an_error() {
    for seed in seeds() {
        let mut bench = standard(seed);
        near_the_peak(&mut bench);
        let line = "SENS1:AVER 1;:SCAN:DEF:LINE 0,1,1,20,0.05,-52,STAR";
        bench.lab.bench_mut().laser(Some(-10.0));
        let calm = scan(&mut bench, line).2;
        for noise_db in [0.1, 0.3, 1.0] {
            noisy(&mut bench.lab, 1e3, noise_db);
            let start = bench.at_side(Side::Input).pose().unwrap();
            let (errors, status, result) = scan(&mut bench, line);
            let end = bench.at_side(Side::Input).pose().unwrap();
            [0, 1].into_iter().for_each(|channel| bench.lab.bench_mut().disturb(channel, None));
            assert!(start.iter().zip(end).all(|(start, end)| (start - end).abs() < 0.03), "{start:?} {end:?}");
            bench.is_well();
            let off = result[3] - calm[3];
            println!("figure: {seed}: noise of {noise_db} dB: {off:.4} um off, told as {:.4}, {errors:?}", result[4]);
            match errors.as_slice() {
                [] => assert!(status & PEAK != 0 && result[4] > 3.0 * calm[4] && off.abs() < 5.0 * result[4]),
                [error] => assert!(status & PEAK == 0 && error.starts_with("113,") && noise_db > 0.5, "{error}"),
                more => panic!("{more:?}"),
            }
        }
    }
}

#[test]
fn a_link_lost_in_a_scan_lets_it_end_by_itself() {
    for seed in seeds() {
        for definition in KINDS {
            let mut bench = standard(seed);
            near_the_peak(&mut bench);
            let mut at = 40;
            bench = bench.when(move |lab: &mut Lab| {
                at -= i32::from(lab.board(Side::Input).front.is_scanning());
                if at == 0 {
                    lab.cut(Side::Input);
                }
                at == 0
            });
            let lost = bench.at_side(Side::Input).run(&format!("{definition};:SCAN:STAR 0"), 20.0);
            let told = lost.unwrap_err();
            assert!(matches!(told, BusError::Silent { side: Side::Input, .. }), "{told}");
            assert!(told.to_string().contains("It ends what it was told last"), "{told}");
            bench.lab.mend(Side::Input);
            let result = bench.at_side(Side::Input).numbers("SCAN:RES? 0").unwrap();
            let status = result[0] as u16;
            assert_eq!(status & (ENDED | PEAK | STOPPED | ERROR), ENDED | PEAK, "{seed} {definition}: {result:?}");
            let pose = bench.at_side(Side::Input).pose().unwrap();
            assert!((pose[0] - result[5]).abs() < 0.01 && (result[3] - result[5]).abs() < 0.06, "{result:?} {pose:?}");
            bench.is_well();
        }
    }
}

#[test]
fn a_soft_limit_refuses_the_scan_before_its_first_step() {
    for seed in seeds() {
        for definition in KINDS {
            let mut bench = standard(seed);
            let limits = "AXIS1:LIM:SOFT:UPP 3.5;LOW -3.5;:AXIS2:LIM:SOFT:UPP 3.5;LOW -3.5";
            bench.at_side(Side::Input).run(limits, 1.0).unwrap();
            let told = bench.at_side(Side::Input).run(&format!("{definition};:SCAN:STAR 0"), 20.0).unwrap_err();
            let BusError::Refused { error, .. } = &told else { panic!("{told}") };
            assert!(error.starts_with("-222,\"Data out of range;AXIS") && error.contains(" um "), "{told}");
            assert!(told.to_string().contains("the way leads beyond a limit"), "{told}");
            assert_eq!(bench.lab.board(Side::Input).twin().motors().0, [0; 6], "{definition}");
            bench.is_well();
        }
    }
}

#[test]
fn a_limit_switch_in_the_way_stops_all_motors_at_its_step() {
    for seed in seeds() {
        let mut short = bench_twin::Options::default();
        short.drawing.drives[0].switches = [-7_000.0, 7_000.0];
        let mut bench = bench(seed, &short);
        bench.at_side(Side::Input).run("AXIS1:LIM:HARD:STAT ON", 1.0).unwrap();
        let (errors, status, _) = scan(&mut bench, "SCAN:DEF:LINE 0,1,1,26,0.2,-58");
        assert!(errors.len() == 1 && errors[0].starts_with("102,"), "{errors:?}");
        assert_eq!(status & (ENDED | PEAK | ERROR), ERROR);
        let x_um = bench.at_side(Side::Input).pose().unwrap()[0];
        // the switch is 7 um from where its motor began; within 20 us there is no further step
        assert!((6.9..7.3).contains(&x_um.abs()), "{x_um}");
        assert_eq!(bench.at_side(Side::Input).ask("SCAN:STAT?").unwrap(), "IDLE,0");
        bench.is_well();
        // and away from it it goes
        bench.at_side(Side::Input).run("AXIS1:MOVE:REL 5", 5.0).unwrap();
        bench.is_well();
    }
}

#[test]
fn a_drift_of_a_tenth_of_a_micrometre_a_minute_moves_the_peak_by_what_the_chip_moved() {
    for seed in seeds() {
        let peak = |drift_um_per_min: f64| {
            let mut bench = bench(seed, &bench_twin::Options { drift_um_per_min, ..Default::default() });
            near_the_peak(&mut bench);
            let (errors, status, result) = scan(&mut bench, "SENS1:AVER 1;:SCAN:DEF:LINE 0,1,1,10,0.05,-52,STAR");
            assert!(errors.is_empty() && status & PEAK != 0, "{errors:?} {status}");
            bench.is_well();
            (result[3], bench.lab.bench().drift_um(Side::Input, bench.lab.tick())[0])
        };
        let ((still, none), (moved, by)) = (peak(0.0), peak(0.1));
        println!("figure: {seed}: the chip moved {:.1} nm, the peak {:.1} nm", by * 1e3, (moved - still) * 1e3);
        assert!(none == 0.0 && (moved - still - by).abs() < 0.02, "{seed}: {still} {moved} {by}");
    }
}

#[test]
fn a_climb_whose_steps_the_play_swallows_is_refused_with_the_least_step_that_works() {
    for seed in seeds() {
        let mut bench = standard(seed);
        near_the_peak(&mut bench);
        let motors = |bench: &mut Haunted| bench.lab.board(Side::Input).twin().motors();
        let hill = |least: f64, patience: u32| format!("SCAN:DEF:HILL 0,1,(@1,2),30,1,{least},{patience},-52");
        for (switch, least, patience, works) in [
            ("COMP:BACK:STAT OFF", 0.1, 1, false),
            ("COMP:BACK:STAT OFF", 0.1, 2, false),
            ("COMP:BACK:STAT OFF", 0.25, 1, false),
            ("COMP:BACK:STAT OFF", 0.1, 4, true),
            ("COMP:BACK:STAT OFF", 0.5, 1, true),
            ("COMP:STAT OFF", 0.1, 1, false),
            ("COMP:STAT ON;BACK:STAT ON", 0.1, 1, true),
        ] {
            bench.at_side(Side::Input).run(switch, 1.0).unwrap();
            let before = motors(&mut bench);
            let started = bench.at_side(Side::Input).run(&format!("{};:SCAN:STAR 0", hill(least, patience)), 60.0);
            match &started {
                Err(BusError::Refused { error, .. }) => {
                    println!("{seed} {switch} {least} {patience}: {error}");
                    let told = "-221,\"Settings conflict;AXIS1 play takes step or range: ";
                    assert!(!works && error.starts_with(told) && error.ends_with(" um\""), "{switch} {least}: {error}");
                    // the reason has the least step that works, and it does
                    let words: Vec<&str> = error.trim_end_matches(" um\"").split(' ').collect();
                    let enough: f64 = words[words.len() - 1].parse().unwrap();
                    assert!((0.3..0.35).contains(&(enough * f64::from(patience)).max(0.3)), "{error}");
                    assert_eq!(motors(&mut bench), before, "nothing moved");
                    let (errors, status, _) = scan(&mut bench, &hill(enough, patience));
                    assert!(errors.is_empty() && status & PEAK != 0, "{enough}: {errors:?}");
                }
                other => {
                    assert!(works && other.is_ok(), "{seed} {switch} {least} {patience}: {other:?}");
                    let status = bench.at_side(Side::Input).numbers("SCAN:RES? 0").unwrap()[0] as u16;
                    assert!(status & PEAK != 0, "{seed} {switch} {least} {patience}: {status}");
                }
            }
            bench.is_well();
        }
    }
}

#[test]
fn the_naive_climb_is_made_of_moves_that_are_never_refused() {
    for seed in seeds() {
        for step_um in [0.1, 0.2, 0.3] {
            let mut bench = standard(seed);
            bench.look(0, Sees::Fibre(0));
            let mut log = Log::default();
            climb(&mut bench.lab, &["COMP:BACK:STAT OFF".into()], step_um, &mut log).unwrap();
            let tried = |axis: Axis| log.probes.iter().any(|probe| probe.at.axis == axis);
            assert!(log.moves > 8 && log.readings > 8 && tried(Axis::X) && tried(Axis::Y), "{seed} {step_um}");
            bench.is_well();
        }
    }
}
