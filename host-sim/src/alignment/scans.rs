//! The scans of a controller, as commands and answers.

use super::bus::{Bus, BusError, Controller};
use stage_controller::units::Axis;

/// What stands for a number that is not known (SCPI-99, 7.2.1.4).
const NOT_A_NUMBER: f64 = 9.9e36;
/// Longest that a scan may take, s.
const PATIENCE_S: f64 = 30.0;

/// What a scan found. Positions in um or degrees.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Bits of the status word.
    pub status: u16,
    /// Samples used.
    pub samples: u32,
    /// Level of the peak, dBm.
    pub level_dbm: f64,
    /// Each axis: place of the peak, its standard uncertainty if known, where the stage stands.
    pub axes: Vec<Place>,
}

/// One axis of a result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The peak.
    pub peak: f64,
    /// Its standard uncertainty.
    pub sigma: Option<f64>,
    /// Where the scan ended.
    pub ended: f64,
}

/// Where a scan ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// At the peak.
    Peak,
    /// Where it began.
    Start,
    /// Where the threshold is reached first.
    First,
}

impl End {
    const fn word(self) -> &'static str {
        match self {
            End::Peak => "PEAK",
            End::Start => "STAR",
            End::First => "FIRS",
        }
    }
}

/// The side of the play on which a motor rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flank {
    /// Points are come to upwards.
    Positive,
    /// Points are come to downwards.
    Negative,
}

/// A scan with its parameters. Channels count from 1, lengths in um or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scan {
    /// Sampled in motion, in one direction.
    Line {
        /// Power input.
        channel: usize,
        /// Which axis.
        axis: Axis,
        /// Whole way, about where it begins.
        range: f64,
        /// Way between two samples.
        pitch: f64,
        /// Level that counts as light, dBm.
        threshold_dbm: f64,
        /// Where it ends.
        end: End,
    },
    /// Measured at rest.
    Parabola {
        /// Power input.
        channel: usize,
        /// Which axis.
        axis: Axis,
        /// Whole way, about where it begins.
        range: f64,
        /// How many.
        points: usize,
        /// Level that counts as light, dBm.
        threshold_dbm: f64,
        /// Where it ends.
        end: End,
        /// The flank on which every point is approached.
        flank: Flank,
    },
    /// In x and y, until there is light.
    FirstLight {
        /// Power input.
        channel: usize,
        /// Whole way in both.
        range: f64,
        /// Between turns.
        step: f64,
        /// Way between two samples.
        pitch: f64,
        /// Level that counts as light, dBm.
        threshold_dbm: f64,
    },
}

impl Scan {
    /// The command that defines it.
    fn definition(&self) -> String {
        let number = |axis: Axis| axis.index() + 1;
        match *self {
            Scan::Line { channel, axis, range, pitch, threshold_dbm, end } => {
                let n = number(axis);
                format!("SCAN:DEF:LINE 0,{channel},{n},{range:.6},{pitch:.6},{threshold_dbm:.3},{}", end.word())
            }
            Scan::Parabola { channel, axis, range, points, threshold_dbm, end, flank } => {
                let (n, end) = (number(axis), end.word());
                let flank = if flank == Flank::Positive { "POS" } else { "NEG" };
                format!("SCAN:DEF:PAR 0,{channel},{n},{range:.6},{points},{threshold_dbm:.3},{end},{flank}")
            }
            Scan::FirstLight { channel, range, step, pitch, threshold_dbm } => {
                format!("SCAN:DEF:SPIR 0,{channel},1,2,{range:.3},{pitch:.3},{step:.3},{threshold_dbm:.3},FIRS")
            }
        }
    }
}

impl<B: Bus> Controller<'_, B> {
    /// Runs a scan to its end.
    ///
    /// # Errors
    /// Those of the bus; [`BusError::Refused`] for a scan that found nothing.
    pub fn scan(&mut self, scan: &Scan) -> Result<Found, BusError> {
        self.run(&format!("{};:SCAN:STAR 0", scan.definition()), PATIENCE_S)?;
        let numbers = self.numbers("SCAN:RES? 0")?;
        let known = |value: f64| (value < NOT_A_NUMBER).then_some(value);
        let place = |place: &[f64]| Place { peak: place[0], sigma: known(place[1]), ended: place[2] };
        match numbers.as_slice() {
            [status, samples, level_dbm, places @ ..] if places.len() % 3 == 0 && !places.is_empty() => Ok(Found {
                status: *status as u16,
                samples: *samples as u32,
                level_dbm: *level_dbm,
                axes: places.chunks_exact(3).map(place).collect(),
            }),
            _ => Err(self.strange(
                "SCAN:RES? 0",
                &format!("{numbers:?}"),
                "status, samples, level and three for each axis",
            )),
        }
    }

    /// Means of both power inputs, dBm.
    ///
    /// # Errors
    /// Those of the bus.
    pub fn powers(&mut self) -> Result<[f64; 2], BusError> {
        const QUESTION: &str = "SENS1:POW?;:SENS2:POW?";
        let numbers = self.numbers(QUESTION)?;
        numbers.as_slice().try_into().map_err(|_| self.strange(QUESTION, &format!("{numbers:?}"), "two levels"))
    }

    /// Moves by so much, um and degrees in the order X, Y, Z, alpha, beta, gamma, and waits until it stands.
    ///
    /// # Errors
    /// Those of the bus.
    pub fn move_by(&mut self, by: [f64; 6]) -> Result<(), BusError> {
        self.begin_move(by)?;
        self.end_move(by)
    }

    /// Sends such a move; none without a way.
    pub(super) fn begin_move(&mut self, by: [f64; 6]) -> Result<(), BusError> {
        if by == [0.0; 6] { Ok(()) } else { self.begin(&move_command(by)) }
    }

    /// Waits for its end.
    pub(super) fn end_move(&mut self, by: [f64; 6]) -> Result<(), BusError> {
        if by == [0.0; 6] { Ok(()) } else { self.end(&move_command(by), PATIENCE_S) }
    }

    /// Where it stands by command, um and degrees.
    ///
    /// # Errors
    /// Those of the bus.
    pub fn pose(&mut self) -> Result<[f64; 6], BusError> {
        let numbers = self.numbers("POSE?")?;
        numbers.as_slice().try_into().map_err(|_| self.strange("POSE?", &format!("{numbers:?}"), "six numbers"))
    }
}

fn move_command([x, y, z, alpha, beta, gamma]: [f64; 6]) -> String {
    format!("POSE:REL {x:.4},{y:.4},{z:.4},{alpha:.7},{beta:.7},{gamma:.7}")
}
