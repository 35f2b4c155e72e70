//! The light: what the power inputs said at the last border.

use super::Front;
use crate::refill::border::Sample;

/// What is known of the light.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sense {
    latest: Option<Sample>,
}

impl Front {
    /// A sample of the board, in the order in which they were taken.
    pub fn receive_sample(&mut self, sample: Sample) {
        self.sense.latest = Some(sample);
    }

    /// The sample that was taken last.
    pub fn latest_sample(&self) -> Option<&Sample> {
        self.sense.latest.as_ref()
    }
}
