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
    for _ in 0..2000 {
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
    for _ in 0..1500 {
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
