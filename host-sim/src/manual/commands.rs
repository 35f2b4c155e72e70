//! A section for every command.

use stage_controller::scpi::tree::{Entry, Kind, Param, TABLE};
use std::fmt::Write;

/// Groups of commands by the first node of their headers, in the order of the table.
const GROUPS: [(&str, &str); 15] = [
    ("*", "Common commands"),
    ("SYSTem", "System"),
    ("STATus", "Status registers"),
    ("AXIS", "One axis and its motor"),
    ("STOP", "Stopping"),
    ("ABORt", "Stopping"),
    ("POSE", "All axes"),
    ("VELocity", "All axes"),
    ("PIVot", "Rotation centre"),
    ("SENSe", "Light"),
    ("SCAN", "Scans"),
    ("TRACe", "Recordings"),
    ("FORMat", "Recordings"),
    ("TRIGger", "Recordings"),
    ("OUTPut", "Trigger output"),
];
/// What is in no other group.
const LAST_GROUP: &str = "Compensation";

fn group(entry: &Entry) -> &'static str {
    let title = GROUPS.iter().find(|(prefix, _)| entry.pattern.starts_with(prefix)).map(|(_, title)| *title);
    title.unwrap_or(LAST_GROUP)
}

/// All sections.
pub fn sections() -> String {
    let mut text = String::new();
    let mut titles: Vec<&str> = GROUPS.iter().map(|(_, title)| *title).chain([LAST_GROUP]).collect();
    titles.dedup();
    for title in titles {
        let _ = writeln!(text, "### {title}\n");
        for entry in TABLE.iter().filter(|entry| group(entry) == title) {
            section(entry, &mut text);
        }
    }
    text
}

fn section(entry: &Entry, text: &mut String) {
    let header = entry.pattern.replace('#', if *entry.numbers().end() == 2 { "<ch>" } else { "<n>" });
    let _ = writeln!(text, "#### `{header}`\n\n```text");
    if entry.form.has(false) {
        let _ = writeln!(text, "{header}{}", list(entry.params));
    }
    if entry.form.has(true) {
        let _ = writeln!(text, "{header}?{}", list(entry.query_params));
    }
    let _ = writeln!(text, "```\n\n{}\n", entry.help);
    let mut names = Vec::new();
    for param in entry.params.iter().chain(entry.query_params).filter(|param| param.kind != Kind::Extreme) {
        if !names.contains(&param.name) {
            names.push(param.name);
            let _ = writeln!(text, "- `{}`: {}", param.name, describe(param));
        }
    }
    if !entry.range.is_empty() {
        let _ = writeln!(text, "- Range: {}", words(entry.range));
    }
    if !entry.default.is_empty() {
        let _ = writeln!(text, "- Default: {}", entry.default);
    }
    if !entry.errors.is_empty() {
        let errors: Vec<_> = entry.errors.iter().map(|e| format!("{} {}", e.code(), e.description())).collect();
        let _ = writeln!(text, "- Errors: {}", errors.join("; "));
    }
    let _ = writeln!(text, "- Example: `{}`\n", entry.example);
}

/// Parameters behind a header.
fn list(params: &[Param]) -> String {
    let name = |param: &Param| match param.kind {
        Kind::Extreme => "MIN|MAX|DEF".to_owned(),
        _ => format!("<{}>", param.name.replace(',', ">,<")),
    };
    let optional = |param: &Param| if param.optional { format!("[{}]", name(param)) } else { name(param) };
    let all: Vec<_> = params.iter().map(optional).collect();
    if all.is_empty() { String::new() } else { format!(" {}", all.join(",")) }
}

fn describe(param: &Param) -> String {
    let mut text = match param.kind {
        Kind::Boolean => "ON, OFF, 1 or 0".to_owned(),
        Kind::Choice(all) => all.join(", "),
        Kind::Integer(least, most) => format!("whole number {least}..{most}"),
        kind if kind.unit().is_empty() => kind.name().to_owned(),
        kind => format!("{} in {}", kind.name(), kind.unit()),
    };
    if param.extremes {
        text += "; or MIN, MAX, DEF";
    }
    text
}

/// Words between bars would be cells of a table.
fn words(range: &str) -> String {
    range.replace('|', ", ")
}
