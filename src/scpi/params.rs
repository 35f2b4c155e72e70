//! Parameters of a unit, taken one after the other by what they should be; the error names the offending text.

use crate::error::{Error, ErrorNumber};
use crate::scpi::lexer::{Class, Framer};
use crate::scpi::response::axis_unit;
use crate::scpi::tree::is_keyword;
use crate::units::decimal::{self, Decimal, Displacement, Unit};
use crate::units::{AXES, Axis, COORDINATE_LIMIT, Pose};

/// A value or one of the words that stand for one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting<T> {
    /// As written.
    Value(T),
    /// `MIN`, `MAX` or `DEF`.
    Extreme(Extreme),
}

/// `MINimum`, `MAXimum` or `DEFault`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Extreme {
    Minimum,
    Maximum,
    Default,
}

impl Extreme {
    /// The value that the word stands for.
    pub fn pick<T>(self, minimum: T, maximum: T, default: T) -> T {
        match self {
            Extreme::Minimum => minimum,
            Extreme::Maximum => maximum,
            Extreme::Default => default,
        }
    }
}

impl<T> Setting<T> {
    /// The value, with the words replaced.
    pub fn resolve(self, minimum: T, maximum: T, default: T) -> T {
        match self {
            Setting::Value(value) => value,
            Setting::Extreme(extreme) => extreme.pick(minimum, maximum, default),
        }
    }
}

/// A set of axes, bit n = axis n + 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisSet(pub u8);

impl AxisSet {
    /// True when the axis is in the set.
    pub const fn contains(self, axis: Axis) -> bool {
        self.0 >> axis.index() & 1 != 0
    }
}

/// The parameters that have not been taken yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Params<'m> {
    /// None: nothing left. An empty text is a missing parameter, a stray comma.
    rest: Option<&'m [u8]>,
    /// How many there were at first.
    count: usize,
}

impl<'m> Params<'m> {
    /// The parameters in the text behind a header.
    ///
    /// # Errors
    /// -102 for a stray comma or parenthesis.
    pub fn new(text: &'m [u8]) -> Result<Self, Error> {
        let text = text.trim_ascii_start();
        let mut params = Params { rest: (!text.is_empty()).then_some(text), count: 0 };
        let mut check = params;
        while let Some(token) = check.split()? {
            if token.is_empty() {
                return Err(Error::token(ErrorNumber::SyntaxError, text));
            }
            params.count += 1;
        }
        Ok(params)
    }

    /// How many there were before one was taken.
    pub const fn count(&self) -> usize {
        self.count
    }

    /// An error that names the parameter with this index.
    pub fn nth_error(mut self, index: usize, number: ErrorNumber) -> Error {
        for _ in 0..index {
            let _ = self.split();
        }
        Error::token(number, self.split().ok().flatten().unwrap_or(b""))
    }

    /// Cuts the next one off, without the white space around it.
    fn split(&mut self) -> Result<Option<&'m [u8]>, Error> {
        let Some(rest) = self.rest else { return Ok(None) };
        let (mut framer, mut depth) = (Framer::parameter(), 0u32);
        let mut end = rest.len();
        for (n, byte) in rest.iter().enumerate() {
            if framer.is_plain(*byte) {
                continue;
            }
            match (framer.step(*byte), byte) {
                (Class::Text, b'(') => depth += 1,
                (Class::Text, b')') if depth == 0 => return Err(Error::token(ErrorNumber::SyntaxError, rest)),
                (Class::Text, b')') => depth -= 1,
                (Class::Text, b',') if depth == 0 => {
                    end = n;
                    break;
                }
                _ => {}
            }
        }
        if depth != 0 {
            return Err(Error::token(ErrorNumber::SyntaxError, rest));
        }
        let (token, tail) = rest.split_at_checked(end).unwrap_or((rest, b""));
        self.rest = tail.get(1..);
        // A block's last bytes may look like white space.
        let token = token.trim_ascii_start();
        Ok(Some(if token.first() == Some(&b'#') { token } else { token.trim_ascii_end() }))
    }

    /// The next one as it is written.
    ///
    /// # Errors
    /// -109 when there is none.
    #[inline(never)]
    pub fn token(&mut self) -> Result<&'m [u8], Error> {
        self.split()?.ok_or(ErrorNumber::MissingParameter.into())
    }

    /// True when all have been taken.
    pub const fn is_empty(&self) -> bool {
        self.rest.is_none()
    }

    /// Nothing may be left.
    ///
    /// # Errors
    /// -108.
    #[inline(never)]
    pub fn end(mut self) -> Result<(), Error> {
        match self.split()? {
            None => Ok(()),
            Some(token) => Err(Error::token(ErrorNumber::ParameterNotAllowed, token)),
        }
    }

    /// A number with an optional suffix, as the integer of `unit`.
    ///
    /// # Errors
    /// -104, -123, -131, -222.
    #[inline(never)]
    pub fn number(&mut self, unit: Unit) -> Result<i64, Error> {
        let token = self.token()?;
        decimal::parse(token, unit).map_err(|number| Error::token(number, token))
    }

    /// A whole number within bounds.
    ///
    /// # Errors
    /// As [`Params::number`], -222 beyond the bounds.
    pub fn integer(&mut self, least: i64, most: i64) -> Result<i64, Error> {
        self.bounded(Unit::COUNT, least, most)
    }

    /// A number within bounds, both in the integer of `unit`.
    ///
    /// # Errors
    /// As [`Params::number`], -222 beyond the bounds.
    #[inline(never)]
    pub fn bounded(&mut self, unit: Unit, least: i64, most: i64) -> Result<i64, Error> {
        let token = self.token()?;
        match decimal::parse(token, unit) {
            Ok(value) if (least..=most).contains(&value) => Ok(value),
            Ok(_) => Err(Error::token(ErrorNumber::DataOutOfRange, token)),
            Err(number) => Err(Error::token(number, token)),
        }
    }

    /// A coordinate of an axis in nm or nrad; um or degrees without suffix.
    ///
    /// # Errors
    /// As [`Params::number`], -222 beyond [`COORDINATE_LIMIT`].
    #[inline(never)]
    pub fn coordinate(&mut self, axis: Axis) -> Result<i32, Error> {
        let value = self.number(axis_unit(axis))?;
        within_coordinates(axis, value)
    }

    /// A distance of an axis, in its unit or in motor steps (`STEP`).
    ///
    /// # Errors
    /// As [`Params::coordinate`].
    pub fn displacement(&mut self, axis: Axis) -> Result<Displacement, Error> {
        let token = self.token()?;
        match decimal::parse_displacement(token, axis_unit(axis)) {
            Ok(Displacement::Logical(value)) => {
                within_coordinates(axis, value).map(|value| Displacement::Logical(value.into()))
            }
            Ok(Displacement::Steps(steps)) => {
                within_coordinates(axis, steps).map(|steps| Displacement::Steps(steps.into()))
            }
            Err(number) => Err(Error::token(number, token)),
        }
    }

    /// A rate of an axis: `order` 1 velocity, 2 acceleration, 3 jerk; nm or nrad per s, s2, s3.
    ///
    /// # Errors
    /// As [`Params::number`].
    pub fn rate(&mut self, axis: Axis, order: u8) -> Result<i64, Error> {
        self.number(axis_unit(axis).per_second(order))
    }

    /// The size of a step of an axis in Q32 nm or nrad.
    ///
    /// # Errors
    /// As [`Params::number`].
    pub fn step_size_q32(&mut self, axis: Axis) -> Result<i64, Error> {
        let token = self.token()?;
        decimal::parse_fine(token, axis_unit(axis), 32).map_err(|number| Error::token(number, token))
    }

    /// Six coordinates.
    ///
    /// # Errors
    /// As [`Params::coordinate`].
    pub fn pose(&mut self) -> Result<Pose, Error> {
        let mut pose = [0; AXES];
        for (axis, to) in Axis::ALL.into_iter().zip(&mut pose) {
            *to = self.coordinate(axis)?;
        }
        Ok(Pose(pose))
    }

    /// Six distances.
    ///
    /// # Errors
    /// As [`Params::displacement`].
    pub fn displacements(&mut self) -> Result<[Displacement; AXES], Error> {
        let mut all = [Displacement::Logical(0); AXES];
        for (axis, to) in Axis::ALL.into_iter().zip(&mut all) {
            *to = self.displacement(axis)?;
        }
        Ok(all)
    }

    /// `ON`, `OFF`, 1 or 0.
    ///
    /// # Errors
    /// -104 another word, -222 another number.
    #[inline(never)]
    pub fn boolean(&mut self) -> Result<bool, Error> {
        let token = self.token()?;
        match token {
            _ if is_keyword("ON", token) => Ok(true),
            _ if is_keyword("OFF", token) => Ok(false),
            _ => match decimal::parse(token, Unit::COUNT) {
                Ok(value @ (0 | 1)) => Ok(value == 1),
                Ok(_) => Err(Error::token(ErrorNumber::DataOutOfRange, token)),
                Err(number) => Err(Error::token(number, token)),
            },
        }
    }

    /// One of the words, as its index.
    ///
    /// # Errors
    /// -104.
    #[inline(never)]
    pub fn choice(&mut self, words: &[&str]) -> Result<usize, Error> {
        let token = self.token()?;
        let found = words.iter().position(|word| is_keyword(word, token));
        found.ok_or_else(|| Error::token(ErrorNumber::DataTypeError, token))
    }

    /// `MIN`, `MAX`, `DEF`, or what `value` takes.
    ///
    /// # Errors
    /// As `value`.
    pub fn setting<T>(&mut self, value: impl FnOnce(&mut Self) -> Result<T, Error>) -> Result<Setting<T>, Error> {
        let mut ahead = *self;
        if let Some(extreme) = extreme(ahead.token()?) {
            *self = ahead;
            return Ok(Setting::Extreme(extreme));
        }
        value(self).map(Setting::Value)
    }

    /// The optional word of a query: `AXIS1:VEL? MAX`.
    ///
    /// # Errors
    /// -104 anything else.
    #[inline(never)]
    pub fn optional_extreme(&mut self) -> Result<Option<Extreme>, Error> {
        match self.split()? {
            None => Ok(None),
            Some(token) => extreme(token).map(Some).ok_or_else(|| Error::token(ErrorNumber::DataTypeError, token)),
        }
    }

    /// The data of a definite block.
    ///
    /// # Errors
    /// -161 when it is none, or not as long as it says.
    pub fn block(&mut self) -> Result<&'m [u8], Error> {
        let token = self.token()?;
        block_data(token).ok_or_else(|| Error::token(ErrorNumber::InvalidBlockData, token))
    }

    /// The inside of a string; doubled quotes stay doubled.
    ///
    /// # Errors
    /// -104 no string, -151 something behind its end.
    pub fn string(&mut self) -> Result<&'m [u8], Error> {
        let token = self.token()?;
        match token {
            [first @ (b'"' | b'\''), inside @ .., last] if first == last => {
                // Every quote inside must have a neighbour, or two strings stand side by side.
                let lone = inside.split(|byte| byte != first).any(|quotes| quotes.len() % 2 != 0);
                if lone { Err(Error::token(ErrorNumber::InvalidStringData, token)) } else { Ok(inside) }
            }
            [b'"' | b'\'', ..] => Err(Error::token(ErrorNumber::InvalidStringData, token)),
            _ => Err(Error::token(ErrorNumber::DataTypeError, token)),
        }
    }

    /// `(@1:6)` or `(@1,3)`.
    ///
    /// # Errors
    /// -104 no list, -102 its syntax, -222 an axis that does not exist.
    #[inline(never)]
    pub fn axis_list(&mut self) -> Result<AxisSet, Error> {
        let token = self.token()?;
        let fail = |number| Error::token(number, token);
        let [b'(', b'@', inside @ .., b')'] = token else { return Err(fail(ErrorNumber::DataTypeError)) };
        let mut set = AxisSet::default();
        for range in inside.split(|byte| *byte == b',') {
            let mut ends = range.split(|byte| *byte == b':').map(|end| axis_number(end).map_err(fail));
            let first = ends.next().unwrap_or(Err(fail(ErrorNumber::SyntaxError)))?;
            let last = ends.next().unwrap_or(Ok(first))?;
            if ends.next().is_some() {
                return Err(fail(ErrorNumber::SyntaxError));
            }
            (first.min(last)..=first.max(last)).for_each(|n| set.0 |= 1 << n);
        }
        Ok(set)
    }
}

fn within_coordinates(axis: Axis, value: i64) -> Result<i32, Error> {
    let limit = i64::from(COORDINATE_LIMIT);
    match i32::try_from(value) {
        Ok(small) if value.abs() <= limit => Ok(small),
        _ => {
            let bound = if value < 0 { -limit } else { limit };
            Err(Error::limit(axis, value, bound, false))
        }
    }
}

fn extreme(token: &[u8]) -> Option<Extreme> {
    [("MINimum", Extreme::Minimum), ("MAXimum", Extreme::Maximum), ("DEFault", Extreme::Default)]
        .into_iter()
        .find_map(|(word, extreme)| is_keyword(word, token).then_some(extreme))
}

fn block_data(token: &[u8]) -> Option<&[u8]> {
    let [b'#', digits @ b'1'..=b'9', rest @ ..] = token else { return None };
    let (length, rest) = rest.split_at_checked(usize::from(digits - b'0'))?;
    // nine digits at most: no overflow
    let value = |n: usize, digit: &u8| digit.is_ascii_digit().then(|| n * 10 + usize::from(digit - b'0'));
    let length = length.iter().try_fold(0, value)?;
    let (data, tail) = rest.split_at_checked(length)?;
    tail.trim_ascii().is_empty().then_some(data)
}

/// Index of the axis with this number.
fn axis_number(text: &[u8]) -> Result<u8, ErrorNumber> {
    let (_, rest) = Decimal::parse(text.trim_ascii()).map_err(|_| ErrorNumber::SyntaxError)?;
    if !rest.is_empty() {
        return Err(ErrorNumber::SyntaxError);
    }
    match decimal::parse(text, Unit::COUNT)? {
        n @ 1..=6 => Ok(n as u8 - 1),
        _ => Err(ErrorNumber::DataOutOfRange),
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    fn params(text: &str) -> Params<'_> {
        Params::new(text.as_bytes()).unwrap()
    }

    #[test]
    fn a_coordinate_takes_the_unit_of_its_axis() {
        let mut p = params(" 1.5 , 2 MM,1,1 MRAD");
        assert_eq!(p.coordinate(Axis::X), Ok(1_500));
        assert_eq!(p.coordinate(Axis::Y), Ok(2_000_000));
        assert_eq!(p.coordinate(Axis::Beta), Ok(17_453_293));
        assert_eq!(p.coordinate(Axis::Gamma), Ok(1_000_000));
        assert_eq!(p.coordinate(Axis::X).unwrap_err().number, ErrorNumber::MissingParameter);
    }

    #[test]
    fn errors_name_the_offending_text() {
        for (text, message) in [
            ("1 DEG", "-131,\"Invalid suffix;1 DEG\""),
            ("NaN", "-104,\"Data type error;NaN\""),
            ("1 STEP", "-131,\"Invalid suffix;1 STEP\""),
            ("1E400", "-222,\"Data out of range;1E400\""),
            ("#13abc", "-104,\"Data type error;#13abc\""),
            ("600 MM", "-222,\"Data out of range;AXIS1 600000.000 um above 536870.912 um\""),
        ] {
            assert_eq!(params(text).coordinate(Axis::X).unwrap_err().to_string(), message);
        }
        assert_eq!(params("1,2").end().unwrap_err().number, ErrorNumber::ParameterNotAllowed);
    }

    #[test]
    fn words_stand_for_values() {
        let mut p = params("max,5,minimum");
        assert_eq!(p.setting(|p| p.integer(0, 9)).map(|s| s.resolve(0, 9, 1)), Ok(9));
        assert_eq!(p.setting(|p| p.integer(0, 9)), Ok(Setting::Value(5)));
        assert_eq!(p.optional_extreme(), Ok(Some(Extreme::Minimum)));
        assert_eq!(p.optional_extreme(), Ok(None));
        assert_eq!(params("10").integer(0, 9).unwrap_err().number, ErrorNumber::DataOutOfRange);
    }

    #[test]
    fn booleans_and_choices_are_closed_sets() {
        let mut p = params("ON,off,1,0");
        assert_eq!([(); 4].map(|()| p.boolean()), [Ok(true), Ok(false), Ok(true), Ok(false)]);
        assert_eq!(params("2").boolean().unwrap_err().number, ErrorNumber::DataOutOfRange);
        assert_eq!(params("YES").boolean().unwrap_err().number, ErrorNumber::DataTypeError);
        assert_eq!(params("REV").choice(&["OFF", "REVersal"]), Ok(1));
        assert_eq!(params("REVE").choice(&["OFF", "REVersal"]).unwrap_err().number, ErrorNumber::DataTypeError);
    }

    #[test]
    fn blocks_strings_and_lists() {
        assert_eq!(params("#13a,;").block(), Ok(&b"a,;"[..]));
        assert_eq!(params("#12\n ").block(), Ok(&b"\n "[..]));
        for bad in ["#0ab", "#13ab,c", "#Hff", "abc", "#12abc"] {
            let result = Params::new(bad.as_bytes()).and_then(|mut p| p.block());
            assert_eq!(result.unwrap_err().number, ErrorNumber::InvalidBlockData, "{bad}");
        }
        assert_eq!(params("'a,\"b'").string(), Ok(&b"a,\"b"[..]));
        assert_eq!(params("\"a\"\"b\"").string(), Ok(&b"a\"\"b"[..]));
        assert_eq!(params("\"a\"b\"c\"").string().unwrap_err().number, ErrorNumber::InvalidStringData);
        assert_eq!(params("(@1:6)").axis_list(), Ok(AxisSet(0x3f)));
        assert_eq!(params("(@1,3)").axis_list(), Ok(AxisSet(5)));
        assert_eq!(params("(@7)").axis_list().unwrap_err().number, ErrorNumber::DataOutOfRange);
        assert_eq!(params("(@)").axis_list().unwrap_err().number, ErrorNumber::SyntaxError);
        assert_eq!(params("(@1:2:3)").axis_list().unwrap_err().number, ErrorNumber::SyntaxError);
    }

    #[test]
    fn steps_are_taken_where_a_distance_is_meant() {
        assert_eq!(params("-3 STEP").displacement(Axis::X), Ok(Displacement::Steps(-3)));
        assert_eq!(params("1").displacement(Axis::X), Ok(Displacement::Logical(1_000)));
        assert_eq!(params("0.0125").step_size_q32(Axis::X), Ok(53_687_091_200));
    }
}
