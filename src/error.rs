//! Errors of the controller: the SCPI numbers, and what each names.

use crate::units::Axis;

/// Number of an error in the queue (SCPI-99 volume 2 chapter 21; positive numbers are the device's own).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[repr(i16)]
#[allow(missing_docs)]
pub enum ErrorNumber {
    InvalidCharacter = -101,
    SyntaxError = -102,
    DataTypeError = -104,
    ParameterNotAllowed = -108,
    MissingParameter = -109,
    UndefinedHeader = -113,
    HeaderSuffixOutOfRange = -114,
    ExponentTooLarge = -123,
    InvalidSuffix = -131,
    InvalidStringData = -151,
    InvalidBlockData = -161,
    InitIgnored = -213,
    SettingsConflict = -221,
    DataOutOfRange = -222,
    DataCorrupt = -230,
    QueueOverflow = -350,
    InputBufferOverrun = -363,
    QueryInterrupted = -410,
    QueryUnterminated = -420,
    QueryDeadlocked = -430,
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
        value: i64,
        /// The bound that it breaks, nm or nrad.
        bound: i64,
        /// The bound is the travel of the motor.
        motor: bool,
    },
}

/// Up to 24 bytes of a message, for an error text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token {
    bytes: [u8; 24],
    len: u8,
}

impl Token {
    /// Keeps the first bytes; what is not printable ASCII becomes `?`.
    pub fn new(text: &[u8]) -> Self {
        let mut bytes = [0; 24];
        let mut len = 0;
        for (to, from) in bytes.iter_mut().zip(text) {
            *to = if matches!(from, b' '..=b'~' if *from != b'"') { *from } else { b'?' };
            len += 1;
        }
        Token { bytes, len }
    }

    /// The kept text.
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(&self.bytes[..usize::from(self.len)]).unwrap_or("?")
    }
}

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
    pub const fn text(number: ErrorNumber, text: &'static str) -> Self {
        Error { number, detail: Detail::Text(text) }
    }

    /// An error that names an axis.
    pub const fn axis(number: ErrorNumber, axis: Axis) -> Self {
        Error { number, detail: Detail::Axis(axis) }
    }

    /// An error that names the offending part of the message.
    pub fn token(number: ErrorNumber, text: &[u8]) -> Self {
        Error { number, detail: Detail::Token(Token::new(text)) }
    }
}

impl From<ErrorNumber> for Error {
    fn from(number: ErrorNumber) -> Self {
        Error { number, detail: Detail::None }
    }
}
