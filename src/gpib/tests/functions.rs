//! Each interface function against its state diagram, arrow by arrow.
//!
//! What is expected is written as rules, in another form than the tables of the crate, and compared over all inputs.

use stage_gpib::acceptor::{self, AH};
use stage_gpib::addressing::{Addressing, L, SP, T};
use stage_gpib::device::{Address, Device, Event, Sample};
use stage_gpib::lines::Lines;
use stage_gpib::message::Message;
use stage_gpib::remote::RL;
use stage_gpib::service::SR;
use stage_gpib::source::SH;

const MESSAGES: [Message; 12] = [
    Message::GTL,
    Message::SDC,
    Message::GET,
    Message::LLO,
    Message::DCL,
    Message::SPE,
    Message::SPD,
    Message::MLA,
    Message::UNL,
    Message::MTA,
    Message::OTA,
    Message::Ignored,
];

#[test]
fn every_code_means_what_the_standard_says() {
    for mine in 0..=30_u8 {
        let address = Address::new(mine).expect("an address");
        for code in 0..=255_u8 {
            let expected = match code & 0x7F {
                0x01 => Message::GTL,
                0x04 => Message::SDC,
                0x08 => Message::GET,
                0x11 => Message::LLO,
                0x14 => Message::DCL,
                0x18 => Message::SPE,
                0x19 => Message::SPD,
                0x3F => Message::UNL,
                listen @ 0x20..=0x3E if listen - 0x20 == mine => Message::MLA,
                talk @ 0x40..=0x5F if talk - 0x40 == mine => Message::MTA,
                0x40..=0x5F => Message::OTA,
                _ => Message::Ignored,
            };
            assert_eq!(Message::read(code, address), expected, "{code:#04x} at {mine}");
        }
    }
    assert_eq!(Address::new(31), None);
}

#[test]
fn the_acceptor_follows_its_diagram() {
    for state in [AH::AIDS, AH::ANRS, AH::ACRS, AH::ACDS, AH::AWNS] {
        for bits in 0..32 {
            let [attention, settled, valid, addressed, ready] = [1, 2, 4, 8, 16].map(|bit| bits & bit != 0);
            let takes_part = attention || addressed;
            let may_be_ready = if attention { settled } else { ready };
            let expected = match state {
                _ if !takes_part => AH::AIDS,
                AH::AIDS => AH::ANRS,
                AH::ANRS => match (attention && valid, may_be_ready) {
                    (true, _) => AH::AWNS,
                    (false, true) => AH::ACRS,
                    (false, false) => AH::ANRS,
                },
                AH::ACRS => match (may_be_ready, valid) {
                    (false, _) => AH::ANRS,
                    (true, true) => AH::ACDS,
                    (true, false) => AH::ACRS,
                },
                AH::ACDS => [AH::ACRS, AH::AWNS][valid as usize],
                AH::AWNS => [AH::ANRS, AH::AWNS][valid as usize],
            };
            let input = acceptor::Input { attention, settled, valid, addressed, ready };
            assert_eq!(state.next(input), expected, "{state:?} {input:?}");
        }
    }
}

#[test]
fn each_acceptor_state_sends_what_the_standard_says() {
    // state, RFD sent false, DAC sent false
    let expected = [
        (AH::AIDS, false, false),
        (AH::ANRS, true, true),
        (AH::ACRS, false, true),
        (AH::ACDS, true, true),
        (AH::AWNS, true, false),
    ];
    for (state, not_ready, not_accepted) in expected {
        assert_eq!(state.lines().has(Lines::NRFD), not_ready, "{state:?}");
        assert_eq!(state.lines().has(Lines::NDAC), not_accepted, "{state:?}");
    }
}

#[test]
fn talker_and_listener_follow_their_messages() {
    for message in MESSAGES {
        for talker in [T::TIDS, T::TADS] {
            for poll in [SP::SPIS, SP::SPMS] {
                for listener in [L::LIDS, L::LADS] {
                    let mut addressing = Addressing { talker, poll, listener };
                    addressing.on_message(message);
                    let talks = match message {
                        Message::MTA => true,
                        Message::OTA | Message::MLA => false,
                        _ => talker == T::TADS,
                    };
                    let listens = match message {
                        Message::MLA => true,
                        Message::UNL | Message::MTA => false,
                        _ => listener == L::LADS,
                    };
                    let polls = match message {
                        Message::SPE => true,
                        Message::SPD => false,
                        _ => poll == SP::SPMS,
                    };
                    assert_eq!(addressing.talker == T::TADS, talks, "{message:?}");
                    assert_eq!(addressing.listener == L::LADS, listens, "{message:?}");
                    assert_eq!(addressing.poll == SP::SPMS, polls, "{message:?}");
                }
            }
        }
    }
}

#[test]
fn who_is_addressed_is_active_while_attention_is_false() {
    for (poll, active) in [(SP::SPIS, T::TACS), (SP::SPMS, T::SPAS)] {
        let mut talker = Addressing { talker: T::TADS, poll, listener: L::LIDS };
        talker.on_attention(false);
        assert_eq!((talker.talker, talker.listener), (active, L::LIDS));
        assert!(talker.talks());
        talker.on_attention(true);
        assert_eq!(talker.talker, T::TADS);
        assert!(!talker.talks());
    }
    let mut listener = Addressing { talker: T::TIDS, poll: SP::SPIS, listener: L::LADS };
    listener.on_attention(false);
    assert_eq!(listener.listener, L::LACS);
    listener.on_attention(true);
    assert_eq!(listener.listener, L::LADS);
    let mut idle = Addressing::IDLE;
    idle.on_attention(false);
    assert_eq!(idle, Addressing::IDLE);
}

#[test]
fn service_request_follows_its_diagram() {
    for (state, request, polled, expected) in [
        (SR::NPRS, false, false, SR::NPRS),
        (SR::NPRS, false, true, SR::NPRS),
        (SR::NPRS, true, false, SR::SRQS),
        (SR::NPRS, true, true, SR::NPRS),
        (SR::SRQS, false, false, SR::NPRS),
        (SR::SRQS, false, true, SR::APRS),
        (SR::SRQS, true, false, SR::SRQS),
        (SR::SRQS, true, true, SR::APRS),
        (SR::APRS, false, false, SR::NPRS),
        (SR::APRS, false, true, SR::APRS),
        (SR::APRS, true, false, SR::APRS),
        (SR::APRS, true, true, SR::APRS),
    ] {
        assert_eq!(state.next(request, polled), expected, "{state:?} rsv {request} SPAS {polled}");
    }
}

#[test]
fn remote_and_local_with_lockout_follow_their_diagram() {
    for state in [RL::LOCS, RL::REMS, RL::RWLS, RL::LWLS] {
        let remote = state.is_remote();
        let locked = matches!(state, RL::RWLS | RL::LWLS);
        for message in MESSAGES {
            for listens in [false, true] {
                for local_key in [false, true] {
                    let remote = match message {
                        // the key is dead under lockout
                        Message::MLA => remote || locked || !local_key,
                        Message::GTL => remote && !listens,
                        _ => remote,
                    };
                    let locked = locked || message == Message::LLO;
                    let expected = match (remote, locked) {
                        (false, false) => RL::LOCS,
                        (true, false) => RL::REMS,
                        (true, true) => RL::RWLS,
                        (false, true) => RL::LWLS,
                    };
                    assert_eq!(state.on_message(message, listens, local_key), expected, "{state:?} {message:?}");
                }
            }
        }
        assert_eq!(state.on_local_key(), if state == RL::REMS { RL::LOCS } else { state });
    }
}

/// A device alone on a bus whose other lines the test sets.
struct Alone {
    device: Device,
    now: u64,
    armed: bool,
    own: Lines,
}

impl Alone {
    fn new() -> Alone {
        Alone { device: Device::new(Address::new(5).expect("an address")), now: 0, armed: false, own: Lines::NONE }
    }

    /// One step, `nanoseconds` after the last, with what others make true.
    fn step(&mut self, nanoseconds: u64, others: Lines) -> Option<Event> {
        self.now += nanoseconds;
        self.armed &= !others.has(Lines::ATN);
        let step = self.device.step(self.now, Sample { lines: self.own | others, armed: self.armed });
        self.own = step.drive.lines;
        self.armed |= step.drive.arm;
        step.event
    }

    /// An interface message, shaken through; what the device told of it.
    fn command(&mut self, code: u8, with: Lines) -> Vec<Event> {
        let attention = Lines::ATN | with;
        let mut told = Vec::new();
        while self.own != Lines::NDAC {
            told.extend(self.step(300, attention));
        }
        while self.own.has(Lines::NDAC) {
            told.extend(self.step(300, attention | Lines::DAV | Lines::of_byte(code)));
        }
        told.extend(self.step(300, attention));
        told
    }
}

#[test]
fn a_device_that_wakes_in_the_middle_of_a_command_lets_it_pass() {
    let mut alone = Alone::new();
    let passing = Lines::ATN | Lines::DAV | Lines::of_byte(0x25);
    for _ in 0..4 {
        assert_eq!(alone.step(1_000, passing), None);
    }
    assert!(!alone.own.has(Lines::NDAC), "the controller waits for nobody");
    assert_eq!(alone.device.states().addressing, Addressing::IDLE, "and what was not heard whole was not heard");
    alone.command(0x25, Lines::NONE);
    assert_eq!(alone.device.states().addressing.listener, L::LADS);
}

#[test]
fn data_that_stand_under_a_new_attention_are_no_interface_message() {
    let mut alone = Alone::new();
    alone.device.accept();
    alone.command(0x25, Lines::NONE);
    for _ in 0..3 {
        alone.step(300, Lines::NONE);
    }
    assert_eq!(alone.own, Lines::NDAC, "ready for data");
    // a talker that has not left yet, with the code of device clear
    let stale = Lines::ATN | Lines::DAV | Lines::of_byte(0x14);
    assert_eq!(alone.step(100, Lines::ATN), None);
    for _ in 0..3 {
        assert_eq!(alone.step(40, stale), None);
    }
    assert_eq!(alone.command(0x14, Lines::NONE), [Event::Clear], "a real one is heard");
}

#[test]
fn a_byte_that_was_withdrawn_or_replaced_before_dav_does_not_leave() {
    let mut alone = Alone::new();
    alone.command(0x45, Lines::NONE);
    alone.device.offer(b'x', true);
    for _ in 0..9 {
        alone.step(1_000, Lines::NRFD | Lines::NDAC);
    }
    assert_eq!(alone.own, Lines::of_byte(b'x') | Lines::EOI);
    alone.device.withdraw();
    assert_eq!(alone.step(1_000, Lines::NDAC), Some(Event::ByteRequested));
    assert_eq!(alone.own, Lines::NONE);
    alone.device.offer(b'y', false);
    alone.step(1_000, Lines::NDAC);
    alone.device.offer(b'z', false);
    for _ in 0..5 {
        assert_eq!(alone.step(1_000, Lines::NDAC), None);
    }
    assert_eq!(alone.own, Lines::of_byte(b'z') | Lines::DAV);
    assert_eq!(alone.step(1_000, Lines::NRFD), Some(Event::Sent { end: false, cut: false }));
}

#[test]
fn a_byte_on_the_bus_leaves_even_if_withdrawn() {
    let mut alone = Alone::new();
    alone.command(0x45, Lines::NONE);
    alone.device.offer(b'x', true);
    while !alone.own.has(Lines::DAV) {
        alone.step(1_000, Lines::NDAC);
    }
    alone.device.withdraw();
    alone.step(1_000, Lines::NRFD | Lines::NDAC);
    assert!(alone.own.has(Lines::DAV));
    assert_eq!(alone.step(1_000, Lines::NRFD), Some(Event::Sent { end: true, cut: false }));
}

#[test]
fn attention_and_interface_clear_cut_a_byte_that_is_on_the_bus() {
    for cut in [Lines::ATN, Lines::IFC] {
        let mut alone = Alone::new();
        alone.command(0x45, Lines::NONE);
        alone.device.offer(b'x', true);
        while !alone.own.has(Lines::DAV) {
            alone.step(1_000, Lines::NDAC);
        }
        assert_eq!(alone.step(1_000, cut | Lines::NDAC), Some(Event::Sent { end: true, cut: true }), "{cut:?}");
        assert!(!alone.own.has(Lines::DAV | Lines::DIO | Lines::EOI));
        alone.step(1_000, cut);
        assert_eq!(alone.device.states().source, SH::SIDS);
    }
}

#[test]
fn the_local_key_returns_to_local_but_not_under_lockout() {
    let mut alone = Alone::new();
    assert_eq!(alone.command(0x25, Lines::REN), [Event::Remote(RL::REMS)]);
    alone.device.set_local_key(true);
    assert_eq!(alone.step(1_000, Lines::REN), Some(Event::Remote(RL::LOCS)));
    assert_eq!(alone.command(0x25, Lines::REN), [], "addressed with the key held: stays local");
    alone.device.set_local_key(false);
    assert_eq!(alone.command(0x25, Lines::REN), [Event::Remote(RL::REMS)]);
    assert_eq!(alone.command(0x11, Lines::REN), [Event::Remote(RL::RWLS)]);
    alone.device.set_local_key(true);
    assert_eq!(alone.step(1_000, Lines::REN), None);
    assert_eq!(alone.step(1_000, Lines::NONE), Some(Event::Remote(RL::LOCS)), "REN false ends lockout");
}

#[test]
fn without_ren_nothing_makes_the_device_remote() {
    let mut alone = Alone::new();
    for code in [0x25, 0x11, 0x25] {
        assert_eq!(alone.command(code, Lines::NONE), []);
    }
    assert_eq!(alone.device.states().remote, RL::LOCS);
}

#[test]
fn a_controller_waits_until_clear_and_trigger_were_told() {
    let mut alone = Alone::new();
    alone.command(0x25, Lines::NONE);
    for (code, event) in [(0x04, Event::Clear), (0x08, Event::Trigger), (0x14, Event::Clear)] {
        let put = Lines::ATN | Lines::DAV | Lines::of_byte(code);
        while alone.own != Lines::NDAC {
            alone.step(300, Lines::ATN);
        }
        assert_eq!(alone.step(300, put), Some(event));
        assert!(alone.own.has(Lines::NDAC), "not accepted before the event is dealt with");
        alone.step(300, put);
        assert!(!alone.own.has(Lines::NDAC));
    }
}

#[test]
fn a_request_that_comes_in_the_middle_of_a_poll_waits_for_the_next() {
    let mut alone = Alone::new();
    alone.command(0x18, Lines::NONE);
    alone.command(0x45, Lines::NONE);
    alone.step(1_000, Lines::NDAC);
    alone.device.set_status(0x10, true);
    while !alone.own.has(Lines::DAV) {
        alone.step(1_000, Lines::NDAC);
    }
    assert_eq!(alone.own.byte(), 0x10, "RQS only after SRQ");
    assert_eq!(alone.step(1_000, Lines::NONE), Some(Event::Polled { status: 0x10, cut: false }));
    alone.step(1_000, Lines::ATN);
    assert!(alone.own.has(Lines::SRQ));
}

#[test]
fn whatever_was_on_the_lines_after_ifc_the_device_hears_and_speaks() {
    let mut bits = 1_u64;
    let mut noise = move || {
        bits ^= bits << 13;
        bits ^= bits >> 7;
        bits ^= bits << 17;
        bits.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32
    };
    for _ in 0..20_000 {
        let mut alone = Alone::new();
        for _ in 0..40 {
            if noise() % 4 == 0 {
                alone.device.offer(noise() as u8, noise() % 2 == 0);
                alone.device.accept();
            }
            alone.step(noise() % 3_000, Lines::from_bits(noise() as u16));
        }
        alone.device.withdraw();
        alone.device.accept();
        for _ in 0..3 {
            alone.step(1_000, Lines::IFC);
        }
        assert_eq!(alone.device.states().addressing, Addressing::IDLE);
        assert!(!alone.own.has(Lines::from_bits(!Lines::SRQ.bits())), "{:?}", alone.own);
        // hears
        alone.command(0x25, Lines::NONE);
        while alone.own != Lines::NDAC {
            alone.step(1_000, Lines::NONE);
        }
        let byte = Lines::DAV | Lines::of_byte(b'?') | Lines::EOI;
        assert_eq!(alone.step(1_000, byte), Some(Event::Byte { byte: b'?', end: true }));
        alone.step(1_000, byte);
        alone.step(1_000, Lines::NONE);
        // speaks
        alone.command(0x19, Lines::NONE);
        alone.command(0x45, Lines::NONE);
        alone.device.offer(b'!', true);
        for _ in 0..10 {
            alone.step(1_000, Lines::NDAC);
        }
        assert_eq!(
            alone.own.only(Lines::from_bits(!Lines::SRQ.bits())),
            Lines::of_byte(b'!') | Lines::EOI | Lines::DAV
        );
        assert_eq!(alone.step(1_000, Lines::NRFD), Some(Event::Sent { end: true, cut: false }));
    }
}
