//! Exact decimal text <-> integer: the one reader and the one writer of numbers.
//!
//! A number never passes through a float. 30 significant digits are used; further ones cannot change a result in nm
//! or ns, and move an angle by less than 10^-10 nrad. Decimal units are rounded exactly, ties away from zero. Degrees
//! are multiplied with pi/180 to 125 bits: the answer is the correctly rounded integer unless the exact value lies
//! within 2^-60 nrad of a tie (a tie itself cannot happen, pi is irrational), for every angle that fits i64.

use crate::error::ErrorNumber;
use crate::units::{Axis, wide};
use core::fmt::{self, Write};

/// Significant digits that are used: 10^30 < 2^100.
const DIGITS: u32 = 30;
/// Largest magnitude of a written exponent (IEEE 488.2, 7.7.2.4.1).
const EXPONENT_LIMIT: i32 = 32_000;
/// Fractional bits of [`NRAD_PER_DEG`] and of the unit factor.
const FACTOR_BITS: u32 = 100;
/// pi / 180 * 10^9 in Q100.
const NRAD_PER_DEG: u128 = 22_124_676_738_864_985_353_824_172_855_290_083_076;
/// The same for a degree, its tenth, and so on: no division for numbers below [`SHORT`], which moves them by less than
/// 2^-60 nrad.
const NRAD_PER_PART: [u128; 10] = {
    let mut parts = [NRAD_PER_DEG; 10];
    let mut n = 1;
    while n < parts.len() {
        parts[n] = NRAD_PER_DEG / 10u128.pow(n as u32);
        n += 1;
    }
    parts
};
const SHORT: u128 = 1 << 40;
/// 180 / pi / 10^9 * 10^8 in Q120: units of 10^-8 degree per nanoradian.
const E8_DEG_PER_NRAD: u128 = 7_615_915_416_910_885_643_922_812_869_023_816_652;
const TEN_19: u64 = 10_000_000_000_000_000_000;

/// What a number measures; with the order of its time derivative this fixes the integer that stands for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// nm; text in um by default.
    Length,
    /// nrad; text in degrees by default.
    Angle,
    /// ns; text in seconds by default.
    Time,
    /// Whole percent.
    Percent,
    /// A plain whole number.
    Count,
    /// Thousandths of a dB or dBm; text in dB or dBm.
    Level,
    /// pW; text in W by default.
    Power,
}

/// A dimension and how often it is divided by time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unit {
    /// What is measured.
    pub dimension: Dimension,
    /// 0 coordinate, 1 velocity (/s), 2 acceleration (/s2), 3 jerk (/s3).
    pub order: u8,
}

/// The unit of an axis's coordinate.
pub const fn axis_unit(axis: Axis) -> Unit {
    if axis.is_rotary() { Unit::ANGLE } else { Unit::LENGTH }
}

impl Unit {
    /// Plain whole number.
    pub const COUNT: Unit = Unit { dimension: Dimension::Count, order: 0 };
    /// Whole percent.
    pub const PERCENT: Unit = Unit { dimension: Dimension::Percent, order: 0 };
    /// Nanoseconds.
    pub const TIME: Unit = Unit { dimension: Dimension::Time, order: 0 };
    /// Thousandths of a dB or dBm.
    pub const LEVEL: Unit = Unit { dimension: Dimension::Level, order: 0 };
    /// Picowatts.
    pub const POWER: Unit = Unit { dimension: Dimension::Power, order: 0 };
    /// Nanometres.
    pub const LENGTH: Unit = Unit { dimension: Dimension::Length, order: 0 };
    /// Nanoradians.
    pub const ANGLE: Unit = Unit { dimension: Dimension::Angle, order: 0 };

    /// The same dimension per second to the power `order`.
    pub const fn per_second(self, order: u8) -> Unit {
        Unit { dimension: self.dimension, order }
    }

    /// The unit of an answer and of a number without suffix.
    pub const fn symbol(self) -> &'static str {
        match (self.dimension, self.order) {
            (Dimension::Length, 0) => "um",
            (Dimension::Length, 1) => "um/s",
            (Dimension::Length, 2) => "um/s2",
            (Dimension::Length, _) => "um/s3",
            (Dimension::Angle, 0) => "deg",
            (Dimension::Angle, 1) => "deg/s",
            (Dimension::Angle, 2) => "deg/s2",
            (Dimension::Angle, _) => "deg/s3",
            (Dimension::Time, _) => "s",
            (Dimension::Percent, _) => "%",
            (Dimension::Count, _) => "",
            (Dimension::Level, _) => "dBm",
            (Dimension::Power, _) => "W",
        }
    }
}

/// How a unit's text becomes the integer: a power of ten, and for degrees pi/180 as well.
#[derive(Clone, Copy)]
struct Factor {
    power: i32,
    degrees: bool,
}

/// A decimal number as written: sign, significant digits, power of ten.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decimal {
    negative: bool,
    digits: u128,
    count: u32,
    power: i32,
}

impl Decimal {
    /// Reads `[+-]digits[.digits][E[+-]digits]` from the front of `text`; answers it and what follows, without the
    /// white space between.
    ///
    /// # Errors
    /// -104 when `text` does not begin with a number, -123 when the exponent is beyond 32000.
    pub fn parse(text: &[u8]) -> Result<(Decimal, &[u8]), ErrorNumber> {
        let mut number = Decimal::default();
        let mut rest = text;
        if let [sign @ (b'+' | b'-'), tail @ ..] = rest {
            number.negative = *sign == b'-';
            rest = tail;
        }
        let (mut any, mut point) = (false, false);
        while let [byte, tail @ ..] = rest {
            match byte {
                b'0'..=b'9' => {
                    any = true;
                    number.append(byte - b'0', point);
                }
                b'.' if !point => point = true,
                _ => break,
            }
            rest = tail;
        }
        if !any {
            return Err(ErrorNumber::DataTypeError);
        }
        if let Some((exponent, tail)) = exponent(rest) {
            if exponent.abs() > EXPONENT_LIMIT {
                return Err(ErrorNumber::ExponentTooLarge);
            }
            number.power = number.power.saturating_add(exponent);
            rest = tail;
        }
        Ok((number, rest.trim_ascii()))
    }

    fn append(&mut self, digit: u8, fraction: bool) {
        if self.count < DIGITS {
            self.digits = self.digits * 10 + u128::from(digit);
            self.count += u32::from(self.digits != 0);
            self.power = self.power.saturating_sub(i32::from(fraction));
        } else {
            self.power = self.power.saturating_add(i32::from(!fraction));
        }
    }

    /// The value times the unit's factor times 2^`bits`, rounded to nearest, ties away from zero.
    /// None when it does not fit i64.
    fn scaled(self, factor: Factor, bits: u32) -> Option<i64> {
        let power = self.power.saturating_add(factor.power);
        let magnitude = self.count as i32;
        if self.digits == 0 || power.saturating_add(magnitude) < -20 {
            return Some(0);
        }
        if power.saturating_add(magnitude) > 20 {
            return None;
        }
        let whole = (0..power.max(0)).fold(self.digits, |digits, _| digits * 10);
        let mut divide_by = (-power).max(0) as u32;
        // nm and nrad, and um with three decimals
        if !factor.degrees && divide_by == 0 && bits == 0 {
            return self.signed(whole);
        }
        let by = match NRAD_PER_PART.get(divide_by as usize).filter(|_| factor.degrees && whole < SHORT) {
            Some(nrad) => {
                divide_by = 0;
                *nrad
            }
            None if factor.degrees => NRAD_PER_DEG,
            None => 1 << FACTOR_BITS,
        };
        let mut product = multiply(whole, by);
        while divide_by > 0 {
            let step = divide_by.min(19);
            divide(&mut product, if step == 19 { TEN_19 } else { 10u64.pow(step) });
            divide_by -= step;
        }
        self.signed(round_shift(product, FACTOR_BITS.checked_sub(bits)?)?)
    }

    fn signed(&self, magnitude: u128) -> Option<i64> {
        let magnitude = i64::try_from(magnitude).ok()?;
        Some(if self.negative { -magnitude } else { magnitude })
    }
}

/// `E[+-]digits` at the front of `text`, saturated beyond the limit. An `E` without digits is no exponent.
fn exponent(text: &[u8]) -> Option<(i32, &[u8])> {
    let [b'E' | b'e', tail @ ..] = text else { return None };
    let (negative, mut rest) = match tail {
        [sign @ (b'+' | b'-'), tail @ ..] => (*sign == b'-', tail),
        _ => (false, tail),
    };
    let mut value = None;
    while let [digit @ b'0'..=b'9', tail @ ..] = rest {
        value = Some((value.unwrap_or(0) * 10 + i32::from(digit - b'0')).min(EXPONENT_LIMIT + 1));
        rest = tail;
    }
    value.map(|value| (if negative { -value } else { value }, rest))
}

/// Full product of two 128-bit numbers, least significant limb first.
#[inline(never)]
fn multiply(a: u128, b: u128) -> [u64; 4] {
    let low = |x: u128| x & u128::from(u64::MAX);
    let (a0, a1, b0, b1) = (low(a), a >> 64, low(b), b >> 64);
    let (p00, p01, p10, p11) = (a0 * b0, a0 * b1, a1 * b0, a1 * b1);
    let middle = (p00 >> 64) + low(p01) + low(p10);
    let high = p11 + (p01 >> 64) + (p10 >> 64) + (middle >> 64);
    [p00 as u64, middle as u64, high as u64, (high >> 64) as u64]
}

/// Divides in place; the remainder is dropped (floors of floors compose).
#[inline(never)]
fn divide(number: &mut [u64; 4], by: u64) {
    let mut remainder = 0u128;
    for limb in number.iter_mut().rev() {
        let value = remainder << 64 | u128::from(*limb);
        let quotient;
        (quotient, remainder) = wide::div_rem(value, u128::from(by));
        *limb = quotient as u64;
    }
}

/// `number / 2^shift` to nearest, ties up, for 64 <= shift < 128; None beyond u128.
#[inline(never)]
fn round_shift(number: [u64; 4], shift: u32) -> Option<u128> {
    let (low, high) =
        (u128::from(number[1]) << 64 | u128::from(number[0]), u128::from(number[3]) << 64 | u128::from(number[2]));
    if shift == 0 || shift >= 128 || high >> (shift - 1) != 0 {
        return None;
    }
    let half = low >> (shift - 1) & 1;
    Some((high << (128 - shift) | low >> shift) + half)
}

/// The factor of a suffix; the default unit's for an empty one.
fn factor(unit: Unit, suffix: &[u8]) -> Option<Factor> {
    let slash = suffix.iter().position(|byte| *byte == b'/').unwrap_or(suffix.len());
    let (base, rate) = suffix.split_at_checked(slash)?;
    let is = |text: &[u8], name: &str| text.eq_ignore_ascii_case(name.as_bytes());
    let rates: &[&str] = match unit.order {
        0 => &[""],
        1 => &["/S"],
        2 => &["/S2", "/S^2", "/S**2"],
        _ => &["/S3", "/S^3", "/S**3"],
    };
    if !suffix.is_empty() && !rates.iter().any(|name| is(rate, name)) {
        return None;
    }
    let names: &[(&str, i32, bool)] = match unit.dimension {
        Dimension::Length => &[("", 3, false), ("NM", 0, false), ("UM", 3, false), ("MM", 6, false), ("M", 9, false)],
        Dimension::Angle => &[
            ("", 0, true),
            ("NRAD", 0, false),
            ("URAD", 3, false),
            ("MRAD", 6, false),
            ("RAD", 9, false),
            ("MDEG", -3, true),
            ("DEG", 0, true),
        ],
        Dimension::Time => &[("", 9, false), ("S", 9, false), ("MS", 6, false), ("US", 3, false), ("NS", 0, false)],
        Dimension::Percent => &[("", 0, false), ("PCT", 0, false), ("%", 0, false)],
        Dimension::Count => &[("", 0, false)],
        Dimension::Level => &[("", 3, false), ("DB", 3, false), ("DBM", 3, false)],
        Dimension::Power => {
            &[("", 12, false), ("W", 12, false), ("MW", 9, false), ("UW", 6, false), ("NW", 3, false), ("PW", 0, false)]
        }
    };
    if base.is_empty() && !suffix.is_empty() {
        return None;
    }
    let (_, power, degrees) = *names.iter().find(|(name, ..)| is(base, name))?;
    Some(Factor { power, degrees })
}

/// Reads a number with an optional suffix into the integer of `unit` (nm, nrad, ns, percent, count).
///
/// # Errors
/// -104 no number, -123 exponent beyond 32000, -131 wrong unit, -222 beyond i64.
pub fn parse(text: &[u8], unit: Unit) -> Result<i64, ErrorNumber> {
    parse_fine(text, unit, 0)
}

/// As [`parse`], with `bits` fractional bits (at most 32): a step size in Q16 nm, for example.
///
/// # Errors
/// As [`parse`].
pub fn parse_fine(text: &[u8], unit: Unit, bits: u32) -> Result<i64, ErrorNumber> {
    let (number, suffix) = Decimal::parse(text.trim_ascii())?;
    let factor = suffix_factor(unit, suffix)?;
    number.scaled(factor, bits.min(32)).ok_or(ErrorNumber::DataOutOfRange)
}

/// A length of travel, or a number of motor steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Displacement {
    /// nm or nrad.
    Logical(i64),
    /// Motor steps.
    Steps(i64),
}

/// As [`parse`], and the suffix `STEP` is allowed.
///
/// # Errors
/// As [`parse`].
pub fn parse_displacement(text: &[u8], unit: Unit) -> Result<Displacement, ErrorNumber> {
    let (number, suffix) = Decimal::parse(text.trim_ascii())?;
    if suffix.eq_ignore_ascii_case(b"STEP") {
        let steps = number.scaled(Factor { power: 0, degrees: false }, 0).ok_or(ErrorNumber::DataOutOfRange)?;
        return Ok(Displacement::Steps(steps));
    }
    let factor = suffix_factor(unit, suffix)?;
    number.scaled(factor, 0).map(Displacement::Logical).ok_or(ErrorNumber::DataOutOfRange)
}

/// What follows the number must be a suffix of the unit; something that cannot be a suffix is no number.
fn suffix_factor(unit: Unit, suffix: &[u8]) -> Result<Factor, ErrorNumber> {
    match suffix {
        [first @ ..=0x7f, ..] if !first.is_ascii_alphabetic() && !matches!(first, b'/' | b'%') => {
            Err(ErrorNumber::DataTypeError)
        }
        _ => factor(unit, suffix).ok_or(ErrorNumber::InvalidSuffix),
    }
}

/// Text of an integer in its unit's default text unit: um with 3 decimals, degrees with 8, seconds with 9, others
/// whole. Reading the text again gives the same integer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Formatted {
    /// nm, nrad, ns, percent or count.
    pub value: i64,
    /// The unit of `value`.
    pub unit: Unit,
}

impl Formatted {
    /// Writes the text.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut dyn Write) -> fmt::Result {
        let magnitude = u128::from(self.value.unsigned_abs());
        let (scaled, decimals) = match self.unit.dimension {
            Dimension::Length | Dimension::Level => (magnitude, 3),
            Dimension::Power => (magnitude, 12),
            Dimension::Angle => (round_shift(multiply(magnitude, E8_DEG_PER_NRAD), 120).unwrap_or(0), 8),
            Dimension::Time => (magnitude, 9),
            Dimension::Percent | Dimension::Count => (magnitude, 0),
        };
        write_fraction(to, self.value < 0, scaled, decimals)
    }
}

impl fmt::Display for Formatted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f)
    }
}

// Texts of numbers without the machinery of `core::fmt`, which takes several KB on a board.

/// The decimal digits of a number, with zeros in front up to `least` of them, at most 20.
///
/// # Errors
/// Those of `to`.
#[inline(never)]
pub fn write_digits(to: &mut dyn Write, value: u64, least: usize) -> fmt::Result {
    let (mut text, mut left, mut count) = ([b'0'; 20], value, 0);
    for digit in text.iter_mut().rev() {
        if left == 0 && count >= least.max(1) {
            break;
        }
        *digit += (left % 10) as u8;
        left /= 10;
        count += 1;
    }
    text.iter().skip(text.len() - count).try_for_each(|digit| write_byte(to, *digit))
}

/// One ASCII character.
///
/// # Errors
/// Those of `to`.
#[inline(never)]
pub fn write_byte(to: &mut dyn Write, byte: u8) -> fmt::Result {
    to.write_str(char::from(byte).encode_utf8(&mut [0; 2]))
}

/// A whole number.
///
/// # Errors
/// Those of `to`.
#[inline(never)]
pub fn write_integer(to: &mut dyn Write, value: i64) -> fmt::Result {
    if value < 0 {
        to.write_str("-")?;
    }
    write_digits(to, value.unsigned_abs(), 1)
}

/// `size / 10^decimals` with its sign; whole units must fit 64 bits, and `decimals` 19.
///
/// # Errors
/// Those of `to`.
#[inline(never)]
pub fn write_fraction(to: &mut dyn Write, negative: bool, size: u128, decimals: u32) -> fmt::Result {
    let (whole, fraction) = wide::div_rem(size, 10u64.pow(decimals).into());
    if negative {
        to.write_str("-")?;
    }
    write_digits(to, wide::narrow(whole), 1)?;
    if decimals == 0 {
        return Ok(());
    }
    to.write_str(".")?;
    write_digits(to, wide::narrow(fraction), decimals as usize)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::format;
    use std::string::ToString;

    fn nm(text: &str) -> Result<i64, ErrorNumber> {
        parse(text.as_bytes(), Unit::LENGTH)
    }

    fn nrad(text: &str) -> Result<i64, ErrorNumber> {
        parse(text.as_bytes(), Unit::ANGLE)
    }

    #[test]
    fn lengths_are_read_exactly_with_ties_away_from_zero() {
        for (text, value) in [
            ("1", 1000),
            ("-1.5 UM", -1500),
            ("+.0005", 1),
            ("-0.0005", -1),
            ("0.00049999999999999999999999999999999999999999", 0),
            ("2.5nm", 3),
            ("1e-3 m", 1_000_000),
            ("12.E2 Mm", 1_200_000_000),
            ("1E-32000", 0),
            ("0E32000", 0),
            ("9223372036854775.807", i64::MAX),
            ("0.000000000000000000000000000000000000000000012E45 NM", 12),
        ] {
            assert_eq!(nm(text), Ok(value), "{text}");
        }
    }

    #[test]
    fn what_is_no_number_or_too_large_names_its_error() {
        use ErrorNumber::*;
        for (text, error) in [
            ("NAN", DataTypeError),
            ("INF", DataTypeError),
            ("", DataTypeError),
            (".", DataTypeError),
            ("1.2.3", DataTypeError),
            ("--1", DataTypeError),
            ("1E32001", ExponentTooLarge),
            ("1E-99999999999999", ExponentTooLarge),
            ("1e400", DataOutOfRange),
            ("9223372036854775.8075", DataOutOfRange),
            ("1 DEG", InvalidSuffix),
            ("1 UM/S", InvalidSuffix),
            ("1 STEP", InvalidSuffix),
            ("1 \u{b5}m", InvalidSuffix),
            ("1E", InvalidSuffix),
            ("1 /S", InvalidSuffix),
        ] {
            assert_eq!(nm(text), Err(error), "{text}");
        }
    }

    #[test]
    fn every_suffix_of_an_angle_is_known() {
        for (text, value) in [
            ("180", 3_141_592_654),
            ("1", 17_453_293),
            ("1 MDEG", 17_453),
            ("-1 MRAD", -1_000_000),
            ("1 RAD", 1_000_000_000),
            ("3 URAD", 3_000),
            ("7 NRAD", 7),
            // 2^31 degrees, from 60 digits of pi
            ("2147483648", 37_480_660_290_338_942),
        ] {
            assert_eq!(nrad(text), Ok(value), "{text}");
        }
    }

    /// Values next to a tie, computed with 120 digits of pi.
    #[test]
    fn degrees_next_to_a_tie_are_rounded_to_the_right_side() {
        for (text, value) in [
            ("0.457493535439005053643950", 7_984_768),
            ("0.457493535439005053643951", 7_984_769),
            ("-0.457493535439005053643951", -7_984_769),
            ("4.55747346290729722021", 79_542_917),
            ("4.55747346290729722022", 79_542_918),
            ("-4.55747346290729722022", -79_542_918),
            ("66.962916318771300846", 1_168_723_366),
            ("66.962916318771300847", 1_168_723_367),
            ("-66.962916318771300847", -1_168_723_367),
            ("1527395278.39559090105324157", 26_658_076_587_418_474),
            ("1527395278.39559090105324158", 26_658_076_587_418_475),
            ("-1527395278.39559090105324158", -26_658_076_587_418_475),
            ("319147760894.187922931877167", 5_570_179_227_971_181_558),
            ("319147760894.187922931877168", 5_570_179_227_971_181_559),
            ("-319147760894.187922931877168", -5_570_179_227_971_181_559),
        ] {
            assert_eq!(nrad(text), Ok(value), "{text}");
        }
    }

    #[test]
    fn rates_take_three_spellings_of_a_power() {
        let rate = |text: &str, order| parse(text.as_bytes(), Unit::LENGTH.per_second(order));
        assert_eq!(rate("1 MM/S", 1), Ok(1_000_000));
        for text in ["2", "2 um/s2", "2UM/S^2", "2 UM/S**2", "2000 NM/S2"] {
            assert_eq!(rate(text, 2), Ok(2_000), "{text}");
        }
        assert_eq!(rate("1 UM/S2", 3), Err(ErrorNumber::InvalidSuffix));
        assert_eq!(rate("1 UM", 1), Err(ErrorNumber::InvalidSuffix));
        assert_eq!(parse(b"1 DEG/S3", Unit::ANGLE.per_second(3)), Ok(17_453_293));
    }

    #[test]
    fn other_units_and_steps() {
        assert_eq!(parse(b"2.5 US", Unit::TIME), Ok(2_500));
        assert_eq!(parse(b"1 MS", Unit::TIME), Ok(1_000_000));
        assert_eq!(parse(b"50 PCT", Unit::PERCENT), Ok(50));
        assert_eq!(parse(b"32.5", Unit::COUNT), Ok(33));
        assert_eq!(parse_fine(b"0.0125", Unit::LENGTH, 16), Ok(819_200));
        assert_eq!(parse_displacement(b"-10 step", Unit::LENGTH), Ok(Displacement::Steps(-10)));
        assert_eq!(parse_displacement(b"1.5", Unit::LENGTH), Ok(Displacement::Logical(1_500)));
    }

    #[test]
    fn an_answer_sent_back_gives_the_same_integer() {
        let round_trip = |value: i64, unit: Unit| {
            let text = Formatted { value, unit }.to_string();
            assert_eq!(parse(text.as_bytes(), unit), Ok(value), "{text}");
            let with_unit = format!("{text} {}", unit.symbol());
            assert_eq!(parse(with_unit.as_bytes(), unit), Ok(value), "{with_unit}");
        };
        let mut seed = 1u64;
        for n in 0..20_000i64 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            for unit in [Unit::ANGLE, Unit::LENGTH, Unit::ANGLE.per_second(3), Unit::TIME] {
                round_trip(n - 10_000, unit);
                round_trip(i64::from((seed >> 32) as i32), unit);
                round_trip(seed as i64 >> (n % 60), unit);
            }
        }
        for value in [i64::MAX, i64::MIN + 1, i64::from(i32::MAX), i64::from(i32::MIN)] {
            round_trip(value, Unit::ANGLE);
            round_trip(value, Unit::LENGTH.per_second(1));
        }
    }

    #[test]
    fn whole_numbers_and_fractions_are_those_of_the_library() {
        let mut seed = 1u64;
        for n in 0..20_000u32 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let value = seed >> (n % 64);
            let mut text = std::string::String::new();
            write_integer(&mut text, value as i64).unwrap();
            assert_eq!(text, (value as i64).to_string());
            let (decimals, mut text) = ((n % 19 + 1) as usize, std::string::String::new());
            write_fraction(&mut text, n % 2 == 1, value.into(), decimals as u32).unwrap();
            let ten = 10u64.pow(decimals as u32);
            let sign = if n % 2 == 1 { "-" } else { "" };
            assert_eq!(text, format!("{sign}{}.{:0decimals$}", value / ten, value % ten));
        }
        let mut text = std::string::String::new();
        write_integer(&mut text, i64::MIN).unwrap();
        write_integer(&mut text, 0).unwrap();
        assert_eq!(text, "-92233720368547758080");
    }

    #[test]
    fn answers_have_three_and_eight_decimals() {
        assert_eq!(Formatted { value: -1_500, unit: Unit::LENGTH }.to_string(), "-1.500");
        assert_eq!(Formatted { value: 17_453_293, unit: Unit::ANGLE }.to_string(), "1.00000003");
        assert_eq!(Formatted { value: -1, unit: Unit::ANGLE }.to_string(), "-0.00000006");
    }
}
