//! Commands of what is wired to a motor beside STEP and DIR: limit switches, enable and fault lines.

use super::setting::Setting;
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::settings::Wiring;
use crate::units::Axis;

/// Words of the polarities: the level at which a line is active.
const LEVELS: [&str; 2] = ["LOW", "HIGH"];

/// Executes a command of the wiring of an axis.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    if call.command == C::AxisLimitHard {
        let (lower, upper) = front.active_switches();
        for mask in [lower, upper] {
            out.integer(mask >> axis.index() & 1);
        }
        return Ok(());
    }
    let mut settings = *front.settings();
    let own = &mut settings.axes[axis.index()].wiring;
    let default = Wiring::default();
    let (field, default) = match call.command {
        C::AxisLimitHardState => (&mut own.limits_on, default.limits_on),
        C::AxisLimitHardPolarity => (&mut own.limits_high, default.limits_high),
        C::AxisEnablePolarity => (&mut own.enable_high, default.enable_high),
        C::AxisFaultPolarity => (&mut own.fault_high, default.fault_high),
        _ => return Err(ErrorNumber::UndefinedHeader.into()),
    };
    let setting = Setting::switch(*field, default);
    let new = if call.command == C::AxisLimitHardState {
        setting.access_switch(call, |v| out.integer(v))?
    } else {
        let parse = |p: &mut crate::scpi::params::Params<'_>| p.choice(&LEVELS).map(|level| level as i64);
        setting.access(call, parse, |v| out.text(LEVELS[v as usize & 1]))?.map(|v| v != 0)
    };
    let Some(new) = new else { return Ok(()) };
    *field = new;
    front.set_axes(&settings)
}
