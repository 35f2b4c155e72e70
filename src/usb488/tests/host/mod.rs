//! A host with its driver, on a model of the endpoints: what the usbtmc driver of Linux and pyvisa-py do, and what no
//! driver does.
#![allow(dead_code)]

use stage_usb488::control::{Answer, OF_ENDPOINT, OF_INTERFACE, Setup, request, status};
use stage_usb488::{Interface, PACKET, Wire};

pub const BULK_OUT: u16 = 0x02;
pub const BULK_IN: u16 = 0x82;

/// What has the instrument behind the interface.
pub trait Bench {
    /// Executes what can be executed, and goes on with the interface; true when something has changed.
    fn turn(&mut self, interface: &mut Interface) -> bool;
    /// Time passes; false when nothing waits for it.
    fn pass(&mut self) -> bool;
}

/// The three endpoints.
#[derive(Default)]
pub struct Endpoints {
    /// What the hardware has of bulk OUT.
    pub out: Option<Vec<u8>>,
    /// What the host sends as soon as that has been read.
    pub behind: Option<Vec<u8>>,
    pub halted: bool,
    bulk_in: Option<Vec<u8>>,
    notice: Option<[u8; 2]>,
    /// Packets that were put at bulk IN.
    pub sent: usize,
}

impl Wire for Endpoints {
    fn receive(&mut self, packet: &mut [u8; PACKET]) -> Option<usize> {
        let came = self.out.take()?;
        self.out = self.behind.take();
        packet[..came.len()].copy_from_slice(&came);
        Some(came.len())
    }

    fn halt(&mut self) {
        self.halted = true;
    }

    fn send(&mut self, packet: &[u8]) -> bool {
        assert!(self.bulk_in.is_none(), "bulk IN is not empty");
        self.sent += 1;
        self.bulk_in = Some(packet.to_vec());
        true
    }

    fn is_fetched(&mut self) -> bool {
        self.bulk_in.is_none()
    }

    fn recall(&mut self) -> bool {
        self.bulk_in.take().is_none()
    }

    fn notify(&mut self, notice: &[u8; 2]) -> bool {
        assert!(self.notice.is_none(), "interrupt IN is not empty");
        self.notice = Some(*notice);
        true
    }

    fn is_notice_fetched(&mut self) -> bool {
        self.notice.is_none()
    }
}

/// Why something did not work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// NAK until the host gave up.
    TimeOut,
    /// STALL.
    Stall,
    /// The device said no: USBTMC_status.
    Refused(u8),
    /// What came is no answer.
    Nonsense,
}

/// A device on its cable, and the driver of the host.
pub struct Usb<B> {
    pub interface: Interface,
    pub wire: Endpoints,
    pub bench: B,
    pub tag: u8,
    status_tag: u8,
    /// Data bytes of a bulk OUT transfer.
    pub chunk: usize,
    /// What a read asks for.
    pub size: u32,
    /// Something has come, gone, or changed, that wakes who serves the endpoints. Nothing else does.
    woken: bool,
}

impl<B: Bench> Usb<B> {
    pub fn new(bench: B) -> Self {
        let (interface, wire) = (Interface::new(), Endpoints::default());
        Usb { interface, wire, bench, tag: 0, status_tag: 1, chunk: 1000, size: 4096, woken: true }
    }

    /// Reset of the bus, or another configuration; the caller closes the link of the instrument.
    pub fn reset(&mut self) {
        (self.interface, self.wire, self.woken) = (Interface::new(), Endpoints::default(), true);
    }

    /// Until nothing goes on any more.
    pub fn settle(&mut self) {
        for _ in 0..10_000 {
            let pumped = std::mem::take(&mut self.woken) && self.interface.pump(&mut self.wire);
            self.woken = self.bench.turn(&mut self.interface);
            if !(self.woken || pumped) {
                return;
            }
        }
        panic!("it never rests");
    }

    // Packets.

    /// Puts a packet on bulk OUT, waiting for as long as time brings something.
    pub fn put(&mut self, packet: &[u8]) -> Result<(), Trouble> {
        assert!(packet.len() <= PACKET);
        for _ in 0..100_000 {
            self.settle();
            if self.wire.halted {
                return Err(Trouble::Stall);
            }
            if self.wire.out.is_none() {
                self.wire.out = Some(packet.to_vec());
                self.woken = true;
                return Ok(());
            }
            if !self.bench.pass() {
                break;
            }
        }
        Err(Trouble::TimeOut)
    }

    /// Fetches a packet from bulk IN, if there is one now.
    pub fn peek(&mut self) -> Option<Vec<u8>> {
        self.settle();
        let packet = self.wire.bulk_in.take();
        self.woken |= packet.is_some();
        self.settle();
        packet
    }

    /// Fetches a packet from bulk IN, waiting for as long as time brings something.
    pub fn get(&mut self) -> Result<Vec<u8>, Trouble> {
        for _ in 0..100_000 {
            if let Some(packet) = self.peek() {
                return Ok(packet);
            }
            if !self.bench.pass() {
                break;
            }
        }
        Err(Trouble::TimeOut)
    }

    /// Fetches a notification.
    pub fn notice(&mut self) -> Option<[u8; 2]> {
        self.settle();
        let notice = self.wire.notice.take();
        self.woken |= notice.is_some();
        self.settle();
        notice
    }

    // Requests.

    /// A request of the class; none: STALL.
    pub fn control(&mut self, kind: u8, request: u8, value: u16, index: u16) -> Option<Vec<u8>> {
        self.woken = true;
        let mut answer: Answer = [0xaa; 24];
        let length = self.interface.control(Setup { kind, request, value, index }, &mut answer)?;
        Some(answer[..length].to_vec())
    }

    pub fn of_interface(&mut self, request: u8, value: u16) -> Vec<u8> {
        self.control(OF_INTERFACE, request, value, 1).expect("a request of the class")
    }

    pub fn of_endpoint(&mut self, request: u8, value: u16, index: u16) -> Vec<u8> {
        self.control(OF_ENDPOINT, request, value, index).expect("a request of the class")
    }

    /// CLEAR_FEATURE(ENDPOINT_HALT) of bulk OUT.
    pub fn clear_halt(&mut self) {
        self.wire.halted = false;
        self.woken = true;
        self.interface.halt_cleared();
    }

    // The driver.

    pub fn next_tag(&mut self) -> u8 {
        self.tag = self.tag % 255 + 1;
        self.tag
    }

    /// Sends a transfer.
    pub fn transfer(&mut self, bytes: &[u8]) -> Result<(), Trouble> {
        bytes.chunks(PACKET).try_for_each(|packet| self.put(packet))
    }

    /// Sends a message, in transfers of `chunk` bytes.
    pub fn write(&mut self, message: &[u8]) -> Result<(), Trouble> {
        let mut left = message;
        while !left.is_empty() {
            let (now, later) = left.split_at(left.len().min(self.chunk));
            let tag = self.next_tag();
            self.transfer(&message_out(tag, now, later.is_empty()))?;
            left = later;
        }
        self.settle();
        Ok(())
    }

    /// Asks for bytes; the tag.
    pub fn ask_for(&mut self, size: u32, term: Option<u8>) -> Result<u8, Trouble> {
        let tag = self.next_tag();
        self.put(&request_in(tag, size, term))?;
        self.settle();
        Ok(tag)
    }

    /// Fetches a transfer that was asked for: its data and attributes.
    pub fn fetch(&mut self, tag: u8, size: u32) -> Result<(Vec<u8>, u8), Trouble> {
        let mut bytes = self.get()?;
        let mut last = bytes.len();
        while last == PACKET {
            let packet = self.get()?;
            last = packet.len();
            bytes.extend(packet);
        }
        let (header, data) = bytes.split_at_checked(12).ok_or(Trouble::Nonsense)?;
        let announced = u32::from_le_bytes(header[4..8].try_into().unwrap());
        let right = header[..4] == [2, tag, !tag, 0] && header[9..] == [0; 3] && announced <= size && announced > 0;
        let padding = data.len().checked_sub(announced as usize).ok_or(Trouble::Nonsense)?;
        if !right || padding > 3 || !bytes.len().is_multiple_of(4) {
            return Err(Trouble::Nonsense);
        }
        Ok((data[..announced as usize].to_vec(), header[8]))
    }

    /// Reads an answer up to its end.
    pub fn read(&mut self) -> Result<Vec<u8>, Trouble> {
        let mut answer = Vec::new();
        loop {
            let tag = self.ask_for(self.size, None)?;
            let (data, attributes) = self.fetch(tag, self.size)?;
            answer.extend(data);
            match attributes {
                0 => {}
                1 => return Ok(answer),
                _ => return Err(Trouble::Nonsense),
            }
        }
    }

    pub fn query(&mut self, message: &str) -> Result<String, Trouble> {
        self.write(message.as_bytes())?;
        self.read().map(|answer| String::from_utf8_lossy(&answer).into_owned())
    }

    pub fn trigger(&mut self) -> Result<(), Trouble> {
        let tag = self.next_tag();
        self.put(&trigger(tag))?;
        self.settle();
        Ok(())
    }

    /// The status byte, as Linux reads it: service requests in front of the answer are taken off first.
    pub fn read_stb(&mut self) -> Result<u8, Trouble> {
        self.status_tag = if self.status_tag >= 127 { 2 } else { self.status_tag + 1 };
        let tag = self.status_tag;
        let answer = self.of_interface(request::READ_STATUS_BYTE, tag.into());
        if answer[0] != status::SUCCESS {
            return Err(Trouble::Refused(answer[0]));
        }
        assert_eq!(answer[1..], [tag, 0]);
        for _ in 0..2 {
            match self.notice() {
                Some([first, status]) if first == 0x80 | tag => return Ok(status),
                Some([0x81, _]) => {}
                _ => break,
            }
        }
        Err(Trouble::Nonsense)
    }

    /// Waits for the second part of a request; the last answer.
    fn check(&mut self, again: impl Fn(&mut Self) -> Vec<u8>) -> Result<Vec<u8>, Trouble> {
        for _ in 0..100_000 {
            self.settle();
            let answer = again(self);
            match answer[0] {
                status::SUCCESS => return Ok(answer),
                status::PENDING if answer[1] & 1 != 0 => {
                    self.peek();
                }
                status::PENDING => {
                    self.bench.pass();
                }
                code => return Err(Trouble::Refused(code)),
            }
        }
        Err(Trouble::TimeOut)
    }

    pub fn clear(&mut self) -> Result<(), Trouble> {
        assert_eq!(self.of_interface(request::INITIATE_CLEAR, 0), [status::SUCCESS]);
        self.check(|host| host.of_interface(request::CHECK_CLEAR_STATUS, 0))?;
        self.clear_halt();
        Ok(())
    }

    /// Aborts a transfer on bulk IN; the bytes that the device says it has sent.
    pub fn abort_in(&mut self, tag: u8) -> Result<u32, Trouble> {
        let answer = self.of_endpoint(request::INITIATE_ABORT_BULK_IN, tag.into(), BULK_IN);
        if answer[0] != status::SUCCESS {
            return Err(Trouble::Refused(answer[0]));
        }
        assert_eq!(answer[1], tag);
        // to a short packet
        while self.get()?.len() == PACKET {}
        let answer = self.check(|host| host.of_endpoint(request::CHECK_ABORT_BULK_IN_STATUS, 0, BULK_IN))?;
        Ok(u32::from_le_bytes(answer[4..8].try_into().unwrap()))
    }

    /// Aborts a transfer on bulk OUT; the bytes that the device says it has received.
    pub fn abort_out(&mut self, tag: u8) -> Result<u32, Trouble> {
        let answer = self.of_endpoint(request::INITIATE_ABORT_BULK_OUT, tag.into(), BULK_OUT);
        if answer[0] != status::SUCCESS {
            return Err(Trouble::Refused(answer[0]));
        }
        assert_eq!(answer[1], tag);
        let answer = self.check(|host| host.of_endpoint(request::CHECK_ABORT_BULK_OUT_STATUS, 0, BULK_OUT))?;
        self.clear_halt();
        Ok(u32::from_le_bytes(answer[4..8].try_into().unwrap()))
    }
}

// Bulk OUT headers (USBTMC, tables 1, 3 and 4; USB488, table 3).

pub fn message_out(tag: u8, data: &[u8], end: bool) -> Vec<u8> {
    let mut bytes = vec![1, tag, !tag, 0];
    bytes.extend((data.len() as u32).to_le_bytes());
    bytes.extend([u8::from(end), 0, 0, 0]);
    bytes.extend(data);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

pub fn request_in(tag: u8, size: u32, term: Option<u8>) -> Vec<u8> {
    let mut bytes = vec![2, tag, !tag, 0];
    bytes.extend(size.to_le_bytes());
    bytes.extend([if term.is_some() { 2 } else { 0 }, term.unwrap_or(0), 0, 0]);
    bytes
}

pub fn trigger(tag: u8) -> Vec<u8> {
    vec![128, tag, !tag, 0, 0, 0, 0, 0, 0, 0, 0, 0]
}
