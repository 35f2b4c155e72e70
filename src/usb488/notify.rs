//! Interrupt IN: service requests and status bytes (USB488, 3.4).

use crate::instrument::Instrument;

/// Bytes of a notification.
pub const SIZE: usize = 2;

/// bNotify1 of a service request (USB488, table 7).
const SERVICE_REQUEST: u8 = 0x81;
/// In bNotify1 beside the tag of a READ_STATUS_BYTE (USB488, table 6).
const STATUS_BYTE: u8 = 0x80;
/// RQS in the status byte.
const RQS: u8 = 0x40;

/// What is to be notified.
#[derive(Clone, Debug, Default)]
pub struct Notify {
    /// The tag of a READ_STATUS_BYTE that has not been looked after.
    asked: Option<u8>,
    answer: Option<[u8; SIZE]>,
    request: Option<[u8; SIZE]>,
    flight: Option<[u8; SIZE]>,
}

impl Notify {
    /// Nothing to notify.
    pub const fn new() -> Self {
        Notify { asked: None, answer: None, request: None, flight: None }
    }

    /// A READ_STATUS_BYTE; false while the answer to the last one was not fetched.
    pub fn ask(&mut self, tag: u8) -> bool {
        let answered = self.flight.is_none_or(|[first, _]| first == SERVICE_REQUEST);
        let free = self.asked.is_none() && self.answer.is_none() && answered;
        if free {
            self.asked = Some(tag);
        }
        free
    }

    /// Looks at the status byte; true when there is something to notify.
    pub fn turn<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        if let Some(tag) = self.asked.take() {
            // a request that the host has not seen is told by this answer
            let unseen = self.request.take().is_some() || self.flight.is_some();
            let status = instrument.serial_poll() | if unseen { RQS } else { 0 };
            self.answer = Some([STATUS_BYTE | tag, status]);
            return true;
        }
        let requests = self.request.is_none() && instrument.requests_service();
        if requests {
            self.request = Some([SERVICE_REQUEST, instrument.serial_poll()]);
        }
        requests
    }

    /// The next notification for the endpoint, when it is free.
    pub fn next(&self) -> Option<[u8; SIZE]> {
        if self.flight.is_some() { None } else { self.answer.or(self.request) }
    }

    /// It is at the endpoint.
    pub fn handed(&mut self) {
        self.flight = self.next();
        if self.answer.take().is_none() {
            self.request = None;
        }
    }

    /// The host has fetched it.
    pub const fn fetched(&mut self) {
        self.flight = None;
    }

    /// A notification stands at the endpoint.
    pub const fn is_in_flight(&self) -> bool {
        self.flight.is_some()
    }
}
