//! The bytes of the settings in a record.

use super::{AxisSettings, BacklashMode, Settings, Side};
use crate::wire::Wire;

const MODES: [BacklashMode; 4] =
    [BacklashMode::Off, BacklashMode::Reversal, BacklashMode::UniPositive, BacklashMode::UniNegative];

impl Settings {
    /// Reads or writes every field.
    pub fn wire(&mut self, wire: &mut Wire<'_>) {
        self.axes.iter_mut().for_each(|axis| axis.wire(wire));
        let switches = &mut self.switches;
        for on in [&mut switches.compensation, &mut switches.coupling, &mut switches.pivot, &mut switches.backlash] {
            wire.flag(on);
        }
        wire.byte(&mut self.override_percent);
        wire.word(&mut self.jog_timeout_ms);
        wire.word(&mut self.baud);
    }
}

impl AxisSettings {
    #[inline(never)]
    fn wire(&mut self, wire: &mut Wire<'_>) {
        for rate in [&mut self.velocity, &mut self.start_velocity, &mut self.acceleration, &mut self.jerk] {
            wire.long(rate);
        }
        wire.signed(&mut self.soft_lower);
        wire.signed(&mut self.soft_upper);
        wire.flag(&mut self.soft_on);
        wire.long(&mut self.step_q32);
        wire.flag(&mut self.inverted);
        let timing = &mut self.timing;
        for time in [&mut timing.high_ns, &mut timing.low_ns, &mut timing.setup_ns, &mut timing.hold_ns] {
            wire.word(time);
        }
        let backlash = &mut self.backlash;
        wire.choice(&mut backlash.mode, &MODES);
        wire.signed(&mut backlash.distance);
        wire.long(&mut backlash.velocity);
        wire.signed(&mut backlash.dead_band);
        wire.signed(&mut backlash.margin);
        let wiring = &mut self.wiring;
        for level in [&mut wiring.limits_on, &mut wiring.limits_high, &mut wiring.enable_high, &mut wiring.fault_high] {
            wire.flag(level);
        }
        wire.choice(&mut self.home.side, &[Side::Lower, Side::Upper]);
        wire.long(&mut self.home.velocity);
        if let Some(offset) = wire.some(&mut self.home.offset) {
            wire.signed(offset);
        }
    }
}
