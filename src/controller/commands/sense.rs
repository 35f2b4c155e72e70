//! Commands of the power inputs.

use super::setting::{Kind, Setting};
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::refill::border::POWER_INPUTS;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::tree::Command as C;
use crate::sense::{
    AVERAGE_DEFAULT, AVERAGE_MAX, BRIGHT, DARK, DELAY_MAX_NS, GAIN_MAX, Input, Reading, SLOPE_MAX, femtowatts,
};
use crate::units::decimal::Unit;
use core::task::Poll;

/// Words of SCALe.
const SCALES: [&str; 2] = ["LOGarithmic", "LINear"];
/// Words of INPut.
const INPUTS: [&str; 2] = ["LINear", "LOGarithmic"];
/// The answer for what is not known.
pub(super) const NOT_A_NUMBER: &str = "9.91E37";

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
    if call.command == C::SensePower {
        return Ok(power(front, channel, out));
    }
    let mut own = *front.sense_settings(channel);
    if call.command == C::SenseInput {
        if call.query {
            input_answer(own.input, out);
            return Ok(Flow::Done);
        }
        own.input = input(call)?;
        // the power at full scale is another one
        own.range = None;
        return front.set_sense(channel, &own).map(|()| Flow::Done);
    }
    let number = |unit, now, least, most, default| Setting { kind: Kind::Number(unit), now, least, most, default };
    let (least, full) = own.ranges();
    let setting = match call.command {
        C::SenseRange => {
            let now = own.range.unwrap_or(full);
            number(Unit::LEVEL, now.into(), least.into(), full.into(), full.into())
        }
        C::SenseAverage => number(Unit::COUNT, own.average.into(), 1, AVERAGE_MAX.into(), AVERAGE_DEFAULT.into()),
        C::SenseScale => Setting { kind: Kind::Words(&SCALES), now: own.watts.into(), least: 0, most: 1, default: 0 },
        _ => number(Unit::TIME, own.delay_ns.into(), 0, DELAY_MAX_NS.into(), 0),
    };
    let Some(value) = setting.access(call, out)? else { return Ok(Flow::Done) };
    match call.command {
        C::SenseRange => own.range = Some(value as i32).filter(|range| *range != full),
        C::SenseAverage => own.average = value as u16,
        C::SenseScale => own.watts = value != 0,
        _ => own.delay_ns = value as u32,
    }
    front.set_sense(channel, &own).map(|()| Flow::Done)
}

/// The mean of the latest samples; waits at rest until they are of where the stage stands.
fn power(front: &mut Front, channel: usize, out: &mut Response) -> Flow {
    let watts = front.sense_settings(channel).watts;
    match front.read_power(channel) {
        Poll::Pending => return Flow::Wait,
        Poll::Ready(Some(Reading::Level(value))) if watts => out.fraction(false, femtowatts(value).into(), 15),
        Poll::Ready(reading) => answer(reading, out),
    }
    Flow::Done
}

/// A level in dBm, or what SCPI answers for what is none (SCPI-99 volume 1, 7.2.1).
#[inline(never)]
pub(super) fn answer(reading: Option<Reading>, out: &mut Response) {
    match reading {
        None => out.text(NOT_A_NUMBER),
        Some(Reading::High) => out.text("9.9E37"),
        Some(Reading::Low) => out.text("-9.9E37"),
        Some(Reading::Level(value)) => {
            // millionths of a dB, answered in thousandths
            out.quantity(i64::from(value.saturating_add(500).div_euclid(1000)), Unit::LEVEL);
        }
    }
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
