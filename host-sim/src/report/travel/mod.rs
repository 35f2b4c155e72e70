//! What each part of the compensation buys: the same moves with none of it, with each part alone and with all.
//!
//! # Design
//! At every stop the motors stand where the controller's fixed-point law, the reversal rule and the overlay put them,
//! and the stage where the twin's play and the exact model of all its errors put it; the error is the true pose less the commanded one.
//! Between stops the target is followed finely enough to see motors that turn on the way. Stops are at rest: what the
//! overlay still lacks during a take-up does not show.

mod drive;
mod tracks;
mod view;

pub use drive::{Mode, Stage};
pub use tracks::{Kind, Track};
pub use view::section;

use super::number::Spread;
use crate::machine::Machine;
use serde::Serialize;
use stage_controller::compensation::calibration::Calibration;
use stage_controller::units::AXES;

/// One track with one part of the compensation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Which part is on.
    pub mode: Mode,
    /// Distance of the fibre point from where it was commanded, um.
    pub position_um: Spread,
    /// Rotation of the array against the commanded orientation, urad.
    pub orientation_urad: Spread,
    /// The distance at every stop, um.
    pub stops_um: Vec<f64>,
}

/// One track with every part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Result {
    /// The moves.
    #[serde(flatten)]
    pub track: Track,
    /// The runs in the order of [`Mode::ALL`].
    pub runs: Vec<Run>,
}

/// All tracks.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Travel {
    /// Each track with its runs; the last one is the poses spread over the travel.
    pub tracks: Vec<Result>,
}

impl Travel {
    /// Runs all tracks.
    pub fn new(machine: &Machine, calibration: &Calibration) -> Self {
        let tracks = tracks::all(machine, calibration)
            .into_iter()
            .map(|(track, poses)| {
                let runs = Mode::ALL.map(|mode| run(machine, calibration, mode, &poses)).into();
                Result { track, runs }
            })
            .collect();
        Travel { tracks }
    }
}

fn run(machine: &Machine, calibration: &Calibration, mode: Mode, poses: &[[f64; AXES]]) -> Run {
    let mut stage = Stage::new(machine, calibration, mode);
    let (mut stops_um, mut turned) = (Vec::new(), Vec::new());
    for pose in poses {
        let error = stage.go(*pose);
        stops_um.push(error.position_nm * 1e-3);
        turned.push(error.orientation_rad * 1e6);
    }
    Run { mode, position_um: Spread::of(&stops_um), orientation_urad: Spread::of(&turned), stops_um }
}
