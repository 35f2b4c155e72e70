//! Commands of the position compare.

use crate::controller::front::Front;
use crate::error::Error;
use crate::refill::border::Compare;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::units::Axis;

/// Executes a command of the position compare.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let mut params = call.params;
    if call.command == C::CompareCount {
        out.integer(front.compare_pulses());
        return Ok(());
    }
    if !call.query {
        let index = params.integer(1, Axis::ALL.len() as i64)? - 1;
        let axis = Axis::from_index(index as usize).unwrap_or(Axis::X);
        let (start, step) = (params.coordinate(axis)?, params.coordinate(axis)?);
        let count = params.integer(0, u16::MAX.into())? as u16;
        return front.set_compare(Compare { axis: index as u8, start, step, count });
    }
    let Compare { axis, start, step, count } = front.compare();
    out.integer(axis + 1);
    let axis = Axis::from_index(axis.into()).unwrap_or(Axis::X);
    out.axis_quantity(axis, start.into(), 0);
    out.axis_quantity(axis, step.into(), 0);
    out.integer(count);
    Ok(())
}
