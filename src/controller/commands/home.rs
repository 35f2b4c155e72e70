//! Commands of homing.

use super::setting::Setting;
use crate::controller::front::{Front, axis_condition};
use crate::error::{Error, ErrorNumber};
use crate::scpi::params::Params;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::settings::{AxisSettings, Side};
use crate::units::{Axis, COORDINATE_LIMIT};

/// Words of HOME:TYPE, and what is answered.
const SIDES: [&str; 2] = ["LOWer", "UPPer"];
const SIDE_ANSWERS: [&str; 2] = ["LOW", "UPP"];

/// Executes a command of homing.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let i = axis.index();
    let motor = front.motors()[i];
    let mut settings = *front.settings();
    let own = settings.axes[i].home;
    let default = AxisSettings::defaults(&motor).home;
    let new = &mut settings.axes[i].home;
    match call.command {
        C::AxisHome => return front.home(axis),
        C::AxisHomeState => {
            out.integer(u8::from(front.axis_condition(axis) & axis_condition::HOMED != 0));
            return Ok(());
        }
        C::AxisHomeType => {
            let setting = Setting::switch(own.side == Side::Upper, false);
            let parse = |p: &mut Params<'_>| p.choice(&SIDES).map(|side| side as i64);
            let answer = |v: i64| out.text(SIDE_ANSWERS[v as usize & 1]);
            let Some(upper) = setting.access(call, parse, answer)? else { return Ok(()) };
            new.side = if upper != 0 { Side::Upper } else { Side::Lower };
        }
        C::AxisHomeVelocity => {
            let (now, most) = (own.velocity as i64, motor.velocity as i64);
            let setting = Setting { now, least: 1, most, default: default.velocity as i64 };
            let answer = |v| out.axis_quantity(axis, v, 1);
            let Some(velocity) = setting.access(call, |p| p.rate(axis, 1), answer)? else { return Ok(()) };
            new.velocity = velocity.unsigned_abs();
        }
        C::AxisHomeOffset => {
            let all = i64::from(COORDINATE_LIMIT);
            let own_default = crate::settings::HomeSettings { offset: None, ..own }.reference(&motor);
            let now = own.reference(&motor).into();
            let setting = Setting { now, least: -all, most: all, default: own_default.into() };
            let parse = |p: &mut Params<'_>| p.coordinate(axis).map(i64::from);
            let answer = |v| out.axis_quantity(axis, v, 0);
            let Some(offset) = setting.access(call, parse, answer)? else { return Ok(()) };
            // the default goes with the side
            new.offset = Some(offset as i32).filter(|offset| *offset != own_default);
        }
        _ => return Err(ErrorNumber::UndefinedHeader.into()),
    }
    front.set_axes(&settings)
}
