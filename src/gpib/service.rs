//! Service request function, SR1 (IEEE 488.1, 2.7).

/// Service request states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SR {
    /// Negative poll response: asks for nothing.
    NPRS,
    /// Service request: SRQ is true.
    SRQS,
    /// Affirmative poll response: bit 7 of the status byte (RQS, value 64) is true.
    APRS,
}

impl SR {
    /// The next state: `request` is the local message rsv, `polled` that SPAS is active.
    #[must_use]
    pub fn next(self, request: bool, polled: bool) -> SR {
        match (self, request, polled) {
            (SR::NPRS, true, false) => SR::SRQS,
            (SR::SRQS, _, true) => SR::APRS,
            (SR::SRQS | SR::APRS, false, false) => SR::NPRS,
            (same, ..) => same,
        }
    }
}
