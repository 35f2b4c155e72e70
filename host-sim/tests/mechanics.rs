//! The mechanical twin: what step words do to motors, play and pose, and what timing they keep.

use host_sim::machine::Machine;
use host_sim::twin::{Limits, Mechanics, Timing};
use proptest::prelude::*;
use stage_controller::stepgen::pins::{DIR_PINS, STEP_PINS};
use stage_controller::units::AXES;

fn step(motor: usize) -> u32 {
    1 << STEP_PINS[motor]
}

fn dir(motor: usize) -> u32 {
    1 << DIR_PINS[motor]
}

/// The pattern of a cleared buffer: all STEP lines low.
fn rest() -> u32 {
    (0..AXES).map(step).sum::<u32>() << 16
}

fn paper() -> Mechanics {
    Mechanics::new(&Machine::paper(), [false; AXES])
}

/// Steps of one motor, each followed by a low tick, after the DIR line is set.
fn steps(motor: usize, count: i32) -> Vec<u32> {
    let direction = if count > 0 { dir(motor) } else { dir(motor) << 16 };
    let mut words = vec![direction];
    for _ in 0..count.abs() {
        words.extend([rest() | step(motor), rest()]);
    }
    words
}

#[test]
fn a_rising_edge_is_one_step_and_a_line_that_stays_high_is_none() {
    let mut stage = paper();
    stage.feed(&[dir(0), step(0), 0, step(0), 0]);
    assert_eq!(stage.motors().0, [1, 0, 0, 0, 0, 0]);
    stage.feed(&[step(0) << 16, step(0)]);
    assert_eq!(stage.motors().0, [2, 0, 0, 0, 0, 0]);
    assert_eq!(stage.ticks(), 7);
}

#[test]
fn a_set_bit_wins_over_a_reset_bit() {
    let mut stage = paper();
    stage.feed(&[dir(3), rest() | step(3), rest(), rest() | step(3)]);
    assert_eq!(stage.motors().0[3], 2);
    assert_eq!(stage.lines(), dir(3) | step(3));
}

#[test]
fn the_direction_line_decides_and_its_sense_can_be_inverted() {
    let inverted = [false, true, false, false, true, false];
    let mut stage = Mechanics::new(&Machine::paper(), inverted);
    for motor in 0..AXES {
        stage.feed(&steps(motor, 3));
    }
    assert_eq!(stage.motors().0, [3, -3, 3, 3, -3, 3]);
}

#[test]
fn on_the_reference_flank_the_actuator_is_the_motor() {
    let mut stage = paper();
    stage.feed(&steps(0, 40));
    assert_eq!(stage.actuators(), [2000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn a_reversal_first_takes_up_the_true_backlash() {
    let mut stage = paper();
    stage.feed(&steps(0, 10));
    // 300 nm of play are six steps of 50 nm.
    stage.feed(&steps(0, -6));
    assert_eq!(stage.actuators()[0], 500.0);
    stage.feed(&steps(0, -1));
    assert_eq!(stage.actuators()[0], 450.0);
    // 87 000 nrad are 21.75 steps of 4000 nrad: the play is not rounded.
    stage.feed(&steps(3, -22));
    assert!((stage.actuators()[3] + 1000.0).abs() < 1e-6);
}

#[test]
fn the_pose_is_the_exact_chain_of_the_actuators() {
    let machine = Machine::paper();
    let mut stage = paper();
    stage.feed(&steps(5, 2000));
    stage.feed(&steps(1, -300));
    let wanted = host_sim::model::Chain::new(&machine).true_pose(stage.actuators());
    for (pose, wanted) in stage.true_pose().into_iter().zip(wanted) {
        assert!((pose - wanted).abs() < 1e-6, "{pose} {wanted}");
    }
    assert!(wanted[5] > 7.9e6 && wanted[1] < 0.0);
}

/// The same stage, one bit at a time.
struct Plain {
    lines: u32,
    motors: [i32; AXES],
    driven: [f64; AXES],
}

impl Plain {
    fn feed(&mut self, words: &[u32], play: [f64; AXES]) {
        for word in words {
            let next = (self.lines & !(word >> 16)) | (word & 0xffff);
            for (motor, play) in play.into_iter().enumerate() {
                if next & !self.lines & step(motor) != 0 {
                    self.motors[motor] += if next & dir(motor) != 0 { 1 } else { -1 };
                    let m = f64::from(self.motors[motor]);
                    self.driven[motor] = self.driven[motor].clamp(m - play / 2.0, m + play / 2.0);
                }
            }
            self.lines = next;
        }
    }
}

/// Words as sparse, as dense and as odd as a generator or a bug could make them.
fn words() -> impl Strategy<Value = Vec<u32>> {
    let word = prop_oneof![6 => Just(0), 6 => Just(rest()), 3 => any::<u32>(),
        2 => (0..AXES).prop_map(|m| rest() | step(m)), 1 => (0..AXES).prop_map(|m| dir(m) << 16)];
    let quiet = prop::collection::vec(prop_oneof![Just(0), Just(rest()), Just(dir(2) << 16)], 0..60);
    let run = (prop::collection::vec(word, 0..60), quiet, 0..3u32).prop_map(|(mut busy, quiet, dense)| {
        busy.extend(quiet);
        busy.extend((0..dense * 600).flat_map(|_| [rest() | step(0) | step(5) | step(3), rest()]));
        busy
    });
    prop::collection::vec(run, 1..5).prop_map(|runs| runs.concat())
}

proptest! {
    #[test]
    fn counting_in_runs_gives_what_bit_by_bit_gives(words in words(), cut in 1..300usize) {
        let machine = Machine::paper();
        let play = machine.drives.map(|drive| drive.backlash / drive.step);
        let mut plain = Plain { lines: 0, motors: [0; AXES], driven: play.map(|b| -b / 2.0) };
        plain.feed(&words, play);
        let mut stage = paper();
        words.chunks(cut).for_each(|part| stage.feed(part));
        prop_assert_eq!(stage.motors().0, plain.motors);
        prop_assert_eq!(stage.lines(), plain.lines);
        let actuators: [f64; AXES] =
            std::array::from_fn(|i| (plain.driven[i] + play[i] / 2.0) * machine.drives[i].step);
        for (a, b) in stage.actuators().into_iter().zip(actuators) {
            prop_assert!((a - b).abs() < 1e-6);
        }
        prop_assert_eq!(stage.ticks(), words.len() as u64);
    }
}

fn timing(high: u64, low: u64, setup: u64, hold: u64) -> Timing {
    Timing::new([Limits { high, low, setup, hold }; AXES])
}

#[test]
fn pulses_that_keep_the_minimum_times_are_not_reported() {
    let mut checker = timing(1, 1, 1, 2);
    checker.feed(&steps(2, 5));
    checker.feed(&steps(2, -5));
    assert!(checker.violations().iter().all(|violations| violations.total() == 0));
}

#[test]
fn every_kind_of_short_time_is_counted_with_the_tick_of_the_first() {
    let (up, down) = (step(1), step(1) << 16);
    let mut checker = timing(2, 3, 3, 4);
    //              tick 0       1   2  3     4   5  6     7            8
    checker.feed(&[dir(1), up, 0, down, up, 0, down, dir(1) << 16, 0]);
    let found = checker.violations();
    assert_eq!((found[1].setup.count, found[1].setup.first), (1, Some(1)));
    assert_eq!((found[1].low.count, found[1].low.first), (1, Some(4)));
    assert_eq!((found[1].hold.count, found[1].hold.first), (1, Some(7)));
    assert_eq!(found[1].high.count, 0);
    checker.feed(&[up, down, up, down]);
    let found = checker.violations();
    assert_eq!((found[1].high.count, found[1].high.first), (2, Some(10)));
    assert_eq!(found[1].low.count, 2);
    assert_eq!(found[0].total(), 0);
}

#[test]
fn a_line_high_from_the_start_of_a_pulse_is_measured_across_calls() {
    let mut checker = timing(3, 1, 1, 1);
    checker.feed(&[step(4)]);
    checker.feed(&[0]);
    checker.feed(&[step(4) << 16]);
    assert_eq!(checker.violations()[4].high.first, Some(2));
}
