//! HiSLIP before a board and a power meter, without sockets: what any client may do to it.

mod lab;

use host_sim::board::Seeded;
use host_sim::gpib::Bus;
use host_sim::hislip::{Client, Frame, Frames, Kind, Locks};
use lab::Bench3;
use stage_controller::scpi::exchange::Exchange;
use stage_controller::scpi::session::Session;
use std::collections::BTreeMap;
use std::time::Duration;

const SEQUENCES: usize = 100_000;
/// The client has read the last answer.
const READ: u8 = 1;

/// A client of the board at 5 or the meter at 7.
struct Link {
    bus: Bench3,
    at: u8,
    client: Client,
    locks: Locks,
    frames: [Frames; 2],
    /// What the server has not taken yet.
    waiting: [Vec<u8>; 2],
    wall: Duration,
    message: u32,
}

impl Link {
    fn new() -> Self {
        let (bus, locks) = (Bench3::new(), Locks::default());
        let (frames, waiting, wall) = (Default::default(), Default::default(), Duration::ZERO);
        Link { bus, at: 5, client: Client::new(1), locks, frames, waiting, wall, message: 0xffff_ff00 }
    }

    /// What comes back on either channel.
    fn turn(&mut self) -> [Vec<Frame>; 2] {
        let Link { bus, client, locks, frames, waiting, wall, .. } = self;
        let mut instrument = bus.instrument(self.at, *wall).unwrap();
        let mut heard = [Vec::new(), Vec::new()];
        loop {
            client.turn(&mut *instrument, locks, *wall);
            let mut any = false;
            for channel in [0, 1] {
                while channel == 1 || client.is_ready(&mut *instrument, locks) {
                    let (taken, frame) = frames[channel].take(&waiting[channel]).unwrap();
                    waiting[channel].drain(..taken);
                    let Some(frame) = frame else { break };
                    any = true;
                    match channel {
                        0 => client.hear(frame, &mut *instrument),
                        _ => client.hear_aside(frame, &mut *instrument, locks, *wall),
                    }
                }
            }
            for (heard, output) in heard.iter_mut().zip(client.output()) {
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

    fn send(&mut self, kind: Kind, control: u8, payload: &[u8]) {
        self.waiting[0].extend(Frame::bytes(kind, control, self.message, payload));
        self.message = self.message.wrapping_add(2);
    }

    fn aside(&mut self, kind: Kind, control: u8, parameter: u32, payload: &[u8]) {
        self.waiting[1].extend(Frame::bytes(kind, control, parameter, payload));
    }

    fn rest(&mut self) {
        for _ in 0..100_000 {
            self.turn();
            if !self.bus.moves() {
                return;
            }
            self.bus.pass(1);
        }
        panic!("it never rests");
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
        self.client = Client::new(1);
        (self.frames, self.waiting, self.message) = (Default::default(), Default::default(), 0xffff_ff00);
        match self.at {
            7 => self.bus.meter = (host_sim::power_meter::Session::new(), Exchange::new()),
            _ => self.bus.links[0] = (Session::new(0), Exchange::new()),
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

impl Link {
    fn errors(&mut self) -> Vec<i32> {
        let mut found = Vec::new();
        loop {
            let told = self.ask("SYST:ERR?", READ);
            match told.split(',').next().and_then(|number| number.parse().ok()) {
                Some(0) => return found,
                Some(number) => found.push(number),
                None => panic!("{told:?}"),
            }
        }
    }

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
            let mut link = Link::new();
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
            let mut link = Link::new();
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
        let mut link = Link::new();
        assert_eq!(link.ask(question, 0), answer);
        assert_eq!(link.ask("*IDN?", 0), IDENTITY, "{question:?}");
        assert_eq!(link.errors(), [-410], "{question:?}");
        assert_eq!(link.ask(question, READ), answer);
        assert_eq!(link.errors(), Vec::<i32>::new(), "it said that it was read");
    }
}

#[test]
fn no_client_wedges_a_link() {
    const PIECES: [&[u8]; 16] = [
        b"*ESE?",
        b"*IDN?\n",
        b"*ESE?;*SRE?\n",
        b"*SRE 48;*ESE 255",
        b"FOO",
        b";",
        b"\n",
        b"COMP:LOAD #15ab",
        b"'",
        b"COMP:DATA?",
        b"*IDN?;*ESE?",
        b"\x18",
        b"\n!\n",
        b"*OPC?",
        b"SYST:VERS?",
        b"AXIS1:VEL?;*WAI",
    ];
    let (mut link, mut random, mut seen) = (Link::new(), Seeded::new(4880), BTreeMap::new());
    let mut count = |kind: &'static str, more: usize| *seen.entry(kind).or_insert(0) += more;
    for sequence in 0..SEQUENCES {
        link.at = if random.below(4) == 0 { 7 } else { 5 };
        link.hang_up();
        for _ in 0..random.below(14) {
            let control = random.below(2) as u8;
            let piece = PIECES[random.below(PIECES.len() as u64) as usize];
            match random.below(20) {
                0..=8 => link.send(Kind::DataEnd, control, piece),
                9..=10 => link.send(Kind::Data, control, piece),
                11 => link.send(Kind::Trigger, control, b""),
                12 => link.aside(Kind::AsyncStatusQuery, control, 0, b""),
                13 => link.clear(control),
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
                _ => link.bus.pass(random.below(3) as usize / 2),
            }
            if random.below(3) > 0 {
                let [answers, asides] = link.turn();
                let of = |frames: &[Frame], kind| frames.iter().filter(|frame| frame.kind == Some(kind)).count();
                count("answers", of(&answers, Kind::DataEnd));
                count("interrupted", of(&answers, Kind::Interrupted));
                count("refused", of(&answers, Kind::Error) + of(&asides, Kind::Error));
                count("service requests", of(&asides, Kind::AsyncServiceRequest));
            }
        }
        link.rest();
        // END ends what has begun
        link.send(Kind::DataEnd, READ, b"\n");
        link.rest();
        if random.below(2) == 0 {
            link.clear(0);
        }
        let mark = random.below(256);
        let told = link.ask(&format!("*ESE {mark};*ESE?"), READ);
        assert_eq!(told, format!("{mark}\n"), "sequence {sequence} at {}", link.at);
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
    assert!(["answers", "interrupted", "-410", "service requests"].iter().all(|kind| seen[kind] > SEQUENCES / 100));
}
