//! Controller and stage from stop to stop: fixed-point law, reversal rule, overlay; play and all errors of the stage.

use crate::calibrate::Q32;
use crate::machine::Machine;
use crate::model::{Euler, vee};
use crate::twin::Mechanics;
use serde::Serialize;
use stage_controller::compensation::backlash::{Flank, Play, PlayConfig};
use stage_controller::compensation::calibration::Calibration;
use stage_controller::compensation::law::{Law, Remembered, Switches};
use stage_controller::units::{AXES, FinePose, MotorSteps};

/// Points at which a move between two stops is looked at for motors that turn.
const POINTS: usize = 64;

/// Which part of the compensation is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Every motor follows its own coordinate.
    None,
    /// The overlay alone.
    Backlash,
    /// D^-1, W^-1 and the second-order term alone.
    Coupling,
    /// The rotation centre alone.
    Pivot,
    /// Everything.
    All,
}

impl Mode {
    /// In the order in which the page shows them.
    pub const ALL: [Mode; 5] = [Mode::None, Mode::Backlash, Mode::Coupling, Mode::Pivot, Mode::All];

    /// Its name on the page, in JSON and among the classes of the style.
    pub const fn name(self) -> &'static str {
        ["none", "backlash", "coupling", "pivot", "all"][self as usize]
    }

    /// The controller's switches.
    pub fn switches(self) -> Switches {
        let one = |mode| self == Mode::All || self == mode;
        Switches {
            compensation: self != Mode::None,
            coupling: one(Mode::Coupling),
            pivot: one(Mode::Pivot),
            backlash: one(Mode::Backlash),
        }
    }
}

/// How far the fibre array is from where it was commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Miss {
    /// Distance of the fibre point, nm.
    pub position_nm: f64,
    /// Angle of the rotation between commanded and true orientation, rad.
    pub orientation_rad: f64,
}

/// A controller with its stage, from rest to rest; homed at 0 on the reference flank.
#[derive(Clone, Debug)]
pub struct Stage {
    law: Law,
    plays: [Play; AXES],
    configs: [PlayConfig; AXES],
    mechanics: Mechanics,
    euler: Euler,
    pose: [f64; AXES],
}

impl Stage {
    /// At home, with parts of the compensation.
    pub fn new(machine: &Machine, calibration: &Calibration, mode: Mode) -> Self {
        let switches = mode.switches();
        let width = |steps: u32| if switches.compensation && switches.backlash { steps as i32 } else { 0 };
        Stage {
            law: Law::new(calibration, switches, calibration.fibre_point),
            plays: [Play::resting(0, Some(Flank::Positive), 0); AXES],
            configs: calibration
                .motors
                .map(|motor| PlayConfig { width: width(motor.backlash_steps), ..PlayConfig::default() }),
            mechanics: Mechanics::new(machine, [false; AXES]),
            euler: Euler::new(&machine.order),
            pose: [0.0; AXES],
        }
    }

    /// Moves straight (in logical coordinates, nm and nrad) to a pose and stops there.
    pub fn go(&mut self, pose: [f64; AXES]) -> Miss {
        let (from, mut remembered) = (self.pose, Remembered::default());
        for point in 1..=POINTS {
            let share = point as f64 / POINTS as f64;
            let at = std::array::from_fn(|i| ((from[i] + (pose[i] - from[i]) * share) * Q32).round() as i64);
            let targets = self.law.targets(&FinePose(at), &mut remembered).floor().0;
            self.mechanics.run_to(MotorSteps(std::array::from_fn(|i| {
                let (play, config) = (&mut self.plays[i], &self.configs[i]);
                play.turn(targets[i], config.dead_band);
                targets[i] + config.overlay_of(play.flank())
            })));
        }
        self.pose = pose;
        self.miss()
    }

    /// Motor counts, overlay included.
    pub fn motors(&self) -> MotorSteps {
        self.mechanics.motors()
    }

    /// True pose, nm and nrad, counted from home: [`Mechanics::true_pose`].
    pub fn true_pose(&self) -> [f64; AXES] {
        self.mechanics.true_pose()
    }

    fn miss(&self) -> Miss {
        let truth = self.true_pose();
        let position_nm = (0..3).map(|i| (truth[i] - self.pose[i]).powi(2)).sum::<f64>().sqrt();
        let turned = self.euler.of_pose(&truth) * self.euler.of_pose(&self.pose).transpose();
        let orientation_rad = vee(&turned).norm();
        Miss { position_nm, orientation_rad }
    }
}
