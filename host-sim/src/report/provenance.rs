//! The section that says what the page was made from.

use super::page::Section;
use crate::machine::Machine;
use maud::html;
use serde::Serialize;

/// What the figures were made from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Provenance {
    /// Name of the machine.
    pub machine: String,
    /// Name of its file, without folders: the same file gives the same page wherever it lies.
    pub file: String,
    /// CRC-32 of the calibration block, what `COMP:CRC?` answers; none when there is no block.
    pub block_crc: Option<u32>,
    /// Version of this tool.
    pub version: &'static str,
    /// The date as it was given; the page looks at no clock.
    pub date: Option<String>,
}

impl Provenance {
    pub(super) fn new(machine: &Machine, file: &str, date: Option<&str>, block_crc: Option<u32>) -> Self {
        Provenance {
            machine: machine.name.clone(),
            file: file.into(),
            block_crc,
            version: env!("CARGO_PKG_VERSION"),
            date: date.map(Into::into),
        }
    }

    /// The CRC as the controller and `calibrate` write it.
    pub(super) fn crc(&self) -> String {
        self.block_crc.map_or("none".into(), |crc| format!("{crc} (0x{crc:08X})"))
    }
}

pub(super) fn section(provenance: &Provenance) -> Section {
    let body = html! {
        table.plain {
            tbody {
                tr { th { "Machine" } td.left { (provenance.machine) } }
                tr { th { "Machine file" } td.left { (provenance.file) } }
                tr { th { "CRC-32 of the calibration block" } td.left { (provenance.crc()) ", as COMP:CRC? answers it" } }
                tr { th { "Made by" } td.left { "host-sim " (provenance.version) } }
                tr { th { "Date" } td.left { (provenance.date.as_deref().unwrap_or("not given")) } }
            }
        }
        p.note {
            "Every number on this page was computed from the machine file, in the section on the paper from the inputs that it prints. The same figures as one JSON object: host-sim \
            report with --json. Method: docs/LAW.md of the project, after doi 10.1177/1687814015589503."
        }
    };
    Section { id: "provenance", title: "Where this page comes from", body }
}
