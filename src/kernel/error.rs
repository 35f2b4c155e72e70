//! Errors of the controller: the SCPI numbers, and what each names.

use crate::units::Axis;
use crate::units::decimal::{Formatted, Unit, axis_unit, write_byte, write_integer};
use core::fmt::{self, Write};

/// Number of an error in the queue (SCPI-99 volume 2 chapter 21; positive numbers are the device's own).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[repr(i16)]
#[allow(missing_docs)]
pub enum ErrorNumber {
    InvalidCharacter = -101,
    SyntaxError = -102,
    DataTypeError = -104,
    #[cfg(feature = "bus")]
    GetNotAllowed = -105,
    ParameterNotAllowed = -108,
    MissingParameter = -109,
    UndefinedHeader = -113,
    HeaderSuffixOutOfRange = -114,
    ExponentTooLarge = -123,
    InvalidSuffix = -131,
    InvalidStringData = -151,
    InvalidBlockData = -161,
    TriggerIgnored = -211,
    InitIgnored = -213,
    SettingsConflict = -221,
    DataOutOfRange = -222,
    DataCorrupt = -230,
    SystemError = -310,
    StorageFault = -320,
    QueueOverflow = -350,
    FramingError = -362,
    InputBufferOverrun = -363,
    #[cfg(feature = "bus")]
    QueryInterrupted = -410,
    #[cfg(feature = "bus")]
    QueryUnterminated = -420,
    #[cfg(feature = "bus")]
    QueryDeadlocked = -430,
    #[cfg(feature = "bus")]
    QueryAfterIndefinite = -440,
    NotHomed = 101,
    LimitSwitch = 102,
    EmergencyStop = 103,
    Moving = 104,
    StepDeadline = 105,
    SettingsLost = 106,
    NoCalibration = 107,
    AxisDisabled = 108,
    PositionUncertain = 109,
    Clock = 110,
    WatchdogRestart = 111,
    DriverFault = 112,
    ScanFailed = 113,
}

impl ErrorNumber {
    /// All of them, in the order of the manual.
    pub const ALL: &[ErrorNumber] = &[
        ErrorNumber::InvalidCharacter,
        ErrorNumber::SyntaxError,
        ErrorNumber::DataTypeError,
        #[cfg(feature = "bus")]
        ErrorNumber::GetNotAllowed,
        ErrorNumber::ParameterNotAllowed,
        ErrorNumber::MissingParameter,
        ErrorNumber::UndefinedHeader,
        ErrorNumber::HeaderSuffixOutOfRange,
        ErrorNumber::ExponentTooLarge,
        ErrorNumber::InvalidSuffix,
        ErrorNumber::InvalidStringData,
        ErrorNumber::InvalidBlockData,
        ErrorNumber::TriggerIgnored,
        ErrorNumber::InitIgnored,
        ErrorNumber::SettingsConflict,
        ErrorNumber::DataOutOfRange,
        ErrorNumber::DataCorrupt,
        ErrorNumber::SystemError,
        ErrorNumber::StorageFault,
        ErrorNumber::QueueOverflow,
        ErrorNumber::FramingError,
        ErrorNumber::InputBufferOverrun,
        #[cfg(feature = "bus")]
        ErrorNumber::QueryInterrupted,
        #[cfg(feature = "bus")]
        ErrorNumber::QueryUnterminated,
        #[cfg(feature = "bus")]
        ErrorNumber::QueryDeadlocked,
        #[cfg(feature = "bus")]
        ErrorNumber::QueryAfterIndefinite,
        ErrorNumber::NotHomed,
        ErrorNumber::LimitSwitch,
        ErrorNumber::EmergencyStop,
        ErrorNumber::Moving,
        ErrorNumber::StepDeadline,
        ErrorNumber::SettingsLost,
        ErrorNumber::NoCalibration,
        ErrorNumber::AxisDisabled,
        ErrorNumber::PositionUncertain,
        ErrorNumber::Clock,
        ErrorNumber::WatchdogRestart,
        ErrorNumber::DriverFault,
        ErrorNumber::ScanFailed,
    ];

    /// The number in the queue and in `SYST:ERR?`.
    pub const fn code(self) -> i16 {
        self as i16
    }

    /// The standard text (SCPI-99 volume 2 chapter 21) or the device's own.
    pub const fn description(self) -> &'static str {
        match self {
            ErrorNumber::InvalidCharacter => "Invalid character",
            ErrorNumber::SyntaxError => "Syntax error",
            ErrorNumber::DataTypeError => "Data type error",
            #[cfg(feature = "bus")]
            ErrorNumber::GetNotAllowed => "GET not allowed",
            ErrorNumber::ParameterNotAllowed => "Parameter not allowed",
            ErrorNumber::MissingParameter => "Missing parameter",
            ErrorNumber::UndefinedHeader => "Undefined header",
            ErrorNumber::HeaderSuffixOutOfRange => "Header suffix out of range",
            ErrorNumber::ExponentTooLarge => "Exponent too large",
            ErrorNumber::InvalidSuffix => "Invalid suffix",
            ErrorNumber::InvalidStringData => "Invalid string data",
            ErrorNumber::InvalidBlockData => "Invalid block data",
            ErrorNumber::TriggerIgnored => "Trigger ignored",
            ErrorNumber::InitIgnored => "Init ignored",
            ErrorNumber::SettingsConflict => "Settings conflict",
            ErrorNumber::DataOutOfRange => "Data out of range",
            ErrorNumber::DataCorrupt => "Data corrupt or stale",
            ErrorNumber::SystemError => "System error",
            ErrorNumber::StorageFault => "Storage fault",
            ErrorNumber::QueueOverflow => "Queue overflow",
            ErrorNumber::FramingError => "Framing error in program message",
            ErrorNumber::InputBufferOverrun => "Input buffer overrun",
            #[cfg(feature = "bus")]
            ErrorNumber::QueryInterrupted => "Query INTERRUPTED",
            #[cfg(feature = "bus")]
            ErrorNumber::QueryUnterminated => "Query UNTERMINATED",
            #[cfg(feature = "bus")]
            ErrorNumber::QueryDeadlocked => "Query DEADLOCKED",
            #[cfg(feature = "bus")]
            ErrorNumber::QueryAfterIndefinite => "Query UNTERMINATED after indefinite response",
            ErrorNumber::NotHomed => "Axis not homed",
            ErrorNumber::LimitSwitch => "Limit switch active",
            ErrorNumber::EmergencyStop => "Emergency stop",
            ErrorNumber::Moving => "Motion in progress",
            ErrorNumber::StepDeadline => "Step deadline missed",
            ErrorNumber::SettingsLost => "Settings lost, defaults in use",
            ErrorNumber::NoCalibration => "No calibration",
            ErrorNumber::AxisDisabled => "Axis disabled",
            ErrorNumber::PositionUncertain => "Position uncertain",
            ErrorNumber::Clock => "Clock fault",
            ErrorNumber::WatchdogRestart => "Restarted by the watchdog",
            ErrorNumber::DriverFault => "Driver fault",
            ErrorNumber::ScanFailed => "Scan without result",
        }
    }

    /// Writes the text: from all of them in one piece, because a choice among so many takes twice the flash.
    fn write(self, to: &mut dyn Write) -> fmt::Result {
        let mut texts = TEXTS.as_slice();
        for number in Self::ALL {
            let Some((length, rest)) = texts.split_first() else { return Err(fmt::Error) };
            let Some((text, rest)) = rest.split_at_checked(usize::from(*length)) else { return Err(fmt::Error) };
            if *number == self {
                return text.iter().try_for_each(|byte| to.write_char(char::from(*byte)));
            }
            texts = rest;
        }
        Err(fmt::Error)
    }

    /// True for a command error: the rest of the message is then dropped.
    pub const fn is_command_error(self) -> bool {
        matches!(self.code(), -199..=-100)
    }
}

/// Every text with its length in front of it, in the order of [`ErrorNumber::ALL`].
static TEXTS: [u8; texts_length()] = {
    let mut texts = [0; texts_length()];
    let (mut at, mut n) = (0, 0);
    while n < ErrorNumber::ALL.len() {
        let text = ErrorNumber::ALL[n].description().as_bytes();
        texts[at] = text.len() as u8;
        let mut byte = 0;
        while byte < text.len() {
            texts[at + 1 + byte] = text[byte];
            byte += 1;
        }
        at += 1 + text.len();
        n += 1;
    }
    texts
};

const fn texts_length() -> usize {
    let (mut length, mut n) = (0, 0);
    while n < ErrorNumber::ALL.len() {
        length += 1 + ErrorNumber::ALL[n].description().len();
        n += 1;
    }
    length
}

/// What an error names, kept small and plain; rendered as text when the queue is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Detail {
    /// Nothing more to say.
    None,
    /// A fixed explanation.
    Text(&'static str),
    /// The offending bytes of the message, as far as they fit.
    Token(Token),
    /// An axis.
    Axis(Axis),
    /// An axis and a fixed explanation.
    AxisText(Axis, &'static str),
    /// Value of an axis beyond a bound, both in nm or nrad; `motor`: the motor's travel, not the logical limit.
    Limit {
        /// The axis or motor.
        axis: Axis,
        /// The value asked for, nm or nrad.
        value: Named,
        /// The bound that it breaks, nm or nrad.
        bound: Named,
        /// The bound is the travel of the motor.
        motor: bool,
    },
    /// Step or range of a climb that the play of a motor swallows, and the least one that it does not, both in nm or nrad.
    Swallowed {
        /// The axis.
        axis: Axis,
        /// The one asked for, nm or nrad.
        value: Named,
        /// The least one that works, nm or nrad.
        bound: Named,
    },
    /// Velocity of an axis beyond a bound, both in nm/s or nrad/s.
    Speed {
        /// The axis.
        axis: Axis,
        /// The value asked for, nm/s or nrad/s.
        value: Named,
        /// The bound that it breaks, nm/s or nrad/s.
        bound: Named,
    },
}

/// A number in an error text: 48 bits, so that errors stay small. A larger one is named as the largest, 140 km.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Named([u16; 3]);

impl Named {
    /// Most that can be named.
    const MOST: i64 = (1 << 47) - 1;

    /// The number; nm, nrad, or per second.
    pub const fn get(self) -> i64 {
        let [low, middle, high] = self.0;
        low as i64 | (middle as i64) << 16 | (high as i16 as i64) << 32
    }
}

impl From<i64> for Named {
    #[inline(never)]
    fn from(value: i64) -> Self {
        let value = value.clamp(-Self::MOST, Self::MOST);
        Named([value as u16, (value >> 16) as u16, (value >> 32) as u16])
    }
}

/// Bytes of a [`Token`].
const TOKEN: usize = 14;

/// The first 14 bytes of a part of a message, for an error text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token {
    bytes: [u8; TOKEN],
    len: u8,
}

impl Token {
    /// Keeps the first bytes; what is not printable ASCII becomes `?`.
    #[inline(never)]
    pub fn new(text: &[u8]) -> Self {
        let mut bytes = [0; TOKEN];
        let mut len = 0;
        for (to, from) in bytes.iter_mut().zip(text) {
            *to = if matches!(from, b' '..=b'~' if *from != b'"') { *from } else { b'?' };
            len += 1;
        }
        Token { bytes, len }
    }

    /// Writes the kept text.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut dyn Write) -> fmt::Result {
        self.bytes.iter().take(self.len.into()).try_for_each(|byte| write_byte(to, *byte))
    }
}

// Every `?` on the way to a link moves one.
const _: () = assert!(size_of::<usize>() != 4 || size_of::<Error>() <= 20);

/// An error with what it names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Error {
    /// The number in the queue.
    pub number: ErrorNumber,
    /// What it names.
    pub detail: Detail,
}

impl Error {
    /// An error that names a fixed text.
    #[inline(never)]
    pub const fn text(number: ErrorNumber, text: &'static str) -> Self {
        Error { number, detail: Detail::Text(text) }
    }

    /// An error that names an axis.
    #[inline(never)]
    pub const fn axis(number: ErrorNumber, axis: Axis) -> Self {
        Error { number, detail: Detail::Axis(axis) }
    }

    /// An axis, or its motor, beyond a bound, both in nm or nrad.
    #[inline(never)]
    pub fn limit(axis: Axis, value: i64, bound: i64, motor: bool) -> Self {
        let (value, bound) = (value.into(), bound.into());
        Error { number: ErrorNumber::DataOutOfRange, detail: Detail::Limit { axis, value, bound, motor } }
    }

    /// -221: a step or a range that the play of an axis' motor swallows, and the least one that it does not, nm or nrad.
    #[inline(never)]
    pub fn swallowed(axis: Axis, value: i64, bound: i64) -> Self {
        let (value, bound) = (value.into(), bound.into());
        Error { number: ErrorNumber::SettingsConflict, detail: Detail::Swallowed { axis, value, bound } }
    }

    /// An axis beyond a velocity, both in nm/s or nrad/s.
    #[inline(never)]
    pub fn speed(axis: Axis, value: i64, bound: i64) -> Self {
        let (value, bound) = (value.into(), bound.into());
        Error { number: ErrorNumber::DataOutOfRange, detail: Detail::Speed { axis, value, bound } }
    }

    /// An error that names an axis and a fixed text.
    #[inline(never)]
    pub const fn axis_text(number: ErrorNumber, axis: Axis, text: &'static str) -> Self {
        Error { number, detail: Detail::AxisText(axis, text) }
    }

    /// An error that names the offending part of the message.
    #[inline(never)]
    pub fn token(number: ErrorNumber, text: &[u8]) -> Self {
        Error { number, detail: Detail::Token(Token::new(text)) }
    }
}

impl From<ErrorNumber> for Error {
    fn from(number: ErrorNumber) -> Self {
        Error { number, detail: Detail::None }
    }
}

/// `AXIS1` .. `AXIS6`.
fn write_axis(to: &mut dyn Write, axis: Axis) -> fmt::Result {
    to.write_str("AXIS")?;
    write_integer(to, axis.index() as i64 + 1)
}

/// `AXIS1 motor 2.000 um above 1.000 um`.
fn write_bound(to: &mut dyn Write, axis: Axis, what: &str, values: (Named, Named), unit: Unit) -> fmt::Result {
    let (value, bound) = (values.0.get(), values.1.get());
    write_axis(to, axis)?;
    to.write_str(what)?;
    Formatted { value, unit }.write(to)?;
    to.write_str(" ")?;
    to.write_str(unit.symbol())?;
    to.write_str(if value < bound { " below " } else { " above " })?;
    Formatted { value: bound, unit }.write(to)?;
    to.write_str(" ")?;
    to.write_str(unit.symbol())
}

impl Detail {
    /// Writes the text.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut dyn Write) -> fmt::Result {
        match self {
            Detail::None => Ok(()),
            Detail::Text(text) => to.write_str(text),
            Detail::Token(token) => token.write(to),
            Detail::Axis(axis) => write_axis(to, *axis),
            Detail::AxisText(axis, text) => {
                write_axis(to, *axis)?;
                to.write_str(" ")?;
                to.write_str(text)
            }
            Detail::Limit { axis, value, bound, motor } => {
                let what = if *motor { " motor " } else { " " };
                write_bound(to, *axis, what, (*value, *bound), axis_unit(*axis))
            }
            Detail::Swallowed { axis, value, bound } => {
                write_bound(to, *axis, " play takes step or range: ", (*value, *bound), axis_unit(*axis))
            }
            Detail::Speed { axis, value, bound } => {
                write_bound(to, *axis, " ", (*value, *bound), axis_unit(*axis).per_second(1))
            }
        }
    }
}

impl fmt::Display for Detail {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f)
    }
}

impl Error {
    /// Writes the text of the queue: `-222,"Data out of range;AXIS2 6200.000 um above 5000.000 um"`.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut dyn Write) -> fmt::Result {
        write_integer(to, self.number.code().into())?;
        to.write_str(",\"")?;
        self.number.write(to)?;
        if !matches!(self.detail, Detail::None) {
            to.write_str(";")?;
            self.detail.write(to)?;
        }
        to.write_str("\"")
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn the_text_names_the_axis_and_the_value() {
        assert_eq!(
            Error::limit(Axis::Y, 6_200_000, 5_000_000, false).to_string(),
            "-222,\"Data out of range;AXIS2 6200.000 um above 5000.000 um\""
        );
        assert_eq!(
            Error::limit(Axis::Alpha, -17_453_293, -8_726_646, true).to_string(),
            "-222,\"Data out of range;AXIS4 motor -1.00000003 deg below -0.49999999 deg\""
        );
    }

    #[test]
    fn every_number_has_its_text() {
        for number in ErrorNumber::ALL {
            let text = std::format!("{},\"{}\"", number.code(), number.description());
            assert_eq!(Error::from(*number).to_string(), text);
        }
    }

    #[test]
    fn a_number_too_large_to_name_is_named_as_the_largest() {
        for value in [0, 1, -1, 6_200_000, -17_453_293, (1 << 47) - 1, 1 - (1 << 47), -65_536, 65_535] {
            assert_eq!(Named::from(value).get(), value);
        }
        assert_eq!(Named::from(i64::MAX).get(), 140_737_488_355_327);
        assert_eq!(Named::from(i64::MIN).get(), -140_737_488_355_327);
    }

    #[test]
    fn a_quote_in_a_token_cannot_end_the_string() {
        let error = Error::token(ErrorNumber::UndefinedHeader, b"A\"B\xff");
        assert_eq!(error.to_string(), "-113,\"Undefined header;A?B?\"");
        assert_eq!(Error::from(ErrorNumber::NotHomed).to_string(), "101,\"Axis not homed\"");
    }
}
