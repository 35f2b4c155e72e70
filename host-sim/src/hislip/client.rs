//! One client: its two connections become operations on an instrument.

use super::PAYLOAD_MOST;
use super::frame::{Frame, Kind};
use super::locks::{Lock, Locks};
use crate::gpib::{Instrument, Panel};
use stage_controller::scpi::exchange::Read;
use std::time::Duration;

/// Answers that the client has not taken yet, beyond which no more is read, bytes.
const OUTPUT: usize = 65_536;
/// Bytes of a header.
const HEADER: u64 = 16;
/// The client has read the last answer to its end.
const DELIVERED: u8 = 1;
/// Of the features: answers may come while questions are sent.
const OVERLAP: u8 = 1;

/// Codes of errors that are not fatal.
mod error {
    pub const UNKNOWN_MESSAGE: u8 = 1;
    pub const UNKNOWN_CONTROL: u8 = 2;
    pub const TOO_LARGE: u8 = 4;
}

/// What the instrument has not taken yet.
#[derive(Clone, Debug, Default)]
enum Doing {
    #[default]
    Nothing,
    Writing {
        bytes: Vec<u8>,
        sent: usize,
        end: bool,
    },
    Triggering,
}

/// A lock that is waited for, until a wall time.
#[derive(Clone, Debug)]
struct Wish {
    name: Vec<u8>,
    until: Duration,
}

/// A client that has both its connections.
#[derive(Clone, Debug)]
pub struct Client {
    id: usize,
    doing: Doing,
    /// MessageID of its latest message.
    message: u32,
    overlap: bool,
    /// Between a device clear and its completion: what comes is dropped.
    clearing: bool,
    wish: Option<Wish>,
    /// SRQ has been told.
    told: bool,
    /// Most bytes of a message that it takes, header included.
    takes: u64,
    output: [Vec<u8>; 2],
}

impl Client {
    /// Number `id` among the clients, in synchronised mode.
    pub fn new(id: usize) -> Self {
        Client {
            id,
            doing: Doing::Nothing,
            message: 0xffff_ff00,
            overlap: false,
            clearing: false,
            wish: None,
            told: false,
            takes: PAYLOAD_MOST + HEADER,
            output: Default::default(),
        }
    }

    /// To be sent on the synchronous and on the asynchronous connection; what is sent is taken out.
    pub fn output(&mut self) -> &mut [Vec<u8>; 2] {
        &mut self.output
    }

    fn say(&mut self, kind: Kind, control: u8, parameter: u32) {
        self.output[0].extend(Frame::bytes(kind, control, parameter, b""));
    }

    fn say_aside(&mut self, kind: Kind, control: u8, parameter: u32) {
        self.output[1].extend(Frame::bytes(kind, control, parameter, b""));
    }

    fn complain(&mut self, channel: usize, code: u8, text: &str) {
        self.output[channel].extend(Frame::bytes(Kind::Error, code, 0, text.as_bytes()));
    }

    /// The next message of the synchronous connection may come.
    pub fn is_ready(&self, instrument: &mut dyn Instrument, locks: &Locks) -> bool {
        let free = matches!(self.doing, Doing::Nothing) && (!self.overlap || instrument.is_idle());
        self.clearing || free && locks.admits(self.id) && self.output[0].len() < OUTPUT
    }

    /// A message on the synchronous connection.
    pub fn hear(&mut self, frame: Frame, instrument: &mut dyn Instrument) {
        let data = matches!(frame.kind, Some(Kind::Data | Kind::DataEnd | Kind::Trigger));
        if data && frame.control & DELIVERED != 0 && !self.clearing {
            instrument.hold(false);
        }
        let Some(payload) = frame.payload else { return self.complain(0, error::TOO_LARGE, "Message too large") };
        match frame.kind {
            Some(Kind::DeviceClearComplete) => {
                self.clearing = false;
                self.overlap = frame.control & OVERLAP != 0;
                self.message = 0xffff_ff00;
                self.say(Kind::DeviceClearAcknowledge, frame.control & OVERLAP, 0);
            }
            _ if self.clearing => {}
            Some(kind @ (Kind::Data | Kind::DataEnd | Kind::Trigger)) => {
                let interrupts = !self.overlap && instrument.awaits_reader();
                self.message = frame.parameter;
                self.doing = match kind {
                    Kind::Trigger => Doing::Triggering,
                    // an empty message without end is nothing
                    Kind::Data if payload.is_empty() => Doing::Nothing,
                    Kind::DataEnd if payload.is_empty() => Doing::Writing { bytes: b"\n".to_vec(), sent: 0, end: true },
                    _ => Doing::Writing { bytes: payload, sent: 0, end: kind == Kind::DataEnd },
                };
                if interrupts {
                    self.say(Kind::Interrupted, 0, self.message);
                    self.say_aside(Kind::AsyncInterrupted, 0, self.message);
                }
                self.go_on(instrument);
            }
            _ => self.complain(0, error::UNKNOWN_MESSAGE, "Unrecognized message type"),
        }
    }

    /// A message on the asynchronous connection, at a `wall` time.
    pub fn hear_aside(&mut self, frame: Frame, instrument: &mut dyn Instrument, locks: &mut Locks, wall: Duration) {
        let Some(payload) = frame.payload else { return self.complain(1, error::TOO_LARGE, "Message too large") };
        match frame.kind {
            Some(Kind::AsyncStatusQuery) => {
                if frame.control & DELIVERED != 0 {
                    instrument.hold(false);
                }
                let status = instrument.serial_poll();
                self.say_aside(Kind::AsyncStatusResponse, status, 0);
            }
            Some(Kind::AsyncMaxMsgSize) => {
                let asked = payload.try_into().map_or(0, u64::from_be_bytes);
                self.takes = asked.clamp(HEADER + 1, PAYLOAD_MOST + HEADER);
                let size = (PAYLOAD_MOST + HEADER).to_be_bytes();
                self.output[1].extend(Frame::bytes(Kind::AsyncMaxMsgSizeResponse, 0, 0, &size));
            }
            Some(Kind::AsyncDeviceClear) => {
                instrument.clear();
                self.doing = Doing::Nothing;
                self.clearing = true;
                self.say_aside(Kind::AsyncDeviceClearAcknowledge, 0, 0);
            }
            Some(Kind::AsyncLock) => match frame.control {
                0 => {
                    let done = locks.release(self.id);
                    self.say_aside(Kind::AsyncLockResponse, done.code(), 0);
                }
                1 => {
                    let until = wall + Duration::from_millis(frame.parameter.into());
                    self.wish = Some(Wish { name: payload, until });
                    self.wait_for_lock(locks, wall);
                }
                _ => self.complain(1, error::UNKNOWN_CONTROL, "Unrecognized control code"),
            },
            Some(Kind::AsyncLockInfo) => {
                let (exclusive, holders) = locks.holders();
                self.say_aside(Kind::AsyncLockInfoResponse, exclusive.into(), holders as u32);
            }
            Some(Kind::AsyncRemoteLocalControl) => {
                let orders: &[Panel] = match frame.control {
                    0 => &[Panel::Enable(false)],
                    1 => &[Panel::Enable(true)],
                    2 => &[Panel::Local, Panel::Enable(false)],
                    3 => &[Panel::Enable(true), Panel::Remote],
                    4 => &[Panel::Enable(true), Panel::LockOut],
                    5 => &[Panel::Enable(true), Panel::Remote, Panel::LockOut],
                    6 => &[Panel::Local],
                    _ => return self.complain(1, error::UNKNOWN_CONTROL, "Unrecognized control code"),
                };
                orders.iter().for_each(|order| instrument.panel(*order));
                self.say_aside(Kind::AsyncRemoteLocalResponse, 0, 0);
            }
            _ => self.complain(1, error::UNKNOWN_MESSAGE, "Unrecognized message type"),
        }
    }

    /// A lock that is waited for comes, or its time is over.
    fn wait_for_lock(&mut self, locks: &mut Locks, wall: Duration) {
        let Some(wish) = &self.wish else { return };
        let lock = locks.request(self.id, &wish.name);
        if lock != Lock::Refused || wall >= wish.until {
            self.wish = None;
            self.say_aside(Kind::AsyncLockResponse, lock.code(), 0);
        }
    }

    /// Goes on at a `wall` time: what the instrument takes and answers, and whether it requests service.
    pub fn turn(&mut self, instrument: &mut dyn Instrument, locks: &mut Locks, wall: Duration) {
        self.wait_for_lock(locks, wall);
        self.go_on(instrument);
        let requests = instrument.requests_service();
        if requests && !self.told {
            let status = instrument.status();
            self.say_aside(Kind::AsyncServiceRequest, status, 0);
        }
        self.told = requests;
    }

    fn go_on(&mut self, instrument: &mut dyn Instrument) {
        let done = match &mut self.doing {
            Doing::Nothing => false,
            Doing::Triggering => instrument.trigger(),
            Doing::Writing { bytes, sent, end } => {
                while *sent < bytes.len() {
                    match instrument.write(&bytes[*sent..], *end) {
                        0 => break,
                        taken => *sent += taken,
                    }
                }
                *sent == bytes.len()
            }
        };
        if done {
            self.doing = Doing::Nothing;
        }
        self.answer(instrument);
    }

    /// Answers go ahead of their reader.
    fn answer(&mut self, instrument: &mut dyn Instrument) {
        let most = (self.takes - HEADER).min(4096) as usize;
        let mut chunk = vec![0; most];
        while self.output[0].len() < OUTPUT && !self.clearing && !instrument.is_idle() {
            let Read::Bytes(count, end) = instrument.read(&mut chunk) else { return };
            let kind = if end { Kind::DataEnd } else { Kind::Data };
            self.output[0].extend(Frame::bytes(kind, 0, self.message, &chunk[..count]));
            if !self.overlap {
                instrument.hold(true);
            }
        }
    }

    /// Something is under way.
    pub fn is_busy(&self) -> bool {
        !matches!(self.doing, Doing::Nothing) || self.wish.is_some()
    }
}
