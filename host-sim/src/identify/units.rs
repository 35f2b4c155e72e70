//! Units in the names of columns and keys: `measured_um`, `noise_urad`.

use crate::machine::NRAD_PER_DEG;
use std::f64::consts::PI;

/// s; drifts are counted per hour.
pub const HOUR: f64 = 3600.0;

/// A length, kept in nm, or an angle, kept in nrad.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// nm.
    Length,
    /// nrad.
    Angle,
}

impl Quantity {
    /// Unit in which values are kept.
    pub fn unit(self) -> &'static str {
        match self {
            Quantity::Length => "nm",
            Quantity::Angle => "nrad",
        }
    }

    /// Units that columns and keys may end with.
    pub fn suffixes(self) -> &'static str {
        match self {
            Quantity::Length => "_nm, _um, _mm",
            Quantity::Angle => "_nrad, _urad, _mrad, _rad, _arcsec, _deg",
        }
    }
}

/// A unit by its suffix: quantity and size in nm or nrad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// As it stands behind the last underscore.
    pub name: &'static str,
    /// What it measures.
    pub quantity: Quantity,
    /// nm or nrad.
    pub size: f64,
}

/// All units that are known.
pub const UNITS: [Unit; 9] = [
    Unit { name: "nm", quantity: Quantity::Length, size: 1.0 },
    Unit { name: "um", quantity: Quantity::Length, size: 1e3 },
    Unit { name: "mm", quantity: Quantity::Length, size: 1e6 },
    Unit { name: "nrad", quantity: Quantity::Angle, size: 1.0 },
    Unit { name: "urad", quantity: Quantity::Angle, size: 1e3 },
    Unit { name: "mrad", quantity: Quantity::Angle, size: 1e6 },
    Unit { name: "rad", quantity: Quantity::Angle, size: 1e9 },
    Unit { name: "arcsec", quantity: Quantity::Angle, size: PI / 648_000.0 * 1e9 },
    Unit { name: "deg", quantity: Quantity::Angle, size: NRAD_PER_DEG },
];

/// A number for a message: to a millionth, without zeros behind.
pub fn plain(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// Splits `measured_um` into `measured` and its unit.
pub fn split(name: &str) -> Option<(&str, Unit)> {
    let (base, suffix) = name.rsplit_once('_')?;
    UNITS.into_iter().find(|unit| unit.name == suffix).map(|unit| (base, unit))
}

/// The unit that a column labelled `written` must really have when its values are `ratio` times too large
/// (below 1: too small); none when no unit explains it.
pub fn really(written: Unit, ratio: f64) -> Option<Unit> {
    // values in a smaller unit are larger numbers
    let close = |unit: &Unit| ((written.size / unit.size) / ratio.abs()).ln().abs() < 0.25;
    UNITS.into_iter().filter(|unit| unit.quantity == written.quantity && unit.name != written.name).find(close)
}
