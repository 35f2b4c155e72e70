//! Commands of one axis and its motor.

use super::axis_settings;
use super::setting::{Kind, Setting};
use crate::compensation::backlash::Flank;
use crate::compensation::calibration::{STEP_END, STEP_MIN};
use crate::controller::front::{Front, axis_condition};
use crate::error::{Error, ErrorNumber};
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::settings::default_step_q32;
use crate::stepgen::timing::MotorTiming;
use crate::units::decimal::{Displacement, Unit};
use crate::units::steps::steps_to_units;
use crate::units::{Axis, SEGMENT_TICKS};

/// Longest pulse, ns.
const PULSE_MAX: i64 = 32_000;
/// Longest set-up or hold time, ns.
const SETTLE_MAX: i64 = SEGMENT_TICKS as i64 * 1000;

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
            let on = Setting::switch(front.is_enabled(axis), false).access_switch(call, out)?;
            on.map_or(Ok(()), |on| front.set_enabled(axis, on))
        }
        C::AxisLimitHard => {
            let (lower, upper) = front.active_switches();
            for mask in [lower, upper] {
                out.integer(mask >> i & 1);
            }
            Ok(())
        }
        C::AxisHome => front.home(axis),
        C::AxisHomeState => {
            out.boolean(front.axis_condition(axis) & axis_condition::HOMED != 0);
            Ok(())
        }
        C::AxisStepSize => step_size(front, axis, call, out),
        C::AxisStepTiming => pulses(front, axis, call, out),
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
        _ => axis_settings::execute(front, axis, call, out),
    }
}

#[inline(never)]
fn step_size(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let now = front.law().step_q32(axis.index());
    let setting = Setting {
        kind: Kind::StepSize(axis),
        now: now as i64,
        least: STEP_MIN as i64,
        most: STEP_END as i64 - 1,
        default: front.default_step_q32(axis).unwrap_or(default_step_q32(axis)) as i64,
    };
    let Some(value) = setting.access(call, out)? else { return Ok(()) };
    front.set_step(axis, value.unsigned_abs())
}

#[inline(never)]
fn pulses(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let i = axis.index();
    let mut settings = *front.settings();
    let own = settings.axes[i];
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
