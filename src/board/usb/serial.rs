//! The serial port on USB (CDC 1.2, PSTN 1.2: abstract control model).

use super::composition::{SERIAL_IN, SERIAL_INTERFACE};
use super::otg;
use crate::board::port::Plug;
use embassy_futures::select::{Either, select};
use embassy_usb::Handler;
use embassy_usb::control::{InResponse, OutResponse, Recipient, Request, RequestType};
use embassy_usb::driver::{EndpointError, EndpointIn, EndpointOut};
use stage_controller::hal::PortEvent;
use stage_usb488::PACKET;

/// PSTN 1.2, table 13.
mod request {
    pub const SET_LINE_CODING: u8 = 0x20;
    pub const GET_LINE_CODING: u8 = 0x21;
    pub const SET_CONTROL_LINE_STATE: u8 = 0x22;
}

/// The lines that the host sets, and its line coding, which means nothing here.
pub struct Lines {
    plug: &'static Plug,
    ready: bool,
    coding: [u8; 7],
}

impl Lines {
    /// Nobody is there; 9600 baud, 8N1.
    pub fn new(plug: &'static Plug) -> Self {
        Lines { plug, ready: false, coding: [0x80, 0x25, 0, 0, 0, 0, 8] }
    }

    /// A terminal that sets DTR is there; one that clears it, or an unplugged cable, is not.
    fn set_ready(&mut self, ready: bool) {
        if core::mem::replace(&mut self.ready, ready) != ready {
            // what came before it was opened is of one who has left
            self.plug.ring(PortEvent::Closed);
            if ready {
                self.plug.ring(PortEvent::Opened);
            } else {
                otg::recall((SERIAL_IN & 0xf).into());
            }
        }
    }
}

fn is_mine(request: Request) -> bool {
    (request.request_type, request.recipient, request.index)
        == (RequestType::Class, Recipient::Interface, SERIAL_INTERFACE)
}

impl Handler for Lines {
    fn reset(&mut self) {
        self.set_ready(false);
    }

    fn control_out(&mut self, request: Request, data: &[u8]) -> Option<OutResponse> {
        if !is_mine(request) {
            return None;
        }
        match (request.request, data.try_into()) {
            (request::SET_LINE_CODING, Ok(coding)) => self.coding = coding,
            (request::SET_CONTROL_LINE_STATE, _) => self.set_ready(request.value & 1 != 0),
            _ => return Some(OutResponse::Rejected),
        }
        Some(OutResponse::Accepted)
    }

    fn control_in<'a>(&'a mut self, request: Request, _: &'a mut [u8]) -> Option<InResponse<'a>> {
        (is_mine(request) && request.request == request::GET_LINE_CODING).then_some(InResponse::Accepted(&self.coding))
    }
}

/// Hands on what comes, for ever.
pub async fn receive(mut endpoint: impl EndpointOut, plug: &Plug) {
    let mut packet = [0; PACKET];
    loop {
        endpoint.wait_enabled().await;
        // a program that never sets DTR is heard all the same
        while let Ok(count) = endpoint.read(&mut packet).await {
            plug.ring(PortEvent::Opened);
            plug.take_in(&packet[..count]).await;
        }
        plug.ring(PortEvent::Closed);
    }
}

/// Sends what is to be sent, for ever.
pub async fn send(mut endpoint: impl EndpointIn, plug: &Plug) {
    let mut packet = [0; PACKET];
    loop {
        endpoint.wait_enabled().await;
        loop {
            let count = plug.fetch(&mut packet).await;
            let sent = async {
                endpoint.write(&packet[..count]).await?;
                // a full packet is followed by an empty one, or the PC waits for more
                if count == PACKET { endpoint.write(&[]).await } else { Ok(()) }
            };
            match select(plug.until_closed(), sent).await {
                Either::First(()) | Either::Second(Ok(())) => {}
                Either::Second(Err(EndpointError::Disabled)) => break,
                Either::Second(Err(EndpointError::BufferOverflow)) => {
                    defmt::warn!("a packet of {} bytes is too long", count)
                }
            }
        }
    }
}
