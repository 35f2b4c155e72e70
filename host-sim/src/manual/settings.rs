//! Range and default of every setting, asked of a live controller.

use crate::machine::Machine;
use crate::session::power_up;
use stage_controller::controller::front::Front;
use stage_controller::scpi::session::Session;
use stage_controller::scpi::tree::{Entry, Kind, TABLE};
use stage_controller::units::Axis;
use std::fmt::Write;
use std::ops::RangeInclusive;

/// One link to a controller that holds the calibration of the paper's machine.
struct Live {
    front: Front,
    session: Session,
}

impl Live {
    fn new() -> Self {
        let front = power_up(&Machine::paper(), true).expect("the paper's machine can be calibrated");
        Live { front, session: Session::new(0) }
    }

    fn ask(&mut self, query: &str) -> String {
        self.session.receive(query.as_bytes());
        self.session.receive(b"\n");
        self.session.poll(&mut self.front);
        let mut answer = [0; 256];
        let length = self.session.transmit(&mut answer);
        let text = String::from_utf8_lossy(&answer[..length]).trim_end().to_owned();
        assert!(!text.is_empty(), "{query} has no answer");
        text
    }

    /// Least, most and default of a setting; `#` in the header is the axis.
    fn range(&mut self, entry: &Entry, axis: Axis) -> [String; 3] {
        let header: String = entry.pattern.chars().filter(|c| !"[]".contains(*c)).collect();
        let header = header.replace('#', &(axis.index() + 1).to_string());
        ["MIN", "MAX", "DEF"].map(|which| self.ask(&format!("{header}? {which}")))
    }
}

/// A setting answers `MIN`, `MAX` and `DEF`.
fn is_setting(entry: &Entry) -> bool {
    entry.query_params.iter().any(|param| param.kind == Kind::Extreme)
}

/// Unit of a setting's answer for an axis.
fn unit(entry: &Entry, axis: Axis) -> &'static str {
    let unit = entry.params.first().map_or("", |param| param.kind.unit());
    match unit.split_once(" or ") {
        Some((linear, rotary)) => {
            if axis.is_rotary() {
                rotary
            } else {
                linear
            }
        }
        None => unit,
    }
}

/// Axes as the table names them.
fn axes(pattern: &str, range: &RangeInclusive<usize>) -> String {
    let (first, last) = (range.start() + 1, range.end() + 1);
    let number = if first == last { first.to_string() } else { format!("{first}…{last}") };
    let all = if pattern.starts_with("SENS") { ((1, 2), "<ch>") } else { ((1, 6), "<n>") };
    pattern.replace('#', &if (first, last) == all.0 { all.1.to_owned() } else { number })
}

/// The table of all settings.
pub fn table() -> String {
    let mut live = Live::new();
    let mut text = String::from("| Setting | Unit | MIN | MAX | DEF |\n|---|---|---|---|---|\n");
    for entry in TABLE.iter().filter(|entry| is_setting(entry)) {
        let per_axis = if entry.pattern.contains('#') {
            &Axis::ALL[..usize::from(*entry.numbers().end())]
        } else {
            &Axis::ALL[..1]
        };
        let mut rows: Vec<(RangeInclusive<usize>, &str, [String; 3])> = Vec::new();
        for (n, axis) in per_axis.iter().enumerate() {
            let (unit, range) = (unit(entry, *axis), live.range(entry, *axis));
            match rows.last_mut() {
                Some((numbers, u, r)) if *u == unit && *r == range => *numbers = *numbers.start()..=n,
                _ => rows.push((n..=n, unit, range)),
            }
        }
        for (numbers, unit, [least, most, default]) in rows {
            let setting = axes(entry.pattern, &numbers);
            let _ = writeln!(text, "| `{setting}` | {unit} | {least} | {most} | {default} |");
        }
    }
    text
}
