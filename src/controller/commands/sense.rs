//! Commands of the power inputs.

use super::setting::{Kind, Setting};
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::refill::border::POWER_INPUTS;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::tree::Command as C;
use crate::sense::{AVERAGE_MAX, BRIGHT, DARK, DELAY_MAX_NS, GAIN_MAX, Input, Reading, SLOPE_MAX, femtowatts};
use crate::units::decimal::Unit;

/// Words of SCALe.
const SCALES: [&str; 2] = ["LOGarithmic", "LINear"];
/// Words of INPut.
const INPUTS: [&str; 2] = ["LINear", "LOGarithmic"];
/// What SCPI answers for what is not a number (SCPI-99 volume 1, 7.2.1).
pub(super) const NOT_A_NUMBER: &str = "9.91E37";

/// Millionths of a dB as an answer in dB.
pub(super) fn level(level: i32, out: &mut Response) {
    out.quantity(i64::from(level).saturating_add(500).div_euclid(1000), Unit::LEVEL);
}

/// Executes a command of a power input.
///
/// # Errors
/// -114 an input that does not exist; those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    let channel = usize::from(call.suffix.unwrap_or(1)).wrapping_sub(1);
    if channel >= POWER_INPUTS {
        return Err(ErrorNumber::HeaderSuffixOutOfRange.into());
    }
    let mut all = front.settings().sense;
    let own = &mut all[channel & 1];
    let setting = |kind, now: i64, least: i64, most: i64, default: i64| Setting { kind, now, least, most, default };
    match call.command {
        C::SensePower => return Ok(power(front, channel, out)),
        C::SenseInput => {
            if call.query {
                input_answer(own.input, out);
                return Ok(Flow::Done);
            }
            own.input = input(call)?;
            // the power at full scale is another one
            own.range = None;
        }
        C::SenseRange => {
            let (least, most) = own.ranges();
            let now = own.range.unwrap_or(most);
            let setting = setting(Kind::Number(Unit::LEVEL), now.into(), least.into(), most.into(), most.into());
            let Some(value) = setting.access(call, out)? else { return Ok(Flow::Done) };
            own.range = Some(value as i32).filter(|range| *range != most);
        }
        C::SenseAverage => {
            let setting = setting(Kind::Number(Unit::COUNT), own.average.into(), 1, AVERAGE_MAX.into(), 16);
            let Some(value) = setting.access(call, out)? else { return Ok(Flow::Done) };
            own.average = value as u16;
        }
        C::SenseScale => {
            let Some(value) = setting(Kind::Words(&SCALES), own.watts.into(), 0, 1, 0).access(call, out)? else {
                return Ok(Flow::Done);
            };
            own.watts = value != 0;
        }
        _ => {
            let setting = setting(Kind::Number(Unit::TIME), own.delay_ns.into(), 0, DELAY_MAX_NS.into(), 0);
            let Some(value) = setting.access(call, out)? else { return Ok(Flow::Done) };
            own.delay_ns = value as u32;
        }
    }
    front.set_sense(all)?;
    Ok(Flow::Done)
}

/// The mean of the latest samples; waits at rest until they are of where the stage stands.
fn power(front: &mut Front, channel: usize, out: &mut Response) -> Flow {
    let settings = front.sense_settings(channel);
    match front.read_power(channel) {
        Err(()) => return Flow::Wait,
        Ok(None) => out.text(NOT_A_NUMBER),
        Ok(Some((_, _, Reading::High))) => out.text("9.9E37"),
        Ok(Some((_, _, Reading::Low))) => out.text("-9.9E37"),
        Ok(Some((_, _, Reading::Level(value)))) if settings.watts => {
            out.fraction(false, femtowatts(value).into(), 15);
        }
        Ok(Some((_, _, Reading::Level(value)))) => level(value, out),
    }
    Flow::Done
}

fn input(call: &Call<'_>) -> Result<Input, Error> {
    let mut params = call.params;
    let input = match params.choice(&INPUTS)? {
        0 => Input::Linear(params.bounded(Unit::POWER, 1, GAIN_MAX as i64)?.unsigned_abs()),
        _ => {
            let slope = params.bounded(Unit::LEVEL, 1, SLOPE_MAX.into())?;
            let zero = params.bounded(Unit::LEVEL, (DARK / 1000).into(), (BRIGHT / 1000).into())?;
            Input::Logarithmic(slope as i32, zero as i32)
        }
    };
    params.end()?;
    Ok(input)
}

fn input_answer(input: Input, out: &mut Response) {
    match input {
        Input::Linear(gain) => {
            out.short_form(INPUTS[0]);
            out.quantity(gain as i64, Unit::POWER);
        }
        Input::Logarithmic(slope, zero) => {
            out.short_form(INPUTS[1]);
            out.quantity(slope.into(), Unit::LEVEL);
            out.quantity(zero.into(), Unit::LEVEL);
        }
    }
}
