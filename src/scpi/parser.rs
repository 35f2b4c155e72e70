//! A message into calls: units at `;`, headers against the tree with the path carried over, parameters at commas.

use crate::error::{Error, ErrorNumber};
use crate::scpi::lexer::{Class, Framer, is_space};
use crate::scpi::params::Params;
use crate::scpi::tree::{self, Command, Header};
use crate::units::Axis;
use heapless::Vec;

/// Most nodes of a header, the carried path included.
const DEPTH: usize = 8;

/// The path that the next unit begins at: places of its nodes in the message (SCPI-99 volume 1, 6.2.4).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Path(Vec<(u16, u16), DEPTH>);

impl Path {
    /// The root.
    pub const fn new() -> Self {
        Path(Vec::new())
    }
}

/// One unit of a message, ready to be executed.
#[derive(Clone, Copy, Debug)]
pub struct Call<'m> {
    /// Which command.
    pub command: Command,
    /// The number in the header, 1..6, where the pattern has one.
    pub suffix: Option<u8>,
    /// The query form.
    pub query: bool,
    /// Its parameters, as many as the table allows; copy it and take one after the other.
    pub params: Params<'m>,
}

impl Call<'_> {
    /// The axis of the header; X where the pattern has none.
    pub fn axis(&self) -> Axis {
        self.suffix.and_then(|n| Axis::from_index(usize::from(n).checked_sub(1)?)).unwrap_or(Axis::X)
    }
}

/// What [`next_unit`] finds.
#[derive(Clone, Debug)]
pub struct Unit<'m> {
    /// The call, or why there is none.
    pub call: Result<Call<'m>, Error>,
    /// Where the next unit begins.
    pub next: usize,
    /// The path for the next unit.
    pub path: Path,
}

/// The unit at or after `at`; None at the end. Empty units are skipped.
#[inline(never)]
pub fn next_unit<'m>(message: &'m [u8], mut at: usize, path: &Path) -> Option<Unit<'m>> {
    loop {
        let rest = message.get(at..).filter(|rest| !rest.is_empty())?;
        let (length, fault) = unit_length(rest);
        let text = rest.get(..length)?;
        let next = at + length + 1;
        let lead = text.iter().take_while(|byte| is_space(**byte)).count();
        if lead == text.len() {
            at = next;
            continue;
        }
        let mut path = path.clone();
        let call = text
            .get(lead..)
            .ok_or(ErrorNumber::SyntaxError.into())
            .and_then(|text| parse(message, at + lead, text, fault, &mut path));
        return Some(Unit { call, next, path });
    }
}

/// Length up to the `;` or the end, and what is wrong at the end.
fn unit_length(rest: &[u8]) -> (usize, Option<ErrorNumber>) {
    let mut framer = Framer::inside();
    for (n, byte) in rest.iter().enumerate() {
        if framer.step(*byte) == Class::Text && *byte == b';' {
            return (n, None);
        }
    }
    let fault = if framer.in_string() {
        Some(ErrorNumber::InvalidStringData)
    } else if framer.in_block() {
        Some(ErrorNumber::InvalidBlockData)
    } else {
        None
    };
    (rest.len(), fault)
}

#[inline(never)]
fn parse<'m>(
    message: &'m [u8],
    start: usize,
    text: &'m [u8],
    fault: Option<ErrorNumber>,
    path: &mut Path,
) -> Result<Call<'m>, Error> {
    let header_length = text.iter().position(|byte| is_space(*byte)).unwrap_or(text.len());
    let (header, params) = text.split_at_checked(header_length).ok_or(ErrorNumber::SyntaxError)?;
    check_header(header)?;
    let (name, query) = match header {
        [name @ .., b'?'] => (name, true),
        name => (name, false),
    };
    let (entry, suffix) = find(message, start, name, query, path).map_err(|number| Error::token(number, header))?;
    if let Some(number) = fault {
        return Err(Error::token(number, params.trim_ascii()));
    }
    let params = Params::new(params)?;
    let (least, most) = entry.arity(query);
    let count = params.count();
    if count < least {
        return Err(Error::token(ErrorNumber::MissingParameter, header));
    }
    if count > most {
        return Err(params.nth_error(most, ErrorNumber::ParameterNotAllowed));
    }
    Ok(Call { command: entry.command, suffix, query, params })
}

fn check_header(header: &[u8]) -> Result<(), Error> {
    for byte in header {
        let number = match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'_' | b':' | b'*' | b'?' => continue,
            b'!'..=b'~' => ErrorNumber::SyntaxError,
            _ => ErrorNumber::InvalidCharacter,
        };
        return Err(Error::token(number, header));
    }
    Ok(())
}

/// The entry of a header; on success `path` is the one for the next unit.
fn find(
    message: &[u8],
    start: usize,
    name: &[u8],
    query: bool,
    path: &mut Path,
) -> Result<(&'static Header, Option<u8>), ErrorNumber> {
    let common = name.first() == Some(&b'*');
    let rooted = name.first() == Some(&b':');
    let mut places = if common || rooted { Vec::new() } else { path.0.clone() };
    let mut at = start + usize::from(rooted);
    for node in name.get(usize::from(rooted)..).unwrap_or(&[]).split(|byte| *byte == b':') {
        if node.is_empty() || node.contains(&b'?') {
            return Err(ErrorNumber::SyntaxError);
        }
        let place = (at as u16, node.len() as u16);
        places.push(place).map_err(|_| ErrorNumber::UndefinedHeader)?;
        at += node.len() + 1;
    }
    let mut nodes: Vec<&[u8], DEPTH> = Vec::new();
    for (at, length) in &places {
        let node = message.get(usize::from(*at)..usize::from(*at) + usize::from(*length)).unwrap_or(&[]);
        nodes.push(node).map_err(|_| ErrorNumber::UndefinedHeader)?;
    }
    let found = tree::find(&nodes, query)?;
    if !common {
        places.pop();
        path.0 = places;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    type Outcome = Result<(Command, Option<u8>, bool), ErrorNumber>;

    /// The units of a message, up to the first error.
    fn parse_all(message: &str) -> Vec<Outcome> {
        let (mut at, mut path, mut out) = (0, Path::default(), Vec::new());
        while let Some(unit) = next_unit(message.as_bytes(), at, &path) {
            let failed = unit.call.is_err();
            out.push(unit.call.map(|call| (call.command, call.suffix, call.query)).map_err(|error| error.number));
            if failed {
                break;
            }
            (at, path) = (unit.next, unit.path);
        }
        out
    }

    fn error(message: &str) -> Option<ErrorNumber> {
        parse_all(message).last().and_then(|unit| unit.err())
    }

    #[test]
    fn the_path_is_carried_over_and_a_colon_returns_to_the_root() {
        use Command::*;
        let units = parse_all("AXIS2:MOVE:ABS 1;REL 2;*CLS;jog 3; ;:stop;AXIS3:LIM:SOFT:LOW -1;UPP MAX;STAT ON;");
        let expected = [
            (AxisMove, Some(2), false),
            (AxisMoveRelative, Some(2), false),
            (ClearStatus, None, false),
            (AxisMoveJog, Some(2), false),
            (Stop, None, false),
            (AxisLimitSoftLower, Some(3), false),
            (AxisLimitSoftUpper, Some(3), false),
            (AxisLimitSoftState, Some(3), false),
        ];
        assert_eq!(units, expected.map(Ok));
    }

    #[test]
    fn separators_inside_strings_blocks_and_lists_part_nothing() {
        assert_eq!(parse_all("COMP:LOAD #15;;,\n\";:ABOR").len(), 2);
        assert_eq!(error("ABOR ';'"), Some(ErrorNumber::ParameterNotAllowed));
    }

    #[test]
    fn each_fault_of_a_unit_has_its_number() {
        use ErrorNumber::*;
        for (message, number) in [
            ("FOO", UndefinedHeader),
            ("AXIS7:FOO", UndefinedHeader),
            ("AXIS7:MOVE 1", HeaderSuffixOutOfRange),
            ("AXIS0:MOVE 1", HeaderSuffixOutOfRange),
            ("AXIS99999999999999999999:MOVE 1", HeaderSuffixOutOfRange),
            ("STAT:AXIS7?", HeaderSuffixOutOfRange),
            ("AXIS\u{e9}:MOVE 1", InvalidCharacter),
            ("AXIS1::MOVE 1", SyntaxError),
            (":", SyntaxError),
            ("?", SyntaxError),
            ("AXIS1:MOVE,1", SyntaxError),
            ("AXIS1:MOVE 1,", SyntaxError),
            ("AXIS1:MOVE ,1", SyntaxError),
            ("POSE 1,,2", SyntaxError),
            ("AXIS1:MOVE (1", SyntaxError),
            ("AXIS1:MOVE", MissingParameter),
            ("POSE 1,2,3,4,5", MissingParameter),
            ("AXIS1:MOVE 1,2", ParameterNotAllowed),
            ("*CLS 1", ParameterNotAllowed),
            ("AXIS1:MOVE? 1", UndefinedHeader),
            ("POSE:CHEC 1,2,3,4,5,6", UndefinedHeader),
            ("AXIS1:MOVE \"1", InvalidStringData),
            ("COMP:LOAD #15ab", InvalidBlockData),
            ("COMP:LOAD #", InvalidBlockData),
            ("A:B:C:D:E:F:G:H:I", UndefinedHeader),
            ("MOVE1:A", UndefinedHeader),
            ("*IDN2?", UndefinedHeader),
        ] {
            assert_eq!(error(message), Some(number), "{message}");
        }
    }

    #[test]
    fn a_missing_axis_is_the_first_and_forms_mix() {
        use Command::*;
        assert_eq!(parse_all("axis:position?"), [Ok((AxisPosition, Some(1), true))]);
        assert_eq!(parse_all("STATus:OPER:EVENT?;:stat:oper?"), [Ok((OperationEvent, None, true)); 2]);
        assert_eq!(error("AXI:POS?"), Some(ErrorNumber::UndefinedHeader));
        assert_eq!(error("AXIS1:POSIT?"), Some(ErrorNumber::UndefinedHeader));
    }
}
