//! Position compare: what is asked for, checked; ordered again when an abort came in between.

use super::Front;
use super::orders::Waiting;
use crate::error::{Error, ErrorNumber};
use crate::refill::border::{Compare, Report};
use crate::units::{Axis, COORDINATE_LIMIT, TICKS_PER_SECOND};

/// The position compare in force.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Comparing {
    pub(super) wanted: Compare,
    /// Its order, while the generator has not answered it.
    ordered: Option<u16>,
}

impl Front {
    /// The position compare in force.
    pub fn compare(&self) -> Compare {
        self.comparing.wanted
    }

    /// Its pulses in the words played so far.
    pub fn compare_pulses(&self) -> u16 {
        if self.comparing.ordered.is_some() { 0 } else { self.report.pulsed }
    }

    /// Another position compare, in place of the one before; at once, moving or not.
    ///
    /// # Errors
    /// -222 when a position is none of the axis, or when the pulses would run into each other at the velocity of the
    /// axis; 104 while too many orders are on their way.
    pub fn set_compare(&mut self, compare: Compare) -> Result<(), Error> {
        if let (Some(axis), 1..) = (Axis::from_index(compare.axis.into()), compare.count) {
            let step = i64::from(compare.step);
            let last = i64::from(compare.start) + step * i64::from(compare.count - 1);
            if last.abs() > i64::from(COORDINATE_LIMIT) {
                return Err(Error::limit(axis, last, i64::from(COORDINATE_LIMIT) * last.signum(), false));
            }
            // high for one grid and low for another
            let ticks = u64::from(2 * self.timing.grid());
            let way = self.settings.axes[axis.index()].velocity.saturating_mul(ticks);
            if compare.count > 1 && step.unsigned_abs() < way.div_ceil(TICKS_PER_SECOND.into()).max(1) {
                let text = "the step of the pulses is too fine for the axis' VELocity";
                return Err(Error::axis_text(ErrorNumber::DataOutOfRange, axis, text));
            }
        }
        let before = core::mem::replace(&mut self.comparing.wanted, compare);
        self.order_compare().inspect_err(|_| self.comparing.wanted = before)
    }

    /// Switches it off.
    pub(super) fn reset_compare(&mut self) {
        if self.comparing.wanted.count != 0 {
            self.comparing.wanted.count = 0;
            let _ = self.order_compare();
        }
    }

    fn order_compare(&mut self) -> Result<(), Error> {
        self.order(Waiting::Compare)?;
        self.comparing.ordered = Some(self.sequence);
        Ok(())
    }

    /// After a report; `aborted`: it tells of an abort, behind which nothing is on its way any more.
    pub(super) fn follow_compare(&mut self, report: &Report, aborted: bool) {
        let Some(sequence) = self.comparing.ordered else { return };
        let since = report.answered.wrapping_sub(sequence);
        if since >= 0x8000 {
            if aborted {
                let _ = self.order_compare();
            }
        } else if report.refused.checked_shr(since.into()).unwrap_or(0) & 1 != 0 {
            let _ = self.order_compare();
        } else {
            self.comparing.ordered = None;
        }
    }
}
