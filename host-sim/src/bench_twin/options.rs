//! What a bench is drawn of, and what its parts are called.

use super::{Face, MeasuredWith, SettlingOptions, StageErrors};
use crate::machine::Machine;
use crate::optics::{FrontEnd, Medium, MeterOptions, Mode, SplitterSize};
use serde::Serialize;

/// A side of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The single fibre that brings the light.
    Input,
    /// The fibre array.
    Output,
}

impl Side {
    /// Both, in the order of every pair here.
    pub const BOTH: [Side; 2] = [Side::Input, Side::Output];

    /// 0 or 1.
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// What a channel of the power meter looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sees {
    /// A fibre of the array, from 0.
    Fibre(usize),
    /// A large-area detector close behind the chip, in place of the array: the light of all outputs.
    Detector,
    /// Nothing.
    Nothing,
}

/// Where the optimum lies from home at the beginning: what the cameras leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Guide 0 beside the fibre point in x and in y: uniform within plus and minus this, um.
    pub lateral_um: f64,
    /// Pitch and yaw: uniform within plus and minus this, degrees.
    pub angle_deg: f64,
    /// Roll: the same, degrees.
    pub roll_deg: f64,
    /// Least distance of the corners of the faces: uniform, um.
    pub clearance_um: [f64; 2],
}

impl Start {
    /// What cameras leave: 10 um, 0.4 degrees, 15 to 30 um.
    pub const CAMERAS: Start = Start { lateral_um: 10.0, angle_deg: 0.4, roll_deg: 0.4, clearance_um: [15.0, 30.0] };
    /// Three times as far aside.
    pub const COARSE: Start = Start { lateral_um: 30.0, ..Start::CAMERAS };
}

/// How far modes and medium are off their data sheets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheets {
    /// Standard deviation of a mode radius, a share: the fibre on each side, and the guides.
    pub radius: f64,
    /// Standard deviation of the medium's index less 1, a share; so air is exact.
    pub refraction: f64,
}

impl Default for Sheets {
    /// 2 % of a radius; 1.5 % of n - 1, which is 0.5 % of an index of 1.5.
    fn default() -> Self {
        Sheets { radius: 0.02, refraction: 0.015 }
    }
}

impl Sheets {
    /// Modes and medium are what their data sheets say.
    pub const EXACT: Sheets = Sheets { radius: 0.0, refraction: 0.0 };
}

/// What a bench is drawn of.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The stages as their drawing says; its order, offsets, steps, play, travel and fibre point count.
    pub drawing: Machine,
    /// Errors of the true stages.
    pub stage: StageErrors,
    /// How they settle.
    pub settling: SettlingOptions,
    /// How they are measured for the controller.
    pub measured: MeasuredWith,
    /// Where the stages stand at the beginning.
    pub start: Start,
    /// Speed at which the chip drifts against each stage, um per minute, in a direction by chance.
    pub drift_um_per_min: f64,
    /// Between the faces.
    pub medium: Medium,
    /// Mode of the fibres.
    pub fibre: Mode,
    /// Mode of the guides, which is the same on both sides.
    pub guide: Mode,
    /// How far the bench is off these data sheets.
    pub sheets: Sheets,
    /// The chip.
    pub splitter: SplitterSize,
    /// Standard deviation of a core's place in the array in x and in y, um.
    pub core_sigma_um: f64,
    /// Faces of the fibre's block and of the array.
    pub faces: [Face; 2],
    /// Least distance of the corners that is left for the glue: the optimum keeps it, um.
    pub working_gap_um: f64,
    /// Power in the input fibre, dBm.
    pub laser_dbm: f64,
    /// The two channels of the meter.
    pub meter: MeterOptions,
    /// Their analog outputs, each wired to one input of both boards.
    pub front_end: FrontEnd,
    /// Noise of a conversion, steps of the converter.
    pub adc_noise_lsb: f64,
    /// What the channels look at in the beginning.
    pub sees: [Sees; 2],
}

impl Default for Options {
    fn default() -> Self {
        let splitter = SplitterSize::default();
        let middle = -0.5 * splitter.pitch_um * (splitter.channels - 1) as f64;
        Options {
            drawing: Machine::paper(),
            stage: StageErrors::default(),
            settling: SettlingOptions::default(),
            measured: MeasuredWith::default(),
            start: Start::CAMERAS,
            drift_um_per_min: 0.02,
            medium: Medium { wavelength_um: 1.55, index: 1.5 },
            fibre: Mode::round(5.2),
            guide: Mode::round(4.8),
            sheets: Sheets::default(),
            splitter,
            core_sigma_um: 0.25,
            faces: [
                Face { middle_um: [0.0, 0.0], size_um: [1800.0, 1500.0] },
                Face { middle_um: [middle, -100.0], size_um: [2500.0, 1500.0] },
            ],
            working_gap_um: 10.0,
            laser_dbm: 0.0,
            meter: MeterOptions::default(),
            front_end: FrontEnd::LOGARITHMIC,
            adc_noise_lsb: 1.0,
            sees: [Sees::Fibre(0), Sees::Fibre(splitter.channels - 1)],
        }
    }
}
