//! The instrument on USB: between the endpoints, requests, and the controller's turn stands one [`Interface`].

use super::composition::{INSTRUMENT, INSTRUMENT_INTERFACE};
use super::{WOKEN, once, otg};
use crate::board::port::{ARRIVED, Events};
use core::cell::RefCell;
use core::task::Context;
use embassy_usb::control::{InResponse, Recipient, Request, RequestType};
use embassy_usb::driver::{EndpointIn, EndpointOut};
use stage_controller::hal::{BusPort, Port, PortEvent};
use stage_controller::scpi::exchange::Attached;
use stage_controller::scpi::session::Session;
use stage_usb488::control::{Answer, OF_ENDPOINT, OF_INTERFACE};
use stage_usb488::{Interface, PACKET, Setup, Wire};

/// Index of an endpoint.
const fn index(address: u8) -> usize {
    (address & 0xf) as usize
}

/// What the tasks of USB and the controller share. Both are on the same executor: neither is in the midst of something
/// when the other has its turn.
pub struct Shared {
    interface: RefCell<Interface>,
    events: Events,
}

impl Shared {
    /// Not configured.
    pub const fn new() -> Self {
        Shared { interface: RefCell::new(Interface::new()), events: Events::new() }
    }

    /// The host has cleared the halt of bulk OUT.
    pub fn halt_cleared(&self) {
        self.interface.borrow_mut().halt_cleared();
    }

    /// Nothing of what was is left; the host may have come.
    pub fn begin(&self, opened: bool) {
        *self.interface.borrow_mut() = Interface::new();
        self.events.begin(opened);
    }

    /// The host sleeps, or is gone.
    pub fn sleep(&self) {
        self.events.sleep();
    }

    /// Answers a request to the interface or to one of its bulk endpoints. None: it is for somebody else.
    pub fn control<'a>(&self, request: Request, answer: &'a mut [u8]) -> Option<InResponse<'a>> {
        let [place, _] = request.index.to_le_bytes();
        let kind = match (request.request_type, request.recipient) {
            (RequestType::Class, Recipient::Interface) if request.index == INSTRUMENT_INTERFACE => OF_INTERFACE,
            (RequestType::Class, Recipient::Endpoint) if [INSTRUMENT.bulk_out, INSTRUMENT.bulk_in].contains(&place) => {
                OF_ENDPOINT
            }
            _ => return None,
        };
        let setup = Setup { kind, request: request.request, value: request.value, index: request.index };
        let answer: &mut Answer = answer.first_chunk_mut()?;
        let length = self.interface.borrow_mut().control(setup, answer);
        ARRIVED.signal(());
        Some(length.and_then(|length| answer.get(..length)).map_or(InResponse::Rejected, InResponse::Accepted))
    }

    /// Goes on with the endpoints.
    #[inline(never)]
    pub fn pump<I: EndpointIn>(
        &self,
        context: &mut Context<'_>,
        bulk_out: &mut impl EndpointOut,
        bulk_in: &mut I,
        interrupt_in: &mut I,
    ) {
        let mut endpoints = Endpoints { context, bulk_out, bulk_in, interrupt_in };
        if self.interface.borrow_mut().pump(&mut endpoints) {
            ARRIVED.signal(());
        }
    }
}

/// The endpoints, looked at once.
struct Endpoints<'a, 'b, O, I> {
    context: &'a mut Context<'b>,
    bulk_out: &'a mut O,
    bulk_in: &'a mut I,
    interrupt_in: &'a mut I,
}

impl<O: EndpointOut, I: EndpointIn> Wire for Endpoints<'_, '_, O, I> {
    fn receive(&mut self, packet: &mut [u8; PACKET]) -> Option<usize> {
        once(self.context, self.bulk_out.read(packet))?.ok()
    }

    fn halt(&mut self) {
        otg::halt_out(index(INSTRUMENT.bulk_out));
    }

    fn send(&mut self, packet: &[u8]) -> bool {
        once(self.context, self.bulk_in.write(packet)).is_some_and(|sent| sent.is_ok())
    }

    fn is_fetched(&mut self) -> bool {
        otg::is_empty(index(INSTRUMENT.bulk_in))
    }

    fn recall(&mut self) -> bool {
        otg::recall(index(INSTRUMENT.bulk_in))
    }

    fn notify(&mut self, notice: &[u8; 2]) -> bool {
        once(self.context, self.interrupt_in.write(notice)).is_some_and(|sent| sent.is_ok())
    }

    fn is_notice_fetched(&mut self) -> bool {
        otg::is_empty(index(INSTRUMENT.interrupt_in))
    }
}

/// The controller's side.
pub struct Socket(pub &'static Shared);

impl Port for Socket {
    fn event(&mut self) -> Option<PortEvent> {
        self.0.events.take()
    }

    fn received(&mut self) -> &[u8] {
        &[]
    }

    fn consume(&mut self, _: usize) {}

    fn room(&self) -> usize {
        0
    }

    fn send(&mut self, _: &[u8]) {}

    fn bus(&mut self) -> Option<&mut dyn BusPort> {
        Some(self)
    }
}

impl BusPort for Socket {
    fn turn(&mut self, link: &mut Attached<'_, Session>) -> bool {
        let any = self.0.interface.borrow_mut().turn(link);
        if any {
            WOKEN.wake();
        }
        any
    }
}
