//! The language on a live controller: what a message does, and what it answers.

use host_sim::board::{Board, Interleaving};
use host_sim::console::Console;
use host_sim::machine::Machine;
use host_sim::session::power_up;

fn console(cold: bool) -> Console {
    let machine = Machine::paper();
    let mut board = Board::new(&machine, power_up(&machine, cold).unwrap(), Interleaving::Jittered(3), 7);
    board.settle();
    Console::new(board)
}

#[test]
fn a_pose_is_reached_to_the_half_step_and_opc_waits_for_it() {
    let mut c = console(false);
    assert_eq!(c.line("POSE 100,-50,20,0.1,0,-0.2;*OPC?", |_| ()), "1");
    let at: Vec<f64> = c.line("POSE?", |_| ()).split(',').map(|x| x.parse().unwrap()).collect();
    for (have, want) in at[..3].iter().zip([100.0, -50.0, 20.0]) {
        assert!((have - want).abs() <= 0.026, "{at:?}");
    }
    assert_eq!(c.line("SYST:ERR?", |_| ()), "0,\"No error\"");
}

#[test]
fn a_refused_move_names_axis_and_value_and_moves_nothing() {
    let mut c = console(false);
    assert_eq!(c.line("AXIS2:MOVE 6200", |_| ()), "");
    assert_eq!(c.line("SYST:ERR?", |_| ()), "-222,\"Data out of range;AXIS2 6200.000 um above 5000.000 um\"");
    c.settle(|played| assert!(played.words.iter().all(|w| w & 0xffff == 0)));
    assert_eq!(c.line("POSE 1,2,3,0,0,50;*OPC?", |_| ()), "1");
    assert!(c.line("SYST:ERR?", |_| ()).starts_with("-222,"));
    assert_eq!(c.line("AXIS1:POS:MOT?", |_| ()), "0");
}

#[test]
fn a_cold_board_wants_homing_and_enabling() {
    let mut c = console(true);
    c.line("AXIS1:MOVE 10", |_| ());
    assert!(c.line("SYST:ERR?", |_| ()).starts_with("101,"));
    c.line("AXIS1:MOVE:REL 10", |_| ());
    assert!(c.line("SYST:ERR?", |_| ()).starts_with("108,"));
    c.line("AXIS1:ENAB ON;POS:SET 0;:AXIS1:MOVE 10", |_| ());
    // Y, Z and the rotary motors make no step for this
    assert_eq!(c.line("SYST:ERR?", |_| ()), "0,\"No error\"");
    assert_eq!(c.line("*OPC?;:AXIS1:POS?", |_| ()), "1;10.000");
}

#[test]
fn messages_sent_back_to_back_are_all_obeyed() {
    let mut c = console(false);
    let bytes = b"AXIS1:MOVE 10\nAXIS2:MOVE 20\nAXIS3:MOVE 30\nAXIS1:MOVE 40\n*OPC?\n";
    let mut answer = c.exchange(bytes);
    while answer.is_empty() {
        answer.extend(c.step(|_| ()));
    }
    assert_eq!(answer, b"1\n");
    let at: Vec<f64> = c.line("POSE?", |_| ()).split(',').map(|x| x.parse().unwrap()).collect();
    for (have, want) in at.iter().zip([40.0, 20.0, 30.0]) {
        assert!((have - want).abs() <= 0.026, "{at:?}");
    }
    assert_eq!(c.line("AXIS1:POS:COMM?", |_| ()), "40.000");
}

#[test]
fn reset_stops_and_keeps_calibration_and_home() {
    let mut c = console(false);
    c.line("AXIS1:VEL 100;:AXIS1:MOVE 1000", |_| ());
    for _ in 0..1000 {
        c.step(|_| ());
    }
    c.line("*RST", |_| ());
    assert_eq!(c.line("AXIS1:VEL?;:COMP:NAME?", |_| ()), "2000.000;\"paper\"");
    assert_eq!(c.line("AXIS1:MOVE 0;*OPC?;:AXIS1:POS?", |_| ()), "1;0.000");
    assert_eq!(c.line("SYST:ERR?", |_| ()), "0,\"No error\"");
}

#[test]
fn an_abort_in_mid_move_keeps_the_position_and_the_next_move_is_right() {
    let mut c = console(false);
    c.line("AXIS1:MOVE 1000", |_| ());
    for _ in 0..750 {
        c.step(|_| ());
    }
    assert_eq!(c.line("ABOR;*OPC?", |_| ()), "1");
    let counts: i32 = c.line("AXIS1:POS:MOT?", |_| ()).parse().unwrap();
    assert!(counts > 0 && counts < 20_000);
    assert_eq!(c.board.twin().motors().0[0], counts);
    assert_eq!(
        c.line("AXIS1:MOVE 1000;*OPC?;:POSE?", |_| ()),
        "1;1000.000,0.000,0.000,0.00000000,0.00000000,0.00000000"
    );
}

#[test]
fn a_law_under_which_the_stage_would_stand_beyond_its_coordinates_is_refused() {
    let machine = Machine::paper();
    let mut board =
        Board::new(&machine, stage_controller::controller::front::Front::new(), Interleaving::Jittered(3), 7);
    board.settle();
    let mut c = Console::new(board);
    assert_eq!(c.line("AXIS1:STEP:SIZE 10 NM;:AXIS1:POS:SET 500 MM;:SYST:ERR?", |_| ()), "0,\"No error\"");
    let before = c.line("AXIS1:POS?;POS:MOT?;:AXIS1:STEP:SIZE?", |_| ());
    assert!(c.line("AXIS1:STEP:SIZE 60 UM;:SYST:ERR?", |_| ()).starts_with("-222,"));
    assert_eq!(c.line("AXIS1:POS?;POS:MOT?;:AXIS1:STEP:SIZE?", |_| ()), before);
}

/// What a line answers when its errors are asked for too.
fn errors(c: &mut Console, line: &str) -> String {
    c.line(&format!("{line};:SYST:ERR:ALL?"), |_| ())
}

#[test]
fn soft_limits_beyond_what_the_law_reaches_are_no_panic() {
    let mut c = console(false);
    assert_eq!(errors(&mut c, "AXIS4:LIM:SOFT:UPP 12;LOW 10"), "0,\"No error\"");
    // towards the range it may go, as far as the motor does (or until the time-out of the jog)
    assert_eq!(errors(&mut c, "AXIS4:MOVE:JOG 2"), "0,\"No error\"");
    c.settle(|_| ());
    let at: f64 = c.line("AXIS4:POS?", |_| ()).parse().unwrap();
    assert!(at > 1.0 && at <= 3.0, "{at}");
}

#[test]
fn a_number_of_steps_that_no_stage_has_is_refused() {
    let mut c = console(false);
    for steps in ["368934881474211033", "9223372036854775807", "1E18"] {
        assert!(errors(&mut c, &format!("AXIS1:MOVE:REL {steps} STEP")).starts_with("-222,"), "{steps}");
    }
    assert!(errors(&mut c, "POSE:REL 0,368934881474211033 STEP,0,0,0,0").starts_with("-222,"));
    assert_eq!(c.line("POSE?;:AXIS1:POS:COMM?", |_| ()), "0.000,0.000,0.000,0.00000000,0.00000000,0.00000000;0.000");
}

#[test]
fn a_jog_has_no_target_for_a_relative_move_and_is_in_nobodys_way() {
    let mut c = console(false);
    c.line("AXIS1:MOVE:JOG -10", |_| ());
    for _ in 0..1000 {
        c.step(|_| ());
    }
    assert!(errors(&mut c, "AXIS1:MOVE:REL 5").starts_with("104,"));
    assert!(errors(&mut c, "POSE:REL 1,1,1,0,0,0").starts_with("104,"));
    assert!(c.line("AXIS1:POS:COMM?", |_| ()).parse::<f64>().unwrap() > -10.0);
    assert_eq!(errors(&mut c, "AXIS5:MOVE 0.2"), "0,\"No error\"");
    assert!(errors(&mut c, "AXIS2:VEL 100;MOVE:JOG 500").ends_with("AXIS2 500.000 um/s above 100.000 um/s\""));
}

#[test]
fn settings_in_a_burst_do_not_make_a_running_track_look_refused() {
    for seed in 0..12 {
        let machine = Machine::paper();
        let mut board = Board::new(&machine, power_up(&machine, false).unwrap(), Interleaving::Jittered(3), seed);
        board.settle();
        let mut c = Console::new(board);
        let (mut last, mut slope, mut peak) = (None, None, 0i64);
        let mut watch = |played: host_sim::board::Played<'_>| {
            let Some(now) = played.motor.map(|m| m.0[0]) else { return };
            let speed = last.map(|last| now - last);
            if let (Some(a), Some(b)) = (slope, speed) {
                peak = peak.max(i64::abs(b - a));
            }
            (last, slope) = (Some(now), speed);
        };
        c.exchange(b"AXIS1:MOVE 5000\n");
        for _ in 0..40 {
            c.exchange(b"AXIS1:VEL 1000;VEL 1001;VEL 1002;VEL 1003;BACK:DEAD 2;DEAD 1\n");
            c.step(&mut watch);
        }
        c.settle(&mut watch);
        // 20 mm/s^2 in steps of 50 nm per segment^2
        assert!(peak as f64 / 4_294_967_296.0 <= 0.02624, "seed {seed}: {}", peak as f64 / 4_294_967_296.0);
    }
}

#[test]
fn a_take_up_on_command_is_not_disturbed_and_a_stop_ends_it() {
    let mut c = console(false);
    c.line("AXIS1:MOVE 100;*WAI", |_| ());
    assert_eq!(errors(&mut c, "AXIS1:BACK:PREL POS"), "0,\"No error\"");
    for line in ["AXIS2:MOVE 500", "POSE 1,2,3,0,0,0", "AXIS2:MOVE:JOG 10"] {
        assert!(errors(&mut c, line).starts_with("104,"), "{line}");
    }
    assert_eq!(c.line("*OPC?;:AXIS1:BACK:STAT?;:AXIS1:POS?", |_| ()), "1;POS;100.000");
    c.line("AXIS1:BACK:PREL NEG", |_| ());
    c.line("AXIS2:STOP;*WAI", |_| ());
    assert_eq!(errors(&mut c, "AXIS1:MOVE 50;*OPC?;:AXIS1:POS?"), "1;50.000;0,\"No error\"");
}

#[test]
fn beyond_the_travel_the_way_back_in_is_free() {
    let mut c = console(false);
    assert_eq!(errors(&mut c, "AXIS1:POS:SET 5010"), "0,\"No error\"");
    assert!(errors(&mut c, "AXIS1:LIM:SOFT:STAT OFF;:AXIS1:MOVE 5020").starts_with("-222,"));
    assert_eq!(errors(&mut c, "AXIS1:MOVE:JOG -100"), "0,\"No error\"");
    for _ in 0..1500 {
        c.step(|_| ());
    }
    assert_eq!(errors(&mut c, "STOP;*WAI"), "0,\"No error\"");
    assert!(c.line("AXIS1:POS?", |_| ()).parse::<f64>().unwrap() < 5000.0);
    assert_eq!(errors(&mut c, "AXIS1:POS:SET 5010;:AXIS1:MOVE 0;*OPC?"), "1;0,\"No error\"");
}

#[test]
fn a_block_that_no_stage_has_is_refused_though_its_crc_is_right() {
    use stage_controller::compensation::calibration::Calibration;
    let good = Calibration::decode(&host_sim::session::block_of(&Machine::paper()).unwrap()).unwrap();
    let spoilt = |spoil: fn(&mut Calibration)| {
        let mut bad = good;
        spoil(&mut bad);
        let mut block = [0; 1024];
        let length = bad.encode(&mut block).unwrap();
        Calibration::decode(&block[..length]).unwrap_err().number.code()
    };
    assert_eq!(spoilt(|c| c.inverse_slides[2][2] = 0), -221);
    assert_eq!(spoilt(|c| c.inverse_slides[0][1] = c.inverse_slides[0][0]), -221);
    assert_eq!(spoilt(|c| c.rotary_gain[1] = -c.rotary_gain[1]), -221);
    assert_eq!(spoilt(|c| c.screws[0].direction[0] /= 2), -221);
    assert_eq!(spoilt(|c| c.home_rotation[1][1] = 0), -221);
}
