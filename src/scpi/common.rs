//! The commands that a link answers by itself: its registers, its errors, the language.

use crate::error::{Error, ErrorNumber};
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::status::{Bank, LinkStatus};
use crate::scpi::tree::{Command, HELP_LENGTH, Walk};

/// What a query or a mask of a SCPI register means.
#[derive(Clone, Copy)]
enum Part {
    Event,
    Condition,
    Enable,
    Positive,
    Negative,
}

/// Executes the call if it is one of the link's own. `pending`: motion, scanning or take-up has not ended.
pub(super) fn execute(
    call: &Call<'_>,
    pending: bool,
    status: &mut LinkStatus,
    out: &mut Response,
) -> Option<Result<Flow, Error>> {
    let mut params = call.params;
    match call.command {
        Command::ClearStatus => status.clear(),
        Command::EventEnable if call.query => out.integer(status.ese),
        Command::EventEnable => match params.integer(0, 255) {
            Ok(mask) => status.ese = mask as u8,
            Err(error) => return Some(Err(error)),
        },
        Command::EventStatus => out.integer(status.take_esr()),
        Command::ServiceEnable if call.query => out.integer(status.sre()),
        Command::ServiceEnable => match params.integer(0, 255) {
            Ok(mask) => status.set_sre(mask as u8),
            Err(error) => return Some(Err(error)),
        },
        Command::StatusByte => out.integer(status.status_byte(out.is_available())),
        Command::Wait if pending => return Some(Ok(Flow::Wait)),
        Command::Wait => {}
        Command::OperationComplete if call.query && pending => return Some(Ok(Flow::Wait)),
        Command::OperationComplete if call.query => out.integer(1),
        Command::OperationComplete => status.await_operation_complete(),
        Command::ErrorNext => error_item(status.next_error(), out),
        Command::ErrorCount => out.integer(status.error_count() as i64),
        Command::ErrorAll => return Some(Ok(error_all(status, out))),
        Command::Version => out.text("1999.0"),
        Command::HelpHeaders => return Some(Ok(help_headers(out))),
        Command::StatusPreset => status.preset(),
        command => {
            let (bank, part) = register(command)?;
            return Some(access(call, status, bank, part, out));
        }
    }
    Some(Ok(Flow::Done))
}

fn error_item(error: Option<Error>, out: &mut Response) {
    match error {
        Some(error) => out.error(&error),
        None => out.text("0,\"No error\""),
    }
}

/// One error a call: the longest fits an answer's part, sixteen do not.
fn error_all(status: &mut LinkStatus, out: &mut Response) -> Flow {
    error_item(status.next_error(), out);
    if status.error_count() > 0 { Flow::More } else { Flow::Done }
}

/// As many lines a call as fit; the cursor counts entries.
fn help_headers(out: &mut Response) -> Flow {
    if out.cursor() == 0 {
        out.block_head(HELP_LENGTH);
    }
    let (first, mut next, mut walk) = (out.cursor(), 0, Walk::begin());
    while let Some(header) = walk.step(None) {
        if next >= first {
            if out.room() < HELP_LINE_MAX {
                out.resume_at(next);
                return Flow::More;
            }
            let _ = walk.write(header, out);
        }
        next += 1;
    }
    Flow::Done
}

/// Longest line of the help, checked by a test of the table.
const HELP_LINE_MAX: usize = 100;

fn register(command: Command) -> Option<(Bank, Part)> {
    use Bank::*;
    use Part::*;
    Some(match command {
        Command::OperationEvent => (Operation, Event),
        Command::OperationCondition => (Operation, Condition),
        Command::OperationEnable => (Operation, Enable),
        Command::OperationPositive => (Operation, Positive),
        Command::OperationNegative => (Operation, Negative),
        Command::OperationInstrumentEvent => (OperationInstrument, Event),
        Command::OperationInstrumentCondition => (OperationInstrument, Condition),
        Command::OperationInstrumentEnable => (OperationInstrument, Enable),
        Command::OperationInstrumentPositive => (OperationInstrument, Positive),
        Command::OperationInstrumentNegative => (OperationInstrument, Negative),
        Command::QuestionableEvent => (Questionable, Event),
        Command::QuestionableCondition => (Questionable, Condition),
        Command::QuestionableEnable => (Questionable, Enable),
        Command::QuestionablePositive => (Questionable, Positive),
        Command::QuestionableNegative => (Questionable, Negative),
        Command::QuestionableInstrumentEvent => (QuestionableInstrument, Event),
        Command::QuestionableInstrumentCondition => (QuestionableInstrument, Condition),
        Command::QuestionableInstrumentEnable => (QuestionableInstrument, Enable),
        Command::QuestionableInstrumentPositive => (QuestionableInstrument, Positive),
        Command::QuestionableInstrumentNegative => (QuestionableInstrument, Negative),
        _ => return None,
    })
}

#[inline(never)]
fn access(call: &Call<'_>, status: &mut LinkStatus, bank: Bank, part: Part, out: &mut Response) -> Result<Flow, Error> {
    let register = status.bank_mut(bank);
    if call.query {
        out.integer(match part {
            Part::Event => register.take_event(),
            Part::Condition => register.condition,
            Part::Enable => register.enable,
            Part::Positive => register.positive,
            Part::Negative => register.negative,
        });
        return Ok(Flow::Done);
    }
    let mut params = call.params;
    // Bit 15 may be written and is always 0 (SCPI-99 volume 1, 9.2).
    let mask = params.integer(0, 65_535)? as u16 & 0x7fff;
    match part {
        Part::Enable => register.enable = mask,
        Part::Positive => register.positive = mask,
        Part::Negative => register.negative = mask,
        Part::Event | Part::Condition => return Err(ErrorNumber::UndefinedHeader.into()),
    }
    Ok(Flow::Done)
}
