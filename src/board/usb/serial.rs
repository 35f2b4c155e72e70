//! The serial port on USB (CDC 1.2, PSTN 1.2: abstract control model).

use super::composition::{SERIAL_IN, SERIAL_INTERFACE};
use super::{WOKEN, once, otg};
use crate::board::port::{ARRIVED, Events};
use core::cell::RefCell;
use core::task::Context;
use embassy_usb::control::{OutResponse, Recipient, Request, RequestType};
use embassy_usb::driver::{EndpointIn, EndpointOut};
use stage_controller::hal::{Port, PortEvent};
use stage_usb488::PACKET;

/// Bytes of answers that wait.
const ROOM: usize = 512;

/// PSTN 1.2, table 13.
mod request {
    pub const SET_LINE_CODING: u8 = 0x20;
    pub const GET_LINE_CODING: u8 = 0x21;
    pub const SET_CONTROL_LINE_STATE: u8 = 0x22;
}

/// What waits between the endpoints and the controller.
struct Waiting {
    /// A packet that came, so long.
    input: [u8; PACKET],
    length: usize,
    /// What the endpoint has from before is to be read away.
    drain: bool,
    /// Answers.
    output: [u8; ROOM],
    from: usize,
    to: usize,
    /// The last packet was full: an empty one follows if nothing else does, or the PC waits for more.
    full: bool,
}

/// What the tasks of USB and the controller share. Both are on the same executor: neither is in the midst of something
/// when the other has its turn.
pub struct Shared {
    events: Events,
    waiting: RefCell<Waiting>,
}

impl Shared {
    /// Nothing waits.
    pub const fn new() -> Self {
        let (input, output) = ([0; PACKET], [0; ROOM]);
        let waiting = Waiting { input, length: 0, drain: false, output, from: 0, to: 0, full: false };
        Shared { events: Events::new(), waiting: RefCell::new(waiting) }
    }

    /// Forgets what came: it is of one who has left.
    fn begin(&self) {
        let waiting = &mut *self.waiting.borrow_mut();
        (waiting.length, waiting.drain) = (0, true);
        self.events.close();
    }

    /// The host sleeps, or is gone.
    pub fn sleep(&self) {
        self.events.sleep();
    }

    /// Goes on with the endpoints.
    pub fn pump(&self, context: &mut Context<'_>, output: &mut impl EndpointOut, input: &mut impl EndpointIn) {
        let waiting = &mut *self.waiting.borrow_mut();
        while waiting.length == 0 {
            let Some(Ok(length)) = once(context, output.read(&mut waiting.input)) else {
                waiting.drain = false;
                break;
            };
            if !waiting.drain {
                waiting.length = length;
                // a program that never sets DTR is heard all the same
                self.events.open();
            }
        }
        let answer = waiting.output.get(waiting.from..waiting.to).unwrap_or(&[]);
        let packet = answer.get(..PACKET).unwrap_or(answer);
        // not to one who has left, as long as the controller has not heard of that
        if (waiting.full || !packet.is_empty())
            && !self.events.is_closed()
            && let Some(Ok(())) = once(context, input.write(packet))
        {
            waiting.full = packet.len() == PACKET;
            waiting.from += packet.len();
            if waiting.from >= waiting.to {
                (waiting.from, waiting.to) = (0, 0);
            }
            // there is room again
            ARRIVED.signal(());
        }
    }
}

/// The lines that the host sets, and its line coding, which means nothing here.
pub struct Lines {
    shared: &'static Shared,
    ready: bool,
    coding: [u8; 7],
}

impl Lines {
    /// Nobody is there; 9600 baud, 8N1.
    pub const fn new(shared: &'static Shared) -> Self {
        Lines { shared, ready: false, coding: [0x80, 0x25, 0, 0, 0, 0, 8] }
    }

    /// A terminal that sets DTR is there; one that clears it is not. What an unplugged cable does, see
    /// [`PortEvent::Asleep`].
    fn set_ready(&mut self, ready: bool) {
        if core::mem::replace(&mut self.ready, ready) != ready {
            if ready {
                self.shared.begin();
                self.shared.events.open();
            } else {
                self.shared.events.close();
            }
            // an answer to the one before: also to what came of him behind his leave
            otg::recall((SERIAL_IN & 0xf).into());
        }
    }

    /// The bus was reset, or the device configured.
    pub fn begin(&mut self) {
        self.ready = false;
        self.shared.begin();
    }

    /// A request of the class to its interface.
    pub fn set(&mut self, request: Request, data: &[u8]) -> OutResponse {
        match (request.request, data.try_into()) {
            (request::SET_LINE_CODING, Ok(coding)) => self.coding = coding,
            (request::SET_CONTROL_LINE_STATE, _) => self.set_ready(request.value & 1 != 0),
            _ => return OutResponse::Rejected,
        }
        OutResponse::Accepted
    }

    /// The answer to a request of the class to its interface.
    pub fn get(&self, request: Request) -> Option<&[u8]> {
        (request.request == request::GET_LINE_CODING).then_some(&self.coding)
    }
}

/// A request of the class to its interface.
pub fn is_mine(request: Request) -> bool {
    (request.request_type, request.recipient, request.index)
        == (RequestType::Class, Recipient::Interface, SERIAL_INTERFACE)
}

/// The controller's side.
pub struct Socket {
    shared: &'static Shared,
    /// The packet that it looks at.
    bytes: [u8; PACKET],
    from: usize,
    to: usize,
}

impl Socket {
    /// The one.
    pub fn new(shared: &'static Shared) -> Self {
        Socket { shared, bytes: [0; PACKET], from: 0, to: 0 }
    }
}

impl Port for Socket {
    fn event(&mut self) -> Option<PortEvent> {
        let event = self.shared.events.take();
        if event == Some(PortEvent::Closed) {
            // what is left of the one who left is nobody else's
            let waiting = &mut *self.shared.waiting.borrow_mut();
            (waiting.from, waiting.to, waiting.full) = (0, 0, false);
            (self.from, self.to) = (0, 0);
        }
        event
    }

    fn received(&mut self) -> &[u8] {
        if self.from >= self.to {
            let waiting = &mut *self.shared.waiting.borrow_mut();
            self.bytes = waiting.input;
            (self.from, self.to) = (0, core::mem::take(&mut waiting.length));
            WOKEN.wake();
        }
        self.bytes.get(self.from..self.to).unwrap_or(&[])
    }

    fn consume(&mut self, count: usize) {
        self.from = (self.from + count).min(self.to);
    }

    fn room(&self) -> usize {
        ROOM - self.shared.waiting.borrow().to
    }

    fn send(&mut self, bytes: &[u8]) {
        let waiting = &mut *self.shared.waiting.borrow_mut();
        if let Some(room) = waiting.output.get_mut(waiting.to..waiting.to + bytes.len()) {
            room.copy_from_slice(bytes);
            waiting.to += bytes.len();
        }
        WOKEN.wake();
    }
}
