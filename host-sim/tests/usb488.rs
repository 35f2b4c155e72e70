//! A board on USB488, from the packets of a host to its motors and back, without a cable.

#[path = "../../src/usb488/tests/host/mod.rs"]
mod host;
#[path = "lab/pieces.rs"]
mod pieces;

use host::{BULK_IN, BULK_OUT, Bench, Trouble, Usb, message_out, request_in};
use host_sim::board::{Board, Interleaving, Seeded};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use pieces::PIECES;
use stage_controller::scpi::exchange::{Attached, Control, Exchange};
use stage_controller::scpi::session::Session;
use stage_usb488::Interface;
use stage_usb488::control::{OF_ENDPOINT, OF_INTERFACE, request, status};
use std::collections::BTreeMap;

const SEQUENCES: usize = 100_000;

/// A board with one link, which is a bus.
struct Stage {
    board: Board,
    session: Session,
    exchange: Exchange,
}

impl Stage {
    fn new() -> Self {
        let machine = Machine::paper();
        let mut board = Board::new(&machine, power_up(&machine, false).unwrap(), Interleaving::Prompt, 1);
        board.settle();
        Stage { board, session: Session::new(0), exchange: Exchange::new() }
    }
}

impl Bench for Stage {
    fn turn(&mut self, interface: &mut Interface) -> bool {
        let Stage { board, session, exchange } = self;
        let executed = exchange.poll(session, |session, see| session.poll_message(&mut board.front, see));
        interface.turn(&mut Attached { exchange, device: session }) | executed
    }

    fn pass(&mut self) -> bool {
        let moves = self.board.front.operation_pending();
        self.board.step(|_| ());
        self.exchange.observe(&self.session);
        moves
    }
}

fn usb() -> Usb<Stage> {
    Usb::new(Stage::new())
}

impl Usb<Stage> {
    /// The cable is pulled and put in again, at whatever moment.
    fn hang_up(&mut self) {
        self.reset();
        self.bench.session.device_clear();
        (self.bench.session, self.bench.exchange) = (Session::new(0), Exchange::new());
    }

    /// Numbers of the errors in the queue, which this empties.
    fn errors(&mut self) -> Vec<i32> {
        let mut numbers = Vec::new();
        loop {
            let told = self.query("SYST:ERR?\n").unwrap();
            match told.split(',').next().and_then(|number| number.parse().ok()) {
                Some(0) => return numbers,
                Some(number) => numbers.push(number),
                None => panic!("{told:?}"),
            }
        }
    }

    /// Until nothing moves.
    fn rest(&mut self) {
        for _ in 0..100_000 {
            self.settle();
            if !self.bench.pass() {
                return;
            }
        }
        panic!("it never rests");
    }
}

#[test]
fn it_says_who_it_is_whether_the_message_ends_with_lf_or_with_eom() {
    for message in ["*IDN?", "*IDN?\n"] {
        let mut usb = usb();
        let told = usb.query(message).unwrap();
        assert_eq!(told.matches(',').count(), 3, "{told}");
        assert!(told.ends_with('\n'));
        assert_eq!(usb.errors(), [0; 0]);
    }
}

#[test]
fn a_block_goes_up_and_down_in_transfers_of_any_size() {
    let block = {
        let mut usb = usb();
        usb.write(b"COMP:DATA?").unwrap();
        usb.read().unwrap()
    };
    assert!(block.len() > 300 && block.starts_with(b"#3"), "{} bytes", block.len());
    for (size, chunk) in [(1, 64), (17, 1), (52, 52), (64, 53), (500, 500), (100_000, 100_000)] {
        let mut usb = usb();
        (usb.size, usb.chunk) = (size, chunk);
        usb.write(b"COMP:DATA?").unwrap();
        assert_eq!(usb.read().unwrap(), block, "by {size}");
        usb.write(&[b"COMP:LOAD ", &block[..block.len() - 1]].concat()).unwrap();
        assert_eq!(usb.errors(), [0; 0], "in {chunk}");
        // END in the middle of a block
        usb.write(&[b"COMP:LOAD ", &block[..100]].concat()).unwrap();
        assert_eq!(usb.errors(), [-161]);
    }
}

#[test]
fn an_answer_longer_than_any_buffer_comes_whole() {
    let mut usb = usb();
    let question = vec!["SYST:VERS?"; 40].join(";:");
    usb.write(question.as_bytes()).unwrap();
    let answer = String::from_utf8(usb.read().unwrap()).unwrap();
    assert_eq!(answer.split(';').count(), 40);
    usb.write(b"*ESE?").unwrap();
    assert_eq!(usb.read().unwrap(), b"0\n");
    assert_eq!(usb.errors(), [0; 0]);
}

#[test]
fn the_end_of_motion_is_waited_for_by_reading() {
    let mut usb = usb();
    assert_eq!(usb.query("AXIS1:MOVE 20;*OPC?").unwrap(), "1\n");
    assert_eq!(usb.query("AXIS1:POS?").unwrap(), "20.000\n");
}

#[test]
fn a_service_request_tells_the_end_of_motion_and_errors() {
    let mut usb = usb();
    usb.write(b"*CLS;*ESE 61;*SRE 32;AXIS1:MOVE 20;*OPC").unwrap();
    assert_eq!(usb.notice(), None);
    usb.rest();
    assert_eq!(usb.notice(), Some([0x81, 0x60]));
    assert_eq!(usb.notice(), None);
    assert_eq!(usb.read_stb(), Ok(0x20), "RQS is gone, its reason is not");
    assert_eq!(usb.query("*ESR?").unwrap(), "1\n");
    assert_eq!(usb.read_stb(), Ok(0));
    usb.write(b"FOO").unwrap();
    assert_eq!(usb.notice().map(|[first, status]| (first, status & 0x60)), Some((0x81, 0x60)));
    assert_eq!(usb.errors(), [-113]);
}

#[test]
fn mav_is_set_for_as_long_as_the_host_has_not_fetched_the_last_packet() {
    let mut usb = usb();
    usb.write(b"*IDN?").unwrap();
    assert_eq!(usb.read_stb(), Ok(0x10));
    let tag = usb.ask_for(1000, None).unwrap();
    assert_eq!(usb.read_stb(), Ok(0x10), "it stands at the endpoint");
    usb.fetch(tag, 1000).unwrap();
    assert_eq!(usb.read_stb(), Ok(0));
}

#[test]
fn query_errors_are_those_of_the_standard() {
    let mut usb = usb();
    assert_eq!(usb.read(), Err(Trouble::TimeOut));
    assert_eq!(usb.errors(), [-420]);
    usb.write(b"*IDN?").unwrap();
    assert_eq!(usb.query("*ESE?").unwrap(), "0\n");
    assert_eq!(usb.errors(), [-410]);
    usb.write(b"*IDN?;*ESE?").unwrap();
    assert!(usb.read().is_ok());
    assert_eq!(usb.errors(), [-440]);
    usb.put(&message_out(1, b"*ESE?", false)).unwrap();
    assert_eq!(usb.read(), Err(Trouble::TimeOut));
    assert_eq!(usb.errors(), [-420], "in the middle of a message");
    usb.put(&message_out(1, b"*ES", false)).unwrap();
    usb.trigger().unwrap();
    assert_eq!(usb.errors(), [-105]);
}

#[test]
fn a_host_that_times_out_reads_the_answer_later() {
    for aborts in [false, true] {
        let mut usb = usb();
        usb.write(b"AXIS1:MOVE 20;*OPC?").unwrap();
        let tag = usb.ask_for(1000, None).unwrap();
        assert_eq!(usb.peek(), None);
        if aborts {
            assert_eq!(usb.abort_in(tag), Err(Trouble::Refused(status::FAILED)));
        } else {
            usb.rest();
        }
        assert_eq!(usb.read().unwrap(), b"1\n");
        assert_eq!(usb.errors(), [0; 0]);
    }
}

#[test]
fn the_answer_of_a_host_that_went_on_does_not_come_under_another_tag() {
    let mut usb = usb();
    usb.write(b"AXIS1:MOVE 20;*OPC?").unwrap();
    usb.ask_for(1000, None).unwrap();
    usb.rest();
    assert_eq!(usb.query("*ESE?").unwrap(), "0\n");
    assert_eq!(usb.errors(), [-410]);
}

#[test]
fn clear_ends_what_waits_and_leaves_motion_alone() {
    let mut usb = usb();
    usb.write(b"AXIS1:MOVE 20;*WAI;*IDN?").unwrap();
    // more than fits behind it
    let transfer = message_out(9, &b"*ESE 1;".repeat(400), true);
    let taken = transfer.chunks(64).take_while(|packet| {
        usb.settle();
        usb.wire.out.is_none() && usb.put(packet).is_ok()
    });
    assert!(taken.count() < 20, "most of it finds no room");
    usb.clear().unwrap();
    assert_eq!(usb.query("*ESE?").unwrap(), "0\n");
    usb.rest();
    assert_eq!(usb.query("AXIS1:POS?").unwrap(), "20.000\n");
}

#[test]
fn clear_at_every_packet_of_a_block_either_way_leaves_a_working_link() {
    let mut usb = usb();
    usb.write(b"COMP:DATA?").unwrap();
    let block = usb.read().unwrap();
    let load = message_out(1, &[b"COMP:LOAD ", &block[..block.len() - 1]].concat(), true);
    for cut in 0..load.len().div_ceil(64) {
        for hang_up in [false, true] {
            load.chunks(64).take(cut).for_each(|packet| usb.put(packet).unwrap());
            if hang_up {
                usb.hang_up()
            } else {
                usb.clear().unwrap()
            }
            assert_eq!(usb.query("*ESE?").unwrap(), "0\n", "{cut} packets down");
            usb.write(b"COMP:DATA?").unwrap();
            usb.ask_for(100_000, None).unwrap();
            (0..cut).for_each(|_| drop(usb.peek()));
            if hang_up {
                usb.hang_up()
            } else {
                usb.clear().unwrap()
            }
            assert_eq!(usb.peek(), None, "{cut} packets up");
            assert_eq!(usb.query("*ESE?").unwrap(), "0\n", "{cut} packets up");
            assert_eq!(usb.errors(), [0; 0]);
        }
    }
}

#[test]
fn clear_behind_every_byte_of_a_message_leaves_nothing_of_it() {
    let mut usb = usb();
    let message = b"*ESE 7;*SRE 32;:AXIS1:VEL 100;*IDN?\n";
    for cut in 0..=message.len() {
        usb.query("*ESE 0;*ESE?").unwrap();
        if cut > 0 {
            usb.put(&message_out(1, &message[..cut], cut == message.len())).unwrap();
            usb.settle();
        }
        usb.clear().unwrap();
        assert_eq!(usb.query("*STB?;*ESE?").unwrap(), if cut == message.len() { "0;7\n" } else { "0;0\n" }, "{cut}");
    }
    assert_eq!(usb.errors(), [0; 0]);
}

#[test]
fn a_message_that_is_aborted_at_any_packet_is_not_executed() {
    let message = [b"*ESE 7;".repeat(50), b"*SRE 1".to_vec()].concat();
    let transfer = message_out(1, &message, true);
    for packets in 1..transfer.len().div_ceil(64) {
        let mut usb = usb();
        usb.tag = 1;
        transfer.chunks(64).take(packets).for_each(|packet| usb.put(packet).unwrap());
        usb.settle();
        assert_eq!(usb.abort_out(1), Ok(packets as u32 * 64 - 12));
        assert_eq!(usb.query("*ESE?;*SRE?").unwrap(), "0;0\n", "{packets}");
        assert_eq!(usb.errors(), [0; 0]);
    }
}

/// A transfer that does not end, at each of its packets: the second holds a line end, a `!` that is none, and a block.
fn broken_off() -> Vec<u8> {
    let lines = ["*ESE 7;", &"*ESE 7;".repeat(6), "\n*ESE 8\nCOMP:LOAD #3100\n!\n", &"x".repeat(30)].concat();
    message_out(9, &[lines.as_bytes(), &[b'y'; 400]].concat(), true)
}

/// `!` stops a motion that `stop` has left alone.
fn stops_at_once(usb: &mut Usb<Stage>) {
    assert!(usb.bench.board.front.operation_pending());
    usb.write(b"!\n").unwrap();
    usb.rest();
    let position: f64 = usb.query("AXIS1:POS?").unwrap().trim().parse().unwrap();
    assert!(position < 40.0, "{position}: it was heard late");
}

#[test]
fn an_abort_behind_a_message_that_waits_is_done_at_once_and_what_comes_next_is_heard() {
    for packets in 1..=8 {
        let mut usb = usb();
        usb.write(b"AXIS1:VEL 50;MOVE 800;*WAI;*ESE 1").unwrap();
        for packet in broken_off().chunks(64).take(packets) {
            usb.put(packet).unwrap();
        }
        usb.settle();
        let taken = usb.abort_out(9).unwrap();
        assert_eq!(taken as usize, packets * 64 - 12);
        stops_at_once(&mut usb);
        let expected = if packets < 2 { "7\n" } else { "8\n" };
        assert_eq!(usb.query("*ESE?").unwrap(), expected, "whole messages stand, and only those: {packets}");
        assert_eq!(usb.errors(), [0; 0]);
    }
}

#[test]
fn an_abort_gives_back_the_room_of_all_that_was_not_whole() {
    let mut usb = usb();
    usb.write(b"AXIS1:VEL 50;MOVE 800;*WAI;*ESE 1").unwrap();
    usb.write(b"*ESE 2").unwrap();
    // a motion under way does not end at once
    usb.settle();
    (0..1000).for_each(|_| assert!(usb.bench.pass()));
    let transfer =
        message_out(9, &[&b"*ESE 3\n"[..], &b"*ESE 4;".repeat(71), &b"\n!\n*ESE 5;".repeat(40)].concat(), true);
    let taken = transfer.chunks(64).take_while(|packet| {
        usb.settle();
        usb.wire.out.is_none() && usb.put(packet).is_ok()
    });
    assert!(taken.count() < 12, "most of it finds no room");
    usb.abort_out(9).unwrap();
    usb.rest();
    assert_eq!(
        usb.query("*ESE?;AXIS1:MOVE 1;*OPC?;:AXIS1:POS?").unwrap(),
        "4;1;1.000\n",
        "nothing is aborted any more"
    );
}

#[test]
fn an_exclamation_mark_is_heard_behind_a_halt_that_was_cleared_while_a_message_waits() {
    for packets in 1..=3 {
        let mut usb = usb();
        usb.write(b"AXIS1:VEL 50;MOVE 800;*WAI;*ESE 1").unwrap();
        for packet in broken_off().chunks(64).take(packets) {
            usb.put(packet).unwrap();
        }
        usb.put(b"short").unwrap();
        usb.settle();
        assert!(usb.wire.halted);
        usb.clear_halt();
        stops_at_once(&mut usb);
        assert_eq!(usb.errors(), [0; 0]);
    }
}

#[test]
fn a_trigger_is_trg() {
    let mut usb = usb();
    usb.trigger().unwrap();
    let by_trigger = usb.errors();
    usb.write(b"*TRG").unwrap();
    assert_eq!(by_trigger, usb.errors());
    assert!(by_trigger.iter().all(|number| *number == -211), "{by_trigger:?}");
}

#[test]
fn who_writes_with_ren_has_the_controls() {
    let mut usb = usb();
    let control = |usb: &mut Usb<Stage>| {
        usb.settle();
        usb.bench.exchange.control().control()
    };
    usb.query("*ESE?").unwrap();
    assert_eq!(control(&mut usb), Control::Local);
    usb.of_interface(request::REN_CONTROL, 1);
    assert_eq!(control(&mut usb), Control::Local);
    usb.query("*ESE?").unwrap();
    assert_eq!(control(&mut usb), Control::Remote);
    usb.of_interface(request::LOCAL_LOCKOUT, 0);
    assert_eq!(control(&mut usb), Control::RemoteWithLockout);
    usb.of_interface(request::GO_TO_LOCAL, 0);
    assert_eq!(control(&mut usb), Control::LocalWithLockout);
    usb.of_interface(request::REN_CONTROL, 0);
    assert_eq!(control(&mut usb), Control::Local);
}

/// Anything a host may do, in any order.
struct Abuser {
    random: Seeded,
    seen: BTreeMap<&'static str, usize>,
}

impl Abuser {
    fn below(&mut self, end: usize) -> usize {
        self.random.below(end as u64) as usize
    }

    fn count(&mut self, what: &'static str, happened: bool) {
        *self.seen.entry(what).or_insert(0) += usize::from(happened);
    }

    /// One thing.
    fn act(&mut self, usb: &mut Usb<Stage>) {
        let piece = PIECES[self.below(PIECES.len())];
        let tag = usb.tag.wrapping_add(self.below(3) as u8);
        match self.below(26) {
            0..=5 => {
                self.count("messages", usb.write(piece).is_ok());
            }
            6 => {
                let transfer = message_out(tag.max(1), piece, self.below(2) == 0);
                let _ = usb.transfer(&transfer);
            }
            7..=10 => {
                let answer = usb.read();
                self.count("answers", answer.is_ok());
                self.count("reads in vain", answer == Err(Trouble::TimeOut));
            }
            11 => drop(usb.ask_for(1 + self.below(200) as u32, (self.below(3) == 0).then_some(b'1'))),
            12 => self.count("packets", usb.peek().is_some()),
            13 => {
                let _ = usb.write(b"*CLS;*SRE 48;*ESE 255;FOO");
                self.count("service requests", usb.notice().is_some_and(|[first, _]| first == 0x81));
            }
            14 => drop(usb.read_stb()),
            15 => drop(usb.trigger()),
            16 => {
                // any bytes at all
                let length = self.below(65);
                let packet: Vec<u8> = (0..length).map(|_| self.below(256) as u8).collect();
                let halted = usb.put(&packet).is_ok() && {
                    usb.settle();
                    usb.wire.halted
                };
                self.count("malformed", halted);
            }
            17 => {
                // a header with one byte wrong
                let mut packet = if self.below(2) == 0 {
                    request_in(tag, 100, None)
                } else {
                    message_out(tag, &piece[..piece.len().min(50)], true)
                };
                let at = self.below(packet.len());
                packet[at] = self.below(256) as u8;
                let _ = usb.put(&packet);
            }
            18 => {
                // the beginning of a long transfer
                let tag = usb.next_tag();
                let transfer = message_out(tag, &b"*ESE 1;".repeat(60), true);
                let packets = self.below(7);
                let _ = transfer.chunks(64).take(packets).try_for_each(|packet| usb.put(packet));
                usb.settle();
                if self.below(2) == 0 {
                    self.count("aborts out", usb.abort_out(tag).is_ok());
                }
            }
            19 => {
                // given up in the middle of an answer
                let _ = usb.write(piece);
                let asked = usb.ask_for(100_000, None);
                for _ in 0..self.below(4) {
                    self.count("packets", usb.peek().is_some());
                }
                self.count("aborts in", asked.is_ok_and(|tag| usb.abort_in(tag).is_ok()));
            }
            20 => self.count("aborts out", usb.abort_out(tag).is_ok()),
            21 => usb.clear().unwrap(),
            22 => usb.clear_halt(),
            23 => {
                // a request without its other half, or of no sense
                let (kind, index) = if self.below(2) == 0 { (OF_INTERFACE, 1) } else { (OF_ENDPOINT, BULK_IN) };
                let index = if self.below(3) == 0 { BULK_OUT } else { index };
                usb.control(kind, self.below(10) as u8, tag.into(), index);
            }
            24 if self.below(4) == 0 => usb.hang_up(),
            _ => {
                if self.below(40) == 0 {
                    let _ = usb.write(b"AXIS1:MOVE:REL 0.05;*OPC?");
                }
                usb.bench.pass();
            }
        }
    }
}

#[test]
fn no_host_wedges_a_link() {
    let mut abuser = Abuser { random: Seeded::new(488), seen: BTreeMap::new() };
    let mut usb = usb();
    for sequence in 0..SEQUENCES {
        usb.hang_up();
        for _ in 0..abuser.below(14) {
            abuser.act(&mut usb);
        }
        if abuser.below(2) == 0 {
            usb.clear().unwrap();
        } else {
            // a driver that finds the endpoint halted clears that; END ends what has begun
            usb.rest();
            usb.clear_halt();
            usb.rest();
            usb.write(b"\n").unwrap_or_else(|trouble| panic!("sequence {sequence}: {trouble:?}"));
            usb.rest();
        }
        let told = usb.query("*IDN?\n").unwrap_or_else(|trouble| panic!("sequence {sequence}: {trouble:?}"));
        assert_eq!(told.matches(',').count(), 3, "sequence {sequence}: {told}");
        for number in usb.errors() {
            assert!((-499..=-100).contains(&number) || number == 104, "sequence {sequence}: {number}");
            abuser.count("errors", true);
            abuser.count("-410", number == -410);
            abuser.count("-420", number == -420);
        }
    }
    println!("{SEQUENCES} sequences, seed 488, none wedged: {:?}", abuser.seen);
    for kind in ["answers", "malformed", "-410", "-420", "service requests", "aborts in", "aborts out", "packets"] {
        assert!(abuser.seen[kind] > SEQUENCES / 100, "{kind}: {}", abuser.seen[kind]);
    }
}
