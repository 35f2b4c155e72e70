//! What stops motion from outside: switches, the emergency stop, drivers, a board in trouble.

use host_sim::board::{Board, GATE_TICKS, Interleaving, STOP_TICKS};
use host_sim::console::Console;
use host_sim::machine::Machine;
use host_sim::session::{block_of, power_up};
use stage_controller::controller::front::{Front, Health};
use stage_controller::controller::links::Links;
use stage_controller::refill::safety::Cause;
use stage_controller::units::AXES;

const NO_ERROR: &str = "0,\"No error\"";

/// The paper's stage with its upper Y switch in the middle of the travel.
fn early_switch() -> Machine {
    let mut machine = Machine::paper();
    machine.drives[1].switches[1] = 400_000.0;
    machine
}

fn console(machine: &Machine, interleaving: Interleaving, seed: u64) -> Console {
    let mut board = Board::new(machine, power_up(machine, false).unwrap(), interleaving, seed);
    assert!(board.settle());
    Console::new(board)
}

fn watched(machine: &Machine, interleaving: Interleaving, seed: u64) -> Console {
    let mut c = console(machine, interleaving, seed);
    for n in 1..=AXES {
        c.line(&format!("AXIS{n}:LIM:HARD:STAT ON"), |_| ());
    }
    assert_eq!(say(&mut c, "SYST:ERR?"), NO_ERROR);
    c
}

fn say(c: &mut Console, line: &str) -> String {
    c.line(line, |_| ())
}

fn errors(c: &mut Console) -> String {
    say(c, "SYST:ERR:ALL?")
}

fn settle(c: &mut Console) {
    assert!(c.settle(|_| ()));
}

fn steps(c: &mut Console, segments: u64) {
    (0..segments).for_each(|_| drop(c.step(|_| ())));
}

fn both(test: impl Fn(Interleaving, u64)) {
    for seed in 0..12 {
        test(Interleaving::Prompt, seed);
        test(Interleaving::Jittered(6), seed);
    }
}

/// What the controller counts is what the stage did; at rest what it is commanded is where its motors stand.
fn assert_exact(c: &Console) {
    let front = &c.board.front;
    assert_eq!(front.motor_counts(), c.board.twin().motors(), "counts");
    assert_eq!(front.law().steps(front.commanded()), front.report().steps, "the counts are those of the command");
}

/// Refused with this number at the front of its error, without a step.
fn assert_refused(c: &mut Console, line: &str, error: &str) {
    let before = c.board.twin().motors();
    say(c, line);
    let said = errors(c);
    assert!(said.starts_with(error) && said.matches(",\"").count() == 1, "{line}: {said}");
    steps(c, 50);
    assert_eq!(c.board.twin().motors(), before, "{line}");
}

#[test]
fn a_limit_switch_in_mid_move_stops_all_motors_and_the_next_move_is_exact() {
    both(|interleaving, seed| {
        let mut c = watched(&early_switch(), interleaving, seed);
        say(&mut c, "POSE 600,900,-300,0.5,0,-0.2");
        settle(&mut c);
        assert_eq!(errors(&mut c), "102,\"Limit switch active;AXIS2 upper limit switch\"");
        let stopped = c.board.last_stop().expect("a stop");
        assert_eq!((stopped.halt.cause, stopped.halt.upper, stopped.halt.lower), (Cause::Limit, 0b10, 0));
        assert!(stopped.latency <= STOP_TICKS);
        assert_exact(&c);
        let motors = c.board.twin().motors().0;
        // 2 mm/s are 0.04 steps of 50 nm in a tick
        assert!((motors[1] - 8000).abs() <= 2, "{motors:?}");
        assert!(motors[0] > 1000 && motors[0] < 12_000, "the others stopped on the way: {motors:?}");
        // let the contact come to rest
        steps(&mut c, 40);
        assert_eq!(say(&mut c, "AXIS2:LIM:HARD?"), "0,1");
        let axis: u16 = say(&mut c, "STAT:AXIS2?").parse().unwrap();
        let questionable: u16 = say(&mut c, "STAT:QUES:COND?").parse().unwrap();
        assert_eq!((axis & (1 << 6 | 1 << 7), questionable & 1 << 11), (1 << 7, 1 << 11));

        say(&mut c, "POSE 100,300,0,0,0,0.1;*WAI");
        assert_eq!(errors(&mut c), NO_ERROR);
        settle(&mut c);
        assert_exact(&c);
        assert!(say(&mut c, "AXIS2:POS?").parse::<f64>().unwrap() - 300.0 < 0.026);
        assert_eq!(say(&mut c, "AXIS2:LIM:HARD?"), "0,0");
    });
}

#[test]
fn at_a_switch_ways_towards_it_are_refused_and_ways_back_are_not() {
    let mut c = watched(&early_switch(), Interleaving::Jittered(3), 5);
    say(&mut c, "AXIS2:MOVE:JOG 500");
    settle(&mut c);
    let upper = "102,\"Limit switch active;AXIS2 upper limit switch\"";
    assert_eq!(errors(&mut c), upper);
    // let the contact come to rest
    steps(&mut c, 40);
    for line in [
        "AXIS2:MOVE 900",
        "AXIS2:MOVE:REL 1 STEP",
        "AXIS2:MOVE:JOG 10",
        "POSE 0,900,0,0,0,0",
        "POSE:REL 10,10,10,0,0,0",
    ] {
        assert_refused(&mut c, line, upper);
    }
    assert!(say(&mut c, "POSE:CHEC? 0,900,0,0,0,0").starts_with("102,"));
    assert!(say(&mut c, "POSE:CHEC? 0,300,0,0,0,0").starts_with("0,"));
    for line in ["AXIS2:MOVE:REL -1", "AXIS3:MOVE 100", "AXIS2:MOVE:JOG -100"] {
        say(&mut c, line);
        assert_eq!(errors(&mut c), NO_ERROR, "{line}");
        steps(&mut c, 150);
        say(&mut c, "STOP;*OPC?");
        assert_exact(&c);
    }
    // still within the hysteresis
    assert_refused(&mut c, "AXIS2:MOVE:REL 1", upper);
    assert_eq!(say(&mut c, "AXIS2:MOVE 0;*OPC?;:AXIS2:MOVE 390;*OPC?"), "1;1");
    assert_eq!(errors(&mut c), NO_ERROR);
    assert_exact(&c);
}

#[test]
fn a_switch_that_bounces_while_it_is_left_stops_nothing() {
    both(|interleaving, seed| {
        let mut c = watched(&early_switch(), interleaving, seed);
        for _ in 0..4 {
            say(&mut c, "AXIS2:MOVE:JOG 2 MM/S");
            settle(&mut c);
            assert!(errors(&mut c).starts_with("102,"));
            let stop = c.board.last_stop();
            // slowly through the hysteresis, the contact bounces on the way
            say(&mut c, "AXIS2:VEL 400;:AXIS2:MOVE:REL -120;*OPC?");
            assert_eq!((errors(&mut c).as_str(), c.board.last_stop()), (NO_ERROR, stop));
            say(&mut c, "AXIS2:VEL MAX");
        }
    });
}

#[test]
fn a_switch_that_is_not_watched_is_seen_and_stops_nothing() {
    let mut c = console(&early_switch(), Interleaving::Jittered(2), 1);
    assert_eq!(say(&mut c, "AXIS2:LIM:HARD:STAT?;:AXIS2:LIM:HARD?"), "0;0,0");
    assert_eq!(say(&mut c, "AXIS2:MOVE 900;*OPC?;:AXIS2:LIM:HARD?;:STAT:QUES:COND?"), "1;0,1;0");
    assert_eq!(errors(&mut c), NO_ERROR);
    assert_exact(&c);
    // watched from now on, it lets the axis only back
    say(&mut c, "AXIS2:LIM:HARD:STAT ON");
    assert_refused(&mut c, "AXIS2:MOVE:REL 1", "102,");
    say(&mut c, "AXIS2:MOVE 0;*WAI");
    assert_eq!(errors(&mut c), NO_ERROR);
}

#[test]
fn switches_that_are_normally_open_are_active_when_low() {
    let mut board = Board::new(&early_switch(), power_up(&early_switch(), false).unwrap(), Interleaving::Prompt, 3);
    board.rewire(0b000010, 0);
    assert!(board.settle());
    let mut c = Console::new(board);
    assert_eq!(say(&mut c, "AXIS2:LIM:HARD?;HARD:POL?"), "1,1;HIGH");
    say(&mut c, "AXIS2:LIM:HARD:POL LOW;STAT ON");
    assert_eq!(say(&mut c, "AXIS2:LIM:HARD?;HARD:POL?"), "0,0;LOW");
    say(&mut c, "AXIS2:MOVE 900;*WAI");
    assert!(errors(&mut c).contains("AXIS2 upper limit switch"));
}

#[test]
fn a_stop_of_the_board_above_the_start_velocity_makes_the_position_uncertain() {
    for (threshold, uncertain) in [("100", true), ("MAX", false)] {
        let mut c = watched(&early_switch(), Interleaving::Jittered(4), 9);
        say(&mut c, &format!("AXIS2:VEL:STAR {threshold};:AXIS2:MOVE 900;*WAI"));
        assert!(errors(&mut c).starts_with("102,"));
        let bit = say(&mut c, "STAT:AXIS2?").parse::<u16>().unwrap() & 1 << 10 != 0;
        assert_eq!(bit, uncertain);
        say(&mut c, "AXIS2:MOVE 0;*WAI");
        let said = errors(&mut c);
        assert_eq!(said.starts_with("109,"), uncertain, "{said}");
        assert_exact(&c);
    }
}

#[test]
fn the_emergency_stop_in_mid_move_is_latched_and_the_next_move_is_exact() {
    both(|interleaving, seed| {
        let mut c = console(&Machine::paper(), interleaving, seed);
        say(&mut c, "POSE 600,900,-300,0.5,0,-0.2");
        steps(&mut c, 350 + 50 * seed);
        c.board.press_stop(true);
        settle(&mut c);
        assert!(c.board.is_latched() && c.board.last_stop().unwrap().latency <= GATE_TICKS);
        assert_eq!(errors(&mut c), "103,\"Emergency stop;latched; close the contact, then SYST:EST:CLE\"");
        assert_eq!(say(&mut c, "*OPC?;:SYST:EST:STAT?"), "1;1,1");
        assert_ne!(say(&mut c, "STAT:QUES:COND?").parse::<u16>().unwrap() & 1 << 10, 0);
        assert_exact(&c);
        for line in ["POSE 0,0,0,0,0,0", "AXIS1:MOVE 1", "AXIS1:MOVE:REL 1", "AXIS1:MOVE:JOG 1", "AXIS1:HOME"] {
            assert_refused(&mut c, line, "103,");
        }
        assert!(say(&mut c, "POSE:CHEC? 0,0,0,0,0,0").starts_with("103,"));
        assert_refused(&mut c, "SYST:EST:CLE", "103,\"Emergency stop;contact open\"");
        c.board.press_stop(false);
        steps(&mut c, 20);
        // closed is not armed
        assert_eq!(say(&mut c, "SYST:EST:STAT?"), "1,0");
        assert_refused(&mut c, "AXIS1:MOVE:REL 1", "103,");
        assert_exact(&c);
        assert_eq!(say(&mut c, "SYST:EST:CLE;:POSE 10,20,30,0,0.1,0;*OPC?;:SYST:EST:STAT?"), "1;0,0");
        assert_eq!(errors(&mut c), NO_ERROR);
        assert_exact(&c);
        assert!((say(&mut c, "AXIS3:POS?").parse::<f64>().unwrap() - 30.0).abs() < 0.026);
    });
}

#[test]
fn an_emergency_stop_at_rest_is_latched_too_and_settings_still_work() {
    let mut c = console(&Machine::paper(), Interleaving::Jittered(3), 2);
    c.board.press_stop(true);
    steps(&mut c, 20);
    assert!(errors(&mut c).starts_with("103,"));
    assert_eq!(say(&mut c, "AXIS1:VEL 100;:COMP:PIV:STAT OFF;*RST;*OPC?;:AXIS1:VEL?"), "1;2000.000");
    c.board.press_stop(false);
    steps(&mut c, 20);
    assert_eq!(say(&mut c, "SYST:EST:CLE;:AXIS1:MOVE 5;*OPC?"), "1");
    // again without the stop there is nothing to clear
    say(&mut c, "SYST:EST:CLE");
    assert_eq!(errors(&mut c), NO_ERROR);
    // pressed a second time it is told a second time
    c.board.press_stop(true);
    steps(&mut c, 20);
    assert!(errors(&mut c).starts_with("103,"));
}

#[test]
fn a_driver_in_fault_stops_everything_and_is_disabled() {
    both(|interleaving, seed| {
        let mut c = console(&Machine::paper(), interleaving, seed);
        say(&mut c, "POSE 600,900,-300,0.5,0,-0.2");
        steps(&mut c, 750);
        c.board.set_fault(2, true);
        settle(&mut c);
        assert_eq!(errors(&mut c), "112,\"Driver fault;AXIS3 driver disabled\"");
        assert!(c.board.last_stop().unwrap().latency <= STOP_TICKS);
        assert_exact(&c);
        assert_eq!(say(&mut c, "AXIS3:ENAB?;:AXIS2:ENAB?"), "0;1");
        let axis: u16 = say(&mut c, "STAT:AXIS3?").parse().unwrap();
        assert_eq!(axis & (1 << 8 | 1 << 9), 1 << 9);
        assert_ne!(say(&mut c, "STAT:QUES:INST:COND?").parse::<u16>().unwrap() & 1 << 3, 0);
        assert_refused(&mut c, "AXIS3:MOVE:REL 1", "108,");
        assert_refused(&mut c, "AXIS3:ENAB ON", "112,\"Driver fault;AXIS3 fault line active");
        c.board.set_fault(2, false);
        steps(&mut c, 20);
        assert_eq!(say(&mut c, "AXIS3:ENAB ON;POS:SET 0;:AXIS3:MOVE 100;*OPC?"), "1");
        assert_eq!(errors(&mut c), NO_ERROR);
    });
}

#[test]
fn a_missed_deadline_is_told_and_forgotten_with_the_next_move() {
    both(|interleaving, seed| {
        let mut c = console(&Machine::paper(), interleaving, seed);
        say(&mut c, "POSE 600,900,-300,0.5,0,-0.2");
        steps(&mut c, 500);
        c.board.fail(Cause::Deadline);
        settle(&mut c);
        assert!(errors(&mut c).starts_with("105,\"Step deadline missed;all motors stopped"));
        assert_exact(&c);
        let missed = |c: &mut Console| say(c, "STAT:QUES:COND?").parse::<u16>().unwrap() & 1 << 9 != 0;
        assert!(missed(&mut c));
        assert_eq!(say(&mut c, "POSE 0,0,0,0,0,0;*OPC?"), "1");
        assert!(!missed(&mut c));
        assert_exact(&c);
        assert_eq!(errors(&mut c), NO_ERROR);
    });
}

#[test]
fn a_failed_output_in_mid_move_leaves_no_axis_certain() {
    let mut c = console(&Machine::paper(), Interleaving::Jittered(3), 4);
    say(&mut c, "AXIS1:MOVE 600");
    steps(&mut c, 500);
    c.board.fail(Cause::Output);
    settle(&mut c);
    assert!(errors(&mut c).starts_with("105,\"Step deadline missed;step output failed"));
    assert_refused(&mut c, "AXIS2:MOVE 1", "109,");
}

#[test]
fn the_lines_follow_enable_and_polarity() {
    let mut c = console(&Machine::paper(), Interleaving::Prompt, 1);
    assert_eq!((c.board.front.enable_lines(), c.board.front.watch().faults), (0, 0b111111), "low is on");
    say(&mut c, "AXIS1:ENAB OFF;:AXIS2:ENAB:POL HIGH;:AXIS4:FAUL:POL HIGH;:AXIS6:LIM:HARD:STAT ON;POL LOW;*OPC?");
    assert_eq!(errors(&mut c), NO_ERROR);
    // what a rewired driver says now counts
    steps(&mut c, 20);
    let front = &c.board.front;
    // driver 4 is off by now: its line said fault
    assert_eq!(front.enable_lines(), 0b001011);
    let watch = front.watch();
    assert_eq!((watch.faults & 1, watch.faults_high, watch.limits, watch.limits_high), (0, 0b1000, 0b100000, 0b011111));
    assert!(errors(&mut c).contains("112,\"Driver fault;AXIS4"), "its line is high");
}

#[test]
fn reset_and_another_calibration_keep_wiring_and_home() {
    let mut c = watched(&Machine::paper(), Interleaving::Jittered(2), 1);
    say(&mut c, "AXIS2:LIM:HARD:POL LOW;:AXIS2:HOME:TYPE UPP;OFFS 4 MM;VEL 100;:AXIS2:ENAB:POL HIGH");
    assert_eq!(errors(&mut c), NO_ERROR);
    let ask = "AXIS2:LIM:HARD:POL?;STAT?;:AXIS2:HOME:TYPE?;OFFS?;VEL?;:AXIS2:ENAB:POL?;:AXIS2:FAUL:POL?";
    let set = "LOW;1;UPP;4000.000;100.000;HIGH;LOW";
    assert_eq!(say(&mut c, ask), set);
    say(&mut c, "*RST");
    assert_eq!(say(&mut c, ask), set);
    // a calibration brings rates
    c.board.front.load(&block_of(&Machine::paper()).unwrap()).unwrap();
    assert_eq!(say(&mut c, ask), set.replace("100.000", "500.000"));
}

#[test]
fn wiring_changes_at_standstill_only() {
    let mut c = console(&Machine::paper(), Interleaving::Jittered(2), 1);
    say(&mut c, "AXIS1:MOVE 500");
    steps(&mut c, 50);
    for line in ["AXIS2:LIM:HARD:STAT ON", "AXIS2:FAUL:POL HIGH", "AXIS2:ENAB:POL HIGH", "AXIS2:HOME:TYPE UPP"] {
        say(&mut c, line);
        assert!(errors(&mut c).starts_with("104,"), "{line}");
    }
}

#[test]
fn every_link_is_told_once_why_the_controller_started() {
    let mut front = Front::new();
    front.set_health(Health { internal_oscillator: true, watchdog: true });
    front.lose_settings(stage_controller::error::ErrorNumber::SettingsLost.into());
    let mut links: Links<3> = Links::new();
    let ask = |links: &mut Links<3>, front: &mut Front, n: usize, line: &str| {
        assert_eq!(links.receive(n, line.as_bytes(), 0), line.len());
        links.poll(front, 0);
        let mut answer = [0; 512];
        let length = links.transmit(n, &mut answer);
        String::from_utf8_lossy(&answer[..length]).trim().to_owned()
    };
    let first = links.open(0).unwrap();
    let told = ask(&mut links, &mut front, first, "SYST:ERR:ALL?\n");
    let numbers: Vec<_> = told.split("\",").map(|e| e.split(',').next().unwrap().to_owned()).collect();
    assert_eq!(numbers, ["111", "110", "106"], "{told}");
    let questionable: u16 = ask(&mut links, &mut front, first, "STAT:QUES:COND?\n").parse().unwrap();
    assert_eq!(questionable & (1 << 8 | 1 << 12), 1 << 8 | 1 << 12);
    // a second link, later; and the first one opened anew
    let second = links.open(0).unwrap();
    assert!(ask(&mut links, &mut front, second, "SYST:ERR:ALL?\n").starts_with("111,"));
    links.close(first, &mut front);
    assert_eq!(links.open(0), Some(first));
    assert_eq!(ask(&mut links, &mut front, first, "SYST:ERR:ALL?\n"), NO_ERROR);
    // a crystal that fails later is told at once to those who are there
    front.set_health(Health::default());
    front.report_clock_fault();
    for n in [first, second] {
        assert!(ask(&mut links, &mut front, n, "SYST:ERR:ALL?\n").starts_with("110,"));
    }
}

#[test]
fn the_generator_says_which_motors_may_be_stepping_and_at_rest_none() {
    both(|interleaving, seed| {
        let mut c = console(&Machine::paper(), interleaving, seed);
        let mut one_way = 0;
        for line in ["POSE 60,-90,30,0.05,0,-0.02", "AXIS1:MOVE -20", "POSE 0,0,0,0,0,0"] {
            say(&mut c, line);
            while c.board.front.operation_pending() {
                let (up, down) = c.board.generator().stepping();
                let before = c.board.twin().motors().0;
                c.step(|_| ());
                for (m, (after, before)) in c.board.twin().motors().0.into_iter().zip(before).enumerate() {
                    assert!(after <= before || up >> m & 1 != 0, "motor {m} stepped up");
                    assert!(after >= before || down >> m & 1 != 0, "motor {m} stepped down");
                    one_way += u32::from(after != before && (up & down) >> m & 1 == 0);
                }
            }
            steps(&mut c, 10);
            assert_eq!(c.board.generator().stepping(), (0, 0), "at rest");
        }
        assert!(one_way > 1000, "only {one_way} segments in one direction");
    });
}
