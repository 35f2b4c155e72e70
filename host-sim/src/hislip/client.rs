//! One client: what comes on its two connections becomes operations on an instrument.

use super::PAYLOAD_MOST;
use super::errors::{Fatal, Mistake, Over};
use super::frame::{Frame, Kind};
use super::link::Channel;
use super::locks::{Lock, Locks};
use crate::gpib::{Instrument, Panel};
use stage_controller::scpi::exchange::Read;
use stage_controller::scpi::lexer::{Class, Framer};
use std::collections::VecDeque;
use std::time::Duration;

/// Answers that the client has not taken yet, beyond which no more is read, bytes.
const OUTPUT: usize = 65_536;
/// Messages that wait for the instrument, beyond which no more is taken, bytes. `!` is seen among them.
const INPUT: usize = 4 * PAYLOAD_MOST as usize;
/// Bytes of a header.
const HEADER: u64 = 16;
/// The client has read the last answer to its end.
const DELIVERED: u8 = 1;
/// Of the features: answers may come while questions are sent.
const OVERLAP: u8 = 1;
/// MessageID in front of the first message.
const BEFORE_FIRST: u32 = 0xffff_ff00 - 2;
/// Answers whose numbers are remembered in overlapped mode.
const ANSWERS: usize = 64;
/// One connection may be so much later than the other one.
const LATE: Duration = Duration::from_millis(100);

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

/// What is waited for in a matter of locks, until a wall time.
#[derive(Clone, Debug)]
enum Wish {
    /// A lock.
    Lock { name: Vec<u8>, until: Duration },
    /// What was sent up to this message is done; then the lock is given back (IVI-6.1, 6.5).
    Release { after: u32, until: Duration },
}

/// A client that has both its connections.
#[derive(Clone, Debug)]
pub(super) struct Client {
    id: usize,
    /// Not begun yet, in their order.
    waiting: VecDeque<Frame>,
    /// Bytes of these.
    weight: usize,
    /// Where a `!` counts in what comes.
    watch: Framer,
    /// A `!` among what waits has been told to the instrument.
    foreseen: bool,
    /// A part of the message was too large: the rest of it is dropped.
    refusing: bool,
    doing: Doing,
    /// The instrument has the beginning of a message.
    begun: bool,
    /// MessageID of the latest message that came, and of the latest one that was begun.
    heard: u32,
    message: u32,
    overlap: bool,
    /// MessageIDs of what was answered in overlapped mode.
    answers: VecDeque<u32>,
    /// Between a device clear and its completion: what comes is dropped.
    clearing: bool,
    /// A completion without a clear came at this time.
    stray: Option<Duration>,
    wish: Option<Wish>,
    /// SRQ has been told.
    told: bool,
    /// Most bytes of a message that it takes, header included.
    takes: u64,
    output: [Vec<u8>; 2],
}

/// A MessageID comes later than another one.
fn is_after(message: u32, other: u32) -> bool {
    (message.wrapping_sub(other) as i32) > 0
}

fn is_data(frame: &Frame) -> bool {
    matches!(frame.kind, Some(Kind::Data | Kind::DataEnd | Kind::Trigger))
}

impl Client {
    /// Number `id` among the clients, in synchronised mode.
    pub fn new(id: usize) -> Self {
        Client {
            id,
            waiting: VecDeque::new(),
            weight: 0,
            watch: Framer::new(),
            foreseen: false,
            refusing: false,
            doing: Doing::Nothing,
            begun: false,
            heard: BEFORE_FIRST,
            message: BEFORE_FIRST,
            overlap: false,
            answers: VecDeque::new(),
            clearing: false,
            stray: None,
            wish: None,
            told: false,
            takes: PAYLOAD_MOST + HEADER,
            output: Default::default(),
        }
    }

    /// To be sent on a connection; what is sent is taken out.
    pub fn output(&mut self, channel: Channel) -> &mut Vec<u8> {
        &mut self.output[channel as usize]
    }

    fn say(&mut self, channel: Channel, kind: Kind, control: u8, parameter: u32) {
        self.output[channel as usize].extend(Frame::bytes(kind, control, parameter, b""));
    }

    fn say_aside(&mut self, kind: Kind, control: u8, parameter: u32) {
        self.say(Channel::Asynchronous, kind, control, parameter);
    }

    fn complain(&mut self, channel: Channel, mistake: Mistake, text: &str) {
        self.output[channel as usize].extend(Frame::bytes(Kind::Error, mistake as u8, 0, text.as_bytes()));
    }

    /// A message that is none of those that are taken on a connection.
    fn refuse(&mut self, channel: Channel, frame: &Frame) -> Result<(), Over> {
        match frame.kind {
            Some(Kind::Initialize | Kind::AsyncInitialize) => return Err(Over::Refused(Fatal::BadInitialization)),
            Some(Kind::FatalError) => return Err(Over::Left),
            // to answer an error by an error has no end
            Some(Kind::Error) => {}
            None if frame.number >= 128 => {
                self.complain(channel, Mistake::UnknownVendorMessage, "Unrecognized Vendor Defined Message");
            }
            _ => self.complain(channel, Mistake::UnknownMessage, "Unrecognized Message Type"),
        }
        Ok(())
    }

    /// Another message may come on a connection.
    pub fn has_room(&self, channel: Channel) -> bool {
        match channel {
            Channel::Synchronous => self.weight < INPUT && self.output[0].len() < 2 * OUTPUT,
            Channel::Asynchronous => self.output[1].len() < OUTPUT,
        }
    }

    /// A message comes on the synchronous connection: it waits for its turn, but `!` is seen at once.
    pub fn hear(&mut self, frame: Frame, instrument: &mut dyn Instrument) -> Result<(), Over> {
        match frame.kind {
            Some(Kind::Data | Kind::DataEnd | Kind::Trigger | Kind::DeviceClearComplete) => {}
            _ => return self.refuse(Channel::Synchronous, &frame),
        }
        let aborts = self.watch(&frame);
        let completes = |frame: &Frame| frame.kind == Some(Kind::DeviceClearComplete);
        if self.clearing && !completes(&frame) && !self.waiting.iter().any(completes) {
            if aborts > 0 {
                instrument.foresee_abort(true);
                instrument.clear();
            }
            return Ok(());
        }
        if is_data(&frame) {
            self.heard = frame.parameter;
        }
        let part = matches!(frame.kind, Some(Kind::Data | Kind::DataEnd));
        let goes_on = part && self.refusing;
        if part {
            let ends = frame.kind == Some(Kind::DataEnd);
            self.refusing = !ends && (self.refusing || frame.payload.is_none());
        }
        if goes_on && frame.payload.is_some() {
            if frame.control & DELIVERED != 0 {
                instrument.hold(false);
            }
            return Ok(());
        }
        for _ in 0..aborts {
            instrument.foresee_abort(true);
            self.foreseen = true;
        }
        self.weight += weight(&frame);
        self.waiting.push_back(frame);
        Ok(())
    }

    /// Counts the `!` that will abort.
    fn watch(&mut self, frame: &Frame) -> usize {
        let aborts = match &frame.payload {
            Some(bytes) if is_data(frame) && !self.refusing => {
                bytes.iter().filter(|byte| self.watch.step(**byte) == Class::Abort).count()
            }
            _ => 0,
        };
        if frame.kind != Some(Kind::Data) {
            self.watch = Framer::new();
        }
        aborts
    }

    /// The next message that waits may be begun.
    fn is_ready(&mut self, instrument: &mut dyn Instrument, locks: &Locks, wall: Duration) -> bool {
        let Some(frame) = self.waiting.front() else { return false };
        if frame.kind == Some(Kind::DeviceClearComplete) {
            // it may be faster than the clear
            return self.clearing || wall >= *self.stray.get_or_insert(wall) + LATE;
        }
        let later = matches!(self.wish, Some(Wish::Release { after, .. }) if is_after(frame.parameter, after));
        let cuts = self.begun && frame.payload.is_none();
        matches!(self.doing, Doing::Nothing)
            && !later
            && locks.admits(self.id)
            && self.output[0].len() < OUTPUT
            && (!self.overlap && !cuts || instrument.is_idle())
    }

    /// Begins a message.
    fn begin(&mut self, frame: Frame, instrument: &mut dyn Instrument) {
        if frame.kind == Some(Kind::DeviceClearComplete) {
            self.stray = None;
            if !self.clearing {
                let text = "DeviceClearComplete without AsyncDeviceClear";
                return self.complain(Channel::Synchronous, Mistake::Unidentified, text);
            }
            self.clearing = false;
            self.overlap = frame.control & OVERLAP != 0;
            instrument.overlap(self.overlap);
            return self.say(Channel::Synchronous, Kind::DeviceClearAcknowledge, frame.control & OVERLAP, 0);
        }
        if frame.control & DELIVERED != 0 {
            instrument.hold(false);
        }
        let Some(payload) = frame.payload else {
            if std::mem::take(&mut self.begun) {
                instrument.drop_message();
            }
            return self.complain(Channel::Synchronous, Mistake::TooLarge, "Message too large");
        };
        let interrupts = !self.overlap && instrument.awaits_reader();
        self.message = frame.parameter;
        self.begun = match frame.kind {
            Some(Kind::Data) => self.begun || !payload.is_empty(),
            _ => false,
        };
        self.doing = match frame.kind {
            Some(Kind::Trigger) => Doing::Triggering,
            // an empty message without end is nothing
            Some(Kind::Data) if payload.is_empty() => Doing::Nothing,
            Some(Kind::DataEnd) if payload.is_empty() => Doing::Writing { bytes: b"\n".to_vec(), sent: 0, end: true },
            kind => Doing::Writing { bytes: payload, sent: 0, end: kind == Some(Kind::DataEnd) },
        };
        if interrupts {
            self.say(Channel::Synchronous, Kind::Interrupted, 0, self.message);
            self.say_aside(Kind::AsyncInterrupted, 0, self.message);
        }
        self.go_on(instrument);
    }

    /// A message on the asynchronous connection, at a `wall` time.
    pub fn hear_aside(
        &mut self,
        frame: Frame,
        instrument: &mut dyn Instrument,
        locks: &mut Locks,
        wall: Duration,
    ) -> Result<(), Over> {
        let Some(payload) = frame.payload else {
            self.complain(Channel::Asynchronous, Mistake::TooLarge, "Message too large");
            return Ok(());
        };
        match frame.kind {
            Some(Kind::AsyncStatusQuery) => {
                if frame.control & DELIVERED != 0 {
                    instrument.hold(false);
                }
                self.look_for_later_answers(frame.parameter, instrument);
                let status = instrument.serial_poll();
                self.say_aside(Kind::AsyncStatusResponse, status, 0);
            }
            Some(Kind::AsyncMaxMsgSize) => {
                let asked = payload.try_into().map_or(0, u64::from_be_bytes);
                self.takes = asked.clamp(HEADER + 1, PAYLOAD_MOST + HEADER);
                let size = (PAYLOAD_MOST + HEADER).to_be_bytes();
                self.output[1].extend(Frame::bytes(Kind::AsyncMaxMsgSizeResponse, 0, 0, &size));
            }
            Some(Kind::AsyncDeviceClear) => self.clear(instrument, locks),
            Some(Kind::AsyncLock) if frame.control > 1 => {
                self.complain(Channel::Asynchronous, Mistake::UnknownControl, "Unrecognized control code");
            }
            // one at a time
            Some(Kind::AsyncLock) if self.wish.is_some() => {
                self.say_aside(Kind::AsyncLockResponse, Lock::Mistaken as u8, 0);
            }
            Some(Kind::AsyncLock) if frame.control == 0 => {
                self.wish = Some(Wish::Release { after: frame.parameter, until: wall + LATE });
            }
            Some(Kind::AsyncLock) => {
                let until = wall + Duration::from_millis(frame.parameter.into());
                self.wish = Some(Wish::Lock { name: payload, until });
            }
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
                    _ => {
                        self.complain(Channel::Asynchronous, Mistake::UnknownControl, "Unrecognized control code");
                        return Ok(());
                    }
                };
                orders.iter().for_each(|order| instrument.panel(*order));
                self.say_aside(Kind::AsyncRemoteLocalResponse, 0, 0);
            }
            _ => return self.refuse(Channel::Asynchronous, &Frame { payload: None, ..frame }),
        }
        Ok(())
    }

    /// In overlapped mode a status query names the last answer that the client has delivered (IVI-6.1, 6.14): others
    /// were sent behind it.
    fn look_for_later_answers(&mut self, delivered: u32, instrument: &mut dyn Instrument) {
        if let Some(at) = self.answers.iter().position(|answer| *answer == delivered) {
            self.answers.drain(..at);
            if self.answers.len() > 1 {
                instrument.hold(true);
            }
        }
    }

    /// Device clear: what waits is dropped, up to a completion that was faster (IVI-6.1, 6.12).
    fn clear(&mut self, instrument: &mut dyn Instrument, locks: &mut Locks) {
        instrument.clear();
        let ended = |frame: &Frame| frame.kind == Some(Kind::DeviceClearComplete);
        let dropped = self.waiting.iter().position(ended).unwrap_or(self.waiting.len());
        self.weight -= self.waiting.drain(..dropped).map(|frame| weight(&frame)).sum::<usize>();
        if self.waiting.is_empty() {
            (self.watch, self.refusing) = (Framer::new(), false);
        }
        // what was foreseen is forgotten by the instrument; what waits still has come behind the clear
        self.foreseen = false;
        (self.doing, self.begun, self.clearing) = (Doing::Nothing, false, true);
        (self.heard, self.message) = (BEFORE_FIRST, BEFORE_FIRST);
        self.answers.clear();
        let lock = match self.wish.take() {
            Some(Wish::Lock { .. }) => Some(Lock::Refused),
            Some(Wish::Release { .. }) => Some(locks.release(self.id)),
            None => None,
        };
        if let Some(lock) = lock {
            self.say_aside(Kind::AsyncLockResponse, lock as u8, 0);
        }
        // synchronised mode is preferred
        self.say_aside(Kind::AsyncDeviceClearAcknowledge, 0, 0);
    }

    /// A lock that is waited for comes, or its time is over; one is given back when its messages are done.
    fn wait_for_lock(&mut self, instrument: &mut dyn Instrument, locks: &mut Locks, wall: Duration) {
        let told = match &self.wish {
            None => return,
            Some(Wish::Lock { name, until }) => {
                let lock = locks.request(self.id, name);
                (lock != Lock::Refused || wall >= *until).then_some(lock)
            }
            Some(Wish::Release { after, until }) => {
                let (after, until) = (*after, *until);
                // who has none need not wait; and what does not come is not waited for without end
                let comes = is_after(after, self.heard) && wall < until;
                let waits = self.waiting.iter().any(|frame| is_data(frame) && !is_after(frame.parameter, after));
                let works =
                    !is_after(self.message, after) && (!matches!(self.doing, Doing::Nothing) || !instrument.is_idle());
                (!locks.has(self.id) || !comes && !waits && !works).then(|| locks.release(self.id))
            }
        };
        if let Some(lock) = told {
            self.wish = None;
            self.say_aside(Kind::AsyncLockResponse, lock as u8, 0);
        }
    }

    /// Goes on at a `wall` time: what the instrument takes and answers, and whether it requests service.
    pub fn turn(&mut self, instrument: &mut dyn Instrument, locks: &mut Locks, wall: Duration) {
        self.go_on(instrument);
        while self.is_ready(instrument, locks, wall) {
            if let Some(frame) = self.waiting.pop_front() {
                self.weight -= weight(&frame);
                self.begin(frame, instrument);
            }
        }
        if self.foreseen && self.waiting.is_empty() && matches!(self.doing, Doing::Nothing) {
            self.foreseen = false;
            instrument.foresee_abort(false);
        }
        self.wait_for_lock(instrument, locks, wall);
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
            instrument.hold(true);
            if end && self.overlap {
                if self.answers.len() == ANSWERS {
                    self.answers.pop_front();
                }
                self.answers.push_back(self.message);
            }
        }
    }

    /// Something that has come is not done yet.
    pub fn has_work(&self) -> bool {
        !self.waiting.is_empty() || !matches!(self.doing, Doing::Nothing)
    }

    /// The instrument takes a message.
    pub fn is_busy(&self) -> bool {
        !matches!(self.doing, Doing::Nothing)
    }
}

/// Bytes of a message that waits.
fn weight(frame: &Frame) -> usize {
    HEADER as usize + frame.payload.as_ref().map_or(0, Vec::len)
}
