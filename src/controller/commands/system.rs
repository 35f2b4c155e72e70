//! Commands of the controller itself: saving and recalling, its serial port.

use super::setting::{Kind, Setting};
use crate::controller::front::{Front, StorageRequest};
use crate::error::{Error, ErrorNumber};
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::tree::Command as C;
use crate::settings::{BAUD_DEFAULT, BAUD_MAX, BAUD_MIN};
use crate::units::decimal::Unit;

/// Executes a command of the controller itself.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    match call.command {
        C::Save => storage(front, StorageRequest::Save, call, out),
        C::Recall => storage(front, StorageRequest::Recall, call, out),
        C::SystemPark => storage(front, StorageRequest::Park, call, out),
        C::SerialBaud => {
            let setting = Setting {
                kind: Kind::Number(Unit::COUNT),
                now: front.baud().into(),
                least: BAUD_MIN.into(),
                most: BAUD_MAX.into(),
                default: BAUD_DEFAULT.into(),
            };
            if let Some(baud) = setting.access(call, out)? {
                front.set_baud(baud as u32);
            }
            Ok(Flow::Done)
        }
        _ => Err(ErrorNumber::UndefinedHeader.into()),
    }
}

/// Asks once and then waits for the end; the cursor keeps the number of the request, so that a link that was cleared
/// meanwhile does not take the end of an old request for that of a new one.
fn storage(front: &mut Front, request: StorageRequest, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    let mut params = call.params;
    if !params.is_empty() {
        // the one place that there is
        params.integer(0, 0)?;
    }
    match out.cursor() {
        0 if front.storage_pending() => Ok(Flow::Wait),
        0 => {
            out.resume_at(front.request_storage(request)?);
            Ok(Flow::More)
        }
        ticket => match front.storage_result(ticket) {
            Some(result) => result.map(|()| Flow::Done),
            None => Ok(Flow::More),
        },
    }
}
