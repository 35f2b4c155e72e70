//! Reads measurement files: comment lines with keys, a header with units, rows of numbers.

use super::fit::LEAST_NOISE;
use super::series::{Approach, Kind, Reading, Series};
use super::units::{Quantity, Unit, split};
use stage_controller::units::{AXES, Axis};
use std::collections::BTreeMap;
use std::path::Path;

/// Why a file is not taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// It cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// File or directory.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// What stands in it cannot be used.
    #[error("{file}:{line}: {reason}")]
    Line {
        /// Name of the file.
        file: String,
        /// Line, from 1.
        line: u64,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// Nothing to read.
    #[error("{path}: no measurements: no file ends in .csv")]
    Empty {
        /// The directory.
        path: String,
    },
}

/// Largest value, nm, nrad or s.
const FARTHEST: f64 = 1e15;
/// The column of times.
const TIME: &str = "time_s";

/// Keys that describe a file to people and are not used.
const NOTES: [&str; 7] = ["instrument", "date", "operator", "note", "temperature", "machine", "made by"];
const KEYS: &str = "kind, axis, direction, reference, normal, point_um, approach, order, noise_<unit>, \
                    and for people instrument, date, operator, note, temperature, machine, made by";

/// True for the name of a file that [`read_directory`] reads.
pub fn is_measurement(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}

/// Reads every file of a directory whose name ends in `.csv`, in the order of the names.
///
/// # Errors
/// The first file that cannot be read or used.
pub fn read_directory(directory: &Path, order: &[Axis; AXES]) -> Result<Vec<Series>, ReadError> {
    let io = |path: &Path| {
        let path = path.display().to_string();
        move |source| ReadError::Io { path, source }
    };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(directory).map_err(io(directory))? {
        let path = entry.map_err(io(directory))?.path();
        if is_measurement(&path) {
            paths.push(path);
        }
    }
    paths.sort();
    if paths.is_empty() {
        return Err(ReadError::Empty { path: directory.display().to_string() });
    }
    let mut all = Vec::new();
    for path in paths {
        let bytes = std::fs::read(&path).map_err(io(&path))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        all.push(parse(&name, &decode(&name, &bytes)?, order)?);
    }
    Ok(all)
}

/// The text of a file. Comments are for people and may be in any encoding; what is read must be UTF-8.
///
/// # Errors
/// Names the first line that is neither.
pub fn decode(file: &str, bytes: &[u8]) -> Result<String, ReadError> {
    let lines = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes).split(|byte| *byte == b'\n');
    for (line, content) in (1..).zip(lines) {
        if !content.trim_ascii_start().starts_with(b"#") && std::str::from_utf8(content).is_err() {
            let reason = format!("{:?} is not UTF-8; save the file as UTF-8 text", String::from_utf8_lossy(content));
            return Err(ReadError::Line { file: file.into(), line, reason });
        }
    }
    Ok(String::from_utf8_lossy(bytes).into_owned())
}

/// A comment line.
fn is_comment(line: &str) -> bool {
    line.trim_start().starts_with('#')
}

/// What to do about a field that was not taken because of what stands between the columns.
fn hint(field: &str) -> &'static str {
    if field.contains([';', '\t']) { "; separate columns by commas, with a decimal point" } else { "" }
}

/// Text of a file with its name for messages.
struct Source<'a> {
    file: &'a str,
    keys: BTreeMap<String, (u64, String)>,
}

impl Source<'_> {
    fn refuse<T>(&self, line: u64, reason: impl Into<String>) -> Result<T, ReadError> {
        Err(ReadError::Line { file: self.file.into(), line, reason: reason.into() })
    }

    fn required(&self, key: &str, why: &str) -> Result<(u64, &str), ReadError> {
        match self.keys.get(key) {
            Some((line, value)) => Ok((*line, value)),
            None => self.refuse(1, format!("no line `# {key}: ...`: {why}")),
        }
    }

    /// One of some words, or the first one when the key is absent.
    fn choice<T: Copy>(&self, key: &str, choices: &[(&str, T)]) -> Result<T, ReadError> {
        let Some((line, value)) = self.keys.get(key) else {
            return Ok(choices[0].1);
        };
        match choices.iter().find(|choice| choice.0 == value) {
            Some(choice) => Ok(choice.1),
            None => {
                let names: Vec<_> = choices.iter().map(|choice| choice.0).collect();
                self.refuse(*line, format!("{key} = {value:?}: must be one of {}", names.join(", ")))
            }
        }
    }

    fn axis(&self, line: u64, name: &str) -> Result<Axis, ReadError> {
        match Axis::ALL.into_iter().find(|axis| axis.name() == name) {
            Some(axis) => Ok(axis),
            None => self.refuse(line, format!("{name:?} is no axis: one of X, Y, Z, alpha, beta, gamma")),
        }
    }

    /// A number times its unit, no larger than any instrument shows.
    fn within(&self, line: u64, what: &str, text: &str, unit: f64) -> Result<f64, ReadError> {
        let beyond = if what == TIME { "30 million years" } else { "1000 km or 1 Mrad" };
        let value = self.number(line, what, text)? * unit;
        if value.abs() > FARTHEST {
            return self.refuse(line, format!("{what} = {text}: is beyond {beyond}"));
        }
        Ok(value)
    }

    fn number(&self, line: u64, what: &str, text: &str) -> Result<f64, ReadError> {
        match text.trim().parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(number) => self.refuse(line, format!("{what} = {number}: must be a finite number; leave out the row")),
            Err(_) => self.refuse(line, format!("{what} = {text:?}: must be a number{}", hint(text))),
        }
    }
}

/// Parses the text of one file. `order` is that of the machine, to compare with the file's own if it states one.
///
/// # Errors
/// Names the line and what is wrong there.
pub fn parse(file: &str, text: &str, order: &[Axis; AXES]) -> Result<Series, ReadError> {
    let mut source = Source { file, keys: BTreeMap::new() };
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (line, content) in (1..).zip(text.lines()) {
        let Some((key, value)) = content.trim().strip_prefix('#').and_then(|comment| comment.split_once(':')) else {
            continue;
        };
        let (key, value) = (key.trim().to_lowercase(), value.trim().to_string());
        let known = ["kind", "axis", "direction", "reference", "normal", "point_um", "approach", "order"];
        let noise = split(&key).is_some_and(|(base, _)| base == "noise");
        if !known.contains(&key.as_str()) && !noise {
            if NOTES.contains(&key.as_str()) {
                continue;
            }
            return source.refuse(line, format!("unknown key {key:?}; known are {KEYS}"));
        }
        if let Some((before, other)) = source.keys.get(&key)
            && *other != value
        {
            let reason = format!("{key} = {value:?} contradicts {other:?} in line {before}");
            return source.refuse(line, reason);
        }
        source.keys.insert(key, (line, value));
    }
    let kind = kind(&source)?;
    check_order(&source, order)?;
    let noise = noise(&source, kind)?;
    let approach = source
        .choice("approach", &[("up", Approach::Up), ("down", Approach::Down), ("sequence", Approach::Sequence)])?;
    rows(
        &source,
        text,
        Series { file: file.into(), kind, approach, noise, timed: false, units: vec![], readings: vec![] },
    )
}

fn kind(source: &Source) -> Result<Kind, ReadError> {
    let kinds = "positioning, straightness, squareness, diagonal, autocollimator, fibre or orientation";
    let (line, name) = source.required("kind", &format!("must say {kinds}"))?;
    let chip_axes = [("x", 0), ("y", 1), ("z", 2)];
    let moved = || {
        let (line, axis) = source.required("axis", "must name the axis that moves")?;
        Ok((line, source.axis(line, axis)?))
    };
    Ok(match name {
        "positioning" => Kind::Positioning(moved()?.1),
        "straightness" => {
            let (line, axis) = moved()?;
            if axis.is_rotary() {
                return source.refuse(line, format!("axis = {}: straightness is of a linear axis", axis.name()));
            }
            source.required("direction", "must say along which chip axis (x, y, z) is measured")?;
            let direction = source.choice("direction", &chip_axes)?;
            if direction == axis.index() {
                let line = source.keys["direction"].0;
                return source.refuse(line, "direction: straightness is measured across the axis, not along it");
            }
            let to_chip = source.choice("reference", &[("free", false), ("chip", true)])?;
            Kind::Straightness { axis, direction, to_chip }
        }
        "squareness" => Kind::Squareness,
        "diagonal" => Kind::Diagonal,
        "autocollimator" => {
            source.required("normal", "must say near which chip axis (x, y, z) the mirror's normal is")?;
            Kind::Autocollimator(source.choice("normal", &chip_axes)?)
        }
        "fibre" => Kind::Fibre(point(source)?),
        "orientation" => Kind::Orientation,
        _ => return source.refuse(line, format!("kind = {name:?}: must be {kinds}")),
    })
}

fn point(source: &Source) -> Result<Option<[f64; 3]>, ReadError> {
    let Some((line, text)) = source.keys.get("point_um") else {
        return Ok(None);
    };
    let parts: Vec<_> = text.split(',').collect();
    if parts.len() != 3 {
        return source.refuse(*line, format!("point_um = {text:?}: must be three numbers with commas between"));
    }
    let mut point = [0.0; 3];
    for (value, part) in point.iter_mut().zip(parts) {
        *value = source.within(*line, "point_um", part, 1e3)?;
    }
    Ok(Some(point))
}

fn check_order(source: &Source, order: &[Axis; AXES]) -> Result<(), ReadError> {
    let Some((line, text)) = source.keys.get("order") else {
        return Ok(());
    };
    let machine = order.map(Axis::name);
    let written: Vec<_> = text.split(|c: char| c == ',' || c.is_whitespace()).filter(|s| !s.is_empty()).collect();
    for name in &written {
        source.axis(*line, name)?;
    }
    if written != machine {
        let reason = format!(
            "contradictory gauge: order {} here, {} in the nominal machine; give the machine that was measured",
            written.join(" "),
            machine.join(" ")
        );
        return source.refuse(*line, reason);
    }
    Ok(())
}

fn noise(source: &Source, kind: Kind) -> Result<Option<f64>, ReadError> {
    let mut stated: Option<(u64, f64)> = None;
    for (key, (line, text)) in &source.keys {
        let Some(("noise", unit)) = split(key) else { continue };
        if unit.quantity != kind.quantity() {
            let reason = format!("{key}: this kind is read in {}", kind.quantity().suffixes());
            return source.refuse(*line, reason);
        }
        let value = source.within(*line, key, text, unit.size)?;
        if value < LEAST_NOISE {
            let reason =
                format!("{key} = {text}: must be positive, at least 1 pm or 1 prad; leave the line out if unknown");
            return source.refuse(*line, reason);
        }
        if let Some((other, _)) = stated {
            return source.refuse(*line, format!("{key}: the noise is already stated in line {other}"));
        }
        stated = Some((*line, value));
    }
    Ok(stated.map(|(_, value)| value))
}

/// What a column is for.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Column {
    Motor(Axis),
    Target,
    Run,
    Direction,
    Line,
    Pair,
    Time,
    Value(usize),
}

/// Columns of a kind besides the values: name, use, quantity if it carries a unit, whether it must be there.
fn expected(kind: Kind) -> Vec<(String, Column, Option<Quantity>, bool)> {
    let mut columns = Vec::new();
    let along = |axis: Axis| Some(if axis.is_rotary() { Quantity::Angle } else { Quantity::Length });
    match kind {
        Kind::Positioning(axis) | Kind::Straightness { axis, .. } => {
            columns.push(("target".into(), Column::Target, along(axis), true));
            columns.push(("run".into(), Column::Run, None, true));
            columns.push(("direction".into(), Column::Direction, None, true));
        }
        Kind::Squareness => columns.push(("pair".into(), Column::Pair, None, true)),
        Kind::Diagonal => columns.push(("line".into(), Column::Line, None, true)),
        Kind::Autocollimator(_) | Kind::Fibre(_) | Kind::Orientation => {}
    }
    if matches!(kind, Kind::Diagonal | Kind::Autocollimator(_) | Kind::Fibre(_) | Kind::Orientation) {
        for axis in Axis::ALL {
            columns.push((format!("at_{}", axis.name()), Column::Motor(axis), along(axis), false));
        }
    }
    if kind != Kind::Squareness {
        columns.push((TIME.into(), Column::Time, None, false));
    }
    for (index, name) in kind.columns().iter().enumerate() {
        columns.push((name.to_string(), Column::Value(index), Some(kind.quantity()), true));
    }
    columns
}

fn rows(source: &Source, text: &str, mut series: Series) -> Result<Series, ReadError> {
    // comments begin as they do for the keys; a record's own position would be where the comments before it begin
    let content: Vec<(u64, &str)> =
        (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty() && !is_comment(line)).collect();
    let body: String = content.iter().flat_map(|(_, line)| [line, "\n"]).collect();
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).has_headers(false).flexible(true).from_reader(body.as_bytes());
    let mut lines = content.iter().map(|(number, _)| *number);
    let mut records = reader.records();
    let mut next = || -> Result<Option<(u64, csv::StringRecord)>, ReadError> {
        let Some(line) = lines.next() else { return Ok(None) };
        match records.next() {
            None => Ok(None),
            Some(Ok(record)) => Ok(Some((line, record))),
            Some(Err(error)) => source.refuse(line, format!("not CSV: {error}")),
        }
    };
    let Some((header_line, header)) = next()? else {
        return source.refuse(1, "no header with the names of the columns");
    };
    let (columns, units) = columns(source, header_line, &header, series.kind)?;
    series.timed = columns.iter().any(|(column, _)| *column == Column::Time);
    series.units = units;
    while let Some((line, record)) = next()? {
        if record.len() != columns.len() {
            let hint = record.iter().map(hint).find(|hint| !hint.is_empty()).unwrap_or_default();
            let reason =
                format!("{} fields, the header in line {header_line} has {}{hint}", record.len(), columns.len());
            return source.refuse(line, reason);
        }
        let mut reading =
            Reading { line, motors: [0.0; AXES], down: false, run: 0, pair: None, time_s: 0.0, values: [0.0; 3] };
        for ((column, size), (field, name)) in columns.iter().zip(record.iter().zip(&header)) {
            let number = || source.within(line, name, field, *size);
            match *column {
                Column::Motor(axis) => reading.motors[axis.index()] = number()?,
                Column::Target => {
                    let (Kind::Positioning(axis) | Kind::Straightness { axis, .. }) = series.kind else { continue };
                    reading.motors[axis.index()] = number()?;
                }
                Column::Run | Column::Line => match field.parse() {
                    Ok(run) => reading.run = run,
                    Err(_) => return source.refuse(line, format!("{name} = {field:?}: must be a whole number")),
                },
                Column::Direction => match field {
                    "up" => reading.down = false,
                    "down" => reading.down = true,
                    _ => return source.refuse(line, format!("direction = {field:?}: must be up or down")),
                },
                Column::Pair => reading.pair = Some(pair(source, line, field)?),
                Column::Time => reading.time_s = number()?,
                Column::Value(index) => reading.values[index] = number()?,
            }
        }
        series.readings.push(reading);
    }
    if series.readings.is_empty() {
        return source.refuse(header_line, "too few points: no row behind the header");
    }
    let start = series.readings[0].time_s;
    for k in 0..series.readings.len() {
        let reading = &mut series.readings[k];
        reading.time_s -= start;
        let (line, now) = (reading.line, reading.time_s);
        if k > 0 && now < series.readings[k - 1].time_s {
            return source.refuse(line, "time_s goes back: rows must stand in the order in which they were measured");
        }
    }
    Ok(series)
}

type Columns = (Vec<(Column, f64)>, Vec<Unit>);

fn columns(source: &Source, line: u64, header: &csv::StringRecord, kind: Kind) -> Result<Columns, ReadError> {
    let expected = expected(kind);
    let mut columns = Vec::new();
    let mut units = vec![None; kind.columns().len()];
    for name in header {
        let found = expected.iter().find_map(|(base, column, quantity, _)| match (quantity, split(name)) {
            (None, _) if name == base => Some(Ok((*column, 1.0, None))),
            (Some(quantity), Some((stem, unit))) if stem == base => Some(if unit.quantity == *quantity {
                Ok((*column, unit.size, Some(unit)))
            } else {
                Err(format!("column {name}: must end in one of {}", quantity.suffixes()))
            }),
            (Some(quantity), _) if name == base => {
                Some(Err(format!("column {name}: has no unit, must end in one of {}", quantity.suffixes())))
            }
            _ => None,
        });
        let (column, size, unit) = match found {
            Some(Ok(found)) => found,
            Some(Err(reason)) => return source.refuse(line, reason),
            None => {
                let names: Vec<_> = expected.iter().map(written).collect();
                let (kind, names) = (kind.name(), names.join(", "));
                let reason = format!("unknown column {name:?}{}; {kind} files have {names}", hint(name));
                return source.refuse(line, reason);
            }
        };
        if columns.iter().any(|(other, _)| *other == column) {
            return source.refuse(line, format!("column {name:?} stands there twice"));
        }
        if let Column::Value(index) = column {
            units[index] = unit;
        }
        columns.push((column, size));
    }
    for column in &expected {
        if column.3 && !columns.iter().any(|(found, _)| *found == column.1) {
            return source.refuse(line, format!("missing column {}", written(column)));
        }
    }
    Ok((columns, units.into_iter().flatten().collect()))
}

/// A column with the unit in which the documents write it.
fn written((base, column, quantity, _): &(String, Column, Option<Quantity>, bool)) -> String {
    match quantity {
        None => base.clone(),
        Some(Quantity::Angle) if matches!(column, Column::Motor(_) | Column::Target) => format!("{base}_deg"),
        Some(Quantity::Length) => format!("{base}_um"),
        Some(Quantity::Angle) => format!("{base}_urad"),
    }
}

fn pair(source: &Source, line: u64, field: &str) -> Result<(Axis, Axis), ReadError> {
    let mut names = field.chars().map(|c| c.to_string());
    let (Some(a), Some(b), None) = (names.next(), names.next(), names.next()) else {
        return source.refuse(line, format!("pair = {field:?}: must be two linear axes such as XY"));
    };
    let (a, b) = (source.axis(line, &a)?, source.axis(line, &b)?);
    if a == b {
        return source.refuse(line, format!("pair = {field:?}: must be two different axes"));
    }
    Ok((a, b))
}
