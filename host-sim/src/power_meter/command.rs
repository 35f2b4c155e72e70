//! What a unit of a message says.

use super::error::Entry;
use crate::bench_twin::Sees;
use stage_controller::scpi::tree::is_keyword;

/// Fibres that the switch reaches.
const FIBRES: usize = 8;

/// A command or query.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Command {
    Identify,
    Clear,
    Reset,
    SelfTest,
    SetComplete,
    Complete,
    Wait,
    EventStatus,
    EventEnable,
    SetEventEnable(u8),
    ServiceEnable,
    SetServiceEnable(u8),
    StatusByte,
    NextError,
    ErrorCount,
    Version,
    /// Channels (0, 1) in the order of the answer.
    Read(Vec<usize>),
    Route(usize, Sees),
    Routed(usize),
}

/// Nodes of a header that a path carries over.
pub(super) type Path = Vec<String>;

impl Command {
    /// Reads a unit; `path` is where the one before it was.
    pub fn parse(unit: &str, path: &mut Path) -> Result<Self, Entry> {
        let (header, rest) = unit.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((unit, ""));
        let parameters = parameters(rest);
        let parameters: Vec<&str> = parameters.iter().map(String::as_str).collect();
        if header.starts_with('*') {
            return common(header, &parameters);
        }
        let (bare, query) = header.strip_suffix('?').map_or((header, false), |bare| (bare, true));
        let mut nodes = if bare.starts_with(':') { Path::new() } else { path.clone() };
        nodes.extend(bare.trim_start_matches(':').split(':').map(String::from));
        let is = |pattern: &[&str]| {
            pattern.len() == nodes.len()
                && pattern.iter().zip(&nodes).all(|(own, node)| is_keyword(own, node.as_bytes()))
        };
        let command = if query && (is(&["READ", "POWer"]) || is(&["READ"])) {
            match parameters[..] {
                [] => Ok(Command::Read(vec![0, 1])),
                [list] => channels(list).map(Command::Read),
                [_, more, ..] => Err(Entry::new(-108, more)),
            }
        } else if is(&["ROUTe", "CLOSe"]) {
            match parameters[..] {
                [channel] if query => self::channel(channel).map(Command::Routed),
                [channel, light] if !query => Ok(Command::Route(self::channel(channel)?, sees(light)?)),
                [_, more, ..] if query => Err(Entry::new(-108, more)),
                [_, _, more, ..] => Err(Entry::new(-108, more)),
                _ => Err(Entry::new(
                    -109,
                    format!("{header} needs a channel{}", if query { "" } else { " and its light" }),
                )),
            }
        } else if query && (is(&["SYSTem", "ERRor"]) || is(&["SYSTem", "ERRor", "NEXT"])) {
            alone(Command::NextError, &parameters)
        } else if query && is(&["SYSTem", "ERRor", "COUNt"]) {
            alone(Command::ErrorCount, &parameters)
        } else if query && is(&["SYSTem", "VERSion"]) {
            alone(Command::Version, &parameters)
        } else {
            Err(Entry::new(-113, header))
        }?;
        nodes.pop();
        *path = nodes;
        Ok(command)
    }
}

/// Parts between commas that stand in no brackets.
fn parameters(text: &str) -> Vec<String> {
    let (mut parts, mut depth) = (vec![String::new()], 0_usize);
    for c in text.chars() {
        match c {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        match parts.last_mut() {
            Some(part) if c != ',' || depth > 0 => part.push(c),
            _ => parts.push(String::new()),
        }
    }
    let parts: Vec<String> = parts.iter().map(|part| part.trim().to_owned()).collect();
    if parts == [""] { Vec::new() } else { parts }
}

fn alone(command: Command, parameters: &[&str]) -> Result<Command, Entry> {
    parameters.first().map_or(Ok(command), |more| Err(Entry::new(-108, *more)))
}

fn common(header: &str, parameters: &[&str]) -> Result<Command, Entry> {
    let byte = || match *parameters {
        [number] => whole(number, "0 to 255")
            .and_then(|n| u8::try_from(n).map_err(|_| Entry::new(-222, format!("{header} {number}; 0 to 255")))),
        [] => Err(Entry::new(-109, format!("{header} needs a number"))),
        [_, more, ..] => Err(Entry::new(-108, more)),
    };
    let command = match header.to_ascii_uppercase().as_str() {
        "*ESE" => return byte().map(Command::SetEventEnable),
        "*SRE" => return byte().map(Command::SetServiceEnable),
        "*IDN?" => Command::Identify,
        "*CLS" => Command::Clear,
        "*RST" => Command::Reset,
        "*TST?" => Command::SelfTest,
        "*OPC" => Command::SetComplete,
        "*OPC?" => Command::Complete,
        "*WAI" => Command::Wait,
        "*ESR?" => Command::EventStatus,
        "*ESE?" => Command::EventEnable,
        "*SRE?" => Command::ServiceEnable,
        "*STB?" => Command::StatusByte,
        _ => return Err(Entry::new(-113, header)),
    };
    alone(command, parameters)
}

fn whole(text: &str, range: &str) -> Result<i64, Entry> {
    match text.parse::<f64>() {
        Ok(number) if number.fract() == 0.0 && number.abs() < 1e15 => Ok(number as i64),
        Ok(_) => Err(Entry::new(-222, format!("{text}; whole numbers, {range}"))),
        Err(_) => Err(Entry::new(-104, format!("{text:?} is no number"))),
    }
}

fn channel(text: &str) -> Result<usize, Entry> {
    match whole(text, "1 or 2")? {
        n @ 1..=2 => Ok(n as usize - 1),
        _ => Err(Entry::new(-222, format!("channel {text}; 1 or 2"))),
    }
}

/// `(@1,2)`, `(@1:2)`.
fn channels(text: &str) -> Result<Vec<usize>, Entry> {
    let inner = text.strip_prefix("(@").and_then(|text| text.strip_suffix(')'));
    let inner = inner.ok_or_else(|| Entry::new(-104, format!("{text:?} is no channel list like (@1,2)")))?;
    let mut found = Vec::new();
    for part in inner.split(',').map(str::trim) {
        match part.split_once(':') {
            None => found.push(channel(part)?),
            Some((from, to)) => match (channel(from.trim())?, channel(to.trim())?) {
                (from, to) if from <= to => found.extend(from..=to),
                (from, to) => found.extend((to..=from).rev()),
            },
        }
    }
    // each channel has one place in an answer; a longer list is a mistake
    if found.len() > 2 { Err(Entry::new(-222, format!("{text}; each channel once"))) } else { Ok(found) }
}

fn sees(text: &str) -> Result<Sees, Entry> {
    if is_keyword("DETector", text.as_bytes()) {
        return Ok(Sees::Detector);
    }
    if is_keyword("OPEN", text.as_bytes()) {
        return Ok(Sees::Nothing);
    }
    if text.parse::<f64>().is_err() {
        return Err(Entry::new(-224, format!("{text:?}; fibre 1 to {FIBRES}, DETector or OPEN")));
    }
    match whole(text, "fibre 1 to 8")? {
        n if (1..=FIBRES as i64).contains(&n) => Ok(Sees::Fibre(n as usize - 1)),
        _ => Err(Entry::new(-222, format!("fibre {text}; 1 to {FIBRES}"))),
    }
}
