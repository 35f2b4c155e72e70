//! What the commands of the language do: from a parsed call to the front.
//!
//! Every handler takes all of its parameters before it changes anything.

mod axis;
mod axis_settings;
mod compare;
mod compensation;
mod pose;
mod scan;
mod sense;
mod setting;
mod system;
mod trace;

use super::front::{Front, axis_condition};
use crate::error::Error;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::{Flow, Instrument};
use crate::scpi::status::Conditions;
use crate::scpi::tree::Command as C;
use crate::settings::{JOG_TIMEOUT_MAX_MS, JOG_TIMEOUT_MIN_MS};
use crate::units::Axis;
use crate::units::decimal::Unit;
use setting::{Kind, Setting, nanoseconds};

/// Bits of STATus:OPERation and STATus:QUEStionable.
mod condition {
    pub const HOMING: u16 = 1 << 0;
    pub const SCANNING: u16 = 1 << 3;
    pub const WAITING_FOR_TRIGGER: u16 = 1 << 5;
    pub const MOVING: u16 = 1 << 8;
    pub const TAKE_UP: u16 = 1 << 9;
    pub const POWER: u16 = 1 << 3;
    pub const SETTINGS_LOST: u16 = 1 << 8;
    pub const DEADLINE: u16 = 1 << 9;
    pub const EMERGENCY_STOP: u16 = 1 << 10;
    pub const LIMIT: u16 = 1 << 11;
    pub const INTERNAL_OSCILLATOR: u16 = 1 << 12;
}

impl Instrument for Front {
    fn execute(&mut self, link: u8, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
        let stops = matches!(
            call.command,
            C::Abort | C::AxisStopImmediate | C::AxisStop | C::Stop | C::ScanStop | C::EmergencyStopClear
        );
        if !call.query && !stops && self.is_busy_at_the_border() {
            return Ok(Flow::Wait);
        }
        let stores = matches!(call.command, C::Save | C::Recall | C::SystemPark);
        if !call.query && !stops && !stores && self.storage_pending() {
            return Ok(Flow::Wait);
        }
        match call.command {
            C::Identify => out.text(concat!("Stage Controller,SC6,0,", env!("CARGO_PKG_VERSION"))),
            C::SelfTest | C::Options => out.integer(0),
            C::Reset | C::SystemPreset => return Ok(reset(self)),
            C::TimeTick => out.integer(i64::try_from(self.ticks()).unwrap_or(i64::MAX)),
            C::JogTimeout => {
                let millisecond = nanoseconds(1);
                let setting = Setting {
                    kind: Kind::Number(Unit::TIME),
                    now: i64::from(self.settings.jog_timeout_ms) * millisecond,
                    least: i64::from(JOG_TIMEOUT_MIN_MS) * millisecond,
                    most: i64::from(JOG_TIMEOUT_MAX_MS) * millisecond,
                    default: 1000 * millisecond,
                };
                if let Some(t) = setting.access(call, out)? {
                    self.settings.jog_timeout_ms = ((t + millisecond / 2) / millisecond) as u32;
                }
            }
            C::Save | C::Recall | C::SystemPark | C::SerialBaud => return system::execute(self, call, out),
            C::Stop => self.stop_all(),
            C::Abort => self.abort(),
            C::EmergencyStopState => {
                out.integer(u8::from(self.is_stopped()));
                out.integer(u8::from(self.stop_contact_open()));
            }
            C::EmergencyStopClear => self.clear_stop()?,
            C::CompareDefine | C::CompareCount => compare::execute(self, call, out)?,
            C::StatusAxis => out.integer(self.axis_condition(call.axis())),
            _ => return other(self, link, call, out),
        }
        Ok(Flow::Done)
    }

    fn abort(&mut self, _link: u8) {
        Front::abort(self);
    }

    fn operation_pending(&self) -> bool {
        Front::operation_pending(self)
    }

    fn conditions(&self) -> Conditions {
        let mut conditions = Conditions::default();
        for (axis, own) in Axis::ALL.into_iter().zip(self.axis_conditions()) {
            let bit = 1 << (axis.index() + 1);
            let has = |mask: u16| own & mask != 0;
            if has(axis_condition::MOVING) {
                conditions.operation_instrument |= bit;
            }
            if !has(axis_condition::HOMED) || has(axis_condition::UNCERTAIN | axis_condition::DRIVER_FAULT) {
                conditions.questionable_instrument |= bit;
            }
            let limits = axis_condition::SOFT_LOW
                | axis_condition::SOFT_HIGH
                | axis_condition::HARD_LOW
                | axis_condition::HARD_HIGH;
            if has(limits) {
                conditions.questionable |= condition::LIMIT;
            }
        }
        if conditions.operation_instrument != 0 {
            conditions.operation |= condition::MOVING;
        }
        if self.taking_up() != 0 {
            conditions.operation |= condition::TAKE_UP;
        }
        if self.homing_axis().is_some() {
            conditions.operation |= condition::HOMING;
        }
        if self.is_scanning() {
            conditions.operation |= condition::SCANNING;
        }
        if self.awaits_trigger() {
            conditions.operation |= condition::WAITING_FOR_TRIGGER;
        }
        let health = self.health();
        for (set, bit) in [
            (self.power_out_of_range(), condition::POWER),
            (self.settings_lost().is_some(), condition::SETTINGS_LOST),
            (self.missed_deadline(), condition::DEADLINE),
            (self.is_stopped(), condition::EMERGENCY_STOP),
            (health.internal_oscillator, condition::INTERNAL_OSCILLATOR),
        ] {
            if set {
                conditions.questionable |= bit;
            }
        }
        conditions
    }
}

/// `*RST`: aborts what moves, and sets the defaults once it stands.
fn reset(front: &mut Front) -> Flow {
    if front.operation_pending() {
        front.abort();
        return Flow::Wait;
    }
    front.reset();
    Flow::Done
}

fn other(front: &mut Front, link: u8, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    match call.command {
        C::SensePower | C::SenseRange | C::SenseAverage | C::SenseInput | C::SenseScale | C::SenseDelay => {
            return sense::execute(front, call, out);
        }
        C::ScanLine
        | C::ScanRaster
        | C::ScanSpiral
        | C::ScanHill
        | C::ScanParabola
        | C::ScanStart
        | C::ScanStop
        | C::ScanContinue
        | C::ScanState
        | C::ScanResult => return scan::execute(front, call, out).map(|()| Flow::Done),
        C::TraceConfigure | C::TraceArm | C::TracePoints | C::TraceData | C::Format | C::Trigger | C::TriggerSource => {
            return trace::execute(front, call, out);
        }
        _ => {}
    }
    match call.suffix {
        Some(_) => axis::execute(front, call.axis(), link, call, out).map(|()| Flow::Done),
        None => match call.command {
            C::PoseMove | C::PoseRelative | C::PoseQuery | C::PoseCheck | C::VelocityOverride => {
                pose::execute(front, call, out).map(|()| Flow::Done)
            }
            _ => compensation::execute(front, call, out),
        },
    }
}
