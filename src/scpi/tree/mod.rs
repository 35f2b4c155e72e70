//! The one table of all commands, its types and its matching. A new command is one entry and one handler.

mod kind;
mod table;

use kind::arity;
pub use kind::{Kind, Param};
pub use table::TABLE;

use crate::error::ErrorNumber;
use core::fmt::{self, Write};

/// Which command; one per entry of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Command {
    Identify,
    Reset,
    ClearStatus,
    EventEnable,
    EventStatus,
    ServiceEnable,
    StatusByte,
    OperationComplete,
    Wait,
    SelfTest,
    Options,
    Save,
    Recall,
    ErrorNext,
    ErrorCount,
    ErrorAll,
    Version,
    HelpHeaders,
    TimeTick,
    SystemPreset,
    JogTimeout,
    SystemPark,
    SerialBaud,
    EmergencyStopState,
    EmergencyStopClear,
    OperationEvent,
    OperationCondition,
    OperationEnable,
    OperationPositive,
    OperationNegative,
    OperationInstrumentEvent,
    OperationInstrumentCondition,
    OperationInstrumentEnable,
    OperationInstrumentPositive,
    OperationInstrumentNegative,
    QuestionableEvent,
    QuestionableCondition,
    QuestionableEnable,
    QuestionablePositive,
    QuestionableNegative,
    QuestionableInstrumentEvent,
    QuestionableInstrumentCondition,
    QuestionableInstrumentEnable,
    QuestionableInstrumentPositive,
    QuestionableInstrumentNegative,
    StatusPreset,
    StatusAxis,
    AxisMove,
    AxisMoveRelative,
    AxisMoveJog,
    AxisStop,
    AxisStopImmediate,
    Stop,
    Abort,
    AxisPosition,
    AxisPositionCommand,
    AxisPositionMotor,
    AxisPositionSet,
    AxisVelocity,
    AxisVelocityStart,
    AxisAcceleration,
    AxisJerk,
    AxisStepSize,
    AxisStepInvert,
    AxisStepTiming,
    AxisEnable,
    AxisEnablePolarity,
    AxisFaultPolarity,
    AxisHome,
    AxisHomeType,
    AxisHomeVelocity,
    AxisHomeOffset,
    AxisHomeState,
    AxisLimitSoftLower,
    AxisLimitSoftUpper,
    AxisLimitSoftState,
    AxisLimitHard,
    AxisLimitHardPolarity,
    AxisLimitHardState,
    AxisBacklashMode,
    AxisBacklashDistance,
    AxisBacklashVelocity,
    AxisBacklashDeadband,
    AxisBacklashMargin,
    AxisBacklashPreload,
    AxisBacklashOffset,
    AxisBacklashState,
    PoseMove,
    PoseRelative,
    PoseQuery,
    PoseCheck,
    VelocityOverride,
    PivotDefine,
    PivotSelect,
    PivotQuery,
    CompareDefine,
    CompareCount,
    CompensationState,
    CompensationCouplingState,
    CompensationPivotState,
    CompensationBacklashState,
    CompensationLoad,
    CompensationData,
    CompensationCrc,
    CompensationName,
    CompensationMatrix,
    SensePower,
    SenseRange,
    SenseAverage,
    SenseInput,
    SenseScale,
    SenseDelay,
    ScanLine,
    ScanRaster,
    ScanSpiral,
    ScanHill,
    ScanParabola,
    ScanStart,
    ScanStop,
    ScanContinue,
    ScanState,
    ScanResult,
    TraceConfigure,
    TraceArm,
    TracePoints,
    TraceData,
    Format,
    Trigger,
    TriggerSource,
}

/// Forms of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Without question mark only.
    Set,
    /// With question mark only.
    Query,
    /// Both.
    Both,
}

/// A command. What the manual says of it is not in the firmware: nobody reads it there, and there is no room for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Which.
    pub command: Command,
    /// Header: capitals are the short form, `[]` may be left out, `#` is an axis number 1..6.
    pub pattern: &'static str,
    /// Its forms.
    pub form: Form,
    /// Fewest and most parameters without question mark, and of the query.
    arity: [(u8, u8); 2],
    /// Parameters without question mark, for the manual.
    #[cfg(not(target_os = "none"))]
    pub params: &'static [Param],
    /// Parameters of the query, for the manual.
    #[cfg(not(target_os = "none"))]
    pub query_params: &'static [Param],
    /// Range for the manual.
    #[cfg(not(target_os = "none"))]
    pub range: &'static str,
    /// Default for the manual.
    #[cfg(not(target_os = "none"))]
    pub default: &'static str,
    /// Errors that it raises beside those of syntax, for the manual.
    #[cfg(not(target_os = "none"))]
    pub errors: &'static [ErrorNumber],
    /// One line, for the manual.
    #[cfg(not(target_os = "none"))]
    pub help: &'static str,
    /// A line that works, for the manual.
    #[cfg(not(target_os = "none"))]
    pub example: &'static str,
}

impl Entry {
    /// Fewest and most parameters.
    pub fn arity(&self, query: bool) -> (usize, usize) {
        let (least, most) = self.arity[usize::from(query)];
        (least.into(), most.into())
    }

    /// Numbers that its header may have in place of `#`: of axes, or of power inputs.
    pub fn numbers(&self) -> core::ops::RangeInclusive<u8> {
        1..=if self.pattern.starts_with("SENS") { 2 } else { 6 }
    }

    /// True when the form exists.
    pub const fn has(&self, query: bool) -> bool {
        match self.form {
            Form::Set => !query,
            Form::Query => query,
            Form::Both => true,
        }
    }
}

impl Entry {
    /// Writes its line of SYSTem:HELP:HEADers? (SCPI-99 volume 2, 21.11), the LF included.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut dyn Write) -> fmt::Result {
        let form = match self.form {
            Form::Set => "/nquery/\n",
            Form::Query => "/qonly/\n",
            Form::Both => "\n",
        };
        if !self.pattern.starts_with('*') {
            to.write_str(":")?;
        }
        to.write_str(self.pattern)?;
        to.write_str(form)
    }
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f)
    }
}

/// Bytes of all lines of SYSTem:HELP:HEADers?.
pub fn help_length() -> usize {
    struct Count(usize);
    impl Write for Count {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.0 += text.len();
            Ok(())
        }
    }
    let mut count = Count(0);
    for entry in TABLE {
        let _ = entry.write(&mut count);
    }
    count.0
}

/// The entry of a header and the number in it.
///
/// # Errors
/// -113 unknown, or not in this form; -114 an axis that does not exist.
pub fn find(nodes: &[&[u8]], query: bool) -> Result<(&'static Entry, Option<u8>), ErrorNumber> {
    let first = nodes.first().and_then(|node| node.first()).map_or(0, u8::to_ascii_uppercase);
    // a header that must begin with another letter: most of them, and a look at it costs little
    let begins = |entry: &&Entry| {
        matches!(entry.pattern.as_bytes(), [b'[', ..]) || entry.pattern.as_bytes().first() == Some(&first)
    };
    for entry in TABLE.iter().filter(|entry| entry.has(query)).filter(begins) {
        if let Some(suffix) = match_nodes(entry.pattern.as_bytes(), nodes) {
            return match suffix {
                None => Ok((entry, None)),
                Some(n) if entry.numbers().contains(&n) => Ok((entry, Some(n))),
                Some(_) => Err(ErrorNumber::HeaderSuffixOutOfRange),
            };
        }
    }
    Err(ErrorNumber::UndefinedHeader)
}

/// True when `text` is the long or the short form of `pattern`, in any case.
pub fn is_keyword(pattern: &str, text: &[u8]) -> bool {
    is_node(pattern.as_bytes(), text)
}

fn is_node(pattern: &[u8], text: &[u8]) -> bool {
    let short = pattern.iter().filter(|byte| !byte.is_ascii_lowercase());
    pattern.eq_ignore_ascii_case(text)
        || short.map(|byte| Some(*byte)).eq(text.iter().map(|b| Some(b.to_ascii_uppercase())))
}

/// None: no match. The suffix saturates, so that every number too large stays one.
fn match_nodes(pattern: &[u8], nodes: &[&[u8]]) -> Option<Option<u8>> {
    match pattern {
        [] => nodes.is_empty().then_some(None),
        [b':', rest @ ..] => match_nodes(rest, nodes),
        [b'[', rest @ ..] => {
            let close = rest.iter().position(|byte| *byte == b']')?;
            let (inner, rest) = (rest.get(..close)?, rest.get(close + 1..)?);
            match_node(inner.strip_prefix(b":").unwrap_or(inner), rest, nodes).or_else(|| match_nodes(rest, nodes))
        }
        _ => {
            let end = pattern.iter().position(|byte| matches!(byte, b':' | b'[')).unwrap_or(pattern.len());
            let (node, rest) = pattern.split_at_checked(end)?;
            match_node(node, rest, nodes)
        }
    }
}

fn match_node(node: &[u8], rest: &[u8], nodes: &[&[u8]]) -> Option<Option<u8>> {
    let (text, others) = nodes.split_first()?;
    let Some(name) = node.strip_suffix(b"#") else {
        return if is_node(node, text) { match_nodes(rest, others) } else { None };
    };
    let digits = text.iter().rev().take_while(|byte| byte.is_ascii_digit()).count();
    let (text, digits) = text.split_at_checked(text.len() - digits)?;
    if !is_node(name, text) {
        return None;
    }
    let number = digits.iter().fold(0u8, |n, digit| n.saturating_mul(10).saturating_add(digit - b'0'));
    match_nodes(rest, others).map(|inner| inner.or(Some(if digits.is_empty() { 1 } else { number })))
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;
    use std::vec::Vec;

    #[test]
    fn both_forms_of_a_keyword_match_and_nothing_between() {
        for (text, expected) in [("VEL", true), ("velocity", true), ("VELO", false), ("VE", false), ("", false)] {
            assert_eq!(is_keyword("VELocity", text.as_bytes()), expected, "{text}");
        }
    }

    #[test]
    fn every_entry_is_found_by_its_own_long_and_short_header() {
        for entry in TABLE {
            let long: Vec<u8> = entry.pattern.bytes().filter(|b| !b"[]#".contains(b)).collect();
            let short: Vec<u8> = long.iter().copied().filter(|b| !b.is_ascii_lowercase()).collect();
            for text in [long, short] {
                let nodes: Vec<&[u8]> = text.split(|b| *b == b':').collect();
                let found = find(&nodes, entry.form == Form::Query).map(|(found, _)| found.command);
                assert_eq!(found, Ok(entry.command), "{}", entry.pattern);
            }
        }
    }

    #[test]
    fn every_entry_is_documented_and_its_example_parses() {
        use crate::scpi::parser::{Path, next_unit};
        for entry in TABLE {
            assert!(!entry.help.is_empty() && !entry.example.is_empty(), "{}", entry.pattern);
            let unit = next_unit(entry.example.as_bytes(), 0, &Path::default()).unwrap();
            assert_eq!(unit.call.map(|call| call.command), Ok(entry.command), "{}", entry.example);
            assert!(entry.to_string().len() < 100, "a line of the help fits an answer's part");
        }
    }

    #[test]
    fn a_command_stands_once_in_the_table() {
        for (n, entry) in TABLE.iter().enumerate() {
            assert!(TABLE[n + 1..].iter().all(|other| other.command != entry.command), "{:?}", entry.command);
        }
    }
}
