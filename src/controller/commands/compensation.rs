//! Commands of the compensation: calibration, switches, pivots.

use super::setting::{Kind, Setting};
use crate::controller::front::{Front, PIVOTS};
use crate::error::{Error, ErrorNumber};
use crate::scpi::params::Params;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::tree::Command as C;
use crate::units::decimal::Unit;

/// Largest coordinate of a pivot, nm: a sixteenth of it fits 30 bits and a sign.
const PIVOT_LIMIT_NM: i64 = 1 << 26;
/// Bytes of a long answer handed out at a time.
const PART: usize = 192;
/// Decimals of a matrix element.
const MATRIX_DECIMALS: u32 = 12;

/// Executes a command of the compensation.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    let mut params = call.params;
    match call.command {
        C::CompensationState
        | C::CompensationCouplingState
        | C::CompensationPivotState
        | C::CompensationBacklashState => switch(front, call, out)?,
        C::CompensationLoad => front.load(params.block()?)?,
        C::CompensationData => return data(front, out),
        C::CompensationCrc => out.integer(front.block_crc()?),
        C::CompensationName => {
            let name = front.calibration()?.name;
            out.string(name.split(|byte| *byte == 0).next().unwrap_or_default());
        }
        C::CompensationMatrix => return matrix(front, out),
        C::PivotDefine => pivot_define(front, call, out)?,
        C::PivotSelect => {
            let now = front.pivot().map_or(0, |(k, _)| i64::from(k));
            let setting =
                Setting { kind: Kind::Number(Unit::COUNT), now, least: 0, most: PIVOTS as i64 - 1, default: 0 };
            if let Some(k) = setting.access(call, out)? {
                front.select_pivot(k as u8)?;
            }
        }
        C::PivotQuery => {
            let (k, point) = front.pivot()?;
            out.integer(k);
            point_answer(point, out);
        }
        _ => return Err(ErrorNumber::UndefinedHeader.into()),
    }
    Ok(Flow::Done)
}

fn switch(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let mut switches = front.settings().switches;
    let field = match call.command {
        C::CompensationState => &mut switches.compensation,
        C::CompensationCouplingState => &mut switches.coupling,
        C::CompensationPivotState => &mut switches.pivot,
        _ => &mut switches.backlash,
    };
    let Some(on) = Setting::switch(*field, true).access_switch(call, out)? else { return Ok(()) };
    *field = on;
    if on {
        front.calibration()?;
    }
    front.set_switches(switches)
}

fn data(front: &Front, out: &mut Response) -> Result<Flow, Error> {
    let block = front.block()?;
    let from = out.cursor() as usize;
    if from == 0 {
        out.block_head(block.len());
    }
    let to = (from + PART).min(block.len());
    out.raw(block.get(from..to).unwrap_or_default());
    if to == block.len() {
        return Ok(Flow::Done);
    }
    out.resume_at(to as u32);
    Ok(Flow::More)
}

/// D^-1 row by row, then W^-1 row by row, nine numbers a part.
#[inline(never)]
fn matrix(front: &Front, out: &mut Response) -> Result<Flow, Error> {
    let calibration = front.calibration()?;
    let unit = 10i128.pow(MATRIX_DECIMALS);
    if out.cursor() == 0 {
        for (row, motor) in calibration.inverse_slides.iter().zip(&calibration.motors) {
            for c in row {
                // steps per nm in Q(row bits), times the step in Q32
                let scaled = i128::from(*c) * i128::from(motor.step_q32) * unit;
                element(round_shift(scaled, u32::from(motor.row_bits) + 32), out);
            }
        }
        out.resume_at(1);
        return Ok(Flow::More);
    }
    for (i, row) in calibration.tilt.iter().enumerate() {
        for (j, t) in row.iter().enumerate() {
            let value = i128::from(*t) + if i == j { 1 << 32 } else { 0 };
            element(round_shift(value * unit, 32), out);
        }
    }
    Ok(Flow::Done)
}

fn round_shift(value: i128, bits: u32) -> i128 {
    (value + (1 << (bits - 1))) >> bits
}

#[inline(never)]
fn element(value: i128, out: &mut Response) {
    out.fraction(value < 0, value.unsigned_abs(), MATRIX_DECIMALS);
}

#[inline(never)]
fn pivot_define(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let mut params = call.params;
    let k = params.integer(0, PIVOTS as i64 - 1)? as u8;
    if call.query {
        let point = front.defined_pivot(k)?;
        out.integer(k);
        point_answer(point, out);
        return Ok(());
    }
    let coordinate = |p: &mut Params<'_>| {
        let nm = p.bounded(Unit::LENGTH, -PIVOT_LIMIT_NM + 1, PIVOT_LIMIT_NM - 1)?;
        Ok::<i32, Error>((nm * 16) as i32)
    };
    let point = [coordinate(&mut params)?, coordinate(&mut params)?, coordinate(&mut params)?];
    front.define_pivot(k, point)
}

fn point_answer(point: [i32; 3], out: &mut Response) {
    for sixteenths in point {
        out.quantity((i64::from(sixteenths) + 8) >> 4, Unit::LENGTH);
    }
}
