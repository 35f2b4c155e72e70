//! What the board says of itself on USB, byte by byte, as a host reads it: the interfaces of the firmware on the stack
//! of the firmware, above endpoints that are not there.

#[path = "../../src/board/usb/composition.rs"]
#[allow(dead_code)]
mod composition;

use composition::{Announced, INSTRUMENT, INSTRUMENT_INTERFACE};
use embassy_usb::Builder;
use embassy_usb::driver::{
    Bus, ControlPipe, Driver, Endpoint, EndpointAddress, EndpointAllocError, EndpointError, EndpointIn, EndpointInfo,
    EndpointOut, EndpointType, Event, Unsupported,
};
use stage_usb488::descriptor;
use std::cell::RefCell;
use std::future::pending;
use std::pin::pin;
use std::rc::Rc;
use std::task::{Context, Waker};

/// Requests of the host, and what the device has answered: none for STALL.
#[derive(Default)]
struct Talk {
    requests: Vec<[u8; 8]>,
    answers: Vec<Option<Vec<u8>>>,
}

struct Nothing(Rc<RefCell<Talk>>);

/// An endpoint that was asked for.
struct End(EndpointInfo);

impl Endpoint for End {
    fn info(&self) -> &EndpointInfo {
        &self.0
    }

    async fn wait_enabled(&mut self) {}
}

impl EndpointOut for End {
    async fn read(&mut self, _: &mut [u8]) -> Result<usize, EndpointError> {
        pending().await
    }
}

impl EndpointIn for End {
    async fn write(&mut self, _: &[u8]) -> Result<(), EndpointError> {
        pending().await
    }
}

impl Driver<'static> for Nothing {
    type EndpointOut = End;
    type EndpointIn = End;
    type ControlPipe = Self;
    type Bus = Self;

    fn alloc_endpoint_out(
        &mut self,
        ep_type: EndpointType,
        addr: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<End, EndpointAllocError> {
        Ok(End(EndpointInfo { addr: addr.ok_or(EndpointAllocError)?, ep_type, max_packet_size, interval_ms }))
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        at: Option<EndpointAddress>,
        size: u16,
        interval: u8,
    ) -> Result<End, EndpointAllocError> {
        self.alloc_endpoint_out(kind, at, size, interval)
    }

    fn start(self, _: u16) -> (Self, Self) {
        (Nothing(self.0.clone()), self)
    }
}

impl Bus for Nothing {
    async fn enable(&mut self) {}

    async fn disable(&mut self) {}

    async fn poll(&mut self) -> Event {
        pending().await
    }

    fn endpoint_set_enabled(&mut self, _: EndpointAddress, _: bool) {}

    fn endpoint_set_stalled(&mut self, _: EndpointAddress, _: bool) {}

    fn endpoint_is_stalled(&mut self, _: EndpointAddress) -> bool {
        false
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        Err(Unsupported)
    }
}

impl ControlPipe for Nothing {
    fn max_packet_size(&self) -> usize {
        64
    }

    async fn setup(&mut self) -> [u8; 8] {
        let next = self.0.borrow_mut().requests.pop();
        match next {
            Some(request) => request,
            None => pending().await,
        }
    }

    async fn data_out(&mut self, _: &mut [u8], _: bool, _: bool) -> Result<usize, EndpointError> {
        Ok(0)
    }

    async fn data_in(&mut self, data: &[u8], first: bool, _: bool) -> Result<(), EndpointError> {
        let mut talk = self.0.borrow_mut();
        if first {
            talk.answers.push(Some(Vec::new()));
        }
        talk.answers.last_mut().unwrap().as_mut().unwrap().extend(data);
        Ok(())
    }

    async fn accept(&mut self) {}

    async fn reject(&mut self) {
        self.0.borrow_mut().answers.push(None);
    }

    async fn accept_set_address(&mut self, _: u8) {}
}

/// A descriptor as the host reads it; none: STALL. Beside it the addresses of the endpoints that are there.
fn read(kind: u8, index: u8) -> (Option<Vec<u8>>, [u8; 5]) {
    let talk = Rc::new(RefCell::new(Talk { requests: vec![[0x80, 6, index, kind, 0, 0, 255, 0]], answers: vec![] }));
    let (configuration, bos) = (vec![0; composition::SIZE].leak(), vec![0; 16].leak());
    let identity = composition::identity("0123456789abcdef01234567");
    let mut builder = Builder::new(Nothing(talk.clone()), identity, configuration, bos, &mut [], vec![0; 64].leak());
    let Announced { serial_out, serial_in, bulk_out, bulk_in, interrupt_in } = composition::announce(&mut builder);
    let ends = [serial_out, serial_in, bulk_out, bulk_in, interrupt_in].map(|end| end.0.addr.into());
    let mut device = builder.build();
    let run = pin!(device.run());
    assert!(run.poll(&mut Context::from_waker(Waker::noop())).is_pending());
    let answer = talk.borrow_mut().answers.pop().expect("the device answers");
    (answer, ends)
}

const CONFIGURATION: [u8; 108] = [
    0x09, 0x02, 0x6c, 0x00, 0x03, 0x01, 0x00, 0x80, 0x32, // 108 bytes, 3 interfaces, bus powered, 100 mA
    0x08, 0x0b, 0x00, 0x01, 0xfe, 0x03, 0x01, 0x00, // interface 0 is a USB488 function
    0x09, 0x04, 0x00, 0x00, 0x03, 0xfe, 0x03, 0x01, 0x00, // interface 0: USB488, 3 endpoints
    0x07, 0x05, 0x02, 0x02, 0x40, 0x00, 0x00, // OUT 2, bulk, 64 bytes
    0x07, 0x05, 0x82, 0x02, 0x40, 0x00, 0x00, // IN 2, bulk, 64 bytes
    0x07, 0x05, 0x83, 0x03, 0x02, 0x00, 0x01, // IN 3, interrupt, 2 bytes, 1 ms
    0x08, 0x0b, 0x01, 0x02, 0x02, 0x02, 0x00, 0x00, // interfaces 1 and 2 are one CDC-ACM function
    0x09, 0x04, 0x01, 0x00, 0x01, 0x02, 0x02, 0x00, 0x00, // interface 1: CDC, ACM, 1 endpoint
    0x05, 0x24, 0x00, 0x10, 0x01, // header: CDC 1.10
    0x04, 0x24, 0x02, 0x02, // ACM: line coding and control lines
    0x05, 0x24, 0x06, 0x01, 0x02, // union of 1 and 2
    0x07, 0x05, 0x84, 0x03, 0x08, 0x00, 0xff, // IN 4, interrupt, 8 bytes, 255 ms
    0x09, 0x04, 0x02, 0x00, 0x02, 0x0a, 0x00, 0x00, 0x00, // interface 2: CDC data, 2 endpoints
    0x07, 0x05, 0x01, 0x02, 0x40, 0x00, 0x00, // OUT 1, bulk, 64 bytes
    0x07, 0x05, 0x81, 0x02, 0x40, 0x00, 0x00, // IN 1, bulk, 64 bytes
];

#[test]
fn the_device_is_a_composite_one_with_association_descriptors() {
    let expected = [
        0x12, 0x01, 0x10, 0x02, 0xef, 0x02, 0x01, 0x40, // USB 2.10, EF/02/01, 64 bytes
        0x09, 0x12, 0x01, 0x00, 0x10, 0x00, 0x01, 0x02, 0x03, 0x01, // 1209:0001, release 0.10, strings 1 to 3
    ];
    assert_eq!(read(1, 0).0.unwrap(), expected);
}

#[test]
fn the_configuration_is_an_instrument_and_a_serial_port() {
    assert_eq!(read(2, 0).0.unwrap(), CONFIGURATION);
}

#[test]
fn the_interface_of_the_instrument_is_that_of_its_class() {
    let ours = descriptor::interface(INSTRUMENT_INTERFACE as u8, INSTRUMENT);
    assert!(CONFIGURATION.windows(ours.len()).any(|bytes| bytes == ours));
}

#[test]
fn all_endpoints_are_those_of_the_chip_but_the_one_for_notifications() {
    let (_, there) = read(2, 0);
    assert_eq!(there, [0x01, 0x81, 0x02, 0x82, 0x83]);
    // OTG_FS has 1 to 3 each way (RM0090, 34.1)
    assert!(there.iter().all(|address| (1..=3).contains(&(address & 0xf))));
    let announced = CONFIGURATION.windows(3).filter(|bytes| bytes[..2] == [7, 5]).map(|bytes| bytes[2]);
    let nowhere: Vec<u8> = announced.filter(|address| !there.contains(address)).collect();
    assert_eq!(nowhere, [0x84]);
}

#[test]
fn the_strings_say_who_it_is() {
    let text = |index| {
        let bytes = read(3, index).0.unwrap();
        assert_eq!(bytes[..2], [bytes.len() as u8, 3]);
        let units: Vec<u16> = bytes[2..].chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
        String::from_utf16(&units).unwrap()
    };
    assert_eq!([1, 2, 3].map(text), ["Stage Controller", "SC6", "0123456789abcdef01234567"]);
    assert_eq!(read(3, 9).0, None);
}
