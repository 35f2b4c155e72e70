//! Where the actuators stand behind the play of the motors, and how that depends on its width.

use super::series::{Approach, Kind, Series};
use stage_controller::units::{AXES, Axis};

/// Actuators of one reading (nm, nrad), and what they gain per unit of each motor's play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Behind {
    /// On the upward flank the motor's position, on the other one the play above it.
    pub actuators: [f64; AXES],
    /// 0 on the upward flank, 1 on the other one.
    pub per_play: [f64; AXES],
}

/// Stage behind six motors: p = clamp(p, m - b/2, m + b/2) (docs/LAW.md 4), counted from the upward flank.
#[derive(Clone, Copy, Debug)]
pub struct Walk {
    play: [f64; AXES],
    at: Behind,
}

impl Walk {
    /// At home on the upward flank.
    pub fn new(play: [f64; AXES]) -> Self {
        Walk { play, at: Behind { actuators: [0.0; AXES], per_play: [0.0; AXES] } }
    }

    /// The motors move to a position.
    pub fn to(&mut self, motors: &[f64; AXES]) -> Behind {
        for (i, motor) in motors.iter().enumerate() {
            if self.at.actuators[i] <= *motor {
                self.at.actuators[i] = *motor;
                self.at.per_play[i] = 0.0;
            } else if self.at.actuators[i] >= motor + self.play[i] {
                self.at.actuators[i] = motor + self.play[i];
                self.at.per_play[i] = 1.0;
            }
        }
        self.at
    }
}

/// Actuators of all readings of a file.
pub fn actuators(series: &Series, play: [f64; AXES]) -> Vec<Behind> {
    let flank = |motors: [f64; AXES], down: [bool; AXES]| Behind {
        actuators: std::array::from_fn(|i| if down[i] { motors[i] + play[i] } else { motors[i] }),
        per_play: down.map(|down| if down { 1.0 } else { 0.0 }),
    };
    let alone = |axis: Axis, down: bool| std::array::from_fn(|i| down && i == axis.index());
    let mut walk = Walk::new(play);
    let place = |reading: &super::series::Reading| match (series.kind, series.approach) {
        (Kind::Positioning(axis) | Kind::Straightness { axis, .. }, _) => {
            flank(reading.motors, alone(axis, reading.down))
        }
        (_, Approach::Up) => flank(reading.motors, [false; AXES]),
        (_, Approach::Down) => flank(reading.motors, [true; AXES]),
        (_, Approach::Sequence) => walk.to(&reading.motors),
    };
    series.readings.iter().map(place).collect()
}
