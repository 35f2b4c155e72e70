//! Commands of scans.

use super::sense::{NOT_A_NUMBER, answer as answer_level};
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::refill::border::POWER_INPUTS;
use crate::scan::{self, Definition, Kind, LEAST_POINTS, LINES, PATIENCE, POINTS, SCANS, TURNS};
use crate::scpi::params::Params;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::tree::Command as C;
use crate::sense::{BRIGHT, DARK, Reading};
use crate::units::decimal::{Unit, axis_unit};
use crate::units::{Axis, COORDINATE_LIMIT};

/// Parameters that are no values: the first axis, the second one, a list of them.
const AXIS: u8 = 10;
const SECOND_AXIS: u8 = 11;
const AXES: u8 = 12;

/// Parameters behind the number, in their order; from the threshold on they may be missing, where the table of commands
/// lets them.
const fn fields(kind: Kind) -> &'static [u8] {
    const CHANNEL: u8 = scan::CHANNEL as u8;
    const RANGE: u8 = scan::RANGE as u8;
    const SECOND_RANGE: u8 = scan::SECOND_RANGE as u8;
    const PITCH: u8 = scan::PITCH as u8;
    const STEP: u8 = scan::STEP as u8;
    const LEAST: u8 = scan::LEAST as u8;
    const NUMBER: u8 = scan::NUMBER as u8;
    const THRESHOLD: u8 = scan::THRESHOLD as u8;
    const END: u8 = scan::END as u8;
    const FLANK: u8 = scan::FLANK as u8;
    match kind {
        Kind::Line => &[CHANNEL, AXIS, RANGE, PITCH, THRESHOLD, END, FLANK],
        Kind::Raster => &[CHANNEL, AXIS, SECOND_AXIS, RANGE, SECOND_RANGE, PITCH, STEP, THRESHOLD, END, FLANK],
        Kind::Spiral => &[CHANNEL, AXIS, SECOND_AXIS, RANGE, PITCH, STEP, THRESHOLD, END],
        Kind::Hill => &[CHANNEL, AXES, RANGE, STEP, LEAST, NUMBER, THRESHOLD, END],
        Kind::Parabola => &[CHANNEL, AXIS, RANGE, NUMBER, THRESHOLD, END, FLANK],
    }
}

/// Words of the end action, in the order of [`scan::end`].
const ENDS: &[&str] = &["PEAK", "STAY", "STARt", "FIRSt"];
/// Words of the flank on which is sampled.
const FLANKS: &[&str] = &["POSitive", "NEGative"];
/// Words of `SCAN:STATe?`, in the order of [`Front::scan_state`].
const STATES: [&str; 5] = ["IDLE", "TRIG", "MOV", "SAMP", "STOP"];

/// Unit of a value, its least and its most.
#[inline(never)]
fn bounds(own: &Definition, slot: usize) -> (Unit, i32, i32) {
    // the step of a raster is one of its second axis
    let across = slot == scan::SECOND_RANGE || slot == scan::STEP && own.kind == Kind::Raster;
    let unit = axis_unit(own.axis(across.into()));
    let [range, second] = [own.values[scan::RANGE], own.values[scan::SECOND_RANGE]];
    match slot {
        scan::CHANNEL => (Unit::COUNT, 1, POWER_INPUTS as i32),
        scan::NUMBER if own.kind == Kind::Hill => (Unit::COUNT, 1, PATIENCE),
        scan::NUMBER => (Unit::COUNT, LEAST_POINTS, POINTS),
        scan::THRESHOLD => (Unit::LEVEL, DARK / 1000, BRIGHT / 1000),
        scan::LEAST => (unit, 1, own.values[scan::STEP]),
        // no more lines or turns than there may be
        scan::STEP if own.kind == Kind::Raster => (unit, second / LINES as i32 + 1, second),
        scan::STEP if own.kind == Kind::Spiral => (unit, range / (2 * TURNS) + 1, range),
        scan::STEP => (unit, 1, range),
        _ => (unit, 1, COORDINATE_LIMIT),
    }
}

/// Words of a value that has some.
fn words(slot: usize) -> Option<&'static [&'static str]> {
    match slot {
        scan::END => Some(ENDS),
        scan::FLANK => Some(FLANKS),
        _ => None,
    }
}

/// Executes a command of scans.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let mut params = call.params;
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
            let id = number(&mut params)?;
            return if call.query { result(front, id, out) } else { front.start_scan(id) };
        }
    };
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
    let mut definition = Definition { defined: true, kind, count: 1, ..Definition::NONE };
    definition.values[scan::THRESHOLD] = DARK / 1000;
    for field in fields(kind) {
        if params.is_empty() && (scan::THRESHOLD..scan::VALUES).contains(&usize::from(*field)) {
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
fn take(to: &mut Definition, field: u8, params: &mut Params<'_>) -> Result<(), Error> {
    let mut text = *params;
    let axes = match field {
        AXIS | SECOND_AXIS => 1u8 << ((params.integer(1, 6)? - 1) & 7),
        AXES => params.axis_list()?.0,
        _ => {
            let slot = usize::from(field);
            let value = match words(slot) {
                Some(words) => params.choice(words)? as i32,
                None => {
                    let (unit, least, most) = bounds(to, slot);
                    params.bounded(unit, least.into(), most.into())? as i32
                }
            };
            if let Some(place) = to.values.get_mut(slot) {
                *place = value;
            }
            return Ok(());
        }
    };
    if field != SECOND_AXIS {
        to.count = 0;
    }
    for axis in Axis::ALL.into_iter().filter(|axis| axes >> axis.index() & 1 != 0) {
        // a step of a spiral or of a climb is one of all axes
        let first = to.axis(0);
        let mixed = to.kind != Kind::Raster && axis.is_rotary() != first.is_rotary() || axis == first;
        let place = to.axes.get_mut(usize::from(to.count)).filter(|_| to.count == 0 || !mixed);
        let Some(place) = place else { return Err(Error::token(ErrorNumber::SettingsConflict, text.token()?)) };
        *place = axis.index() as u8;
        to.count += 1;
    }
    Ok(())
}

/// Answers a parameter of a definition as it may be sent again.
#[inline(never)]
fn answer(own: &Definition, field: u8, out: &mut Response) {
    match field {
        AXIS | SECOND_AXIS => out.integer(own.axis((field - AXIS).into()).index() as i64 + 1),
        AXES => {
            out.text("(@");
            let mut between: &[u8] = b"";
            for axis in own.axes() {
                out.raw(between);
                out.raw(&[b'1' + axis]);
                between = b",";
            }
            out.raw(b")");
        }
        _ => {
            let slot = usize::from(field);
            let value = own.values.get(slot).copied().unwrap_or(0);
            match words(slot) {
                Some(words) => out.short_form(words.get(value as usize).unwrap_or(&"")),
                None => out.quantity(value.into(), bounds(own, slot).0),
            }
        }
    }
}

#[inline(never)]
fn result(front: &Front, id: usize, out: &mut Response) -> Result<(), Error> {
    let definition = front.scan_definition(id)?;
    let (outcome, stands) = front.scan_outcome(id)?;
    out.integer(outcome.status);
    out.integer(outcome.samples);
    let known = outcome.has_position();
    let reading = if outcome.level >= BRIGHT { Reading::High } else { Reading::Level(outcome.level) };
    answer_level(known.then_some(reading), out);
    for (n, i) in definition.axes().iter().enumerate() {
        let of = |all: &[i32]| all.get(usize::from(*i)).copied().unwrap_or(0);
        let sigma = outcome.sigma.get(n).copied().unwrap_or(0) as i32;
        let values = [(of(&outcome.position), known), (sigma, known && sigma > 0), (of(&stands.0), true)];
        for (value, known) in values {
            if known { out.axis_quantity(definition.axis(n), value.into(), 0) } else { out.text(NOT_A_NUMBER) }
        }
    }
    Ok(())
}
