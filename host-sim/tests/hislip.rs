//! HiSLIP before a board and a power meter, without sockets: what any client may do to it.

mod lab;
#[path = "lab/pieces.rs"]
mod pieces;

use host_sim::board::Seeded;
use host_sim::control::Hand;
use host_sim::gpib::{Bus, Instrument, Ports};
use host_sim::hislip::{Channel, Fatal, Frame, Frames, Kind, Link, Locks, Over};
use host_sim::server::{OnHislip, Served};
use lab::Bench3;
use mio::Poll;
use pieces::PIECES;
use stage_controller::scpi::exchange::Exchange;
use stage_controller::scpi::session::Session;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

const SEQUENCES: usize = 100_000;
/// The client has read the last answer.
const READ: u8 = 1;
const CHANNELS: [Channel; 2] = [Channel::Synchronous, Channel::Asynchronous];

/// A client of the board at 5 or the meter at 7.
struct Caller {
    bus: Bench3,
    at: u8,
    link: Link,
    locks: Locks,
    /// What the server has not taken yet.
    waiting: [Vec<u8>; 2],
    wall: Duration,
    message: u32,
    /// The server has ended the session.
    over: Option<Over>,
}

impl Caller {
    fn new() -> Self {
        let (bus, locks) = (Bench3::new(), Locks::default());
        let (waiting, wall) = (Default::default(), Duration::ZERO);
        Caller { bus, at: 5, link: Link::new(1), locks, waiting, wall, message: 0xffff_ff00, over: None }
    }

    /// What comes back on either channel.
    fn turn(&mut self) -> [Vec<Frame>; 2] {
        let Caller { bus, link, locks, waiting, wall, over, .. } = self;
        let mut instrument = bus.instrument(self.at, *wall).unwrap();
        let mut heard = [Vec::new(), Vec::new()];
        loop {
            let mut any = false;
            for (channel, waiting) in CHANNELS.into_iter().zip(&mut *waiting) {
                if over.is_none() {
                    match link.receive(channel, waiting, &mut *instrument, locks, *wall) {
                        Ok(taken) => {
                            any |= taken > 0;
                            waiting.drain(..taken);
                        }
                        Err(reason) => *over = Some(reason),
                    }
                }
            }
            link.turn(&mut *instrument, locks, *wall);
            for (channel, heard) in CHANNELS.into_iter().zip(&mut heard) {
                let output = link.output(channel);
                any |= !output.is_empty();
                let mut frames = Frames::default();
                while let (taken, Some(frame)) = frames.take(output).unwrap() {
                    output.drain(..taken);
                    heard.push(frame);
                }
                assert!(output.is_empty(), "whole messages");
            }
            if !any {
                return heard;
            }
        }
    }

    /// As [`Caller::turn`]: kind and control code of what comes.
    fn told(&mut self) -> [Vec<(Kind, u8)>; 2] {
        self.turn().map(|frames| frames.iter().map(|frame| (frame.kind.unwrap(), frame.control)).collect())
    }

    fn send(&mut self, kind: Kind, control: u8, payload: &[u8]) {
        self.waiting[0].extend(Frame::bytes(kind, control, self.message, payload));
        self.message = self.message.wrapping_add(2);
    }

    fn aside(&mut self, kind: Kind, control: u8, parameter: u32, payload: &[u8]) {
        self.waiting[1].extend(Frame::bytes(kind, control, parameter, payload));
    }

    fn clear(&mut self, feature: u8) {
        self.aside(Kind::AsyncDeviceClear, 0, 0, b"");
        let acknowledged = |heard: &[Frame], kind| heard.iter().any(|frame| frame.kind == Some(kind));
        assert!(acknowledged(&self.turn()[1], Kind::AsyncDeviceClearAcknowledge));
        self.waiting[0].extend(Frame::bytes(Kind::DeviceClearComplete, feature, 0, b""));
        assert!(acknowledged(&self.turn()[0], Kind::DeviceClearAcknowledge));
        self.message = 0xffff_ff00;
    }

    /// The connection is lost and made anew.
    fn hang_up(&mut self) {
        self.locks.forget(1);
        self.link = Link::new(1);
        (self.waiting, self.message, self.over) = (Default::default(), 0xffff_ff00, None);
        match self.at {
            7 => self.bus.meter = (host_sim::power_meter::Session::new(), Exchange::new()),
            _ => self.bus.links[0] = (Session::new(0), Exchange::new()),
        }
    }

    /// The status byte.
    fn status(&mut self, control: u8, message: u32) -> u8 {
        self.aside(Kind::AsyncStatusQuery, control, message, b"");
        let told = self.told();
        told[1].iter().find(|(kind, _)| *kind == Kind::AsyncStatusResponse).unwrap().1
    }

    /// Virtual time until nothing moves, segments.
    fn until_rest(&mut self) -> usize {
        for segments in 0..100_000 {
            self.turn();
            if !self.bus.moves() {
                return segments;
            }
            self.bus.pass(1);
        }
        panic!("it never rests");
    }

    /// It still moves after so many segments.
    fn moves_for(&mut self, segments: usize) -> bool {
        (0..segments).all(|_| {
            self.bus.pass(1);
            self.turn();
            self.bus.moves()
        })
    }

    fn errors(&mut self) -> Vec<i32> {
        let mut errors = Vec::new();
        loop {
            match self.ask("SYST:ERR?", READ).split(',').next().unwrap().parse().unwrap() {
                0 => return errors,
                error => errors.push(error),
            }
        }
    }

    /// The answer to a question, with the number of its message.
    fn ask(&mut self, text: &str, control: u8) -> String {
        let asked = self.message;
        self.send(Kind::DataEnd, control, text.as_bytes());
        let mut answer = Vec::new();
        for frame in &self.turn()[0] {
            if matches!(frame.kind, Some(Kind::Data | Kind::DataEnd)) && frame.parameter == asked {
                answer.extend(frame.payload.as_deref().unwrap());
            }
        }
        String::from_utf8(answer).unwrap()
    }
}

const IDENTITY: &str = "Stage Controller,SC6,0,0.1.0\n";
const QUESTIONS: [(&str, &str); 3] =
    [("*IDN?", IDENTITY), ("*ESE?;:SYST:ERR?\n", "0;0,\"No error\"\n"), ("AXIS1:POS:COMM?;*SRE?", "0.000;0\n")];

impl Caller {
    /// Answers come in messages of one byte each.
    fn take_single_bytes(&mut self) {
        self.aside(Kind::AsyncMaxMsgSize, 0, 0, &17_u64.to_be_bytes());
        assert_eq!(self.turn()[1].len(), 1);
    }
}

#[test]
fn a_clear_at_each_byte_of_a_question_or_behind_its_answer_leaves_nothing_of_it_and_no_error() {
    for ((question, answer), overlap) in QUESTIONS.into_iter().flat_map(|q| [(q, 0), (q, 1)]) {
        for at in 0..=question.len() {
            let mut link = Caller::new();
            link.take_single_bytes();
            link.clear(overlap);
            let context = format!("{question:?} {at} {overlap}");
            if at == question.len() {
                link.send(Kind::DataEnd, READ, question.as_bytes());
                let parts = link.turn()[0].iter().filter_map(|frame| frame.payload.clone()).collect::<Vec<_>>();
                assert!(parts.iter().all(|part| part.len() == 1) && parts.concat() == answer.as_bytes(), "{context}");
            } else if at > 0 {
                link.send(Kind::Data, READ, &question.as_bytes()[..at]);
                assert_eq!(link.turn(), [vec![], vec![]], "{context}");
            }
            link.clear(0);
            // nothing of it comes behind the clear
            assert_eq!(link.turn(), [vec![], vec![]], "{context}");
            assert_eq!(link.ask("*IDN?", READ), IDENTITY, "{context}");
            assert_eq!(link.errors(), Vec::<i32>::new(), "{context}");
        }
    }
}

#[test]
fn a_message_that_stops_at_each_byte_of_its_header_or_text_hangs_up_without_a_trace() {
    for (question, _) in QUESTIONS {
        let whole = Frame::bytes(Kind::DataEnd, READ, 0xffff_ff00, question.as_bytes());
        for at in 0..=whole.len() {
            let mut link = Caller::new();
            link.waiting[0].extend(&whole[..at]);
            let answered = !link.turn()[0].is_empty();
            assert_eq!(answered, at == whole.len(), "{question:?} {at}");
            link.hang_up();
            assert_eq!(link.ask("*IDN?", 0), IDENTITY, "{question:?} {at}");
            assert_eq!(link.errors(), Vec::<i32>::new(), "{question:?} {at}");
        }
    }
}

#[test]
fn a_question_before_the_answer_is_said_to_be_read_is_the_error_of_the_standard() {
    for (question, answer) in QUESTIONS {
        let mut link = Caller::new();
        assert_eq!(link.ask(question, 0), answer);
        assert_eq!(link.ask("*IDN?", 0), IDENTITY, "{question:?}");
        assert_eq!(link.errors(), [-410], "{question:?}");
        assert_eq!(link.ask(question, READ), answer);
        assert_eq!(link.errors(), Vec::<i32>::new(), "it said that it was read");
    }
}

#[test]
fn no_client_wedges_a_link() {
    let (mut link, mut random, mut seen) = (Caller::new(), Seeded::new(4880), BTreeMap::new());
    let mut count = |kind: &'static str, more: usize| *seen.entry(kind).or_insert(0) += more;
    for sequence in 0..SEQUENCES {
        link.at = if random.below(4) == 0 { 7 } else { 5 };
        link.hang_up();
        for _ in 0..random.below(14) {
            let control = random.below(2) as u8;
            let piece = PIECES[random.below(PIECES.len() as u64) as usize];
            if let Some(over) = link.over {
                assert_eq!(over, Over::Refused(Fatal::BadInitialization), "sequence {sequence}");
                count("sent away", 1);
                link.hang_up();
            }
            match random.below(23) {
                0..=8 => link.send(Kind::DataEnd, control, piece),
                9..=10 => link.send(Kind::Data, control, piece),
                11 => link.send(Kind::Trigger, control, b""),
                12 => link.aside(Kind::AsyncStatusQuery, control, 0, b""),
                13 => {
                    link.turn();
                    if link.over.is_none() {
                        link.clear(control);
                    }
                }
                14 => link.aside(Kind::AsyncLock, control, 50, if random.below(2) == 0 { b"" } else { b"name" }),
                15 => link.send(Kind::Initialize, 0, b"hislip0"),
                16 => {
                    link.send(Kind::DataEnd, 0, if random.below(40) == 0 { b"AXIS1:MOVE:REL 0.05;*OPC?" } else { b"" })
                }
                17 => link.wall += Duration::from_millis(20),
                // cut in the middle of a message
                18 if random.below(8) == 0 => {
                    let left = random.below(link.waiting[0].len() as u64 + 1) as usize;
                    link.waiting[0].truncate(left);
                    link.turn();
                    link.hang_up();
                }
                19 => link.aside(Kind::AsyncLock, 0, link.message.wrapping_sub(2), b""),
                20 if random.below(20) == 0 => {
                    link.send(if control == 0 { Kind::Data } else { Kind::DataEnd }, 0, &vec![b'*'; 65_537]);
                }
                // a clear whose completion does not wait
                21 => {
                    link.aside(Kind::AsyncDeviceClear, 0, 0, b"");
                    link.waiting[0].extend(Frame::bytes(Kind::DeviceClearComplete, control, 0, b""));
                }
                _ => link.bus.pass(random.below(3) as usize / 2),
            }
            if random.below(3) > 0 {
                let [answers, asides] = link.turn();
                let of = |frames: &[Frame], kind| frames.iter().filter(|frame| frame.kind == Some(kind)).count();
                count("answers", of(&answers, Kind::DataEnd));
                count("interrupted", of(&answers, Kind::Interrupted));
                count("refused", of(&answers, Kind::Error) + of(&asides, Kind::Error));
                count("service requests", of(&asides, Kind::AsyncServiceRequest));
                count("locks", of(&asides, Kind::AsyncLockResponse));
            }
        }
        link.until_rest();
        // what waits for the other connection comes or is given up
        link.wall += Duration::from_millis(200);
        link.until_rest();
        if link.over.is_some() {
            link.hang_up();
        }
        // END ends what has begun
        link.send(Kind::DataEnd, READ, b"\n");
        link.until_rest();
        if random.below(2) == 0 {
            link.clear(0);
        }
        let mark = random.below(256);
        let told = link.ask(&format!("*ESE {mark};*ESE?"), READ);
        assert_eq!(told, format!("{mark}\n"), "sequence {sequence} at {}", link.at);
        // no stop of this sequence is left behind
        if link.at == 5 && sequence % 16 == 0 {
            let before = link.ask("AXIS1:POS:COMM?", READ).trim().parse::<f64>().unwrap();
            link.send(Kind::DataEnd, READ, b"AXIS1:MOVE:REL 0.05");
            link.until_rest();
            let way = link.ask("AXIS1:POS:COMM?", READ).trim().parse::<f64>().unwrap() - before;
            assert!((way - 0.05).abs() < 0.002, "sequence {sequence}: {way}");
            count("moves", 1);
        }
        loop {
            let told = link.ask("SYST:ERR?", READ);
            match told.split(',').next().and_then(|number| number.parse::<i32>().ok()) {
                Some(0) => break,
                Some(number) => {
                    assert!((-499..=-100).contains(&number) || number == 104, "sequence {sequence}: {told}");
                    count("errors", 1);
                    count("-410", usize::from(number == -410));
                }
                None => panic!("sequence {sequence}: {told:?}"),
            }
        }
    }
    println!("{SEQUENCES} sequences, seed 4880, none wedged: {seen:?}");
    assert!(
        ["answers", "interrupted", "-410", "service requests", "locks", "sent away", "refused"]
            .iter()
            .all(|kind| seen[kind] > SEQUENCES / 100)
    );
}

/// A long move at 2 um/ms, so slow that it would take thousands of segments, is under way.
const LONG: &[u8] = b"AXIS1:VEL 2;MOVE 1000;*OPC?";

#[test]
fn an_emergency_stop_is_seen_behind_a_question_that_waits_for_motion() {
    for feature in [0, 1] {
        let mut link = Caller::new();
        link.clear(feature);
        link.send(Kind::DataEnd, 0, LONG);
        link.turn();
        link.bus.pass(200);
        assert!(link.bus.moves());
        // what was sent before it does not move after it
        link.send(Kind::DataEnd, 0, b"AXIS1:MOVE 900");
        link.send(Kind::DataEnd, 0, b"!");
        link.turn();
        assert!(link.until_rest() < 500, "overlap {feature}");
        let position: f64 = link.ask("AXIS1:POS?", READ).trim().parse().unwrap();
        assert!((0.0..100.0).contains(&position), "overlap {feature}: {position}");
        // and it stops once
        link.send(Kind::DataEnd, READ, b"AXIS1:VEL 50;MOVE 200");
        link.turn();
        link.until_rest();
        let position: f64 = link.ask("AXIS1:POS:COMM?", READ).trim().parse().unwrap();
        assert_eq!(position, 200.0, "overlap {feature}");
    }
}

#[test]
fn an_emergency_stop_asks_no_lock_and_is_told_from_data() {
    let mut link = Caller::new();
    link.send(Kind::DataEnd, 0, b"AXIS1:VEL 2;MOVE 1000");
    link.turn();
    link.locks.request(2, b"");
    link.bus.pass(200);
    // neither a `!` inside a message nor one in a block is a stop
    link.send(Kind::Data, 0, b"COMP:LOAD #15ab\n!\n");
    link.send(Kind::DataEnd, 0, b"!");
    link.turn();
    assert!(link.moves_for(600), "it moves on");
    link.send(Kind::DataEnd, 0, b"*ESE 1\n!\n");
    link.turn();
    assert!(link.until_rest() < 500);
    // who gets the instrument later is not stopped again by it
    link.locks.release(2);
    link.turn();
    link.send(Kind::DataEnd, 0, b"AXIS1:VEL 50;MOVE 300");
    link.turn();
    link.until_rest();
    assert_eq!(link.ask("AXIS1:POS:COMM?", READ).trim().parse::<f64>().unwrap(), 300.0);
}

#[test]
fn nothing_of_a_message_that_was_refused_for_its_size_is_executed() {
    let long = vec![b' '; 65_537];
    let parts: [&[(Kind, &[u8])]; 4] = [
        &[(Kind::Data, &long), (Kind::DataEnd, b"*ESE 77")],
        &[(Kind::Data, b"*ESE 66;"), (Kind::Data, &long), (Kind::Data, b";*ESE 77"), (Kind::DataEnd, b"\n*ESE 78\n")],
        &[(Kind::Data, b"*ESE 66;"), (Kind::DataEnd, &long)],
        &[(Kind::DataEnd, &long)],
    ];
    for feature in [0, 1] {
        for parts in parts {
            let mut link = Caller::new();
            link.clear(feature);
            for (kind, payload) in parts {
                link.send(*kind, 0, payload);
            }
            assert_eq!(link.told(), [vec![(Kind::Error, 4)], vec![]]);
            assert_eq!(link.ask("*ESE?", 0), "0\n");
            assert_eq!(link.errors(), Vec::<i32>::new());
        }
    }
}

#[test]
fn in_overlapped_mode_an_answer_is_available_until_its_client_has_it() {
    const MAV: u8 = 16;
    let mut link = Caller::new();
    link.clear(1);
    link.send(Kind::DataEnd, 0, b"*CLS;*SRE 16");
    link.turn();
    let none = 0xffff_ff00u32.wrapping_sub(2);
    assert_eq!(link.status(0, none), 0);
    let first = link.message;
    link.send(Kind::DataEnd, 0, b"*ESE?");
    assert_eq!(link.told(), [vec![(Kind::DataEnd, 0)], vec![(Kind::AsyncServiceRequest, 64 | MAV)]]);
    assert_eq!((link.status(0, none), link.status(0, none)), (64 | MAV, MAV), "a serial poll takes RQS");
    // the next question interrupts nothing
    let second = link.message;
    link.send(Kind::DataEnd, 0, b"*SRE?");
    assert_eq!(link.told(), [vec![(Kind::DataEnd, 0)], vec![]]);
    assert_eq!(link.status(READ, first) & MAV, MAV, "the second one is not read yet");
    assert_eq!(link.status(READ, second), 0);
    assert_eq!(link.status(0, second), 0);
    // the next one is a new reason
    link.send(Kind::DataEnd, 0, b"*ESE?");
    assert_eq!(link.told()[1], [(Kind::AsyncServiceRequest, 64 | MAV)]);
    link.send(Kind::DataEnd, READ, b"*CLS");
    link.turn();
    assert_eq!(link.status(0, second.wrapping_add(2)), 0);
    assert_eq!(link.errors(), Vec::<i32>::new());
}

#[test]
fn a_lock_is_given_back_when_the_messages_before_are_done() {
    let mut link = Caller::new();
    link.aside(Kind::AsyncLock, 1, 0, b"");
    assert_eq!(link.told()[1], [(Kind::AsyncLockResponse, 1)]);
    let last = link.message.wrapping_add(2);
    link.send(Kind::DataEnd, 0, b"AXIS1:VEL 2;MOVE 5;*WAI;*ESE 55");
    // the release is faster than the message that it names
    link.aside(Kind::AsyncLock, 0, last, b"");
    assert_eq!(link.told()[1], []);
    assert!(!link.locks.admits(2) && link.bus.moves());
    link.send(Kind::DataEnd, 0, b"*ESE 56");
    for _ in 0..100_000 {
        assert_eq!(link.told()[1].is_empty(), link.bus.moves(), "as long as it moves");
        if !link.bus.moves() {
            break;
        }
        assert!(!link.locks.admits(2));
        link.bus.pass(1);
    }
    assert!(link.locks.admits(2));
    assert_eq!(link.ask("*ESE?", 0), "56\n");
    // a message that never comes is not waited for without end; who has no lock does not wait
    link.aside(Kind::AsyncLock, 0, last, b"");
    assert_eq!(link.told()[1], [(Kind::AsyncLockResponse, 3)]);
    link.aside(Kind::AsyncLock, 1, 0, b"team");
    assert_eq!(link.told()[1], [(Kind::AsyncLockResponse, 1)]);
    link.aside(Kind::AsyncLock, 0, link.message.wrapping_add(100), b"");
    assert_eq!(link.told()[1], []);
    link.wall += Duration::from_millis(200);
    assert_eq!(link.told()[1], [(Kind::AsyncLockResponse, 2)]);
}

#[test]
fn what_is_sent_behind_a_release_waits_for_the_next_owner() {
    let mut link = Caller::new();
    link.aside(Kind::AsyncLock, 1, 0, b"");
    link.turn();
    link.send(Kind::DataEnd, 0, b"AXIS1:VEL 2;MOVE 5;*WAI;*ESE 55");
    let first = link.message.wrapping_sub(2);
    link.send(Kind::DataEnd, 0, b"*ESE 56;*ESE?");
    link.aside(Kind::AsyncLock, 0, first, b"");
    link.turn();
    let released = loop {
        assert!(link.bus.moves());
        link.bus.pass(1);
        let mut instrument = link.bus.instrument(5, link.wall).unwrap();
        link.link.turn(&mut *instrument, &mut link.locks, link.wall);
        if link.locks.admits(2) {
            break link.locks.request(2, b"") as u8;
        }
    };
    assert_eq!(released, 1);
}

#[test]
fn a_completion_that_is_faster_than_its_clear_completes_it() {
    for feature in [0, 1] {
        let mut link = Caller::new();
        link.send(Kind::DataEnd, 0, LONG);
        link.send(Kind::DataEnd, 0, b"*ESE 9");
        link.turn();
        link.waiting[0].extend(Frame::bytes(Kind::DeviceClearComplete, feature, 0, b""));
        assert_eq!(link.told(), [vec![], vec![]], "it waits for the clear");
        link.aside(Kind::AsyncDeviceClear, 0, 0, b"");
        assert_eq!(
            link.told(),
            [vec![(Kind::DeviceClearAcknowledge, feature)], vec![(Kind::AsyncDeviceClearAcknowledge, 0)]]
        );
        link.message = 0xffff_ff00;
        assert_eq!(link.ask("*ESE?", 0), "9\n", "overlap {feature}");
    }
}

#[test]
fn a_completion_without_a_clear_is_an_error_and_changes_nothing() {
    let mut link = Caller::new();
    link.send(Kind::DataEnd, 0, b"*ESE 9");
    link.turn();
    link.waiting[0].extend(Frame::bytes(Kind::DeviceClearComplete, 1, 0, b""));
    link.turn();
    link.wall += Duration::from_millis(200);
    assert_eq!(link.told(), [vec![(Kind::Error, 0)], vec![]]);
    assert_eq!(link.ask("*ESE?", 0), "9\n");
    // still synchronised: a question before the answer is read interrupts
    link.send(Kind::DataEnd, 0, b"*ESE?");
    assert_eq!(link.told()[0], [(Kind::Interrupted, 0), (Kind::DataEnd, 0)]);
}

#[test]
fn each_message_that_is_not_taken_has_the_error_of_the_standard() {
    let raw = |number: u8| {
        let mut bytes = Frame::bytes(Kind::Data, 0, 0, b"xyz");
        bytes[2] = number;
        bytes
    };
    for channel in [0, 1] {
        for number in 26..=255 {
            let mut link = Caller::new();
            link.waiting[channel].extend(raw(number));
            let code = if number < 128 { 1 } else { 3 };
            assert_eq!(link.told()[channel], [(Kind::Error, code)], "{number}");
            assert_eq!(link.ask("*ESE?", 0), "0\n", "its payload is not a message");
        }
        for (number, over) in [
            (Kind::Initialize as u8, Over::Refused(Fatal::BadInitialization)),
            (Kind::AsyncInitialize as u8, Over::Refused(Fatal::BadInitialization)),
            (Kind::FatalError as u8, Over::Left),
        ] {
            let mut link = Caller::new();
            link.waiting[channel].extend(raw(number));
            link.turn();
            assert_eq!(link.over, Some(over), "{number}");
        }
        let mut link = Caller::new();
        link.waiting[channel].extend(raw(Kind::Error as u8));
        assert_eq!(link.told(), [vec![], vec![]], "an error is not answered by an error");
    }
}

/// One instrument for all, behind sockets: what matters is when the server says that it is at work.
struct Desk(Bench3);

impl Ports for Desk {
    fn places(&self) -> usize {
        1
    }

    fn open(&mut self, place: usize, _: Duration) -> Option<usize> {
        (place == 0).then_some(0)
    }

    fn close(&mut self, _: usize, _: usize) {}

    fn port(&mut self, _: usize, _: usize, wall: Duration) -> Option<Box<dyn Instrument + '_>> {
        self.0.instrument(5, wall)
    }
}

impl Served for Desk {
    fn turn(&mut self, _: Duration, _: Duration) -> bool {
        self.0.moves()
    }

    fn hand(&mut self, _: Hand) {}

    fn is_flat_out(&self) -> bool {
        true
    }

    fn status(&self) -> String {
        String::new()
    }
}

/// A HiSLIP server, and the time that it is told.
struct Host {
    server: OnHislip<Desk>,
    wall: Duration,
    _poll: Poll,
}

impl Host {
    fn new() -> Self {
        let poll = Poll::new().unwrap();
        let server = OnHislip::new(Desk(Bench3::new()), "127.0.0.1:0".parse().unwrap(), &poll).unwrap();
        Host { server, wall: Duration::ZERO, _poll: poll }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.server.address().unwrap()).unwrap();
        stream.set_nodelay(true).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        stream
    }

    /// Some turns in real time, and none in the server's; it is at work in the last one.
    fn turns(&mut self) -> bool {
        (0..10).fold(false, |_, _| {
            std::thread::sleep(Duration::from_millis(1));
            self.server.turn(self.wall, Duration::ZERO)
        })
    }

    /// What has come: kinds and control codes.
    fn told(&mut self, stream: &mut TcpStream) -> Vec<(Kind, u8, u32)> {
        self.turns();
        let (mut bytes, mut chunk) = (Vec::new(), [0; 4096]);
        while let Ok(count @ 1..) = stream.read(&mut chunk) {
            bytes.extend(&chunk[..count]);
        }
        let (mut frames, mut at, mut told) = (Frames::default(), 0, Vec::new());
        while let (taken, Some(frame)) = frames.take(&bytes[at..]).unwrap() {
            at += taken;
            told.push((frame.kind.unwrap(), frame.control, frame.parameter));
        }
        told
    }

    fn initialize(&mut self) -> (TcpStream, u32) {
        let mut stream = self.connect();
        stream.write_all(&Frame::bytes(Kind::Initialize, 0, 0x0100_7878, b"hislip0")).unwrap();
        let told = self.told(&mut stream);
        assert_eq!(told[0].0, Kind::InitializeResponse, "{told:?}");
        (stream, told[0].2 & 0xffff)
    }

    fn client(&mut self) -> [TcpStream; 2] {
        let (synchronous, id) = self.initialize();
        let mut asynchronous = self.connect();
        asynchronous.write_all(&Frame::bytes(Kind::AsyncInitialize, 0, id, b"")).unwrap();
        assert_eq!(self.told(&mut asynchronous)[0].0, Kind::AsyncInitializeResponse);
        [synchronous, asynchronous]
    }
}

#[test]
fn who_says_nothing_makes_no_work_and_is_sent_away() {
    let mut host = Host::new();
    let mut silent = host.connect();
    let (mut half, _) = host.initialize();
    let [_sync, mut whole] = host.client();
    assert!(!host.turns(), "nobody says anything");
    host.wall = Duration::from_secs(9);
    assert_eq!((host.told(&mut silent), host.told(&mut half)), (vec![], vec![]));
    host.wall = Duration::from_secs(11);
    let away = [(Kind::FatalError, Fatal::BadInitialization as u8, 0)];
    assert_eq!((&host.told(&mut silent)[..], &host.told(&mut half)[..]), (&away[..], &away[..]));
    for gone in [&mut silent, &mut half] {
        assert_eq!(gone.read(&mut [0]).unwrap(), 0, "closed");
    }
    // a client that is there may be silent for as long as it likes
    host.wall = Duration::from_secs(100_000);
    whole.write_all(&Frame::bytes(Kind::AsyncStatusQuery, 0, 0, b"")).unwrap();
    assert_eq!(host.told(&mut whole)[0].0, Kind::AsyncStatusResponse);
}

#[test]
fn silent_connections_leave_room_for_a_client() {
    let mut host = Host::new();
    let _silent: Vec<_> = (0..40).map(|_| host.connect()).collect();
    host.turns();
    host.client();
    // and so do those that have begun and do not go on
    let _half: Vec<_> = (0..15).map(|_| host.initialize()).collect();
    host.wall += Duration::from_secs(2);
    let clients: Vec<_> = (0..10).map(|_| host.client()).collect();
    assert_eq!(clients.len(), 10);
}

#[test]
fn to_wait_for_a_lock_is_no_work() {
    let mut host = Host::new();
    let [_sync, mut owner] = host.client();
    let [mut sync, mut other] = host.client();
    owner.write_all(&Frame::bytes(Kind::AsyncLock, 1, 0, b"")).unwrap();
    assert_eq!(host.told(&mut owner), [(Kind::AsyncLockResponse, 1, 0)]);
    other.write_all(&Frame::bytes(Kind::AsyncLock, 1, 60_000, b"")).unwrap();
    sync.write_all(&Frame::bytes(Kind::DataEnd, 0, 0xffff_ff00, b"*ESE?")).unwrap();
    assert!(!host.turns(), "neither the lock nor what is sent without it");
    assert_eq!(host.told(&mut sync), []);
    owner.write_all(&Frame::bytes(Kind::AsyncLock, 0, 0xffff_fefe, b"")).unwrap();
    assert_eq!(host.told(&mut other), [(Kind::AsyncLockResponse, 1, 0)]);
    assert_eq!(host.told(&mut sync), [(Kind::DataEnd, 0, 0xffff_ff00)]);
}
