extern crate std;
use super::*;
use crate::error::Error;
use crate::scpi::parser::Call;
use crate::scpi::response::Response;
use crate::scpi::session::{Flow, Instrument, Session};
use crate::scpi::status::Conditions;
use crate::scpi::tree::Command;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;
use std::{println, vec};

const DATA: usize = 900;

/// Moves last until they are told to end.
#[derive(Default)]
struct Stage {
    moving: bool,
    triggers: usize,
}

impl Instrument for Stage {
    fn execute(&mut self, _: u8, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
        match call.command {
            Command::Identify => out.text("maker,stage,0,1"),
            Command::AxisMove => self.moving = true,
            Command::AxisPosition => out.axis_quantity(call.axis(), 1_500, 0),
            Command::Trigger => self.triggers += 1,
            Command::CompensationData => {
                let from = out.cursor() as usize;
                if from == 0 {
                    out.block_head(DATA);
                }
                let part = (DATA - from).min(out.room());
                out.raw(&vec![b'\n'; part]);
                out.resume_at((from + part) as u32);
                return Ok(if from + part < DATA { Flow::More } else { Flow::Done });
            }
            _ => {}
        }
        Ok(Flow::Done)
    }

    fn abort(&mut self, _: u8) {
        self.moving = false;
    }

    fn operation_pending(&self) -> bool {
        self.moving
    }

    fn conditions(&self) -> Conditions {
        Conditions::default()
    }
}

/// A device and its controller.
struct Bus {
    exchange: Exchange,
    session: Session,
    stage: Stage,
}

impl Bus {
    fn new() -> Self {
        let mut bus = Bus { exchange: Exchange::new(), session: Session::new(0), stage: Stage::default() };
        assert_eq!(bus.ask("*CLS;*ESE?"), "0\n");
        bus
    }

    fn poll(&mut self) {
        let Bus { exchange, session, stage } = self;
        exchange.poll(session, |session, see| session.poll_message(stage, see));
    }

    /// Sends until all is taken, or nothing more is; says how much.
    fn put(&mut self, bytes: &[u8], end: bool) -> usize {
        let mut sent = 0;
        loop {
            let taken = self.exchange.write(&mut self.session, &bytes[sent..], end);
            self.poll();
            sent += taken;
            if taken == 0 || sent == bytes.len() {
                return sent;
            }
        }
    }

    fn write(&mut self, text: &str) {
        assert_eq!(self.put(text.as_bytes(), true), text.len(), "{text}");
    }

    fn read(&mut self, most: usize) -> (Vec<u8>, Read) {
        let mut buffer = vec![0; most];
        self.poll();
        let read = self.exchange.read(&mut self.session, &mut buffer);
        self.poll();
        buffer.truncate(if let Read::Bytes(count, _) = read { count } else { 0 });
        (buffer, read)
    }

    /// The answer up to END, none when it does not come.
    fn answer(&mut self) -> Option<String> {
        let mut all = Vec::new();
        loop {
            let (bytes, read) = self.read(64);
            all.extend(bytes);
            match read {
                Read::Bytes(_, true) => return Some(String::from_utf8_lossy(&all).into_owned()),
                Read::Bytes(_, false) => {}
                _ => return None,
            }
        }
    }

    fn ask(&mut self, text: &str) -> String {
        self.write(text);
        self.answer().unwrap_or_else(|| panic!("no answer to {text}"))
    }

    /// Numbers of the queued errors.
    fn errors(&mut self) -> Vec<i32> {
        let mut found = Vec::new();
        loop {
            let told = self.ask("SYST:ERR?");
            match told.split(',').next().and_then(|number| number.parse().ok()) {
                Some(0) => return found,
                Some(number) => found.push(number),
                None => panic!("{told}"),
            }
        }
    }

    fn poll_status(&mut self) -> u8 {
        self.poll();
        self.exchange.serial_poll(&self.session)
    }

    fn clear(&mut self) {
        self.exchange.clear(&mut self.session);
    }

    /// Every move that was sent comes to its end.
    fn rest(&mut self) {
        while core::mem::take(&mut self.stage.moving) {
            self.poll();
        }
    }
}

#[test]
fn an_answer_ends_with_end_and_not_with_a_line_feed_in_its_data() {
    let mut bus = Bus::new();
    assert_eq!(bus.ask("AXIS1:POS?;*ESE?"), "1.500;0\n");
    assert_eq!(bus.ask("*ESE?;COMP:DATA?;*ESE?"), format!("0;#3900{};0\n", "\n".repeat(DATA)));
    assert_eq!(bus.errors(), []);
}

#[test]
fn end_and_line_feed_end_a_message_alone_and_together() {
    for (text, end) in [("*ESE?", true), ("*ESE?\n", false), ("*ESE?\n", true), ("*ESE?\r\n", true)] {
        let mut bus = Bus::new();
        assert_eq!(bus.put(text.as_bytes(), end), text.len());
        assert_eq!(bus.answer().as_deref(), Some("0\n"), "{text:?} {end}");
        assert_eq!(bus.errors(), [], "{text:?} {end}");
    }
}

#[test]
fn end_cuts_a_block_short_wherever_it_comes() {
    for moving in [false, true] {
        for cut in ["COMP:LOAD #", "COMP:LOAD #2", "COMP:LOAD #210", "COMP:LOAD #210abc\n"] {
            let mut bus = Bus::new();
            if moving {
                bus.write("AXIS1:MOVE 1;*WAI");
            }
            bus.write(cut);
            assert_eq!(bus.put(b"*ESE 3", true), if moving { 0 } else { 6 }, "{cut}");
            bus.stage.moving = false;
            bus.poll();
            bus.write("*ESE 3");
            assert_eq!(bus.ask("*ESE?"), "3\n");
            assert_eq!(bus.errors(), [-161], "{cut}");
        }
    }
}

#[test]
fn what_is_sent_before_the_answer_is_read_interrupts_it() {
    for read in [0, 1, 7] {
        let mut bus = Bus::new();
        bus.write("AXIS1:POS?;*ESE?");
        assert_eq!(bus.read(read).0.len(), read);
        assert_eq!(bus.ask("*ESE?"), "0\n", "the first answer is gone");
        assert_eq!(bus.errors(), [-410], "{read}");
    }
    let mut bus = Bus::new();
    bus.write("COMP:DATA?;*ESE 9");
    bus.read(5);
    assert_eq!(bus.ask("*ESE?"), "0\n", "and the rest of its message");
    assert_eq!(bus.errors(), [-410]);
}

#[test]
fn two_questions_in_one_go_are_one_too_many() {
    let mut bus = Bus::new();
    bus.write("*ESE?\n*SRE 4\nAXIS1:POS?\n");
    assert_eq!(bus.answer().as_deref(), Some("1.500\n"));
    assert_eq!(bus.ask("*SRE?"), "4\n", "what does not ask is executed in between");
    assert_eq!(bus.errors(), [-410]);
}

#[test]
fn white_space_behind_a_question_is_no_second_one() {
    for tail in ["\n", "\r\n", "\n \r\n", " \n\n\n", "\n ", "\n\t"] {
        for pieces in [1, 2, 99] {
            let mut bus = Bus::new();
            let text = std::format!("*ESE 7;*ESE?{tail}");
            let size = text.len().div_ceil(pieces);
            for (n, piece) in text.as_bytes().chunks(size).enumerate() {
                assert_eq!(bus.put(piece, (n + 1) * size >= text.len()), piece.len());
            }
            bus.write("\r\n");
            assert_eq!(bus.answer().as_deref(), Some("7\n"), "{tail:?} {pieces}");
            assert_eq!(bus.errors(), [], "{tail:?} {pieces}");
        }
    }
    let mut bus = Bus::new();
    bus.write("AXIS1:MOVE 1;*OPC?\n\r\n");
    bus.rest();
    assert_eq!(bus.answer().as_deref(), Some("1\n"));
    assert_eq!(bus.errors(), []);
}

#[test]
fn a_question_that_waits_is_answered_in_the_end_or_interrupted() {
    let mut bus = Bus::new();
    bus.write("AXIS1:MOVE 1;*OPC?");
    assert_eq!(bus.read(10).1, Read::NotYet);
    assert!(!bus.exchange.is_idle(&bus.session));
    bus.stage.moving = false;
    assert_eq!(bus.answer().as_deref(), Some("1\n"));
    bus.write("AXIS1:MOVE 1;*OPC?;*ESE 5");
    assert_eq!(bus.ask("*ESE?"), "0\n");
    assert_eq!(bus.errors(), [-410]);
    assert!(bus.stage.moving, "the move is not the question");
}

#[test]
fn a_question_behind_a_wait_is_interrupted_once_it_is_asked() {
    let mut bus = Bus::new();
    bus.write("AXIS1:MOVE 1;*WAI;*ESE?");
    bus.write("*SRE?");
    assert_eq!(bus.read(10).1, Read::NotYet);
    bus.stage.moving = false;
    assert_eq!(bus.answer().as_deref(), Some("0\n"));
    assert_eq!(bus.errors(), [-410]);
}

#[test]
fn reading_without_a_question_is_an_error_and_drops_what_has_begun() {
    let mut bus = Bus::new();
    assert_eq!(bus.read(10), (vec![], Read::NothingAsked));
    bus.put(b"*ESE 7;*ESE?", false);
    assert_eq!(bus.read(10), (vec![], Read::NothingAsked));
    assert_eq!(bus.ask("*ESE?"), "0\n", "the half message is gone");
    assert_eq!(bus.read(10), (vec![], Read::NothingAsked), "after an answer too");
    assert_eq!(bus.errors(), [-420; 3]);
}

#[test]
fn nothing_follows_an_indefinite_answer() {
    let mut bus = Bus::new();
    assert_eq!(bus.ask("*ESE?;*IDN?;*ESE 2;*ESE?;*ESE 3"), "0;maker,stage,0,1\n");
    assert_eq!(bus.ask("*ESE?"), "2\n", "commands before the question count");
    assert_eq!(bus.errors(), [-440]);
}

#[test]
fn a_trigger_is_a_trigger_command_in_its_turn() {
    let mut bus = Bus::new();
    let Bus { exchange, session, .. } = &mut bus;
    assert!(exchange.trigger(session));
    bus.poll();
    assert_eq!(bus.stage.triggers, 1);
    bus.write("AXIS1:MOVE 1;*WAI");
    assert!(bus.exchange.trigger(&mut bus.session));
    bus.poll();
    assert_eq!(bus.stage.triggers, 1);
    bus.stage.moving = false;
    bus.poll();
    assert_eq!(bus.stage.triggers, 2);
    bus.put(b"*ESE", false);
    assert!(bus.exchange.trigger(&mut bus.session));
    bus.write("*SRE?");
    assert!(bus.exchange.trigger(&mut bus.session));
    bus.poll();
    assert_eq!(bus.stage.triggers, 3);
    assert_eq!(bus.errors(), [-105, -410]);
}

#[test]
fn service_is_requested_when_the_summary_rises_until_it_is_polled() {
    let mut bus = Bus::new();
    bus.write("*SRE 4;*ESE 1");
    assert!(!bus.exchange.requests_service());
    bus.write("FOO");
    assert!(bus.exchange.requests_service());
    assert_eq!(bus.poll_status(), 0x44);
    assert!(!bus.exchange.requests_service());
    assert_eq!(bus.poll_status(), 0x04, "RQS is told once");
    assert_eq!(bus.ask("*STB?"), "68\n", "MSS stays");
    bus.write("FOO");
    assert!(!bus.exchange.requests_service(), "it has not risen anew");
    bus.write("*CLS;FOO");
    assert!(bus.exchange.requests_service(), "it fell and rose within one message");
    bus.write("*CLS");
    assert!(!bus.exchange.requests_service(), "nothing is left to ask for");
    bus.write("*SRE 32;AXIS1:MOVE 1;*OPC");
    assert_eq!(bus.poll_status(), 0);
    bus.stage.moving = false;
    assert_eq!(bus.poll_status(), 0x60);
    bus.write("*CLS;*SRE 16;*ESE?");
    assert_eq!(bus.poll_status(), 0x50, "an answer waits");
    bus.answer();
    assert_eq!(bus.poll_status(), 0);
}

#[test]
fn a_held_write_goes_on_when_there_is_room() {
    let mut bus = Bus::new();
    bus.write("AXIS1:MOVE 1;*WAI");
    let many = "*ESE 6\n".repeat(200);
    let sent = bus.put(many.as_bytes(), true);
    assert!((512..many.len()).contains(&sent), "{sent}");
    bus.stage.moving = false;
    bus.poll();
    assert_eq!(bus.put(&many.as_bytes()[sent..], true), many.len() - sent);
    assert_eq!(bus.ask("*ESE?"), "6\n");
    assert_eq!(bus.errors(), []);
}

const MESSAGES: [&str; 12] = [
    "*ESE 36",
    "AXIS1:POS?",
    "*ESE?",
    "AXIS1:POS?;*SRE?",
    "COMP:DATA?",
    "*IDN?",
    "*IDN?;*ESE?",
    "COMP:LOAD #15a\n!\x18b",
    "COMP:LOAD #15ab",
    "FOO",
    "*SRE 32;AXIS2:POS?",
    "STAT:OPER:ENAB 3;ENAB 5",
];

#[test]
fn a_clear_at_each_byte_leaves_a_working_link_and_no_error() {
    for message in MESSAGES {
        let mut whole = Bus::new();
        whole.write(message);
        let answer = if whole.exchange.is_idle(&whole.session) { 0 } else { whole.answer().unwrap_or_default().len() };
        for at in 0..message.len() + answer {
            let mut bus = Bus::new();
            if at < message.len() {
                bus.put(&message.as_bytes()[..at], false);
            } else {
                bus.write(message);
                bus.read(at - message.len());
            }
            bus.clear();
            assert_eq!(bus.poll_status() & 0x10, 0, "{message} {at}");
            assert_eq!(bus.ask("STAT:OPER:NTR 77;NTR?"), "77\n", "{message} {at}");
            // what was whole was executed
            let own = if at < message.len() { vec![] } else { whole.errors_of(message) };
            assert_eq!(bus.errors(), own, "{message} {at}");
        }
    }
}

impl Bus {
    /// The errors that a message has by itself.
    fn errors_of(&mut self, message: &str) -> Vec<i32> {
        match message {
            "FOO" => vec![-113],
            "*IDN?;*ESE?" => vec![-440],
            "COMP:LOAD #15ab" => vec![-161],
            _ => vec![],
        }
    }
}

/// A cheap generator of sequences.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % bound
    }
}

const SEQUENCES: usize = 100_000;

/// What the standard says of a device that executes at once: the message that has begun, and the answer that waits.
#[derive(Default)]
struct Model {
    begun: String,
    answer: Vec<u8>,
    ese: u8,
    triggers: usize,
    errors: Vec<i32>,
}

impl Model {
    fn interrupt(&mut self) {
        if !self.answer.is_empty() {
            self.answer.clear();
            self.errors.push(-410);
        }
    }

    fn write(&mut self, text: &str, end: bool) {
        self.interrupt();
        self.begun += text;
        if !end {
            return;
        }
        match core::mem::take(&mut self.begun).as_str() {
            "*ESE?" => self.answer = format!("{}\n", self.ese).into(),
            "*ESE 36" => self.ese = 36,
            "*ESE 4" => self.ese = 4,
            "AXIS1:POS?;*ESE?" => self.answer = format!("1.500;{}\n", self.ese).into(),
            "COMP:DATA?" => self.answer = format!("#3900{}\n", "\n".repeat(DATA)).into(),
            "*IDN?;*ESE?" => {
                self.answer = "maker,stage,0,1\n".into();
                self.errors.push(-440);
            }
            "FOO" => self.errors.push(-113),
            other => panic!("{other}"),
        }
    }

    fn read(&mut self, most: usize) -> (Vec<u8>, Read) {
        if self.answer.is_empty() {
            self.begun.clear();
            self.errors.push(-420);
            return (vec![], Read::NothingAsked);
        }
        let bytes: Vec<u8> = self.answer.drain(..most.min(self.answer.len())).collect();
        let read = Read::Bytes(bytes.len(), self.answer.is_empty());
        (bytes, read)
    }

    fn trigger(&mut self) {
        match core::mem::take(&mut self.begun).is_empty() {
            true => {
                self.interrupt();
                self.triggers += 1;
            }
            false => self.errors.push(-105),
        }
    }

    fn clear(&mut self) {
        self.begun.clear();
        self.answer.clear();
    }
}

/// Reads up to `most` bytes as the device hands them out in parts.
fn read_all(bus: &mut Bus, most: usize) -> (Vec<u8>, Read) {
    let mut all = Vec::new();
    loop {
        let (bytes, read) = bus.read(most - all.len());
        all.extend(bytes);
        match read {
            Read::Bytes(_, false) if all.len() < most => {}
            Read::Bytes(_, end) => return (all.clone(), Read::Bytes(all.len(), end)),
            other => return (all, other),
        }
    }
}

#[test]
fn any_sequence_ends_in_the_errors_of_the_standard() {
    const TEXTS: [&str; 7] = ["*ESE?", "*ESE 36", "*ESE 4", "AXIS1:POS?;*ESE?", "COMP:DATA?", "*IDN?;*ESE?", "FOO"];
    let (mut random, mut told) = (Random(20_260), [0_usize; 5]);
    for sequence in 0..SEQUENCES {
        let (mut bus, mut model, mut log) = (Bus::new(), Model::default(), String::new());
        // half of a text, and where it goes on
        let mut rest: Option<&str> = None;
        for _ in 0..random.below(12) {
            let kind = random.below(10);
            match kind {
                0..=3 => {
                    let text = rest.take().filter(|_| !model.begun.is_empty());
                    // what was dropped is not gone on with
                    let text = text.unwrap_or(TEXTS[random.below(TEXTS.len())]);
                    if !model.begun.is_empty() && !TEXTS.contains(&(model.begun.clone() + text).as_str()) {
                        continue;
                    }
                    let cut = if random.below(3) == 0 { 1 + random.below(text.len() - 1) } else { text.len() };
                    let end = cut == text.len();
                    log += &format!("write {:?} {end}; ", &text[..cut]);
                    assert_eq!(bus.put(&text.as_bytes()[..cut], end), cut);
                    model.write(&text[..cut], end);
                    rest = (!end).then_some(&text[cut..]).filter(|rest| rest.len() > 1);
                    if !end && rest.is_none() {
                        bus.clear();
                        model.clear();
                    }
                }
                4..=6 => {
                    let most = [1, 3, 64, 2000][random.below(4)];
                    log += &format!("read {most}; ");
                    assert_eq!(read_all(&mut bus, most), model.read(most), "sequence {sequence}: {log}");
                }
                7 => {
                    log += "trigger; ";
                    assert!(bus.exchange.trigger(&mut bus.session));
                    bus.poll();
                    model.trigger();
                }
                8 => {
                    log += "clear; ";
                    bus.clear();
                    model.clear();
                }
                _ => {
                    let waits = u8::from(!model.answer.is_empty()) << 4 | u8::from(!model.errors.is_empty()) << 2;
                    assert_eq!(bus.poll_status() & 0x14, waits, "sequence {sequence}: {log}");
                }
            }
        }
        bus.clear();
        assert_eq!(bus.errors(), model.errors, "sequence {sequence}: {log}");
        assert_eq!(bus.stage.triggers, model.triggers, "sequence {sequence}: {log}");
        assert_eq!(bus.ask("*ESE?"), format!("{}\n", model.ese), "sequence {sequence}: {log}");
        for (count, number) in told.iter_mut().zip([-410, -420, -440, -105, -113]) {
            *count += model.errors.iter().filter(|error| **error == number).count();
        }
    }
    println!("{SEQUENCES} sequences, seed 20260: -410, -420, -440, -105, -113 came {told:?} times");
    assert!(told.iter().all(|count| *count > SEQUENCES / 100), "{told:?}");
}

#[test]
fn no_sequence_wedges_a_device_that_moves() {
    const PIECES: [&str; 16] = [
        "*ESE?",
        "\n",
        "\nAXIS1:MOVE 1;*WAI\n",
        ";",
        "*OPC?",
        "*WAI",
        "*ESE 1\n",
        "COMP:DATA?",
        "COMP:LOAD #15",
        "abc",
        "\x18",
        "\n!\n",
        "'",
        "*OPC",
        "*IDN?",
        "#3",
    ];
    let (mut random, mut held) = (Random(488), 0);
    for sequence in 0..SEQUENCES {
        let (mut bus, mut log) = (Bus::new(), String::new());
        for _ in 0..random.below(24) {
            match random.below(12) {
                0..=5 => {
                    let text = PIECES[random.below(PIECES.len())].repeat(if random.below(8) == 0 { 90 } else { 1 });
                    let end = random.below(4) == 0;
                    log += &format!("write {text:?} {end}; ");
                    if bus.put(text.as_bytes(), end) < text.len() {
                        held += 1;
                        log += "held; ";
                        // who gives up clears
                        if random.below(2) == 0 {
                            bus.rest();
                        }
                        bus.clear();
                    }
                }
                6..=8 => drop(bus.read(1 + random.below(900))),
                9 => drop(bus.exchange.trigger(&mut bus.session)),
                10 => bus.stage.moving = false,
                _ => drop(bus.poll_status()),
            }
        }
        bus.rest();
        if random.below(2) == 0 {
            bus.clear();
        } else {
            // END ends whatever has begun, and a question drops whatever was answered
            bus.put(b"\n", true);
            bus.rest();
        }
        let marker = format!("{}\n", 1 + random.below(200));
        assert_eq!(bus.ask(&format!("STAT:OPER:ENAB {};ENAB?", marker.trim())), marker, "sequence {sequence}: {log}");
        for error in bus.errors() {
            // what the pieces make may be wrong in any way
            let language = (-299..=-100).contains(&error) || [-350, -363].contains(&error);
            assert!(language || [-410, -420, -440].contains(&error), "sequence {sequence}: {error}: {log}");
        }
        assert_eq!(bus.ask("*ESE 0;*ESE?"), 0.to_string() + "\n");
    }
    println!("{SEQUENCES} sequences, seed 488, none wedged; {held} writes were held off and given up");
    assert!(held > SEQUENCES / 1000);
}
