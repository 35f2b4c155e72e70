//! What goes wrong in a scan ends in a stated state, with one error and the stage where the manual says.

mod light;

use host_sim::board::{Board, Interleaving, Seeded};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use light::{Bench, DONE_WITH_PEAK, Spot};
use stage_controller::controller::links::Links;

const LINE: &str = "SENS:AVER 1;:SCAN:DEF:LINE 0,1,1,20,0.05,-40,PEAK";

fn bench(at: [f64; 3], seed: u64) -> Bench {
    let mut bench = Bench::new(Spot::new(at), seed);
    bench.good("AXIS1:LIM:HARD:STAT ON;:AXIS2:LIM:HARD:STAT ON");
    bench
}

/// Errors in the queue.
fn errors(bench: &mut Bench) -> Vec<String> {
    let mut all = Vec::new();
    loop {
        let error = bench.error();
        if error.starts_with("0,") {
            return all;
        }
        all.push(error);
    }
}

/// A scan that ends without a result: the stage is back where it began.
fn fails(bench: &mut Bench, definition: &str, why: &str) -> light::Outcome {
    let start = bench.line("AXIS1:POS?;:AXIS2:POS?");
    bench.good(definition);
    bench.good("SCAN:STAR 0");
    assert_eq!(bench.line("*OPC?"), "1");
    let outcome = bench.result(0);
    assert_eq!(errors(bench), [format!("113,\"Scan without result;{why}\"")], "{definition}: {outcome:?}");
    assert_eq!(outcome.status & 0x303, 256, "{definition}: {outcome:?}");
    assert_eq!(bench.line("AXIS1:POS?;:AXIS2:POS?"), start, "{definition}");
    assert_eq!(bench.line("SCAN:STAT?"), "IDLE,0");
    outcome
}

const KINDS: [&str; 5] = [
    "SCAN:DEF:LINE 0,1,1,20,0.1,-40",
    "SCAN:DEF:RAST 0,1,1,2,12,12,0.2,3,-40",
    "SCAN:DEF:SPIR 0,1,1,2,16,0.2,4,-40",
    "SCAN:DEF:HILL 0,1,(@1,2),10,1,0.2,1,-40",
    "SCAN:DEF:PAR 0,1,1,8,7,-40",
];

#[test]
fn without_light_every_scan_goes_back_to_where_it_began() {
    for end in ["PEAK", "STAY", "STAR", "FIRS"] {
        for definition in KINDS {
            for top in [-300.0, -70.0] {
                let mut bench = bench([0.0; 3], 3);
                (bench.spot.top, bench.spot.noise) = (top, 0.5);
                bench.run(10);
                bench.good("SENS:AVER 1;:AXIS1:MOVE 12.3;*OPC?");
                fails(&mut bench, &format!("{definition},{end}"), "no light above the threshold");
            }
        }
    }
}

#[test]
fn a_saturated_meter_gives_no_peak() {
    for definition in KINDS {
        let mut bench = bench([500.0, 0.0, 0.0], 4);
        bench.spot.top = 6.0;
        bench.run(10);
        bench.good("SENS:AVER 1");
        let outcome = fails(&mut bench, definition, "power saturated");
        assert!(outcome.status & 16 != 0);
        assert!(bench.line("STAT:QUES:COND?").parse::<u16>().unwrap() & 8 != 0);
        assert_eq!(bench.line("SENS:POW?"), "9.9E37");
    }
}

#[test]
fn a_maximum_beyond_the_range_is_none_and_its_edge_is_told() {
    // where the best place of each kind lies; the lines of a raster have their maxima
    for (kind, across, edge) in KINDS.into_iter().zip([0, 1, 0, 0, 0]).zip([10.0, 6.0, 8.0, 5.0, 4.0]).map(flat) {
        for at in [-14_000.0, 14_000.0] {
            let mut place = [0.0; 3];
            // enough lines of a raster must see it
            place[across] = if across == 1 { at / 2.0 } else { at };
            let mut bench = bench(place, 5);
            bench.good("SENS:AVER 1");
            let outcome = fails(&mut bench, kind, "no maximum within the range");
            let [best, sigma, _] = outcome.axes[across];
            assert!(outcome.status & 8 != 0 && (best - at.signum() * edge).abs() < 0.3, "{kind}: {outcome:?}");
            assert!(sigma > 1e37, "{kind}: {outcome:?}");
        }
    }
    // light there is what a search looks for
    let mut bench = bench([7500.0, 0.0, 0.0], 5);
    bench.good("SENS:AVER 1;:SCAN:DEF:SPIR 0,1,1,2,16,0.2,4,-3,FIRS");
    let outcome = bench.scan(0);
    assert!(outcome.status == 5 && (outcome.axes[0][0] - 7.5).abs() < 4.2, "{outcome:?}");
}

fn flat<A, B, C>(((a, b), c): ((A, B), C)) -> (A, B, C) {
    (a, b, c)
}

#[test]
fn a_climb_that_would_never_end_is_given_up_and_says_so() {
    let mut bench = bench([0.0; 3], 5);
    bench.good("SENS:AVER 1;:AXIS1:BACK:MODE UNIP;:AXIS1:MOVE 10;*OPC?");
    let outcome = fails(&mut bench, "SCAN:DEF:HILL 0,1,(@1),200,0.004,0.004,100,-60", "2000 points, no end");
    assert!(outcome.samples == 2000 && outcome.status & 0xf == 4 && outcome.axes[0][0] < 8.0, "{outcome:?}");
}

#[test]
fn bursts_of_noise_are_left_out() {
    for (every, burst) in [(37, 3.0), (23, -20.0), (50, 1.0)] {
        for seed in 0..5 {
            let mut bench = bench([0.0; 3], seed);
            bench.spot.at[0] = bench.between(-4000.0, 4000.0);
            bench.spot.bursts = (every, burst);
            bench.good(LINE);
            let outcome = bench.scan(0);
            assert_eq!(outcome.status & !32, DONE_WITH_PEAK, "{every} {burst}: {outcome:?}");
            // what lies far below is not looked at
            assert!(burst < 0.0 || outcome.status & 32 != 0, "{every} {burst}: {outcome:?}");
            let off = outcome.axes[0][0] * 1000.0 - bench.spot.at[0];
            assert!(off.abs() < 20.0, "{every} {burst}: {off}");
        }
    }
}

#[test]
fn light_that_goes_out_on_the_way_is_no_peak() {
    let mut bench = bench([0.0; 3], 6);
    bench.good(LINE);
    bench.good("SCAN:STAR 0");
    while bench.console.board.front.position().0[0] > -9_000 || bench.line("SCAN:STAT?") != "SAMP,0" {
        bench.run(1);
    }
    while bench.console.board.front.position().0[0] < -2_000 {
        bench.run(1);
    }
    bench.spot.top = -200.0;
    assert_eq!(bench.line("*OPC?"), "1");
    let outcome = bench.result(0);
    assert_eq!(outcome.status & 0x103, 256, "{outcome:?}");
    assert_eq!(errors(&mut bench).len(), 1);
    assert!(bench.truth()[0].abs() < 60.0);
}

#[test]
fn an_abort_at_any_word_stops_the_scan_there_and_the_next_one_is_right() {
    let machine = Machine::paper();
    for seed in 0..60u64 {
        let mut bench = Bench::of(&machine, Spot::new([700.0, -300.0, 0.0]), seed, Interleaving::Jittered(3));
        let mut dice = Seeded::new(seed);
        for _ in 0..4 {
            let _ = dice.next_u64();
        }
        bench.good("SENS:AVER 1");
        bench.good(KINDS[seed as usize % KINDS.len()]);
        bench.good("SCAN:STAR 0");
        bench.run(dice.below(900));
        let running = !bench.line("SCAN:STAT?").starts_with("IDLE");
        bench.console.board.stop_after(dice.below(257) as usize);
        let how = ["ABOR", "!", "*RST", "AXIS2:STOP:IMM"][dice.below(4) as usize];
        bench.line(how);
        assert_eq!(bench.line("*OPC?"), "1");
        assert_eq!(bench.line("SCAN:STAT?"), "IDLE,0");
        assert!(bench.error().starts_with("0,"), "an abort is no error");
        if running && how != "*RST" {
            assert_eq!(bench.result(0).status & 0x381, 128, "{seed} {how}");
            bench.line("SCAN:CONT");
            assert!(bench.error().starts_with("-221,"));
        }
        let counts = bench.console.board.front.motor_counts();
        assert_eq!(bench.console.board.twin().motors(), counts, "{seed}");
        // an axis that was stopped at speed has to be named again, or not: it was slow
        bench.good("AXIS1:MOVE 0;:AXIS2:MOVE 0;*OPC?");
        bench.good("SENS:AVER 1;:SCAN:DEF:LINE 0,1,1,24,0.1,-60,PEAK");
        let outcome = bench.scan(0);
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK, "{seed}: {outcome:?}");
        assert!((bench.truth()[0] - 700.0).abs() < 60.0, "{seed}: {:?}", bench.truth());
    }
}

#[test]
fn a_stopped_scan_goes_on_and_a_changed_frame_ends_it() {
    for (n, definition) in KINDS.into_iter().enumerate() {
        let mut bench = bench([600.0, 400.0, 0.0], n as u64);
        bench.good("SENS:AVER 1");
        bench.good(definition);
        bench.good("SCAN:STAR 0");
        for k in 0..6 {
            bench.run(90 + 37 * k);
            if bench.line("SCAN:STAT?") == "IDLE,0" {
                break;
            }
            bench.good(["SCAN:STOP", "STOP"][k as usize % 2]);
            assert_eq!(bench.line("*OPC?"), "1");
            assert_eq!(bench.line("SCAN:STAT?"), "STOP,0");
            assert_eq!(bench.result(0).status & 0x280, 128);
            bench.good("SCAN:CONT");
        }
        assert_eq!(bench.line("*OPC?"), "1");
        let outcome = bench.result(0);
        assert_eq!(outcome.status & 0x383, 3, "{definition}: {outcome:?}");
        let near = if n == 2 { 3000.0 } else { 300.0 };
        assert!((bench.truth()[0] - 600.0).abs() < near, "{definition} {:?}", bench.truth());
        bench.good("SCAN:STAR 0");
        bench.run(100);
        bench.good("SCAN:STOP;*OPC?");
        bench.good("AXIS1:POS:SET 100");
        bench.line("SCAN:CONT");
        assert!(bench.error().starts_with("-221,"), "{definition}");
    }
}

#[test]
fn what_stops_the_motors_ends_the_scan_with_its_own_error_once() {
    for (n, number) in ["103", "112", "102"].into_iter().enumerate() {
        let mut bench = bench([0.0; 3], 7 + n as u64);
        bench.good("SENS:AVER 1;:AXIS1:LIM:SOFT:STAT OFF");
        if number == "102" {
            // named so that the switch lies within the range: the travel is 5000 um, the switches are beyond
            bench.good("AXIS1:MOVE 4995;*OPC?");
            bench.good("AXIS1:POS:SET 0;:SCAN:DEF:LINE 0,1,1,2000,2,-60,PEAK");
        } else {
            bench.good("SCAN:DEF:LINE 0,1,1,200,0.5,-60,PEAK");
        }
        bench.good("SCAN:STAR 0");
        bench.run(400);
        match number {
            "103" => bench.console.board.press_stop(true),
            "112" => bench.console.board.set_fault(0, true),
            _ => {}
        }
        for _ in 0..40_000 {
            if bench.console.board.front.scan_state().0 == 0 {
                break;
            }
            bench.run(1);
        }
        bench.run(500);
        let all = errors(&mut bench);
        assert_eq!(all.iter().filter(|error| error.starts_with(number)).count(), 1, "{number}: {all:?}");
        assert!(all.iter().all(|error| error.starts_with(number)), "{number}: {all:?}");
        assert_eq!(bench.result(0).status & 0x303, 256, "{number}");
        assert_eq!(bench.line("SCAN:STAT?"), "IDLE,0");
        if number != "102" {
            assert_eq!(bench.console.board.twin().motors(), bench.console.board.front.motor_counts());
        }
    }
}

#[test]
fn a_scan_that_would_leave_a_limit_moves_nothing() {
    for definition in KINDS {
        let mut bench = bench([0.0; 3], 8);
        bench.good("AXIS1:LIM:SOFT:UPP 4.5;LOW -3");
        bench.good(definition);
        let counts = bench.console.board.front.motor_counts();
        bench.line("SCAN:STAR 0");
        let error = bench.error();
        assert!(
            error.starts_with("-222,\"Data out of range;AXIS1 ") && error.contains(" um "),
            "{definition}: {error}"
        );
        bench.run(300);
        assert_eq!(bench.console.board.front.motor_counts(), counts);
        bench.good("AXIS1:LIM:SOFT:UPP MAX;LOW MIN;:AXIS1:ENAB OFF");
        bench.line("SCAN:STAR 0");
        assert!(bench.error().starts_with("108,"), "{definition}");
    }
}

#[test]
fn while_a_scan_runs_what_would_disturb_it_is_refused() {
    let mut bench = bench([0.0; 3], 9);
    bench.good(LINE);
    bench.good("SCAN:STAR 0");
    bench.run(50);
    for (line, number) in [
        ("SCAN:STAR 0", "-213"),
        ("AXIS1:MOVE 5", "-213"),
        ("POSE:REL 1,0,0,0,0,0", "-213"),
        ("AXIS2:MOVE:JOG 5", "-213"),
        ("AXIS1:HOME", "-213"),
        ("SENS:AVER 3", "-213"),
        ("SCAN:DEF:LINE 0,1,1,20,0.05", "-213"),
        ("AXIS1:POS:SET 5", "104"),
        ("AXIS1:BACK:PREL POS", "104"),
        ("COMP:STAT OFF", "104"),
        ("SCAN:CONT", "-213"),
        ("SCAN:STAR 5", "-213"),
    ] {
        bench.line(line);
        let error = bench.error();
        assert!(error.starts_with(number), "{line}: {error} {}", bench.line("SCAN:STAT?"));
    }
    assert!(bench.line("STAT:OPER:COND?").parse::<u16>().unwrap() & 8 != 0);
    assert_eq!(bench.line("*OPC?"), "1");
    assert_eq!(bench.result(0).status & !32, DONE_WITH_PEAK);
    assert_eq!(bench.line("STAT:OPER:COND?").parse::<u16>().unwrap() & 8, 0);
}

#[test]
fn definitions_and_settings_refuse_nonsense_with_the_value() {
    let mut bench = bench([0.0; 3], 10);
    for (line, error) in [
        ("SCAN:DEF:LINE 8,1,1,20,0.1", "-222,\"Data out of range;8\""),
        ("SCAN:DEF:LINE 0,3,1,20,0.1", "-222,\"Data out of range;3\""),
        ("SCAN:DEF:LINE 0,1,7,20,0.1", "-222,\"Data out of range;7\""),
        ("SCAN:DEF:LINE 0,1,1,-20,0.1", "-222,\"Data out of range;-20\""),
        ("SCAN:DEF:LINE 0,1,1,20 DEG,0.1", "-131,\"Invalid suffix;20 DEG\""),
        ("SCAN:DEF:LINE 0,1,1,20,0", "-222,\"Data out of range;0\""),
        ("SCAN:DEF:LINE 0,1,1,20,0.1,-201", "-222,\"Data out of range;-201\""),
        ("SCAN:DEF:LINE 0,1,1,20,0.1,-20,TOP", "-104,\"Data type error;TOP\""),
        ("SCAN:DEF:RAST 0,1,1,1,20,20,1,1", "-221,\"Settings conflict;1\""),
        ("SCAN:DEF:RAST 0,1,1,2,20,100,1,1", "-222,\"Data out of range;1\""),
        ("SCAN:DEF:SPIR 0,1,1,4,20,1,1,-40", "-221,\"Settings conflict;4\""),
        ("SCAN:DEF:SPIR 0,1,1,2,200,1,1,-40", "-222,\"Data out of range;1\""),
        ("SCAN:DEF:SPIR 0,1,1,2,20,1,1", "-109,\"Missing parameter;SCAN:DEF:SPIR\""),
        ("SCAN:DEF:HILL 0,1,(@1,4),20,1,0.1,1", "-221,\"Settings conflict;(@1,4)\""),
        ("SCAN:DEF:HILL 0,1,(@1:6),20,1,0.1,1", "-221,\"Settings conflict;(@1:6)\""),
        ("SCAN:DEF:HILL 0,1,(@1),20,1,2,1", "-222,\"Data out of range;2\""),
        ("SCAN:DEF:HILL 0,1,(@1),20,1,1,0", "-222,\"Data out of range;0\""),
        ("SCAN:DEF:PAR 0,1,1,20,4", "-222,\"Data out of range;4\""),
        ("SENS3:AVER 2", "-114,\"Header suffix out of range;SENS3:AVER\""),
        ("SENS:AVER 0", "-222,\"Data out of range;0\""),
        ("SENS:AVER 257", "-222,\"Data out of range;257\""),
        ("SENS:DEL 0.2", "-222,\"Data out of range;0.2\""),
        ("SENS:INP LIN,0", "-222,\"Data out of range;0\""),
        ("SENS:INP LIN", "-109,\"Missing parameter;SENS:INP\""),
        ("SENS:INP LOG,20", "-109,\"Missing parameter\""),
        ("SENS:INP LIN,1,2", "-108,\"Parameter not allowed;2\""),
        ("SENS:RANG 30", "-222,\"Data out of range;30\""),
        ("TRIG:SOUR EXT", "-222,\"Data out of range;EXT\""),
        ("TRAC:DATA? 0,1", "-222,\"Data out of range;1\""),
        ("SCAN:STAR 3", "-221,\"Settings conflict;scan not defined\""),
    ] {
        bench.console.exchange(format!("{line}\n").as_bytes());
        bench.run(5);
        assert_eq!(bench.error(), error, "{line}");
    }
    // what is answered may be sent again
    for line in [
        "LINE 0,2,4,1,0.01,-33.5,STAY,NEG",
        "RAST 1,1,1,6,20,0.5,0.5,0.1,-20,PEAK,POS",
        "SPIR 2,1,2,3,26,0.5,4,-50,FIRS",
        "HILL 3,1,(@1,2,3),20,1,0.1,3,-60,STAR",
        "PAR 4,1,3,8,9,-60,PEAK,NEG",
    ] {
        let (kind, parameters) = line.split_once(' ').unwrap();
        bench.good(&format!("SCAN:DEF:{kind} {parameters}"));
        let answer = bench.good(&format!("SCAN:DEF:{kind}? {}", &parameters[..1]));
        bench.good(&format!("SCAN:DEF:{kind} {answer}"));
        assert_eq!(bench.good(&format!("SCAN:DEF:{kind}? {}", &parameters[..1])), answer);
    }
}

#[test]
fn a_link_that_closes_or_is_cleared_does_not_end_a_scan() {
    let machine = Machine::paper();
    let mut board = Board::new(&machine, power_up(&machine, false).unwrap(), Interleaving::Prompt, 1);
    assert!(board.settle());
    let mut links: Links<2> = Links::new();
    let link = links.open(0).unwrap();
    for line in ["SENS:AVER 1", "SCAN:DEF:LINE 0,1,1,10,0.05,-60,PEAK", "SCAN:STAR 0"] {
        links.receive(link, format!("{line}\n").as_bytes(), 0);
        links.poll(&mut board.front, 0);
    }
    let run = |board: &mut Board, links: &mut Links<2>, segments: u64| {
        for _ in 0..segments {
            board.step(|_| ());
            let off = (board.twin().true_pose()[0] - 1500.0) / 5000.0;
            let code = ((-off * off).exp() / 3.3 * 32768.0) as u16;
            board.set_power([code, code]);
            links.poll(&mut board.front, 0);
        }
    };
    run(&mut board, &mut links, 150);
    assert!(board.front.is_scanning());
    links.receive(link, b"*OPC?\n\x18", 0);
    links.close(link, &mut board.front);
    run(&mut board, &mut links, 3000);
    assert!(!board.front.operation_pending());
    let other = links.open(0).unwrap();
    links.receive(other, b"SCAN:RES? 0\n", 0);
    run(&mut board, &mut links, 1);
    let mut answer = [0; 200];
    let length = links.transmit(other, &mut answer);
    let answer = String::from_utf8_lossy(&answer[..length]).into_owned();
    assert!(answer.starts_with("7,") && answer.contains(",1.5"), "{answer}");
    assert!((board.twin().true_pose()[0] - 1500.0).abs() < 60.0);
}

#[test]
fn first_light_may_be_too_much_and_is_still_light() {
    let mut bench = bench([3000.0, 0.0, 0.0], 12);
    (bench.spot.top, bench.spot.width) = (40.0, [1000.0, 1000.0, 500_000.0]);
    bench.run(10);
    bench.good("SENS:AVER 1;:SCAN:DEF:LINE 0,1,1,10,0.2,5.1,FIRS");
    let outcome = bench.scan(0);
    assert_eq!(outcome.status & 0x307, 5, "{outcome:?}");
    assert!(bench.truth()[0] < 1_500.0 && bench.truth()[0] > -1_000.0, "{:?}", bench.truth());
}
