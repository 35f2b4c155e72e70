//! The one table of all commands, its types and its matching. A new command is one entry and one handler.

mod headers;
mod kind;
mod table;

pub use headers::{HELP_LENGTH, Header, Walk, find};
use kind::arity;
pub use kind::{Kind, Param};
pub use table::TABLE;

#[cfg(not(target_os = "none"))]
use crate::error::ErrorNumber;

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

impl Form {
    /// True when a command of this form may be said so.
    pub const fn has(self, query: bool) -> bool {
        !matches!((self, query), (Form::Set, true) | (Form::Query, false))
    }
}

/// A command. What the manual says of it is not in the firmware: nobody reads it there, and there is no room for it;
/// the rest becomes a [`Header`].
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
    /// Numbers that its header may have in place of `#`: of axes, or of power inputs.
    pub fn numbers(&self) -> core::ops::RangeInclusive<u8> {
        numbers(self.pattern.as_bytes())
    }
}

fn numbers(pattern: &[u8]) -> core::ops::RangeInclusive<u8> {
    1..=if pattern.starts_with(b"SENS") { 2 } else { 6 }
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
    use std::string::String;
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
        }
    }

    #[test]
    fn a_walk_comes_by_every_entry_and_the_lines_of_the_help_are_as_long_as_announced() {
        let (mut walk, mut help) = (Walk::begin(), String::new());
        for entry in TABLE {
            let header = walk.step(None).unwrap();
            assert_eq!((header.command, walk.pattern()), (entry.command, entry.pattern.as_bytes()));
            let from = help.len();
            walk.write(header, &mut help).unwrap();
            assert!(help.len() - from < 100, "a line of the help fits an answer's part");
        }
        assert_eq!((walk.step(None), help.len()), (None, HELP_LENGTH));
    }

    #[test]
    fn a_command_stands_once_in_the_table() {
        for (n, entry) in TABLE.iter().enumerate() {
            assert!(TABLE[n + 1..].iter().all(|other| other.command != entry.command), "{:?}", entry.command);
        }
    }
}
