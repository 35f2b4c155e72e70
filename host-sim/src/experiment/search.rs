//! What is tried on every bench: searches, where each begins, and the messages that switch a compensation.

use crate::bench_twin::Start;
use crate::report::Mode;

/// Steps of the climbs, um.
pub const STEPS_UM: [f64; 5] = [0.1, 0.2, 0.3, 0.5, 1.0];
/// Start of the climbs: straight, up to 3 um aside.
pub const NEAR: Start = Start { lateral_um: 3.0, angle_deg: 0.0, roll_deg: 0.0, clearance_um: [8.0, 12.0] };
/// Start of the angle climb: the same with pitch and yaw up to 1 degree off.
pub const TILTED: Start = Start { angle_deg: 1.0, ..NEAR };

/// A search with its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Search {
    /// x and y, one after the other, step by step, from near.
    Climb {
        /// Its step, um.
        step_um: f64,
    },
    /// x and y, then pitch and yaw without going back to the peak, gap, x and y.
    AngleClimb,
    /// The same, but back to the peak in x and y after every turn.
    AngleClimbRepeaked,
    /// The project's own alignment, from where the climb begins.
    RobustNear,
    /// The same, from what cameras leave.
    Robust,
}

impl Search {
    /// All of the experiment.
    pub fn all() -> Vec<Search> {
        let climbs = STEPS_UM.map(|step_um| Search::Climb { step_um });
        climbs
            .into_iter()
            .chain([Search::AngleClimb, Search::AngleClimbRepeaked, Search::RobustNear, Search::Robust])
            .collect()
    }

    /// Its name in JSON.
    pub fn name(self) -> String {
        match self {
            Search::Climb { step_um } => format!("climb_{step_um:.1}"),
            Search::AngleClimb => "angle_climb".into(),
            Search::AngleClimbRepeaked => "angle_climb_repeaked".into(),
            Search::RobustNear => "robust_near".into(),
            Search::Robust => "robust".into(),
        }
    }

    /// Its name in tables.
    pub fn words(self) -> String {
        match self {
            Search::Climb { step_um } => format!("climb, {step_um:.1} um"),
            Search::AngleClimb => "angle climb".into(),
            Search::AngleClimbRepeaked => "angle climb, re-peaked".into(),
            Search::RobustNear => "robust, start near".into(),
            Search::Robust => "robust, start cameras".into(),
        }
    }

    /// Where it begins.
    pub fn start(self) -> Start {
        match self {
            Search::Climb { .. } | Search::RobustNear => NEAR,
            Search::AngleClimb | Search::AngleClimbRepeaked => TILTED,
            Search::Robust => Start::CAMERAS,
        }
    }

    /// A compensation has something to correct in it. In a climb over x and y alone nothing turns: what cross-coupling and
    /// rotation centre correct does not change, and a difference from `none` is chance.
    pub fn is_touched_by(self, mode: Mode) -> bool {
        let lateral = matches!(self, Search::Climb { .. });
        mode != Mode::None && !(lateral && matches!(mode, Mode::Coupling | Mode::Pivot))
    }

    /// It is [`align`](crate::alignment::align).
    pub fn is_robust(self) -> bool {
        matches!(self, Search::Robust | Search::RobustNear)
    }
}

/// The commands that switch parts of the compensation, in their order: the whole comes last, because none of the parts
/// does anything without it.
pub fn switches(mode: Mode) -> Vec<String> {
    let on = mode.switches();
    let word = |on: bool| if on { "ON" } else { "OFF" };
    vec![
        format!("COMP:COUP:STAT {}", word(on.coupling)),
        format!("COMP:PIV:STAT {}", word(on.pivot)),
        format!("COMP:BACK:STAT {}", word(on.backlash)),
        format!("COMP:STAT {}", word(on.compensation)),
    ]
}
