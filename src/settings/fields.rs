//! The bytes of the settings in a record.

use super::{AxisSettings, BacklashMode, Settings, Side};
use crate::sense::{Input, SenseSettings};
use crate::wire::Wire;

const MODES: [BacklashMode; 4] =
    [BacklashMode::Off, BacklashMode::Reversal, BacklashMode::UniPositive, BacklashMode::UniNegative];

impl Settings {
    /// Reads or writes every field that a record of this version has; version 1 knows no power inputs.
    pub fn wire(&mut self, wire: &mut Wire<'_>, version: u16) {
        self.axes.iter_mut().for_each(|axis| axis.wire(wire));
        let switches = &mut self.switches;
        for on in [&mut switches.compensation, &mut switches.coupling, &mut switches.pivot, &mut switches.backlash] {
            wire.flag(on);
        }
        wire.byte(&mut self.override_percent);
        wire.word(&mut self.jog_timeout_ms);
        wire.word(&mut self.baud);
        if version >= 2 {
            self.sense.iter_mut().for_each(|input| input.wire(wire));
        }
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

impl SenseSettings {
    #[inline(never)]
    fn wire(&mut self, wire: &mut Wire<'_>) {
        let (mut logarithmic, mut gain, mut slope, mut zero) = match self.input {
            Input::Linear(gain) => (false, gain, 0, 0),
            Input::Logarithmic(slope, zero) => (true, 0, slope, zero),
        };
        wire.choice(&mut logarithmic, &[false, true]);
        if logarithmic {
            wire.signed(&mut slope);
            wire.signed(&mut zero);
            self.input = Input::Logarithmic(slope, zero);
        } else {
            wire.long(&mut gain);
            self.input = Input::Linear(gain);
        }
        if let Some(range) = wire.some(&mut self.range) {
            wire.signed(range);
        }
        wire.word(&mut self.delay_ns);
        let mut average = self.average.into();
        wire.word(&mut average);
        self.average = average as u16;
        wire.flag(&mut self.watts);
    }
}
