//! A table of text, as Markdown or as CSV.

use super::Failure;
use super::common::{say, say_json};
use crate::machine::{FARTHEST_UM, LARGEST_KINEMATIC_UM, LARGEST_STATIC};

/// A titled table.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    title: String,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Sheet {
    /// An empty table with the names of its columns.
    pub fn new<T: ToString>(title: impl Into<String>, header: impl IntoIterator<Item = T>) -> Self {
        Sheet { title: title.into(), header: header.into_iter().map(|h| h.to_string()).collect(), rows: Vec::new() }
    }

    /// Adds a row; as many cells as there are columns.
    pub fn row<T: ToString>(&mut self, cells: impl IntoIterator<Item = T>) {
        let cells: Vec<String> = cells.into_iter().map(|cell| cell.to_string()).collect();
        assert_eq!(cells.len(), self.header.len(), "a cell for each column of {}", self.title);
        self.rows.push(cells);
    }

    /// As Markdown, columns aligned for a reader in a terminal.
    pub fn markdown(&self) -> String {
        let width = |c: usize| {
            let cells = self.rows.iter().map(|row| row[c].chars().count());
            cells.chain([self.header[c].chars().count(), 3]).max().unwrap_or(3)
        };
        let widths: Vec<usize> = (0..self.header.len()).map(width).collect();
        let line = |cells: &[String]| {
            let padded: Vec<String> = cells.iter().zip(&widths).map(|(cell, w)| format!("{cell:<w$}")).collect();
            format!("| {} |\n", padded.join(" | "))
        };
        let rule: Vec<String> = widths.iter().map(|w| "-".repeat(*w)).collect();
        let body: String = self.rows.iter().map(|row| line(row)).collect();
        format!("## {}\n\n{}{}{body}", self.title, line(&self.header), line(&rule))
    }

    /// As CSV (RFC 4180), the title in the first column of each row.
    pub fn csv(&self) -> Result<String, Failure> {
        let failed = |reason: String| Failure::Refused(format!("{}: {reason}", self.title));
        let mut writer = csv::Writer::from_writer(Vec::new());
        let titled = |cells: &[String], first: &str| -> Vec<String> {
            std::iter::once(first.to_string()).chain(cells.iter().cloned()).collect()
        };
        writer.write_record(titled(&self.header, "table")).map_err(|e| failed(e.to_string()))?;
        for row in &self.rows {
            writer.write_record(titled(row, &self.title)).map_err(|e| failed(e.to_string()))?;
        }
        let bytes = writer.into_inner().map_err(|e| failed(e.to_string()))?;
        String::from_utf8(bytes).map_err(|e| failed(e.to_string()))
    }
}

/// How a result is printed.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Style {
    /// Print one JSON object instead of Markdown tables.
    #[arg(long, conflicts_with = "csv")]
    json: bool,
    /// Print CSV instead of Markdown tables, one table after the other with a blank line between.
    #[arg(long)]
    csv: bool,
}

impl Style {
    /// Prints a result in this style; `sheets` are only made when needed.
    pub fn print(&self, result: &impl serde::Serialize, sheets: impl FnOnce() -> Vec<Sheet>) -> Result<(), Failure> {
        if self.json {
            return say_json(result);
        }
        let texts: Vec<String> = sheets()
            .iter()
            .map(|sheet| if self.csv { sheet.csv() } else { Ok(sheet.markdown()) })
            .collect::<Result<_, _>>()?;
        say(texts.join("\n").trim_end())
    }
}

/// So many finite numbers, written `1,2,3`.
pub fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Vec<f64> = text.split(',').map(finite).collect::<Result<_, _>>()?;
    numbers.try_into().map_err(|_| format!("{text:?} is not {N} numbers with commas between"))
}

/// A point, um, as far from home as a machine file may say.
pub fn three(text: &str) -> Result<[f64; 3], String> {
    let point: [f64; 3] = numbers(text)?;
    match point.into_iter().find(|v| v.abs() > FARTHEST_UM) {
        Some(far) => Err(format!("{far} um is farther than {FARTHEST_UM} um")),
        None => Ok(point),
    }
}

/// A finite number.
pub fn finite(text: &str) -> Result<f64, String> {
    let number: f64 = text.trim().parse().map_err(|_| format!("{text:?} is not a number"))?;
    if number.is_finite() { Ok(number) } else { Err(format!("{text:?} is not finite")) }
}

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    finite(text).and_then(|v| if v > 0.0 { Ok(v) } else { Err(format!("{text:?} is not above zero")) })
}

/// Size of a displacement error, um.
fn error_um(text: &str) -> Result<f64, String> {
    believed(text, LARGEST_KINEMATIC_UM, "um")
}

/// Size of an angular error, urad.
fn error_urad(text: &str) -> Result<f64, String> {
    believed(text, LARGEST_STATIC * 1e6, "urad")
}

/// A size that a machine file would take as well.
fn believed(text: &str, largest: f64, unit: &str) -> Result<f64, String> {
    match finite(text)? {
        value if value.abs() <= largest => Ok(value),
        value => Err(format!("{value:e} {unit} is no error of a stage: at most {largest} {unit} is believed")),
    }
}

/// Sizes of errors, where the machine's own are not used.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Sizes {
    /// Displacement error of a stage or mount, um, at most 200 either way.
    #[arg(long, value_name = "UM", default_value = "0.3", value_parser = error_um, allow_negative_numbers = true)]
    error_um: f64,
    /// Rotation error of a stage or mount, urad, at most 20000 either way.
    #[arg(long, value_name = "URAD", default_value = "50", value_parser = error_urad, allow_negative_numbers = true)]
    error_urad: f64,
    /// Each of the nine static angular errors, urad, at most 20000 either way.
    #[arg(long, value_name = "URAD", default_value = "50", value_parser = error_urad, allow_negative_numbers = true)]
    static_urad: f64,
}

impl From<Sizes> for crate::model::Magnitudes {
    fn from(sizes: Sizes) -> Self {
        crate::model::Magnitudes {
            linear_um: sizes.error_um,
            angular_rad: sizes.error_urad / 1e6,
            squareness_rad: sizes.static_urad / 1e6,
        }
    }
}
