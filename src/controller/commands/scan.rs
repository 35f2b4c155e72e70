//! Commands of scans.

use super::sense::{NOT_A_NUMBER, level};
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::refill::border::POWER_INPUTS;
use crate::scan::{Definition, End, Kind, LINES, PATIENCE, POINTS, SCAN_AXES, SCANS, TURNS};
use crate::scpi::params::Params;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::sense::{BRIGHT, DARK};
use crate::units::decimal::Unit;
use crate::units::{Axis, COORDINATE_LIMIT};

/// A parameter of a definition.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Field {
    Channel,
    Axis(usize),
    Axes,
    Range(usize),
    Pitch,
    /// Of the axis with this place.
    Step(usize),
    Least,
    Points,
    Patience,
    Threshold,
    End,
    Side,
}

use Field::*;

/// Parameters behind the number, in their order; from [`Threshold`] on they may be missing.
const fn fields(kind: Kind) -> &'static [Field] {
    match kind {
        Kind::Line => &[Channel, Axis(0), Range(0), Pitch, Threshold, End, Side],
        Kind::Raster => &[Channel, Axis(0), Axis(1), Range(0), Range(1), Pitch, Step(1), Threshold, End, Side],
        Kind::Spiral => &[Channel, Axis(0), Axis(1), Range(0), Pitch, Step(0), Threshold, End],
        Kind::Hill => &[Channel, Axes, Range(0), Step(0), Least, Patience, Threshold, End],
        Kind::Parabola => &[Channel, Axis(0), Range(0), Points, Threshold, End, Side],
    }
}

/// Words of the end action, in the order of [`ENDS`].
const END_WORDS: [&str; 4] = ["PEAK", "STAY", "STARt", "FIRSt"];
const ENDS: [End; 4] = [End::Peak, End::Stay, End::Start, End::First];
/// Words of the flank on which is sampled.
const SIDES: [&str; 2] = ["POSitive", "NEGative"];
/// Words of `SCAN:STATe?`, in the order of [`Front::scan_state`].
const STATES: [&str; 5] = ["IDLE", "TRIG", "MOV", "SAMP", "STOP"];
/// Largest range, nm or nrad.
const RANGE_MAX: i64 = COORDINATE_LIMIT as i64;

/// Executes a command of scans.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let kind = match call.command {
        C::ScanLine => Kind::Line,
        C::ScanRaster => Kind::Raster,
        C::ScanSpiral => Kind::Spiral,
        C::ScanHill => Kind::Hill,
        C::ScanParabola => Kind::Parabola,
        C::ScanStop => {
            front.stop_scan();
            return Ok(());
        }
        C::ScanContinue => return front.continue_stopped_scan(),
        C::ScanState => {
            let (state, id) = front.scan_state();
            out.text(STATES.get(usize::from(state)).unwrap_or(&""));
            out.integer(id);
            return Ok(());
        }
        _ => {
            let id = number(&mut call.params.clone())?;
            return if call.query { result(front, id, out) } else { front.start_scan(id) };
        }
    };
    let mut params = call.params;
    let id = number(&mut params)?;
    if call.query {
        let definition = front.scan_definition(id)?;
        if definition.kind != kind {
            return Err(Error::text(ErrorNumber::SettingsConflict, "scan of another kind"));
        }
        out.integer(id as i64);
        fields(kind).iter().for_each(|field| answer(definition, *field, out));
        return Ok(());
    }
    let mut definition = Definition { defined: true, kind, count: 1, threshold: DARK / 1000, ..Definition::default() };
    for field in fields(kind) {
        if params.is_empty() && matches!(field, Threshold | End | Side) {
            break;
        }
        take(&mut definition, *field, &mut params)?;
    }
    params.end()?;
    front.define_scan(id, definition)
}

fn number(params: &mut Params<'_>) -> Result<usize, Error> {
    params.integer(0, SCANS as i64 - 1).map(|id| id as usize)
}

/// Takes a parameter into a definition.
#[inline(never)]
fn take(to: &mut Definition, field: Field, params: &mut Params<'_>) -> Result<(), Error> {
    let mut text = *params;
    let own = |to: &Definition, n: usize| to.axis(n);
    let mut span = |axis: Axis, least: i64, most: i64| {
        let mut text = *params;
        let value = params.coordinate(axis)?;
        if (least..=most).contains(&i64::from(value)) {
            return Ok(value);
        }
        Err(Error::token(ErrorNumber::DataOutOfRange, text.token()?))
    };
    let refused = |text: &mut Params<'_>, number| Err(Error::token(number, text.token()?));
    match field {
        Channel => to.channel = params.integer(1, POWER_INPUTS as i64)? as u8 - 1,
        Axis(n) => {
            let axis = params.integer(1, 6)? as u8 - 1;
            // a spiral's step is one of both axes
            let mixed = to.kind == Kind::Spiral && n == 1 && (axis >= 3) != (to.axes[0] >= 3);
            if n > 0 && axis == to.axes[0] || mixed {
                return refused(&mut text, ErrorNumber::SettingsConflict);
            }
            to.axes[n & 1] = axis;
            to.count = n as u8 + 1;
        }
        Axes => {
            let set = params.axis_list()?;
            to.count = 0;
            for axis in Axis::ALL.into_iter().filter(|axis| set.contains(*axis)) {
                let mixed = to.count > 0 && axis.is_rotary() != own(to, 0).is_rotary();
                let place = to.axes.get_mut(usize::from(to.count)).filter(|_| !mixed);
                let Some(place) = place else { return refused(&mut text, ErrorNumber::SettingsConflict) };
                *place = axis.index() as u8;
                to.count += 1;
            }
        }
        Range(n) => to.range[n & 1] = span(own(to, n), 1, RANGE_MAX)?,
        Pitch => to.pitch = span(own(to, 0), 1, RANGE_MAX)?,
        Step(n) => {
            // no more lines or turns than there may be, no step beyond the range
            let range = i64::from(to.range[n & 1]);
            let least = match to.kind {
                Kind::Raster => range / LINES as i64 + 1,
                Kind::Spiral => (range + 2 * i64::from(TURNS) - 1) / (2 * i64::from(TURNS)),
                _ => 1,
            };
            to.step = span(own(to, n), least, range.max(1))?;
        }
        Least => to.least = span(own(to, 0), 1, to.step.into())?,
        Points => to.number = params.integer(3, POINTS)? as u16,
        Patience => to.number = params.integer(1, PATIENCE)? as u16,
        Threshold => {
            let (least, most) = (i64::from(DARK / 1000), i64::from(BRIGHT / 1000));
            let value = params.setting(|p| p.number(Unit::LEVEL))?.resolve(least, most, least);
            if !(least..=most).contains(&value) {
                return refused(&mut text, ErrorNumber::DataOutOfRange);
            }
            to.threshold = value as i32;
        }
        End => to.end = ENDS[params.choice(&END_WORDS)? & 3],
        Side => to.negative = params.choice(&SIDES)? == 1,
    }
    Ok(())
}

/// Answers a parameter of a definition as it may be sent again.
fn answer(own: &Definition, field: Field, out: &mut Response) {
    let mut span = |n: usize, value: i32| out.axis_quantity(own.axis(n), value.into(), 0);
    match field {
        Channel => out.integer(own.channel + 1),
        Axis(n) => out.integer(own.axis(n).index() as i64 + 1),
        Axes => {
            const LIST: usize = 2 * SCAN_AXES + 2;
            let mut list = *b"(@1,1,1)";
            for (place, axis) in list.iter_mut().skip(2).step_by(2).zip(own.axes()) {
                *place = b'1' + axis.index() as u8;
            }
            let end = (2 * usize::from(own.count) + 1).min(LIST - 1);
            list[end] = b')';
            out.text(list.get(..=end).and_then(|list| core::str::from_utf8(list).ok()).unwrap_or(""));
        }
        Range(n) => span(n, own.range[n & 1]),
        Pitch => span(0, own.pitch),
        Step(n) => span(n, own.step),
        Least => span(0, own.least),
        Points | Patience => out.integer(own.number),
        Threshold => out.quantity(own.threshold.into(), Unit::LEVEL),
        End => out.short_form(ENDS.iter().position(|end| *end == own.end).map_or("", |n| END_WORDS[n & 3])),
        Side => out.short_form(SIDES[usize::from(own.negative)]),
    }
}

fn result(front: &Front, id: usize, out: &mut Response) -> Result<(), Error> {
    let outcome = front.scan_outcome(id)?;
    let definition = front.scan_definition(id)?;
    out.integer(outcome.status);
    out.integer(outcome.samples);
    let known = outcome.samples > 0 && outcome.has_position();
    if known {
        level(outcome.level, out)
    } else {
        out.text(NOT_A_NUMBER)
    }
    for (n, axis) in definition.axes().enumerate() {
        let i = axis.index();
        if known {
            out.axis_quantity(axis, outcome.position[i].into(), 0)
        } else {
            out.text(NOT_A_NUMBER)
        }
        match outcome.sigma.get(n) {
            Some(sigma) if *sigma > 0 && known => out.axis_quantity(axis, (*sigma).into(), 0),
            _ => out.text(NOT_A_NUMBER),
        }
        out.axis_quantity(axis, outcome.ended[i].into(), 0);
    }
    Ok(())
}
