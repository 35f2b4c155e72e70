//! Commands of all six axes.

use super::axis::distance;
use super::setting::{Kind, Setting};
use crate::controller::front::Front;
use crate::error::Error;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::units::decimal::Unit;
use crate::units::{AXES, Axis};

/// Executes a command of the pose.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let mut params = call.params;
    match call.command {
        C::PoseMove => {
            let pose = params.pose()?;
            front.pose_absolute(pose.0.map(i64::from))
        }
        C::PoseRelative => {
            let mut by = [0; AXES];
            for ((to, axis), displacement) in by.iter_mut().zip(Axis::ALL).zip(params.displacements()?) {
                *to = distance(front, axis, displacement);
            }
            front.pose_relative(by)
        }
        C::PoseQuery => {
            let pose = front.position();
            Axis::ALL.into_iter().for_each(|axis| out.axis_quantity(axis, pose.0[axis.index()].into(), 0));
            Ok(())
        }
        C::PoseCheck => {
            let pose = params.pose()?;
            let check = front.check(pose.0.map(i64::from));
            out.integer(check.verdict.map_or(0, |error| error.number.code()));
            out.quantity(i64::try_from(check.duration_us * 1000).unwrap_or(i64::MAX), Unit::TIME);
            check.step_rates.iter().for_each(|rate| out.integer(i64::try_from(*rate).unwrap_or(i64::MAX)));
            check.flank_changes.iter().for_each(|n| out.integer(*n));
            Ok(())
        }
        _ => {
            let now = i64::from(front.settings().override_percent);
            let setting = Setting { kind: Kind::Number(Unit::PERCENT), now, least: 1, most: 100, default: 100 };
            if let Some(percent) = setting.access(call, out)? {
                front.set_override(percent as u8);
            }
            Ok(())
        }
    }
}
