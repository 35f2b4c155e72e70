//! Commands of recordings and of the trigger.

use super::sense::answer;
use super::setting::{Kind, Setting};
use crate::controller::front::{Format, Front, Trigger};
use crate::error::Error;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::Flow;
use crate::scpi::tree::Command as C;
use crate::sense::FULL_SCALE;
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
        C::Format | C::TriggerSource => {
            let format = call.command == C::Format;
            let (words, now): (&'static [_], _) = match format {
                true => (&FORMATS, front.format() == Format::Packed),
                false => (&TRIGGERS, front.trigger_source() == Trigger::Bus),
            };
            let setting = Setting { kind: Kind::Words(words), now: now.into(), least: 0, most: 1, default: 0 };
            match setting.access(call, out)? {
                Some(value) if format => front.set_format([Format::Ascii, Format::Packed][value as usize & 1]),
                Some(value) => front.set_trigger_source([Trigger::Immediate, Trigger::Bus][value as usize & 1]),
                None => {}
            }
        }
        _ => front.trigger()?,
    }
    Ok(Flow::Done)
}

/// In the cursor: the answer is a block.
const BLOCK: u32 = 1 << 16;

/// As many records a call as fit; the cursor counts those that are answered, and remembers how.
#[inline(never)]
fn data(front: &Front, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
    let mut params = call.params;
    let first = params.integer(0, RECORDS as i64 - 1)? as u16;
    let cursor = out.cursor();
    let packed = if cursor == 0 { front.format() == Format::Packed } else { cursor & BLOCK != 0 };
    // as many as there are, and as fit a block
    let there = i64::from(front.trace().points().saturating_sub(first));
    let most = if packed { there.min(PACKED_MOST as i64) } else { there };
    let done = cursor as u16;
    // what was promised is sent, though another recording may have begun meanwhile
    let count = params.integer(1, if cursor == 0 { most } else { RECORDS as i64 })? as u16;
    if cursor == 0 && packed {
        out.block_head(usize::from(count) * PACKED);
    }
    for n in done..count {
        if out.room() < TEXT {
            out.resume_at(u32::from(n) | if packed { BLOCK } else { 0 });
            return Ok(Flow::More);
        }
        let Told { tick, counts, power } = front.trace_record(first + n);
        if packed {
            out.raw(&tick.to_le_bytes());
        } else {
            out.integer(tick as i64);
        }
        for count in counts {
            if packed { out.raw(&count.to_le_bytes()) } else { out.integer(count) }
        }
        for (channel, code) in power.into_iter().enumerate() {
            if packed {
                out.raw(&code.to_le_bytes());
            } else {
                let settings = front.sense_settings(channel);
                answer(Some(settings.reading(code.into(), 1, code >= FULL_SCALE)), out);
            }
        }
    }
    Ok(Flow::Done)
}
