//! One device on the bus: lines in, lines and events out.

use crate::acceptor::{self, AH};
use crate::addressing::{Addressing, L, T};
use crate::lines::Lines;
use crate::message::Message;
use crate::remote::RL;
use crate::service::SR;
use crate::source::{self, Offer, SH, Source};
use crate::timing::{ATTENTION_ANSWER, Nanoseconds};

/// Primary address, 0 to 30.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address(u8);

impl Address {
    /// `None` above 30: 31 is nobody (unlisten, untalk).
    pub const fn new(address: u8) -> Option<Address> {
        if address <= 30 { Some(Address(address)) } else { None }
    }

    /// 0 to 30.
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// Device clear states (DC1; IEEE 488.1, 2.10).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DC {
    /// Idle.
    DCIS,
    /// Active: a clear is being accepted.
    DCAS,
}

/// Device trigger states (DT1; IEEE 488.1, 2.11).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DT {
    /// Idle.
    DTIS,
    /// Active: a trigger is being accepted.
    DTAS,
}

/// What the bus and the gates show at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// All lines. Where one read does not show all sixteen, DAV is read before DIO and EOI.
    pub lines: Lines,
    /// The gates let data through: [`Drive::arm`] was pulsed, and ATN was not true since.
    pub armed: bool,
}

/// What goes to the transceivers and the gates: levels first, then the pulse.
///
/// The gates (docs/GPIB-BOARD.md) are one flip-flop, armed by a pulse and cleared by ATN, and two functions:
/// TE = `talk_enable` and armed; NRFD and NDAC are held unless armed, or ATN is true and `attention_seen`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drive {
    /// Lines that this device makes true.
    pub lines: Lines,
    /// The device knows that ATN is true and has the handshake in hand.
    pub attention_seen: bool,
    /// Drive DIO, DAV and EOI, receive NRFD and NDAC: TE of SN75160 and SN75161, if the gates agree.
    pub talk_enable: bool,
    /// Pulse: data may pass. Given only to gates that were seen disarmed, for a pulse at every step would hide an ATN
    /// that came and went between two samples.
    pub arm: bool,
    /// PE of SN75160: three-state drivers. Always: without a parallel poll nothing asks for open collector.
    pub pullup_enable: bool,
    /// DC of SN75161: receive ATN, REN and IFC, send SRQ. Always: the device is no controller.
    pub direction: bool,
}

/// What a message exchange has to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A byte of a message was taken; `end` if EOI was true. The next one waits for [`Device::accept`].
    Byte {
        /// The byte.
        byte: u8,
        /// The last byte of a message.
        end: bool,
    },
    /// The device is to talk and has nothing to say: [`Device::offer`]. Told once each time (brq of IEEE 488.2).
    ByteRequested,
    /// The byte that was offered left; the next one is welcome.
    Sent {
        /// It was the last byte of a message.
        end: bool,
        /// ATN or IFC came before its acceptance: it may or may not have arrived. It is not to be repeated.
        cut: bool,
    },
    /// The status byte left in a serial poll.
    Polled {
        /// The status byte, with RQS.
        status: u8,
        /// As in [`Event::Sent`].
        cut: bool,
    },
    /// Device clear, selected or not; an offered byte is withdrawn already. The controller waits until the next step.
    Clear,
    /// Trigger. The controller waits until the next step.
    Trigger,
    /// Another state of remote and local.
    Remote(RL),
}

/// What one step made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// To be put on the lines before the next sample is taken.
    pub drive: Drive,
    /// To be dealt with before the next step.
    pub event: Option<Event>,
}

/// The states of all interface functions, for tests and displays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct States {
    /// Acceptor handshake.
    pub acceptor: AH,
    /// Source handshake.
    pub source: SH,
    /// Talker, serial poll mode, listener.
    pub addressing: Addressing,
    /// Service request.
    pub service: SR,
    /// Remote local.
    pub remote: RL,
    /// Device clear.
    pub clear: DC,
    /// Device trigger.
    pub trigger: DT,
}

/// A device with the interface functions of [`crate::CAPABILITY`].
///
/// # Use
///
/// A loop or an interrupt takes a [`Sample`], calls [`Device::step`], puts [`Drive`] on the pins and deals with the
/// [`Event`]: as often as it likes, and within t4 (100 us) of IFC and of REN. Every state of a handshake waits for the
/// others, so a slow caller makes a slow bus and nothing worse; what cannot wait is in the gates.
///
/// # Local messages of the standard
///
/// | message | here |
/// |---|---|
/// | pon | [`Device::new`] |
/// | rdy | [`Device::accept`] |
/// | nba | [`Device::offer`], [`Device::withdraw`] |
/// | rsv | [`Device::set_status`] |
/// | rtl | [`Device::set_local_key`] |
///
/// IEEE 488.2 (11.3.3) makes rsv from the edges of MSS: true at reqt; false at reqf, and at [`Event::Polled`] with
/// value 64 in the status byte.
#[derive(Clone, Copy, Debug)]
pub struct Device {
    address: Address,
    states: States,
    source: Source,
    /// Since when ATN is true, as far as steps saw it.
    attention: Option<Nanoseconds>,
    /// The gates were seen armed, so that their being disarmed tells of an ATN.
    armed: bool,
    ready: bool,
    offer: Option<Offer>,
    asked: bool,
    status: u8,
    request: bool,
    local_key: bool,
}

/// Bit 7 of the status byte: this device requested service.
const RQS: u8 = 0x40;

impl Device {
    /// After power-on: idle and local, with no room for a byte yet.
    pub const fn new(address: Address) -> Device {
        Device {
            address,
            states: States {
                acceptor: AH::AIDS,
                source: SH::SIDS,
                addressing: Addressing::IDLE,
                service: SR::NPRS,
                remote: RL::LOCS,
                clear: DC::DCIS,
                trigger: DT::DTIS,
            },
            source: Source::IDLE,
            attention: None,
            armed: false,
            ready: false,
            offer: None,
            asked: false,
            status: 0,
            request: false,
            local_key: false,
        }
    }

    /// There is room for one more byte. Cannot be taken back: a source may already count on it.
    pub fn accept(&mut self) {
        self.ready = true;
    }

    /// The next byte to send when the device is made to talk; replaces one that was offered and did not leave.
    pub fn offer(&mut self, byte: u8, end: bool) {
        self.offer = Some(Offer { byte, end });
    }

    /// Nothing more to send. A byte that is already on the bus with DAV still leaves, and says so.
    pub fn withdraw(&mut self) {
        self.offer = None;
    }

    /// The status byte for serial polls, and whether the device asks for one (rsv). Its bit 7 is ignored: SR1 makes it.
    pub fn set_status(&mut self, status: u8, request: bool) {
        self.status = status & !RQS;
        self.request = request;
    }

    /// The key that returns to local is pressed or released (rtl).
    pub fn set_local_key(&mut self, pressed: bool) {
        self.local_key = pressed;
    }

    /// The states of all interface functions.
    pub fn states(&self) -> States {
        States { source: self.source.state, ..self.states }
    }

    /// Looks at the bus once: each handshake goes on by one state that the others can see, and at most one event is
    /// told.
    ///
    /// `now` is when the sample was taken.
    pub fn step(&mut self, now: Nanoseconds, sample: Sample) -> Step {
        let event = self.run(now, sample);
        Step { drive: self.drive(sample), event }
    }

    fn run(&mut self, now: Nanoseconds, sample: Sample) -> Option<Event> {
        // an ATN that no sample saw ends what it would have ended
        let missed = self.armed && !sample.armed;
        let attention = sample.lines.has(Lines::ATN) || missed;
        self.armed = sample.armed && !attention;
        self.attention = if attention { self.attention.or(Some(now)) } else { None };
        if sample.lines.has(Lines::IFC) {
            self.states.addressing = Addressing::IDLE;
        }
        self.states.addressing.on_attention(attention);
        let polled = self.states.addressing.talker == T::SPAS;
        self.states.service = self.states.service.next(self.request, polled);
        // Both handshakes go on whatever there is to tell: `attention_seen` releases the gates. They never tell at the
        // same time, for who sends does not accept; what is left for later is a level.
        let sent = self.send(now, sample);
        let taken = self.take(now, sample.lines);
        sent.or(taken).or_else(|| self.localise(sample.lines))
    }

    /// REN false and the local key: the two ways to local without a message.
    fn localise(&mut self, lines: Lines) -> Option<Event> {
        let remote = match (lines.has(Lines::REN), self.local_key) {
            (false, _) => RL::LOCS,
            (true, true) => self.states.remote.on_local_key(),
            (true, false) => self.states.remote,
        };
        self.enter(remote)
    }

    fn enter(&mut self, remote: RL) -> Option<Event> {
        let changed = remote != self.states.remote;
        self.states.remote = remote;
        changed.then_some(Event::Remote(remote))
    }

    /// The source handshake, and what it has to tell.
    fn send(&mut self, now: Nanoseconds, sample: Sample) -> Option<Event> {
        let polled = self.states.addressing.talker == T::SPAS;
        // arrows that no line shows are gone at once: SWNS, SGNS, SDYS
        for _ in 0..3 {
            let input = source::Input {
                active: self.states.addressing.talks(),
                enabled: sample.armed,
                not_ready: sample.lines.has(Lines::NRFD),
                not_accepted: sample.lines.has(Lines::NDAC),
                offer: if polled { Some(self.status_byte()) } else { self.offer },
                polled,
            };
            let before = self.source.state;
            if let Some(left) = self.source.step(now, input) {
                return Some(self.left(left));
            }
            if self.source.state == before || self.source.state == SH::SDYS {
                break;
            }
        }
        let starved = self.source.state == SH::SGNS && !polled && self.offer.is_none();
        let request = starved && !self.asked;
        self.asked = starved;
        request.then_some(Event::ByteRequested)
    }

    fn status_byte(&self) -> Offer {
        let rqs = if self.states.service == SR::APRS { RQS } else { 0 };
        Offer { byte: self.status | rqs, end: false }
    }

    fn left(&mut self, left: source::Left) -> Event {
        let Offer { byte, end } = self.source.offer();
        if self.source.polls() {
            Event::Polled { status: byte, cut: left.cut }
        } else {
            self.offer = None;
            Event::Sent { end, cut: left.cut }
        }
    }

    /// The acceptor handshake, and what it has to tell.
    fn take(&mut self, now: Nanoseconds, lines: Lines) -> Option<Event> {
        let settled = |since| now.saturating_sub(since) >= ATTENTION_ANSWER;
        let next = self.states.acceptor.next(acceptor::Input {
            attention: self.attention.is_some(),
            settled: self.attention.is_some_and(settled),
            valid: lines.has(Lines::DAV),
            addressed: self.states.addressing.listener != L::LIDS,
            ready: self.ready,
        });
        let enters = next == AH::ACDS && self.states.acceptor != AH::ACDS;
        self.states.acceptor = next;
        if next != AH::ACDS {
            self.states.clear = DC::DCIS;
            self.states.trigger = DT::DTIS;
        }
        match (enters, self.attention) {
            (false, _) => None,
            (true, Some(_)) => self.obey(Message::read(lines.byte(), self.address), lines.has(Lines::REN)),
            (true, None) => {
                self.ready = false;
                Some(Event::Byte { byte: lines.byte(), end: lines.has(Lines::EOI) })
            }
        }
    }

    /// An interface message was accepted.
    fn obey(&mut self, message: Message, remote_enable: bool) -> Option<Event> {
        let listens = self.states.addressing.listener == L::LADS;
        self.states.addressing.on_message(message);
        match message {
            Message::DCL => Some(self.clear()),
            Message::SDC if listens => Some(self.clear()),
            Message::GET if listens => {
                self.states.trigger = DT::DTAS;
                Some(Event::Trigger)
            }
            _ if remote_enable => self.enter(self.states.remote.on_message(message, listens, self.local_key)),
            _ => None,
        }
    }

    fn clear(&mut self) -> Event {
        self.states.clear = DC::DCAS;
        self.offer = None;
        Event::Clear
    }

    fn drive(&self, sample: Sample) -> Drive {
        let attention_seen = self.attention.is_some();
        Drive {
            lines: self.states.acceptor.lines()
                | self.source.lines()
                | Lines::SRQ.when(self.states.service == SR::SRQS),
            attention_seen,
            talk_enable: self.states.addressing.talks(),
            arm: !attention_seen && !sample.armed,
            pullup_enable: true,
            direction: true,
        }
    }
}
