//! Requests of the host: each goes to the function that it names.

use super::serial::{Lines, is_mine};
use super::{Shared, otg};
use embassy_usb::Handler;
use embassy_usb::control::{InResponse, OutResponse, Request};

/// See above.
pub struct Requests {
    shared: &'static Shared,
    lines: Lines,
}

impl Requests {
    /// Nobody has asked anything.
    pub const fn new(shared: &'static Shared) -> Self {
        Requests { shared, lines: Lines::new(&shared.serial) }
    }

    /// Nothing of what was is left; the host may have come.
    fn begin(&mut self, configured: bool) {
        self.lines.begin();
        self.shared.instrument.begin(configured);
    }
}

impl Handler for Requests {
    fn reset(&mut self) {
        self.begin(false);
    }

    fn configured(&mut self, configured: bool) {
        otg::begin();
        self.begin(configured);
    }

    fn control_out(&mut self, request: Request, data: &[u8]) -> Option<OutResponse> {
        is_mine(request).then(|| self.lines.set(request, data))
    }

    fn control_in<'a>(&'a mut self, request: Request, answer: &'a mut [u8]) -> Option<InResponse<'a>> {
        if is_mine(request) {
            return Some(self.lines.get(request).map_or(InResponse::Rejected, InResponse::Accepted));
        }
        self.shared.instrument.control(request, answer)
    }
}
