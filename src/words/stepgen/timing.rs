//! What the motor drivers ask of the edges, in whole ticks.

use super::pins::{DIR_PINS, STEP_PINS};
use crate::units::{AXES, TICKS_PER_SECOND};
use serde::{Deserialize, Serialize};

/// Duration of a tick in nanoseconds.
const TICK_NS: u32 = 1_000_000_000 / TICKS_PER_SECOND;

/// Coarsest grid in ticks.
pub const MAX_GRID: u32 = 32;

/// Longest set-up or hold time, ns.
pub const MAX_SETTLE_NS: u32 = 128_000;

/// What the driver of one motor asks for, in nanoseconds. STEP acts on its rising edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MotorTiming {
    /// Shortest time that STEP is high.
    pub high_ns: u32,
    /// Shortest time that STEP is low.
    pub low_ns: u32,
    /// Shortest time from a change of DIR to the rising edge.
    pub setup_ns: u32,
    /// Shortest time from the rising edge to a change of DIR.
    pub hold_ns: u32,
}

impl Default for MotorTiming {
    fn default() -> Self {
        MotorTiming { high_ns: 1_000, low_ns: 1_000, setup_ns: 2_500, hold_ns: 2_500 }
    }
}

/// One motor's lines and times, as the placement needs them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Set bit of the STEP line.
    pub(super) step: u32,
    /// Set bit of the DIR line.
    pub(super) dir: u32,
    /// True where a high DIR line means downwards.
    pub(super) inverted: bool,
    /// Steps start on multiples of this many ticks; also the width of a pulse. A power of two.
    pub(super) grid: u32,
    /// Ticks from a change of DIR to a rising edge, at least.
    pub(super) setup: u32,
    /// Ticks from a rising edge to a change of DIR, at least.
    pub(super) hold: u32,
}

impl Line {
    /// Ticks between two rising edges, at least: one grid high, one grid low.
    pub(super) const fn gap(&self) -> u32 {
        2 * self.grid
    }

    /// Rounds a tick down to the grid.
    pub(super) const fn on_grid(&self, tick: u32) -> u32 {
        tick & !(self.grid - 1)
    }
}

/// Timing of all motors. The grid is common, because the reset pattern is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    grid: u32,
    lines: [Line; AXES],
}

impl Timing {
    /// The timing that meets what every driver asks for, or `None` if a pulse would need a grid
    /// above [`MAX_GRID`] ticks or a set-up or hold time exceeds [`MAX_SETTLE_NS`].
    ///
    /// The grid is the smallest power of two of ticks that covers the longest high or low time.
    /// Set-up is at least one tick; hold is at least the grid, so that DIR never changes while
    /// STEP is high.
    pub fn new(motors: [MotorTiming; AXES]) -> Option<Timing> {
        let ticks = |ns: u32| ns.div_ceil(TICK_NS).max(1);
        let longest = motors.iter().map(|m| ticks(m.high_ns.max(m.low_ns))).max()?;
        let grid = longest.checked_next_power_of_two().filter(|&grid| grid <= MAX_GRID)?;
        let blank = Line { step: 0, dir: 0, inverted: false, grid, setup: 0, hold: 0 };
        let mut lines = [blank; AXES];
        let pins = STEP_PINS.iter().zip(&DIR_PINS);
        for ((line, motor), (&step, &dir)) in lines.iter_mut().zip(&motors).zip(pins) {
            line.step = 1 << step;
            line.dir = 1 << dir;
            if motor.setup_ns.max(motor.hold_ns) > MAX_SETTLE_NS {
                return None;
            }
            line.setup = ticks(motor.setup_ns);
            line.hold = ticks(motor.hold_ns).max(grid);
        }
        Some(Timing { grid, lines })
    }

    /// The same timing with the sense of DIR inverted for the motors marked `true`.
    pub fn with_inverted(mut self, inverted: [bool; AXES]) -> Timing {
        for (line, inverted) in self.lines.iter_mut().zip(inverted) {
            line.inverted = inverted;
        }
        self
    }

    /// The grid in ticks: steps start on its multiples and a pulse is one grid wide.
    pub fn grid(&self) -> u32 {
        self.grid
    }

    /// Set-up times in ticks.
    pub fn setup_ticks(&self) -> [u32; AXES] {
        self.lines.map(|line| line.setup)
    }

    /// Hold times in ticks, counted from the rising edge of STEP.
    pub fn hold_ticks(&self) -> [u32; AXES] {
        self.lines.map(|line| line.hold)
    }

    /// Ceiling of the step rate in steps/s: 0.2 % below one step per two grids, so that the
    /// rounding of crossings to the grid never brings two edges too close.
    pub fn max_step_rate(&self) -> u32 {
        let fastest = TICKS_PER_SECOND / (2 * self.grid);
        fastest - fastest.div_ceil(500)
    }

    /// Each motor's lines and times, in the order of the axes.
    pub fn lines(&self) -> &[Line; AXES] {
        &self.lines
    }
}

impl Default for Timing {
    /// The default times of [`MotorTiming`], on a grid of one tick of 1 us.
    fn default() -> Self {
        let line = |motor: usize| Line {
            step: 1 << STEP_PINS[motor],
            dir: 1 << DIR_PINS[motor],
            inverted: false,
            grid: 1,
            setup: 3,
            hold: 3,
        };
        Timing { grid: 1, lines: [line(0), line(1), line(2), line(3), line(4), line(5)] }
    }
}
