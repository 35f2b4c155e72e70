//! Requests of the host: each goes to the function that it names.

use super::Shared;
use super::composition::{DATA_INTERFACE, INSTRUMENT_INTERFACE};
use super::serial::{Lines, is_mine};
use embassy_usb::Handler;
use embassy_usb::control::{InResponse, OutResponse, Request};
use embassy_usb::types::InterfaceNumber;

/// See above.
pub struct Requests {
    shared: &'static Shared,
    lines: Lines,
    configured: bool,
}

impl Requests {
    /// Nobody has asked anything.
    pub const fn new(shared: &'static Shared) -> Self {
        Requests { shared, lines: Lines::new(&shared.serial), configured: false }
    }

    /// Nothing of what was on an interface is left; the host may have come.
    #[inline(never)] // called in three places
    fn begin(&mut self, interface: u16) {
        match interface {
            INSTRUMENT_INTERFACE => self.shared.instrument.begin(self.configured),
            DATA_INTERFACE => self.lines.begin(),
            _ => {}
        }
    }
}

impl Handler for Requests {
    fn reset(&mut self) {
        // of each interface, its alternate setting is told next
        self.configured = false;
    }

    fn configured(&mut self, configured: bool) {
        self.configured = configured;
        self.begin(INSTRUMENT_INTERFACE);
        self.begin(DATA_INTERFACE);
    }

    fn set_alternate_setting(&mut self, interface: InterfaceNumber, _: u8) {
        self.begin(interface.0.into());
    }

    fn suspended(&mut self, suspended: bool) {
        if suspended {
            self.shared.serial.sleep();
            self.shared.instrument.sleep();
        }
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
