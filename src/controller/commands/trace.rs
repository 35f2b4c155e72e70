//! Commands of recordings and of the trigger.

use super::sense::level;
use super::setting::{Kind, Setting};
use crate::controller::front::{Format, Front, Trigger};
use crate::error::{Error, ErrorNumber};
use crate::refill::border::POWER_INPUTS;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::tree::Command as C;
use crate::sense::{FULL_SCALE, Reading};
use crate::trace::{PACKED, PACKED_MOST, RECORDS, Source, Told};

const SOURCES: [&str; 2] = ["SAMPle", "SCAN"];
const FORMATS: [&str; 2] = ["ASCii", "PACKed"];
const TRIGGERS: [&str; 3] = ["IMMediate", "BUS", "EXTernal"];
/// Longest text of a record: a tick of 20 digits, six counts of 11, two levels of 8, and commas.
const TEXT: usize = 112;

/// Executes a command of recordings or of the trigger.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    let mut params = call.params;
    match call.command {
        C::TraceConfigure if call.query => {
            let trace = front.trace();
            out.short_form(SOURCES[usize::from(trace.source == Source::Scan)]);
            out.integer(i64::from(trace.skip) + 1);
        }
        C::TraceConfigure => {
            let source = [Source::Border, Source::Scan][params.choice(&SOURCES)? & 1];
            let every = if params.is_empty() { 1 } else { params.integer(1, 1 << 16)? };
            params.end()?;
            front.configure_trace(source, (every - 1) as u16);
        }
        C::TraceArm => front.arm_trace()?,
        C::TracePoints => out.integer(front.trace().points()),
        C::TraceData => return data(front, call, out),
        C::Format => {
            let now = i64::from(front.format() == Format::Packed);
            let setting = Setting { kind: Kind::Words(&FORMATS), now, least: 0, most: 1, default: 0 };
            if let Some(value) = setting.access(call, out)? {
                front.set_format(if value == 0 { Format::Ascii } else { Format::Packed });
            }
        }
        C::TriggerSource => {
            let now = i64::from(front.trigger_source() == Trigger::Bus);
            let setting = Setting { kind: Kind::Words(&TRIGGERS), now, least: 0, most: 1, default: 0 };
            if let Some(value) = setting.access(call, out)? {
                front.set_trigger_source(if value == 0 { Trigger::Immediate } else { Trigger::Bus });
            }
        }
        _ => front.trigger()?,
    }
    Ok(Flow::Done)
}

/// As many records a call as fit; the cursor counts those that are answered.
fn data(front: &Front, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    let mut params = call.params;
    let first = params.integer(0, RECORDS as i64 - 1)?;
    let packed = front.format() == Format::Packed;
    let most = if packed { PACKED_MOST } else { RECORDS } as i64;
    let mut text = params;
    let count = params.integer(1, most)?;
    let done = out.cursor();
    if done == 0 && first + count > front.trace().points().into() {
        return Err(Error::token(ErrorNumber::DataOutOfRange, text.token()?));
    }
    if done == 0 && packed {
        out.block_head(count as usize * PACKED);
    }
    // one that was recorded anew meanwhile has none: what was promised is still sent
    let none = Told { tick: 0, counts: [0; 6], power: [0; POWER_INPUTS] };
    for n in i64::from(done)..count {
        if out.room() < TEXT {
            out.resume_at(n as u32);
            return Ok(Flow::More);
        }
        let record = front.trace_record((first + n) as u16).unwrap_or(none);
        if packed { out.raw(&record.packed()) } else { write(front, &record, out) }
    }
    Ok(Flow::Done)
}

fn write(front: &Front, record: &Told, out: &mut Response) {
    out.integer(i64::try_from(record.tick).unwrap_or(i64::MAX));
    record.counts.iter().for_each(|count| out.integer(*count));
    for (n, code) in record.power.iter().enumerate() {
        match front.sense_settings(n).reading((*code).into(), 1, *code >= FULL_SCALE) {
            Reading::Level(value) => level(value, out),
            Reading::High => out.text("9.9E37"),
            Reading::Low => out.text("-9.9E37"),
        }
    }
}
