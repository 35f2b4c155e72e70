//! What is changed at standstill moves no motor: switches, pivots, names of positions.

mod stage;

use host_sim::board::Board;
use host_sim::machine::Machine;
use stage::{Dice, GOLDEN, board, golden};
use stage_controller::compensation::law::Switches;
use stage_controller::controller::front::Front;
use stage_controller::error::Error;
use stage_controller::units::{AXES, Axis, MotorSteps};

/// A board of a golden machine that came to one of its poses.
fn at_a_pose(name: &str, number: usize) -> (Machine, Board) {
    let (machine, poses) = golden(name);
    let mut board = board(&machine);
    // a third of the way: within the travel of every motor
    board.front.pose_absolute(poses[number].map(|u| i64::from(u) / 3)).unwrap();
    assert!(board.settle());
    (machine, board)
}

/// Does something to the front; no step edge may come of it.
fn without_a_step(board: &mut Board, what: impl FnOnce(&mut Front) -> Result<(), Error>) {
    let (motors, truth) = (board.twin().motors(), board.twin().true_pose());
    what(&mut board.front).unwrap();
    assert!(board.settle());
    assert_eq!((board.twin().motors(), board.twin().true_pose()), (motors, truth));
}

#[test]
fn switches_and_pivots_leave_every_motor_where_it_is() {
    for name in GOLDEN {
        let (_, mut board) = at_a_pose(name, 3);
        let counts = board.front.motor_counts();
        let all = Switches::default();
        for switches in [
            Switches { coupling: false, ..all },
            Switches { pivot: false, ..all },
            Switches { compensation: false, ..all },
            Switches { backlash: false, coupling: false, ..all },
            all,
        ] {
            without_a_step(&mut board, |front| front.set_switches(switches));
            let steps = board.front.report().steps;
            assert_eq!(board.front.law().steps(board.front.position()), steps, "{name}");
            assert_eq!(board.front.motor_counts(), counts, "{name}");
        }
        without_a_step(&mut board, |front| front.define_pivot(3, [16_000_000, -48_000_000, 320_000_000]));
        without_a_step(&mut board, |front| front.select_pivot(3));
        // and what is commanded then begins there: a move by nothing makes no step
        without_a_step(&mut board, |front| front.pose_relative([0; AXES]));
        without_a_step(&mut board, |front| front.select_pivot(0));
    }
}

#[test]
fn naming_a_position_re_anchors_its_motor_alone() {
    let mut dice = Dice::new(77);
    for name in GOLDEN {
        let (machine, mut board) = at_a_pose(name, 5);
        for axis in Axis::ALL {
            let i = axis.index();
            let (before, steps) = (board.front.motor_counts(), board.front.report().steps);
            let [lower, upper] = machine.drives[i].travel.map(|end| (end / 2.0) as i64);
            let x = dice.integer(lower..=upper);
            without_a_step(&mut board, |front| front.set_position(axis, x));
            let now = i64::from(board.front.position().0[i]);
            assert!((now - x).abs() as f64 <= 0.5 * machine.drives[i].step + 1.0, "{name} {axis:?}: {now} {x}");
            let others = |m: MotorSteps| (0..AXES).filter(|k| *k != i).map(|k| m.0[k]).collect::<Vec<_>>();
            assert_eq!(others(board.front.motor_counts()), others(before), "{name} {axis:?}");
            assert_eq!(others(board.front.report().steps), others(steps), "{name} {axis:?}");
            assert_eq!(board.front.law().steps(board.front.position()), board.front.report().steps);
        }
    }
}

#[test]
fn after_naming_a_position_the_overlay_is_still_taken_up_from_where_it_was() {
    let machine = Machine::paper();
    let mut board = board(&machine);
    for x in [100_000, 50_000] {
        board.front.move_absolute(Axis::X, x).unwrap();
        assert!(board.settle());
    }
    let (overlay, truth) = (board.front.report().overlay[0], board.twin().true_pose()[0]);
    assert_eq!(overlay, -6);
    without_a_step(&mut board, |front| front.set_position(Axis::X, 0));
    assert_eq!(board.front.report().overlay[0], overlay);
    // forward is now a reversal, and the true way is the commanded one
    board.front.move_absolute(Axis::X, 20_000).unwrap();
    assert!(board.settle());
    assert_eq!(board.front.report().overlay[0], 0);
    let way = board.twin().true_pose()[0] - truth;
    assert!((way - 20_000.0).abs() <= 55.0, "{way}");
}
