//! The settings of one axis and its motor: which command sets what, how it is written, and within which range.

use super::setting::{Kind, Setting};
use crate::compensation::calibration::MotorData;
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::scpi::parser::Call;
use crate::scpi::response::{Response, axis_unit};
use crate::scpi::tree::Command as C;
use crate::settings::{
    AxisSettings, BacklashMode, HomeSettings, RATE_MIN, STEPS_MAX, Side, TAKE_UP_SHARE_MAX, TAKE_UP_SHARE_MIN,
};
use crate::units::decimal::Unit;
use crate::units::steps::steps_to_units;
use crate::units::{Axis, COORDINATE_LIMIT};

/// Words of BACKlash:MODE, in the order of [`MODE`].
const MODES: [&str; 4] = ["OFF", "REVersal", "UNIPos", "UNINeg"];
const MODE: [BacklashMode; 4] =
    [BacklashMode::Off, BacklashMode::Reversal, BacklashMode::UniPositive, BacklashMode::UniNegative];
/// Words of HOME:TYPE, in the order of [`SIDE`].
const SIDES: [&str; 2] = ["LOWer", "UPPer"];
const SIDE: [Side; 2] = [Side::Lower, Side::Upper];
/// Words of the polarities: the level at which a line is active.
const LEVELS: [&str; 2] = ["LOW", "HIGH"];

/// The place of a setting, read and written as the integer of its kind.
enum Field<'a> {
    Rate(&'a mut u64),
    Whole(&'a mut i32),
    Flag(&'a mut bool),
    Mode(&'a mut BacklashMode),
    Side(&'a mut Side),
    /// None stands for this value.
    Offset(&'a mut Option<i32>, i32),
}

impl Field<'_> {
    fn get(&self) -> i64 {
        let index = |found: Option<usize>| found.unwrap_or(0) as i64;
        match self {
            Field::Rate(rate) => signed(**rate),
            Field::Whole(value) => i64::from(**value),
            Field::Flag(on) => i64::from(**on),
            Field::Mode(mode) => index(MODE.iter().position(|m| m == *mode)),
            Field::Side(side) => index(SIDE.iter().position(|s| s == *side)),
            Field::Offset(offset, none) => i64::from(offset.unwrap_or(*none)),
        }
    }

    /// `value`: within the range of the setting.
    fn set(self, value: i64) {
        match self {
            Field::Rate(rate) => *rate = value.unsigned_abs(),
            Field::Whole(whole) => *whole = value as i32,
            Field::Flag(on) => *on = value != 0,
            Field::Mode(mode) => *mode = MODE[value as usize & 3],
            Field::Side(side) => *side = SIDE[value as usize & 1],
            Field::Offset(offset, none) => *offset = Some(value as i32).filter(|new| *new != none),
        }
    }
}

/// A setting of an axis.
struct Row<'a> {
    field: Field<'a>,
    kind: Kind,
    least: i64,
    most: i64,
}

fn signed(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

/// The table. None: no setting of an axis.
#[inline(never)]
fn row<'a>(command: C, axis: Axis, own: &'a mut AxisSettings, motor: &MotorData) -> Option<Row<'a>> {
    let rate = |order, field: &'a mut u64, least: u64, most: u64| Row {
        field: Field::Rate(field),
        kind: Kind::Number(axis_unit(axis).per_second(order)),
        least: signed(least.min(most)),
        most: signed(most),
    };
    let coordinate = |field, least: i64, most: i64| Row { field, kind: Kind::Coordinate(axis), least, most };
    let count = |field: &'a mut i32| Row {
        field: Field::Whole(field),
        kind: Kind::Number(Unit::COUNT),
        least: 0,
        most: STEPS_MAX.into(),
    };
    let words = |field, words: &'static [&'static str]| Row {
        field,
        kind: Kind::Words(words),
        least: 0,
        most: words.len() as i64 - 1,
    };
    let switch = |field: &'a mut bool| Row { field: Field::Flag(field), kind: Kind::Switch, least: 0, most: 1 };
    let all = i64::from(COORDINATE_LIMIT);
    let (backlash, home, wiring) = (&mut own.backlash, &mut own.home, &mut own.wiring);
    Some(match command {
        C::AxisVelocity => rate(1, &mut own.velocity, 1, motor.velocity),
        C::AxisVelocityStart => rate(1, &mut own.start_velocity, 0, motor.velocity),
        C::AxisAcceleration => rate(2, &mut own.acceleration, RATE_MIN, motor.acceleration),
        C::AxisJerk => rate(3, &mut own.jerk, RATE_MIN, motor.jerk),
        C::AxisLimitSoftLower => coordinate(Field::Whole(&mut own.soft_lower), -all, all),
        C::AxisLimitSoftUpper => coordinate(Field::Whole(&mut own.soft_upper), -all, all),
        C::AxisLimitSoftState => switch(&mut own.soft_on),
        C::AxisStepInvert => switch(&mut own.inverted),
        C::AxisBacklashMode => words(Field::Mode(&mut backlash.mode), &MODES),
        C::AxisBacklashDistance => {
            let most = steps_to_units(STEPS_MAX.into(), motor.step_q32).min(all);
            coordinate(Field::Whole(&mut backlash.distance), 0, most)
        }
        C::AxisBacklashVelocity => {
            let share = |part: u64| (motor.velocity / part).max(1);
            rate(1, &mut backlash.velocity, share(TAKE_UP_SHARE_MIN), share(TAKE_UP_SHARE_MAX))
        }
        C::AxisBacklashDeadband => count(&mut backlash.dead_band),
        C::AxisBacklashMargin => count(&mut backlash.margin),
        C::AxisHomeType => words(Field::Side(&mut home.side), &SIDES),
        C::AxisHomeVelocity => rate(1, &mut home.velocity, 1, motor.velocity),
        C::AxisHomeOffset => {
            let end = HomeSettings { offset: None, ..*home }.reference(motor);
            coordinate(Field::Offset(&mut home.offset, end), -all, all)
        }
        C::AxisLimitHardState => switch(&mut wiring.limits_on),
        C::AxisLimitHardPolarity => words(Field::Flag(&mut wiring.limits_high), &LEVELS),
        C::AxisEnablePolarity => words(Field::Flag(&mut wiring.enable_high), &LEVELS),
        C::AxisFaultPolarity => words(Field::Flag(&mut wiring.fault_high), &LEVELS),
        _ => return None,
    })
}

/// Executes a command that reads or sets a setting of an axis.
///
/// # Errors
/// Those of the table of commands.
#[inline(never)]
pub fn execute(front: &mut Front, axis: Axis, call: &Call<'_>, out: &mut Response) -> Result<(), Error> {
    let motor = front.motor(axis);
    let mut settings = *front.settings();
    let own = &mut settings.axes[axis.index()];
    let mut default = AxisSettings::defaults(&motor);
    if call.command == C::AxisHomeOffset {
        // its default goes with the side
        default.home.side = own.home.side;
    }
    let (Some(Row { field, kind, least, most }), Some(default)) =
        (row(call.command, axis, own, &motor), row(call.command, axis, &mut default, &motor))
    else {
        return Err(ErrorNumber::UndefinedHeader.into());
    };
    let setting = Setting { kind, now: field.get(), least, most, default: default.field.get() };
    let Some(value) = setting.access(call, out)? else { return Ok(()) };
    field.set(value);
    match call.command {
        C::AxisLimitSoftLower | C::AxisLimitSoftUpper if own.soft_lower >= own.soft_upper => {
            let mut params = call.params;
            Err(Error::token(ErrorNumber::DataOutOfRange, params.token()?))
        }
        C::AxisStepInvert => front.set_pulses(&settings),
        _ => front.set_axes(&settings),
    }
}
