//! Bytes and messages over the lines, one thing at a time.

mod bus;

use bus::board::{Board, Pace};
use bus::controller::*;
use bus::instrument::Instrument;
use bus::{Bench, DEVICE, INSTRUMENT};
use stage_gpib::device::Event;
use stage_gpib::lines::Lines;
use stage_gpib::remote::RL;

fn bench(seed: u64) -> Bench {
    let mut bench = Bench::new(seed, Board::new(Pace::FAST), Instrument::new(true));
    bench.controller.script.push_back(Op::Remote(true));
    bench.controller.recover();
    bench
}

fn text(words: &str) -> Vec<(u8, bool)> {
    let last = words.len() - 1;
    words.bytes().enumerate().map(|(at, byte)| (byte, at == last)).collect()
}

#[test]
fn a_query_goes_in_and_its_answer_comes_out() {
    let mut bench = bench(1);
    bench.controller.say(&[DEVICE], &text("*IDN?\n"));
    bench.board.firmware.exchange.answer.extend(text("stage,6,0,1\n"));
    bench.controller.read(DEVICE, &[], 100);
    bench.controller.command(&[UNT, UNL]);
    bench.finish();
    bench.check();
    assert_eq!(bench.ledger.device.got, text("*IDN?\n"));
    assert_eq!(bench.ledger.controller.got, text("stage,6,0,1\n"));
    assert_eq!(bench.watch.sourced, 12, "each byte once");
}

#[test]
fn what_the_device_says_reaches_every_listener_once() {
    let mut bench = bench(2);
    bench.board.firmware.exchange.answer.extend(text("0.125,-3.5\n"));
    bench.controller.read(DEVICE, &[INSTRUMENT], 100);
    bench.controller.command(&[UNT, UNL]);
    bench.finish();
    bench.check();
    assert_eq!(bench.ledger.controller.got, text("0.125,-3.5\n"));
    assert_eq!(bench.ledger.instrument.got, text("0.125,-3.5\n"));
}

#[test]
fn what_another_instrument_says_reaches_the_device() {
    let mut bench = bench(3);
    bench.instrument.answer.extend(text("-12.5\n"));
    bench.controller.read(INSTRUMENT, &[DEVICE], 100);
    bench.controller.command(&[UNT, UNL]);
    bench.finish();
    bench.check();
    assert_eq!(bench.ledger.device.got, text("-12.5\n"));
}

#[test]
fn a_talker_that_has_nothing_to_say_asks_once_and_waits() {
    let mut bench = bench(4);
    bench.controller.command(&[UNL, talk(DEVICE)]);
    bench.controller.script.push_back(Op::StandBy);
    bench.finish();
    bench.rest(300_000);
    let asked = bench.board.firmware.exchange.events.iter().filter(|event| **event == Event::ByteRequested).count();
    assert_eq!(asked, 1);
    assert_eq!(bench.watch.sourced, 0);
}

#[test]
fn nothing_leaves_while_nobody_listens() {
    let mut bench = Bench::new(5, Board::new(Pace::FAST), Instrument::new(false));
    bench.board.firmware.exchange.answer.extend(text("lost?\n"));
    bench.controller.recover();
    bench.controller.command(&[UNL, talk(DEVICE)]);
    bench.controller.script.push_back(Op::StandBy);
    bench.finish();
    bench.rest(300_000);
    assert_eq!(bench.watch.sourced, 0);
    bench.controller.read(DEVICE, &[], 100);
    bench.finish();
    assert_eq!(bench.ledger.controller.got, text("lost?\n"));
}

#[test]
fn a_device_without_room_holds_the_source_and_loses_nothing() {
    let mut bench = bench(6);
    bench.board.firmware.exchange.deaf = true;
    bench.controller.say(&[DEVICE], &text("ab"));
    for _ in 0..20_000 {
        bench.tick();
    }
    assert_eq!(bench.ledger.device.got, [(b'a', false)], "the one it had room for");
    assert!(bench.lines.has(Lines::NRFD));
    bench.board.firmware.exchange.deaf = false;
    bench.finish();
    bench.rest(10_000);
    bench.check();
    assert_eq!(bench.ledger.device.got, text("ab"));
}

#[test]
fn a_serial_poll_sends_the_status_byte_and_ends_the_request() {
    let mut bench = bench(7);
    bench.finish();
    bench.board.status(0x10, true);
    bench.rest(10_000);
    assert!(bench.lines.has(Lines::SRQ));
    bench.controller.poll(INSTRUMENT);
    bench.finish();
    assert!(bench.lines.has(Lines::SRQ), "another's poll changes nothing");
    bench.controller.poll(DEVICE);
    bench.controller.poll(DEVICE);
    bench.finish();
    bench.rest(10_000);
    assert!(!bench.lines.has(Lines::SRQ));
    assert_eq!(bench.controller.statuses, [bus::instrument::STATUS, 0x50, 0x10], "RQS once");
    assert_eq!(bench.board.firmware.exchange.polls, [(0x50, false), (0x10, false)]);
}

#[test]
fn a_poll_between_two_bytes_of_an_answer_disturbs_neither() {
    let mut bench = bench(8);
    bench.board.firmware.exchange.answer.extend(text("abcdef"));
    bench.board.status(0x51, true);
    bench.controller.read(DEVICE, &[], 3);
    bench.controller.poll(DEVICE);
    bench.controller.read(DEVICE, &[], 3);
    bench.finish();
    bench.check();
    assert_eq!(bench.ledger.controller.got, text("abcdef"));
    assert_eq!(bench.controller.statuses, [0x51]);
}

#[test]
fn service_is_requested_again_only_after_the_request_was_withdrawn() {
    let mut bench = bench(9);
    bench.board.status(0, true);
    bench.controller.poll(DEVICE);
    bench.finish();
    bench.rest(5_000);
    assert!(!bench.lines.has(Lines::SRQ));
    bench.board.status(0, true);
    bench.rest(5_000);
    assert!(bench.lines.has(Lines::SRQ));
    bench.board.status(0, false);
    bench.rest(5_000);
    assert!(!bench.lines.has(Lines::SRQ));
}

#[test]
fn clear_and_trigger_reach_whom_they_name() {
    let mut bench = bench(10);
    bench.controller.command(&[UNL, listen(INSTRUMENT), GET, SDC]);
    bench.finish();
    assert_eq!((bench.board.firmware.exchange.clears, bench.board.firmware.exchange.triggers), (0, 0));
    bench.controller.command(&[listen(DEVICE), GET, SDC]);
    bench.finish();
    bench.rest(5_000);
    assert_eq!((bench.board.firmware.exchange.clears, bench.board.firmware.exchange.triggers), (1, 1));
    bench.controller.command(&[UNL, DCL, GET]);
    bench.finish();
    bench.rest(5_000);
    assert_eq!((bench.board.firmware.exchange.clears, bench.board.firmware.exchange.triggers), (2, 1));
}

#[test]
fn commands_of_other_functions_are_passed_over() {
    let mut bench = bench(11);
    bench.controller.command(&[UNL, listen(DEVICE)]);
    bench.finish();
    bench.rest(5_000);
    let (before, events) = (bench.board.firmware.device.states(), bench.board.firmware.exchange.events.len());
    // parallel poll configure with its secondary, unconfigure, take control, codes without meaning, secondaries
    let mut codes = vec![PPC, 0x6A, PPU, TCT, 0x00, 0x02, 0x0F, 0x10, 0x12, 0x1F];
    codes.extend(0x60..=0x7F);
    bench.controller.command(&codes);
    bench.finish();
    bench.rest(5_000);
    let after = bench.board.firmware.device.states();
    assert_eq!((after.addressing, after.remote), (before.addressing, before.remote));
    assert_eq!(bench.board.firmware.exchange.events.len(), events);
    let told = bench.controller.said.iter().filter(|said| matches!(said, Said::Command(_))).count();
    assert_eq!(told, 2 + codes.len(), "each was shaken hands for");
}

#[test]
fn interface_messages_leave_the_eighth_bit_open() {
    let mut bench = bench(12);
    bench.controller.command(&[0x80 | listen(DEVICE), 0x80 | GET]);
    bench.finish();
    bench.rest(5_000);
    assert_eq!(bench.board.firmware.exchange.triggers, 1);
}

#[test]
fn a_parallel_poll_is_not_answered() {
    let mut bench = bench(13);
    bench.board.status(0xFF, true);
    bench.controller.command(&[UNL, listen(DEVICE), PPC, 0x68]);
    bench.controller.script.push_back(Op::ParallelPoll);
    bench.controller.command(&[UNL]);
    bench.finish();
    assert_eq!(bench.controller.parallel, [0]);
}

#[test]
fn the_device_is_remote_when_addressed_and_local_when_ren_goes() {
    let mut bench = bench(14);
    bench.controller.command(&[listen(DEVICE), GTL, listen(DEVICE), LLO, GTL, listen(DEVICE)]);
    bench.controller.script.push_back(Op::Remote(false));
    bench.finish();
    bench.rest(5_000);
    let expected = [RL::REMS, RL::LOCS, RL::REMS, RL::RWLS, RL::LWLS, RL::RWLS, RL::LOCS];
    assert_eq!(bench.board.firmware.exchange.remotes, expected);
}

#[test]
fn a_dead_processor_leaves_the_bus_to_others() {
    // outputs of a processor in reset are pulled down: the gates do not hold, the transceivers listen
    let mut bench = bench(15);
    bench.board = Board::unpowered();
    bench.instrument.answer.extend(text("on\n"));
    bench.controller.read(INSTRUMENT, &[], 10);
    bench.finish();
    assert_eq!(bench.ledger.controller.got, text("on\n"));
}
