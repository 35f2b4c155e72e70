//! Everything that a user may do, in random order.

use super::stage::Stage;
use host_sim::session::block_of;
use stage_controller::settings::BacklashMode;
use stage_controller::units::{AXES, Axis};

/// What a storm is made of.
#[derive(Clone, Copy)]
pub struct Weather {
    /// Commands.
    pub commands: u64,
    /// Largest single distance, as a part of the travel: 1/n.
    pub part: i64,
    /// Aborts happen.
    pub aborts: bool,
    /// Backlash modes change, calibrations are loaded, switches are thrown at standstill.
    pub changes: bool,
}

/// Commands of every kind; every segment is checked.
pub fn storm(stage: &mut Stage, weather: Weather) {
    for _ in 0..weather.commands {
        let kind = stage.random.below(100);
        match kind {
            0..20 => absolute(stage, weather),
            20..30 => relative(stage, weather),
            30..45 => pose(stage, weather, true),
            45..52 => pose(stage, weather, false),
            52..64 => jog(stage),
            64..70 => stop_one(stage),
            70..74 => stop_all(stage),
            74..80 => override_speed(stage),
            80..84 if weather.aborts => abort(stage),
            84..90 if weather.changes => change(stage),
            90..92 => rates(stage),
            _ => {
                stage.note(|| "settle".into());
                end_jogs(stage);
                stage.settle();
            }
        }
        let pause = match stage.random.below(4) {
            0 => 0,
            1 => stage.random.below(8),
            2 => stage.random.below(50),
            _ => stage.random.below(300),
        };
        stage.run(pause);
    }
    stage.board.front.set_override(100);
    end_jogs(stage);
    stage.settle();
}

fn end_jogs(stage: &mut Stage) {
    for axis in Axis::ALL {
        if stage.board.front.has_jog(axis.index() as u8) {
            stage.board.front.end_jogs(axis.index() as u8);
            // with a coordinated move that waits all of its axes stop
            stage.expected = [None; AXES];
        }
    }
}

fn near(stage: &mut Stage, axis: Axis, weather: Weather) -> i64 {
    let own = stage.board.front.settings().axes[axis.index()];
    let (low, high) = (i64::from(own.soft_lower), i64::from(own.soft_upper));
    let at = i64::from(stage.board.front.commanded().0[axis.index()]);
    let by = stage.any((high - low) / weather.part);
    // sometimes exactly to a limit, sometimes beyond
    match stage.random.below(40) {
        0 => low,
        1 => high,
        2 => high + 1,
        _ => (at + by).clamp(low, high),
    }
}

fn absolute(stage: &mut Stage, weather: Weather) {
    let axis = stage.axis();
    let to = near(stage, axis, weather);
    let before = stage.board.front.commanded();
    let result = stage.board.front.move_absolute(axis, to);
    stage.note(|| format!("{axis:?} to {to}: {result:?}"));
    if !stage.refused(&result, before) {
        stage.expected[axis.index()] = Some(to as i32);
    }
}

fn relative(stage: &mut Stage, weather: Weather) {
    let axis = stage.axis();
    let before = stage.board.front.commanded();
    let by = near(stage, axis, weather) - i64::from(before.0[axis.index()]);
    let result = stage.board.front.move_relative(axis, by);
    stage.note(|| format!("{axis:?} by {by}: {result:?}"));
    if !stage.refused(&result, before) {
        stage.expected[axis.index()] = Some((i64::from(before.0[axis.index()]) + by) as i32);
    }
}

fn pose(stage: &mut Stage, weather: Weather, absolute: bool) {
    let before = stage.board.front.commanded();
    let target: [i64; AXES] = std::array::from_fn(|i| {
        let axis = Axis::from_index(i).unwrap();
        match stage.random.below(4) {
            0 => i64::from(before.0[i]),
            _ => near(stage, axis, weather),
        }
    });
    let front = &mut stage.board.front;
    let result = if absolute {
        front.pose_absolute(target)
    } else {
        front.pose_relative(std::array::from_fn(|i| target[i] - i64::from(before.0[i])))
    };
    stage.note(|| format!("pose {target:?}: {result:?}"));
    if !stage.refused(&result, before) {
        stage.expected = target.map(|t| Some(t as i32));
    }
}

fn jog(stage: &mut Stage) {
    let axis = stage.axis();
    let i = axis.index();
    let most = stage.board.front.motors()[i].velocity as i64;
    let v = match stage.random.below(6) {
        0 => 0,
        1 => most,
        2 => -most,
        _ => stage.any(most),
    };
    let before = stage.board.front.commanded();
    let coordinated = v != 0;
    let result = stage.board.front.jog(axis, v, i as u8);
    stage.note(|| format!("jog {axis:?} {v}: {result:?}"));
    if v == 0 {
        stage.expected = [None; AXES];
    } else if !stage.refused(&result, before) && coordinated {
        // a coordinated move that it belonged to has been stopped
        stage.expected = [None; AXES];
    }
}

fn stop_one(stage: &mut Stage) {
    let axis = stage.axis();
    stage.note(|| format!("stop {axis:?}"));
    stage.board.front.stop(axis);
    // with a coordinated move all of its axes stop
    stage.expected = [None; AXES];
}

fn stop_all(stage: &mut Stage) {
    stage.note(|| "stop".into());
    stage.board.front.stop_all();
    stage.expected = [None; AXES];
    if stage.random.below(2) == 0 {
        stage.settle();
    }
}

fn override_speed(stage: &mut Stage) {
    let percent = 1 + stage.random.below(100) as u8;
    let percent = if stage.random.below(3) == 0 { 100 } else { percent.max(10) };
    stage.note(|| format!("override {percent}"));
    stage.board.front.set_override(percent);
}

fn rates(stage: &mut Stage) {
    let axis = stage.axis();
    let part = 1 + stage.random.below(10);
    let motor = stage.board.front.motors()[axis.index()];
    let mut settings = *stage.board.front.settings();
    let own = &mut settings.axes[axis.index()];
    own.velocity = motor.velocity / part;
    own.acceleration = motor.acceleration / (1 + stage.random.below(10));
    own.jerk = motor.jerk / (1 + stage.random.below(10));
    stage.note(|| format!("rates of {axis:?}: a {part}th"));
    stage.board.front.set_axes(&settings).expect("rates may change while moving");
}

/// An immediate stop at some word; what follows must start from what was played.
pub fn abort(stage: &mut Stage) {
    stage.note(|| "abort".into());
    stage.board.front.abort();
    stage.expected = [None; AXES];
    stage.wait_for_anchor();
}

fn change(stage: &mut Stage) {
    end_jogs(stage);
    stage.settle();
    let before = stage.board.front.motor_counts();
    let kind = stage.random.below(5);
    stage.note(|| format!("change {kind}"));
    match kind {
        0 => {
            let machine = stage.machine.clone();
            stage
                .board
                .front
                .load(&block_of(&machine).expect("the machine can be calibrated"))
                .expect("loads at standstill");
        }
        1 => {
            let mut switches = stage.board.front.settings().switches;
            match stage.random.below(4) {
                0 => switches.compensation ^= true,
                1 => switches.coupling ^= true,
                2 => switches.pivot ^= true,
                _ => switches.backlash ^= true,
            }
            stage.board.front.set_switches(switches).expect("switches at standstill");
        }
        2 => {
            let axis = stage.axis();
            let mut settings = *stage.board.front.settings();
            let own = &mut settings.axes[axis.index()].backlash;
            own.mode =
                [BacklashMode::Off, BacklashMode::Reversal, BacklashMode::UniPositive, BacklashMode::UniNegative]
                    [stage.random.below(4) as usize];
            own.distance = stage.random.below(2 * own.distance.max(10) as u64) as i32;
            own.dead_band = stage.random.below(4) as i32;
            stage.board.front.set_axes(&settings).expect("backlash at standstill");
        }
        3 => {
            let pivot = stage.random.below(3) as u8;
            let point = std::array::from_fn(|_| stage.any(16_000_000) as i32);
            if pivot != 0 {
                let defined = stage.board.front.define_pivot(pivot, point);
                if defined.is_err() {
                    return;
                }
            }
            stage.board.front.select_pivot(pivot).expect("pivot at standstill");
        }
        _ => {
            let mut settings = *stage.board.front.settings();
            for axis in &mut settings.axes {
                axis.velocity = u64::MAX >> 20;
                axis.acceleration = u64::MAX >> 20;
                axis.jerk = u64::MAX >> 16;
                axis.backlash.mode = BacklashMode::Reversal;
            }
            stage.board.front.set_axes(&settings).expect("backlash at standstill");
        }
    }
    stage.wait_for_anchor();
    stage.expect(stage.board.front.motor_counts() == before, "a change moved a motor");
    // a new law: the pose was recomputed, a whole nm near the one before
    match kind {
        0 | 3 => stage.expected = stage.board.front.commanded().0.map(Some),
        1 => stage.expected = [None; AXES],
        _ => {}
    }
}
