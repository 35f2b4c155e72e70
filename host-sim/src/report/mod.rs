//! The report of a stage: everything that can be computed from its machine file, on one self-contained page.
//!
//! [`Report::new`] computes all figures; [`page::render`] writes them as HTML with drawings, and serde as JSON. Every
//! number of the page carries the JSON pointer of its figure. The page needs nothing from elsewhere: no scripts, no
//! fonts, no pictures.

mod budget;
mod field;
mod number;
pub(crate) mod page;
mod paper;
pub(crate) mod plot;
mod provenance;
mod sensitivity;
mod stage;
mod travel;

pub use budget::Budget;
pub use field::Fields;
pub use number::short;
pub use page::render;
pub use provenance::Provenance;
pub use stage::StageFacts;
pub use travel::{Mode, Stage as CompensatedStage, Travel};

use crate::calibrate::calibrate;
use crate::machine::Machine;
use crate::model::{AccuracyOptions, Claim, Options, Sensitivity, paper_claims, sensitivity};
use serde::Serialize;

/// Format of the JSON; raised when a figure changes its meaning or its place.
const FORMAT: u32 = 1;

/// All figures of the page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Format of this object.
    pub format: u32,
    /// What the figures were made from.
    pub provenance: Provenance,
    /// Why the machine cannot be calibrated; then `travel` and `budget` are absent, and the fields have no "after".
    pub refusal: Option<String>,
    /// What the stage is.
    pub stage: StageFacts,
    /// Which error moves F how far.
    pub sensitivity: Sensitivity,
    /// Errors over the travel, before and after compensation.
    pub field: Fields,
    /// What each part of the compensation buys.
    pub travel: Option<Travel>,
    /// What fixed point costs.
    pub budget: Option<Budget>,
    /// The numbers that the paper prints.
    pub paper: Vec<Claim>,
}

impl Report {
    /// How often [`Report::new`] calls its `progress`: once for each accuracy field, nearly all of its time.
    pub fn progress_steps() -> u64 {
        AccuracyOptions::default().fields() as u64
    }

    /// Computes everything. `file`: the name that the page gives for the machine file; `date`: what it gives as date.
    /// `progress` is called [`Report::progress_steps`] times, by several threads.
    pub fn new(machine: &Machine, file: &str, date: Option<&str>, progress: &(dyn Fn() + Sync)) -> Self {
        let calibrated = calibrate(machine);
        let (travel, budget, crc, refusal) = match &calibrated {
            Ok((calibration, report)) => (
                Some(Travel::new(machine, calibration)),
                Budget::new(machine, calibration, report),
                Some(report.crc),
                None,
            ),
            Err(refusal) => (None, None, None, Some(refusal.to_string())),
        };
        Report {
            format: FORMAT,
            provenance: Provenance::new(machine, file, date, crc),
            refusal,
            stage: StageFacts::new(machine),
            sensitivity: sensitivity(machine, &Options::default()),
            field: Fields::new(machine, progress),
            travel,
            budget,
            paper: paper_claims(),
        }
    }
}
