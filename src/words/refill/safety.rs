//! What stops all motors at once: limit switches, the emergency stop, drivers in fault, a late refill.
//!
//! # Design
//! [`Watch`] is a few bits of plain data, so that an interrupt above the refill can judge the inputs: a watched
//! switch stops the motors when its own motor may be stepping towards it. A switch that is left, or that belongs to a
//! motor at rest, stops nothing: it may bounce. The refill judges the same inputs once a segment.

use crate::units::AXES;

/// Bits of all motors.
const ALL: u8 = (1 << AXES) - 1;

/// Levels of the board's inputs as sampled; bit n belongs to motor n.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// The line of the lower limit switch is high.
    pub lower: u8,
    /// The line of the upper limit switch is high.
    pub upper: u8,
    /// The fault line of the driver is high.
    pub fault: u8,
    /// The contact of the emergency stop is open.
    pub stop: bool,
}

/// Which levels of the inputs stop motors; bit n belongs to motor n.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Watch {
    /// The limit switches of the motor are watched.
    pub limits: u8,
    /// Its limit switches are active when high.
    pub limits_high: u8,
    /// The fault line of its driver is watched.
    pub faults: u8,
    /// Its fault line is active when high.
    pub faults_high: u8,
}

impl Watch {
    /// Switches and faults that are active, watched or not.
    #[inline(always)]
    pub fn active(&self, inputs: Inputs) -> Inputs {
        Inputs {
            lower: !(inputs.lower ^ self.limits_high) & ALL,
            upper: !(inputs.upper ^ self.limits_high) & ALL,
            fault: !(inputs.fault ^ self.faults_high) & ALL,
            stop: inputs.stop,
        }
    }

    /// What the motors are to be stopped for, if anything. `up`, `down`: motors that may be stepping that way in the
    /// words that play or wait to be played.
    #[inline(always)]
    pub fn halt(&self, inputs: Inputs, up: u8, down: u8) -> Option<Halt> {
        if !inputs.stop && self.limits | self.faults == 0 {
            return None;
        }
        let active = self.active(inputs);
        let halt = |cause, lower, upper, fault| Some(Halt { cause, lower, upper, fault });
        let (lower, upper) = (active.lower & self.limits & down, active.upper & self.limits & up);
        let fault = active.fault & self.faults;
        if active.stop {
            halt(Cause::EmergencyStop, 0, 0, 0)
        } else if lower | upper != 0 {
            halt(Cause::Limit, lower, upper, 0)
        } else if fault != 0 {
            halt(Cause::DriverFault, 0, 0, fault)
        } else {
            None
        }
    }

    /// The bits in one word, for an atomic.
    pub fn to_bits(self) -> u32 {
        u32::from_le_bytes([self.limits, self.limits_high, self.faults, self.faults_high])
    }

    /// The inverse of [`Watch::to_bits`].
    pub fn from_bits(bits: u32) -> Self {
        let [limits, limits_high, faults, faults_high] = bits.to_le_bytes();
        Watch { limits, limits_high, faults, faults_high }
    }
}

/// Why all motors were stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cause {
    /// ABORt, or whatever asks for an immediate stop.
    #[default]
    Requested,
    /// A limit switch.
    Limit,
    /// The emergency stop: latched, the stream stands until it is armed again.
    EmergencyStop,
    /// A driver reported a fault.
    DriverFault,
    /// A segment was not ready in time: silence was played instead, the position is exact.
    Deadline,
    /// The step output itself failed (DMA error).
    Output,
}

/// Why all motors were stopped, and where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Halt {
    /// The cause.
    pub cause: Cause,
    /// Motors that ran onto their lower limit switch.
    pub lower: u8,
    /// Motors that ran onto their upper limit switch.
    pub upper: u8,
    /// Motors whose driver reported a fault.
    pub fault: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    const WATCH: Watch = Watch { limits: 0b11, limits_high: 0b10, faults: 0b1, faults_high: 0 };
    /// Switches open: motor 0 is active low, motor 1 active high.
    const QUIET: Inputs = Inputs { lower: 0b01, upper: 0b01, fault: 0b111111, stop: false };

    #[test]
    fn a_switch_stops_only_what_moves_towards_it() {
        let hit = Inputs { upper: 0b11, ..QUIET };
        assert_eq!(WATCH.halt(hit, 0b10, 0), Some(Halt { cause: Cause::Limit, upper: 0b10, ..Halt::default() }));
        assert_eq!(WATCH.halt(hit, 0b01, 0b10), None, "motor 1 leaves its upper switch");
        assert_eq!(WATCH.halt(QUIET, 0b111111, 0b111111), None);
    }

    #[test]
    fn an_unwatched_switch_stops_nothing_and_is_still_seen() {
        let hit = Inputs { lower: 0b01 & !0b01, ..QUIET };
        let deaf = Watch { limits: 0, ..WATCH };
        assert_eq!(deaf.halt(hit, 0b111111, 0b111111), None);
        assert_eq!(deaf.active(hit).lower & 0b11, 0b01);
    }

    #[test]
    fn the_emergency_stop_comes_before_everything() {
        let all = Inputs { lower: 0, upper: 0b11, fault: 0, stop: true };
        assert_eq!(WATCH.halt(all, 0b11, 0b11).map(|halt| halt.cause), Some(Cause::EmergencyStop));
        assert_eq!(WATCH.halt(Inputs { stop: false, ..all }, 0, 0).map(|halt| halt.fault), Some(0b1));
    }

    #[test]
    fn the_bits_come_back() {
        assert_eq!(Watch::from_bits(WATCH.to_bits()), WATCH);
    }
}
