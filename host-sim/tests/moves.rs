//! What each command does, under the eyes of the same checker.

#[allow(dead_code)]
mod support;

use host_sim::board::Interleaving::{self, Jittered, Prompt};
use host_sim::machine::Machine;
use stage_controller::compensation::law::Switches;
use stage_controller::error::{Error, ErrorNumber};
use stage_controller::settings::BacklashMode;
use stage_controller::units::{AXES, Axis};
use support::stage::Stage;
use support::{machines, quicker};

fn both(test: impl Fn(Stage)) {
    for interleaving in [Prompt, Jittered(6)] {
        for seed in 0..4 {
            test(stage(interleaving, seed));
        }
    }
}

fn stage(interleaving: Interleaving, seed: u64) -> Stage {
    Stage::new(&quicker(Machine::paper(), 2.0, 20.0, 100.0), interleaving, seed)
}

fn number(result: Result<(), Error>) -> Option<ErrorNumber> {
    result.err().map(|e| e.number)
}

#[test]
fn a_coordinated_move_ends_on_the_same_segment_for_all_axes() {
    both(|mut stage| {
        let off = Switches { compensation: false, ..Switches::default() };
        stage.board.front.set_switches(off).unwrap();
        stage.wait_for_anchor();
        let target = [300_000, -1_000, 47, 9_000_000, -4_000, 123_456];
        stage.board.front.pose_absolute(target).unwrap();
        stage.expected = target.map(|t| Some(t as i32));
        let (mut last, mut ended) = (stage.board.generator().targets(), [0; AXES]);
        for _ in 0..10_000 {
            stage.step();
            let now = stage.board.generator().targets();
            for (ended, (now, last)) in ended.iter_mut().zip(now.0.iter().zip(&last.0)) {
                if now != last {
                    *ended = stage.board.now();
                }
            }
            last = now;
        }
        assert!(ended[0] > 0 && ended.iter().all(|e| *e == ended[0]), "{ended:?}");
        stage.settle();
    });
}

#[test]
fn a_refused_command_moves_nothing() {
    both(|mut stage| {
        let start = stage.board.front.motor_counts();
        let front = &mut stage.board.front;
        assert_eq!(number(front.pose_absolute([0, 0, 0, 0, 0, 52_359_879])), Some(ErrorNumber::DataOutOfRange));
        assert_eq!(number(front.move_absolute(Axis::X, 5_000_001)), Some(ErrorNumber::DataOutOfRange));
        assert_eq!(number(front.jog(Axis::X, 4_000_001, 0)), Some(ErrorNumber::DataOutOfRange));
        front.set_enabled(Axis::Y, false).unwrap();
        assert_eq!(number(front.move_absolute(Axis::Y, 1000)), Some(ErrorNumber::AxisDisabled));
        stage.run(100);
        assert_eq!(stage.board.front.motor_counts(), start);
        stage.settle();
    });
}

#[test]
fn a_new_target_for_one_axis_keeps_those_of_the_others() {
    both(|mut stage| {
        let target = [1_000_000, 800_000, -600_000, 9_000_000, -8_000_000, 7_000_000];
        stage.board.front.pose_absolute(target).unwrap();
        stage.run(150);
        stage.board.front.move_absolute(Axis::Y, -5_000).unwrap();
        stage.expected = target.map(|t| Some(t as i32));
        stage.expected[1] = Some(-5_000);
        stage.settle();
    });
}

#[test]
fn a_stop_of_one_axis_stops_the_whole_coordinated_move() {
    both(|mut stage| {
        let target = [2_000_000, 1_000_000, 500_000, 0, 0, 0];
        stage.board.front.pose_absolute(target).unwrap();
        stage.run(450);
        stage.board.front.stop(Axis::Y);
        stage.expected = [None; AXES];
        let took = stage.settle();
        let at = stage.board.front.position().0;
        assert!(took < 1_000 && at[0] > 10_000 && at[0] < 1_900_000, "{took} {at:?}");
        // still on the line
        assert!((at[0] - 2 * at[1]).abs() < 200 && (at[1] - 2 * at[2]).abs() < 200, "{at:?}");
    });
}

#[test]
fn six_axes_run_at_once_and_each_ends_where_it_should() {
    both(|mut stage| {
        let target = [1_000_000, -800_000, 600_000, 9_000_000, -8_000_000, 7_000_000];
        let mut alone = 0;
        for (axis, to) in Axis::ALL.into_iter().zip(target) {
            let mut single = self::stage(Prompt, 1);
            single.board.front.move_absolute(axis, to).unwrap();
            single.expected[axis.index()] = Some(to as i32);
            alone += single.settle();
            stage.board.front.move_absolute(axis, to).unwrap();
            stage.expected[axis.index()] = Some(to as i32);
        }
        let mut most = 0;
        for _ in 0..200 {
            stage.step();
            most = most.max(stage.board.front.report().moving.count_ones());
        }
        let together = 200 + stage.settle();
        assert_eq!(most, 6);
        assert!(together < alone / 2, "{together} of {alone}");
    });
}

#[test]
fn a_move_waits_for_motors_that_others_use_and_then_goes() {
    // on a long lever one rotation uses nearly all of the linear motors
    let machine = machines().swap_remove(4);
    for interleaving in [Prompt, Jittered(6)] {
        let mut stage = Stage::new(&machine, interleaving, 3);
        for (axis, to) in Axis::ROTARY.into_iter().zip([30_000_000, -40_000_000, 35_000_000]) {
            stage.board.front.move_absolute(axis, to).unwrap();
            stage.expected[axis.index()] = Some(to as i32);
        }
        for (axis, to) in Axis::LINEAR.into_iter().zip([300_000, -400_000, 500_000]) {
            stage.board.front.move_absolute(axis, to).unwrap();
            stage.expected[axis.index()] = Some(to as i32);
        }
        stage.run(25);
        assert!(stage.board.front.operation_pending());
        stage.settle();
    }
}

#[test]
fn a_jog_reverses_stops_and_ends_exactly_at_the_limit() {
    both(|mut stage| {
        stage.board.front.jog(Axis::X, 3_000_000, 0).unwrap();
        stage.run(250);
        let out = stage.board.front.position().0[0];
        stage.board.front.jog(Axis::X, -1_000_000, 0).unwrap();
        stage.run(1500);
        assert!(out > 0 && stage.board.front.position().0[0] < out);
        stage.board.front.jog(Axis::X, 0, 0).unwrap();
        stage.expected = [None; AXES];
        assert!(stage.settle() < 500);
        stage.board.front.jog(Axis::X, 4_000_000, 0).unwrap();
        stage.expected[0] = Some(5_000_000);
        stage.settle();
        assert_eq!(number(stage.board.front.jog(Axis::X, 1000, 0)), Some(ErrorNumber::DataOutOfRange));
        // an end of the link ends the jog
        stage.board.front.jog(Axis::X, -4_000_000, 7).unwrap();
        stage.run(150);
        stage.board.front.end_jogs(7);
        stage.expected = [None; AXES];
        assert!(stage.settle() < 500);
    });
}

#[test]
fn the_speed_override_takes_effect_while_moving() {
    let time = |at: u64, percent: u8, first: u8| {
        let mut stage = stage(Jittered(2), 5);
        stage.board.front.set_override(first);
        stage.board.front.pose_absolute([3_000_000, 100, 0, 0, 0, 0]).unwrap();
        stage.expected = [Some(3_000_000), Some(100), Some(0), Some(0), Some(0), Some(0)];
        stage.run(at);
        stage.board.front.set_override(percent);
        at + stage.settle()
    };
    let (full, slowed, raised, slow) = (time(350, 100, 100), time(350, 20, 100), time(350, 100, 20), time(350, 20, 20));
    assert!(full < raised && raised < slowed && slowed < slow, "{full} {raised} {slowed} {slow}");
}

#[test]
fn a_one_directional_motor_ends_in_its_direction_whatever_happens_on_the_way() {
    both(|mut stage| {
        let mut settings = *stage.board.front.settings();
        settings.axes[0].backlash.mode = BacklashMode::UniPositive;
        settings.axes[1].backlash.mode = BacklashMode::UniNegative;
        stage.board.front.set_axes(&settings).unwrap();
        stage.wait_for_anchor();
        stage.board.front.pose_absolute([-50_000, 50_000, 0, 0, 0, 0]).unwrap();
        stage.expected = [Some(-50_000), Some(50_000), Some(0), Some(0), Some(0), Some(0)];
        stage.settle();
        for _ in 0..40 {
            for axis in [Axis::X, Axis::Y] {
                let to = stage.any(400_000);
                stage.board.front.move_absolute(axis, to).unwrap();
                stage.expected[axis.index()] = Some(to as i32);
                let pause = stage.random.below(150);
                stage.run(pause);
            }
            stage.settle();
            let report = stage.board.front.report();
            assert_eq!(report.negative & 3, 2, "X rests on the positive flank, Y on the negative one");
        }
    });
}

#[test]
fn a_preload_ends_where_it_began_on_the_flank_asked_for() {
    use stage_controller::compensation::backlash::Flank;
    both(|mut stage| {
        for flank in [Flank::Negative, Flank::Positive, Flank::Positive] {
            stage.board.front.preload(Axis::Z, flank).unwrap();
            stage.settle();
            assert_eq!(stage.board.front.flank(Axis::Z), Some(flank));
            assert_eq!(stage.board.front.report().owing, 0);
        }
    });
}

#[test]
fn a_reset_while_moving_leaves_a_stage_that_moves_again() {
    both(|mut stage| {
        stage.board.front.pose_absolute([1_000_000, 0, 0, 5_000_000, 0, 0]).unwrap();
        stage.run(150);
        stage.board.front.reset();
        stage.expected = [None; AXES];
        stage.wait_for_anchor();
        let target = [-1_000, 2_000, 3_000, 0, 1_000_000, 0];
        stage.board.front.pose_absolute(target).unwrap();
        stage.expected = target.map(|t| Some(t as i32));
        stage.settle();
    });
}

#[test]
fn a_named_position_is_there_at_once_and_moves_start_from_it() {
    both(|mut stage| {
        stage.board.front.pose_absolute([10_000, 0, 0, 0, 0, 0]).unwrap();
        stage.expected = [None; AXES];
        stage.settle();
        stage.board.front.set_position(Axis::X, 200_000).unwrap();
        let seen = stage.board.front.position().0[0];
        assert!((seen - 200_000).abs() <= 26, "{seen}");
        for _ in 0..20 {
            stage.checker.jumps = true;
            stage.step();
            assert_eq!(stage.board.front.position().0[0], seen);
        }
        // a second change before the first is answered starts from it
        stage.board.front.set_position(Axis::Y, -100_000).unwrap();
        stage.board.front.select_pivot(0).unwrap();
        stage.wait_for_anchor();
        let at = stage.board.front.position().0;
        assert!((at[0] - 200_000).abs() < 100 && (at[1] + 100_000).abs() < 100, "{at:?}");
        stage.board.front.move_absolute(Axis::X, 0).unwrap();
        stage.expected = [None; AXES];
        stage.settle();
        assert_eq!(stage.board.front.commanded().0[0], 0);
    });
}
