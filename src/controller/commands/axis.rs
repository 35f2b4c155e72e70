//! Commands of one axis and its motor.

use super::setting::Setting;
use super::{home, wiring};
use crate::compensation::backlash::Flank;
use crate::compensation::calibration::{STEP_END, STEP_MIN};
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::scpi::parser::Call;
use crate::scpi::response::{Response, axis_unit};
use crate::scpi::tree::Command as C;
use crate::settings::{
    AxisSettings, BacklashMode, RATE_MIN, STEPS_MAX, TAKE_UP_SHARE_MAX, TAKE_UP_SHARE_MIN, default_step_q32,
};
use crate::stepgen::timing::{MAX_SETTLE_NS, MotorTiming};
use crate::units::decimal::{Displacement, Unit};
use crate::units::steps::steps_to_units;
use crate::units::{Axis, COORDINATE_LIMIT};

/// Words of BACKlash:MODE, in the order of [`MODE`].
const MODES: [&str; 4] = ["OFF", "REVersal", "UNIPos", "UNINeg"];
const MODE: [BacklashMode; 4] =
    [BacklashMode::Off, BacklashMode::Reversal, BacklashMode::UniPositive, BacklashMode::UniNegative];
/// Their short forms, as answered.
const MODE_ANSWERS: [&str; 4] = ["OFF", "REV", "UNIP", "UNIN"];
/// Longest pulse, ns.
const PULSE_MAX: i64 = 32_000;
/// Longest set-up or hold time, ns.
const SETTLE_MAX: i64 = MAX_SETTLE_NS as i64;

/// Distance in nm or nrad.
pub fn distance(front: &Front, axis: Axis, by: Displacement) -> i64 {
    match by {
        Displacement::Logical(units) => units,
        Displacement::Steps(steps) => steps_to_units(steps, front.law().step_q32(axis.index())),
    }
}

/// Executes a command whose header names an axis.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, axis: Axis, link: u8, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let mut params = call.params;
    let i = axis.index();
    match call.command {
        C::AxisMove => {
            let x = params.coordinate(axis)?;
            front.move_absolute(axis, x.into())
        }
        C::AxisMoveRelative => {
            let by = params.displacement(axis)?;
            front.move_relative(axis, distance(front, axis, by))
        }
        C::AxisMoveJog => {
            let v = params.rate(axis, 1)?;
            front.jog(axis, v, link)
        }
        C::AxisStop => {
            front.stop(axis);
            Ok(())
        }
        C::AxisStopImmediate => {
            front.abort();
            Ok(())
        }
        C::AxisPosition => {
            out.axis_quantity(axis, front.position().0[i].into(), 0);
            Ok(())
        }
        C::AxisPositionCommand => {
            out.axis_quantity(axis, front.commanded().0[i].into(), 0);
            Ok(())
        }
        C::AxisPositionMotor => {
            out.integer(front.motor_counts().0[i]);
            Ok(())
        }
        C::AxisPositionSet => {
            let x = params.coordinate(axis)?;
            front.set_position(axis, x.into())
        }
        C::AxisEnable => {
            let on = Setting::switch(front.is_enabled(axis), false).access_switch(call, |v| out.integer(v))?;
            on.map_or(Ok(()), |on| front.set_enabled(axis, on))
        }
        C::AxisEnablePolarity
        | C::AxisFaultPolarity
        | C::AxisLimitHard
        | C::AxisLimitHardPolarity
        | C::AxisLimitHardState => wiring::execute(front, axis, call, out),
        C::AxisHome | C::AxisHomeType | C::AxisHomeVelocity | C::AxisHomeOffset | C::AxisHomeState => {
            home::execute(front, axis, call, out)
        }
        C::AxisStepSize => step_size(front, axis, call, out),
        C::AxisStepInvert | C::AxisStepTiming => pulses(front, axis, call, out),
        C::AxisBacklashMode
        | C::AxisBacklashDistance
        | C::AxisBacklashVelocity
        | C::AxisBacklashDeadband
        | C::AxisBacklashMargin => backlash(front, axis, call, out),
        C::AxisBacklashPreload => {
            let flank = [Flank::Positive, Flank::Negative][params.choice(&["POSitive", "NEGative"])? & 1];
            front.preload(axis, flank)
        }
        C::AxisBacklashOffset => {
            out.integer(front.overlay_steps(axis));
            Ok(())
        }
        C::AxisBacklashState => {
            out.text(match front.flank(axis) {
                Some(Flank::Positive) => "POS",
                Some(Flank::Negative) => "NEG",
                None => "UNKN",
            });
            Ok(())
        }
        _ => rates_and_limits(front, axis, call, out),
    }
}

/// Settings that may change at any time.
#[inline(never)]
fn rates_and_limits(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let i = axis.index();
    let motor = front.motors()[i];
    let own = front.settings().axes[i];
    let default = AxisSettings::defaults(&motor);
    let mut settings = *front.settings();
    let new = &mut settings.axes[i];
    let signed = |v: u64| i64::try_from(v).unwrap_or(i64::MAX);
    let rate = |now: u64, least: i64, most: u64, default: u64| Setting {
        now: signed(now),
        least: least.min(signed(most)),
        most: signed(most),
        default: signed(default),
    };
    let (setting, order, field) = match call.command {
        C::AxisVelocity => (rate(own.velocity, 1, motor.velocity, default.velocity), 1, &mut new.velocity),
        C::AxisVelocityStart => {
            (rate(own.start_velocity, 0, motor.velocity, default.start_velocity), 1, &mut new.start_velocity)
        }
        C::AxisAcceleration => (
            rate(own.acceleration, RATE_MIN as i64, motor.acceleration, default.acceleration),
            2,
            &mut new.acceleration,
        ),
        C::AxisJerk => (rate(own.jerk, RATE_MIN as i64, motor.jerk, default.jerk), 3, &mut new.jerk),
        _ => return limits(front, axis, call, out),
    };
    let value = setting.access(call, |p| p.rate(axis, order), |v| out.axis_quantity(axis, v, order))?;
    if let Some(value) = value {
        *field = value.unsigned_abs();
        front.set_axes(&settings)?;
    }
    Ok(())
}

#[inline(never)]
fn limits(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let i = axis.index();
    let own = front.settings().axes[i];
    let default = AxisSettings::defaults(&front.motors()[i]);
    let mut settings = *front.settings();
    let new = &mut settings.axes[i];
    if call.command == C::AxisLimitSoftState {
        let on = Setting::switch(own.soft_on, true).access_switch(call, |v| out.integer(v))?;
        let Some(on) = on else { return Ok(()) };
        new.soft_on = on;
        return front.set_axes(&settings);
    }
    let (now, default, field) = match call.command {
        C::AxisLimitSoftLower => (own.soft_lower, default.soft_lower, &mut new.soft_lower),
        C::AxisLimitSoftUpper => (own.soft_upper, default.soft_upper, &mut new.soft_upper),
        _ => return Err(ErrorNumber::UndefinedHeader.into()),
    };
    let all = i64::from(COORDINATE_LIMIT);
    let setting = Setting { now: now.into(), least: -all, most: all, default: default.into() };
    let parse = |p: &mut crate::scpi::params::Params<'_>| p.coordinate(axis).map(i64::from);
    let Some(value) = setting.access(call, parse, |v| out.axis_quantity(axis, v, 0))? else { return Ok(()) };
    *field = value as i32;
    if new.soft_lower >= new.soft_upper {
        let mut params = call.params;
        return Err(Error::token(ErrorNumber::DataOutOfRange, params.token()?));
    }
    front.set_axes(&settings)
}

#[inline(never)]
fn backlash(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let i = axis.index();
    let motor = front.motors()[i];
    let own = front.settings().axes[i].backlash;
    let default = AxisSettings::defaults(&motor).backlash;
    let mut settings = *front.settings();
    let new = &mut settings.axes[i].backlash;
    let velocity = motor.velocity as i64;
    match call.command {
        C::AxisBacklashMode => {
            let index = |mode: BacklashMode| MODE.iter().position(|m| *m == mode).unwrap_or(0) as i64;
            let setting = Setting { now: index(own.mode), least: 0, most: 3, default: index(default.mode) };
            let answer = |v: i64| out.text(MODE_ANSWERS[v as usize & 3]);
            let Some(mode) = setting.access(call, |p| p.choice(&MODES).map(|m| m as i64), answer)? else {
                return Ok(());
            };
            new.mode = MODE[mode as usize & 3];
        }
        C::AxisBacklashDistance => {
            let most = steps_to_units(STEPS_MAX.into(), motor.step_q32).min(COORDINATE_LIMIT.into());
            let setting = Setting { now: own.distance.into(), least: 0, most, default: default.distance.into() };
            let parse = |p: &mut crate::scpi::params::Params<'_>| p.coordinate(axis).map(i64::from);
            let Some(value) = setting.access(call, parse, |v| out.axis_quantity(axis, v, 0))? else { return Ok(()) };
            new.distance = value as i32;
        }
        C::AxisBacklashVelocity => {
            let setting = Setting {
                now: own.velocity as i64,
                least: (velocity / TAKE_UP_SHARE_MIN as i64).max(1),
                most: (velocity / TAKE_UP_SHARE_MAX as i64).max(1),
                default: default.velocity as i64,
            };
            let Some(value) = setting.access(call, |p| p.rate(axis, 1), |v| out.axis_quantity(axis, v, 1))? else {
                return Ok(());
            };
            new.velocity = value.unsigned_abs();
        }
        _ => {
            let (now, default, field) = match call.command {
                C::AxisBacklashDeadband => (own.dead_band, default.dead_band, &mut new.dead_band),
                _ => (own.margin, default.margin, &mut new.margin),
            };
            let setting = Setting { now: now.into(), least: 0, most: STEPS_MAX.into(), default: default.into() };
            let Some(value) = setting.access(call, |p| p.number(Unit::COUNT), |v| out.integer(v))? else {
                return Ok(());
            };
            *field = value as i32;
        }
    }
    front.set_axes(&settings)
}

#[inline(never)]
fn step_size(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let now = front.law().step_q32(axis.index());
    let setting = Setting {
        now: now as i64,
        least: STEP_MIN as i64,
        most: STEP_END as i64 - 1,
        default: front.default_step_q32(axis).unwrap_or(default_step_q32(axis)) as i64,
    };
    let answer = |v: i64| out.fine_quantity(v, axis_unit(axis));
    let Some(value) = setting.access(call, |p| p.step_size_q32(axis), answer)? else { return Ok(()) };
    front.set_step(axis, value.unsigned_abs())
}

#[inline(never)]
fn pulses(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let i = axis.index();
    let mut settings = *front.settings();
    let own = settings.axes[i];
    if call.command == C::AxisStepInvert {
        let on = Setting::switch(own.inverted, false).access_switch(call, |v| out.integer(v))?;
        let Some(on) = on else { return Ok(()) };
        settings.axes[i].inverted = on;
        return front.set_pulses(&settings);
    }
    let times = |t: &MotorTiming| [t.high_ns, t.low_ns, t.setup_ns, t.hold_ns].map(i64::from);
    let least = [0; 4];
    let most = [PULSE_MAX, PULSE_MAX, SETTLE_MAX, SETTLE_MAX];
    let default = times(&MotorTiming::default());
    let mut params = call.params;
    if call.query {
        let extreme = params.optional_extreme()?;
        let answer = extreme.map_or(times(&own.timing), |e| e.pick(least, most, default));
        answer.iter().for_each(|t| out.quantity(*t, Unit::TIME));
        return Ok(());
    }
    let mut new = [0i64; 4];
    for (k, value) in new.iter_mut().enumerate() {
        let mut text = params;
        *value = params.setting(|p| p.number(Unit::TIME))?.resolve(least[k], most[k], default[k]);
        if !(least[k]..=most[k]).contains(value) {
            return Err(Error::token(ErrorNumber::DataOutOfRange, text.token()?));
        }
    }
    let [high_ns, low_ns, setup_ns, hold_ns] = new.map(|t| t as u32);
    settings.axes[i].timing = MotorTiming { high_ns, low_ns, setup_ns, hold_ns };
    front.set_pulses(&settings)
}
