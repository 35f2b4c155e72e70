//! Requests on endpoint 0: aborts, clear, status byte, service request, remote and local.

mod fake;
mod host;

use fake::{pattern, usb};
use host::{BULK_IN, BULK_OUT, Trouble, message_out};
use stage_usb488::Panel;
use stage_usb488::control::{OF_ENDPOINT, OF_INTERFACE, request, status};

#[test]
fn what_is_not_known_is_stalled() {
    let known = |kind, request| match request {
        1..=4 => kind == OF_ENDPOINT,
        5..=7 | 128 | 160..=162 => kind == OF_INTERFACE,
        _ => false,
    };
    for kind in 0..=255 {
        for request in 0..=255 {
            let index = if request >= 3 { BULK_IN } else { BULK_OUT };
            let answer = usb().control(kind, request, 2, index);
            assert_eq!(answer.is_some(), known(kind, request), "{kind:#x} {request}");
        }
    }
    for request in 1..=4 {
        let other = if request >= 3 { BULK_OUT } else { BULK_IN };
        assert_eq!(usb().control(OF_ENDPOINT, request, 1, other), None, "{request} of the other endpoint");
    }
}

#[test]
fn answers_are_as_long_as_the_standard_says() {
    let lengths = [(5, 1), (6, 2), (7, 24), (128, 3), (160, 1), (161, 1), (162, 1)];
    for (request, length) in lengths {
        assert_eq!(usb().of_interface(request, 2).len(), length, "{request}");
    }
    for (request, index, length) in [(1, BULK_OUT, 2), (2, BULK_OUT, 8), (3, BULK_IN, 2), (4, BULK_IN, 8)] {
        assert_eq!(usb().of_endpoint(request, 1, index).len(), length, "{request}");
    }
}

#[test]
fn bulk_in_can_be_aborted_at_every_packet_and_a_later_read_goes_on() {
    for size in [1, 52, 53, 116, 117, 300] {
        for fetched in 0..6 {
            let mut usb = usb();
            usb.write(format!("send {size}").as_bytes()).unwrap();
            let tag = usb.ask_for(1000, None).unwrap();
            let before: Vec<u8> = (0..fetched).map_while(|_| usb.peek()).flatten().collect();
            let before = before.get(12..).unwrap_or(&[]);
            let before = &before[..before.len().min(size)];
            if before.len() == size {
                continue;
            }
            assert_eq!(usb.abort_in(tag), Ok(before.len() as u32), "{size}, {fetched} packets");
            assert_eq!([before, &usb.read().unwrap()].concat(), pattern(size), "{size}, {fetched} packets");
            assert_eq!(usb.bench.interrupted, 0);
        }
    }
}

#[test]
fn an_abort_of_bulk_in_says_when_it_is_not_its_turn() {
    let mut usb = usb();
    assert_eq!(usb.abort_in(1), Err(Trouble::Refused(status::FAILED)));
    usb.write(b"send 300").unwrap();
    let tag = usb.ask_for(1000, None).unwrap();
    let refused = usb.of_endpoint(request::INITIATE_ABORT_BULK_IN, u16::from(tag) + 1, BULK_IN);
    assert_eq!(refused, [status::TRANSFER_NOT_IN_PROGRESS, tag], "the one under way, not the one asked for");
    assert_eq!(usb.fetch(tag, 1000).unwrap().0, pattern(300));
    assert_eq!(usb.abort_in(tag), Err(Trouble::Refused(status::FAILED)));
    let check = usb.of_endpoint(request::CHECK_ABORT_BULK_IN_STATUS, 0, BULK_IN);
    assert_eq!(check[0], status::SPLIT_NOT_IN_PROGRESS);
}

#[test]
fn an_aborted_request_that_was_not_served_is_withdrawn() {
    let mut usb = usb();
    usb.write(b"work").unwrap();
    usb.bench.work = 5;
    let tag = usb.ask_for(1000, None).unwrap();
    assert_eq!(usb.abort_in(tag), Err(Trouble::Refused(status::FAILED)));
    usb.bench.work = 0;
    usb.bench.answer = b"late".iter().copied().collect();
    assert_eq!(usb.peek(), None);
    assert_eq!(usb.read().unwrap(), b"late");
}

#[test]
fn an_abort_waits_until_the_host_has_read_up_to_a_short_packet() {
    let mut usb = usb();
    usb.write(b"send 300").unwrap();
    let tag = usb.ask_for(1000, None).unwrap();
    assert_eq!(usb.of_endpoint(request::INITIATE_ABORT_BULK_IN, tag.into(), BULK_IN), [status::SUCCESS, tag]);
    usb.settle();
    let check = usb.of_endpoint(request::CHECK_ABORT_BULK_IN_STATUS, 0, BULK_IN);
    assert_eq!(check[..2], [status::PENDING, 1]);
    assert_eq!(usb.peek().unwrap(), [0; 0]);
    let check = usb.of_endpoint(request::CHECK_ABORT_BULK_IN_STATUS, 0, BULK_IN);
    assert_eq!(check, [status::SUCCESS, 0, 0, 0, 0, 0, 0, 0]);
}

#[test]
fn bulk_out_can_be_aborted_at_every_packet_and_the_message_is_dropped() {
    let message = message_out(9, &[b'x'; 300], true);
    for packets in 1..message.len().div_ceil(64) {
        for appetite in [None, Some(0)] {
            let mut usb = usb();
            usb.bench.appetite = appetite;
            let sent = if appetite.is_some() { 1 } else { packets };
            message.chunks(64).take(sent).for_each(|packet| usb.put(packet).unwrap());
            usb.settle();
            assert_eq!(usb.abort_out(9), Ok(sent as u32 * 64 - 12), "{packets}");
            usb.bench.appetite = None;
            assert_eq!(usb.query("again?").as_deref(), Ok("again?"), "{packets}");
            assert_eq!(usb.bench.messages.len(), 1);
        }
    }
}

#[test]
fn an_abort_of_bulk_out_reads_away_what_is_on_its_way() {
    let message = message_out(9, &[b'x'; 300], true);
    let mut usb = usb();
    usb.bench.appetite = Some(0);
    for packet in message.chunks(64).take(2) {
        usb.put(packet).unwrap();
    }
    usb.settle();
    assert!(usb.wire.out.is_some(), "one waits behind the one that is not taken");
    usb.bench.appetite = None;
    usb.abort_out(9).unwrap();
    assert!(usb.wire.out.is_none());
    assert_eq!(usb.query("again?").as_deref(), Ok("again?"));
}

#[test]
fn an_abort_of_bulk_out_says_when_it_is_not_its_turn() {
    let mut usb = usb();
    assert_eq!(usb.of_endpoint(request::INITIATE_ABORT_BULK_OUT, 1, BULK_OUT), [status::FAILED, 0]);
    usb.put(&message_out(5, &[b'x'; 100], true)[..64]).unwrap();
    usb.settle();
    let refused = usb.of_endpoint(request::INITIATE_ABORT_BULK_OUT, 4, BULK_OUT);
    assert_eq!(refused, [status::TRANSFER_NOT_IN_PROGRESS, 5]);
    assert_eq!(usb.of_endpoint(request::CHECK_ABORT_BULK_OUT_STATUS, 0, BULK_OUT)[0], status::SPLIT_NOT_IN_PROGRESS);
    usb.put(&message_out(5, &[b'x'; 100], true)[64..]).unwrap();
    usb.settle();
    assert_eq!(usb.bench.messages.len(), 1);
}

#[test]
fn an_abort_of_bulk_out_is_done_at_once_whatever_is_executed() {
    let mut usb = usb();
    usb.write(b"work").unwrap();
    usb.bench.work = 3;
    usb.put(&message_out(9, &[b'x'; 300], true)[..64]).unwrap();
    usb.settle();
    assert_eq!(usb.of_endpoint(request::INITIATE_ABORT_BULK_OUT, 9, BULK_OUT), [status::SUCCESS, 9]);
    usb.settle();
    assert_eq!(usb.of_endpoint(request::CHECK_ABORT_BULK_OUT_STATUS, 0, BULK_OUT)[0], status::SUCCESS);
    assert_eq!(usb.bench.work, 3);
}

#[test]
fn one_split_request_at_a_time_but_clear_always() {
    let mut usb = usb();
    usb.write(b"send 300").unwrap();
    let tag = usb.ask_for(1000, None).unwrap();
    usb.of_endpoint(request::INITIATE_ABORT_BULK_IN, tag.into(), BULK_IN);
    let other = usb.of_endpoint(request::INITIATE_ABORT_BULK_OUT, 1, BULK_OUT);
    assert_eq!(other[0], status::SPLIT_IN_PROGRESS);
    usb.clear().unwrap();
    assert_eq!(usb.of_interface(request::CHECK_CLEAR_STATUS, 0)[0], status::SPLIT_NOT_IN_PROGRESS);
}

#[test]
fn a_host_that_never_checks_is_not_held_up() {
    let mut usb = usb();
    usb.of_interface(request::INITIATE_CLEAR, 0);
    assert_eq!(usb.query("on?").as_deref(), Ok("on?"));
    let tag = usb.tag;
    assert_eq!(usb.abort_in(tag), Err(Trouble::Refused(status::FAILED)));
    usb.write(b"send 300").unwrap();
    let tag = usb.ask_for(1000, None).unwrap();
    usb.of_endpoint(request::INITIATE_ABORT_BULK_IN, tag.into(), BULK_IN);
    assert_eq!(usb.query("on?").as_deref(), Ok("on?"));
}

#[test]
fn clear_at_every_packet_of_an_answer_leaves_nothing_of_it() {
    for fetched in 0..5 {
        let mut usb = usb();
        usb.write(b"send 250").unwrap();
        usb.ask_for(1000, None).unwrap();
        (0..fetched).for_each(|_| assert!(usb.peek().is_some()));
        usb.clear().unwrap();
        assert_eq!(usb.peek(), None, "behind {fetched}");
        assert_eq!(usb.query("again?").as_deref(), Ok("again?"), "behind {fetched}");
        assert_eq!((usb.bench.clears, usb.bench.interrupted), (1, 0));
    }
}

#[test]
fn clear_at_every_packet_of_a_message_leaves_nothing_of_it() {
    let message = message_out(9, &[b'x'; 300], true);
    for packets in 0..message.len().div_ceil(64) {
        let mut usb = usb();
        message.chunks(64).take(packets).for_each(|packet| usb.put(packet).unwrap());
        usb.clear().unwrap();
        assert_eq!(usb.query("again?").as_deref(), Ok("again?"), "{packets}");
        assert_eq!(usb.bench.messages, ["again?"]);
    }
}

#[test]
fn clear_reads_away_what_was_on_its_way() {
    let mut usb = usb();
    usb.bench.work = 1000;
    usb.transfer(&message_out(1, b"first", true)).unwrap();
    usb.transfer(&message_out(2, b"second", true)).unwrap();
    assert_eq!(usb.of_interface(request::INITIATE_CLEAR, 0), [status::SUCCESS]);
    assert_eq!(usb.of_interface(request::CHECK_CLEAR_STATUS, 0), [status::PENDING, 0]);
    usb.settle();
    assert_eq!(usb.of_interface(request::CHECK_CLEAR_STATUS, 0), [status::SUCCESS, 0]);
    assert_eq!(usb.query("again?").as_deref(), Ok("again?"));
    assert_eq!(usb.bench.messages, ["again?"]);
}

#[test]
fn an_exclamation_mark_behind_a_clear_is_heard_before_the_host_has_checked() {
    for (packet, heard) in [
        (message_out(7, b"!\n", true), true),
        (message_out(7, b"!", true), true),
        (message_out(7, b"x!\n", true), false),
        (message_out(7, b"", true), false),
        (b"no header 12!".to_vec(), false),
    ] {
        let mut usb = usb();
        usb.write(b"work").unwrap();
        usb.bench.work = 5;
        assert_eq!(usb.of_interface(request::INITIATE_CLEAR, 0), [status::SUCCESS]);
        usb.wire.out = Some(packet.clone());
        usb.settle();
        assert_eq!(usb.of_interface(request::CHECK_CLEAR_STATUS, 0), [status::SUCCESS, 0]);
        usb.clear_halt();
        let expected: &[&str] = if heard { &["work", "!\n"] } else { &["work"] };
        assert_eq!(usb.bench.messages, expected, "{packet:?}");
        assert_eq!(usb.query("next?").as_deref(), Ok("next?"));
    }
}

#[test]
fn the_status_byte_comes_as_a_notification_under_its_tag() {
    let mut usb = usb();
    usb.bench.status = 0x24;
    for tag in 2..=127 {
        assert_eq!(usb.of_interface(request::READ_STATUS_BYTE, tag), [status::SUCCESS, tag as u8, 0]);
        assert_eq!(usb.notice(), Some([0x80 | tag as u8, 0x24]));
        assert_eq!(usb.notice(), None);
    }
    for tag in [0, 1, 128, 255] {
        assert_eq!(usb.of_interface(request::READ_STATUS_BYTE, tag), [status::FAILED, tag as u8, 0]);
        assert_eq!(usb.notice(), None);
    }
}

#[test]
fn a_status_byte_that_was_not_fetched_makes_the_next_one_wait() {
    let mut usb = usb();
    assert_eq!(usb.read_stb(), Ok(0));
    usb.of_interface(request::READ_STATUS_BYTE, 20);
    assert_eq!(usb.of_interface(request::READ_STATUS_BYTE, 21)[0], status::INTERRUPT_IN_BUSY);
    usb.settle();
    assert_eq!(usb.of_interface(request::READ_STATUS_BYTE, 21)[0], status::INTERRUPT_IN_BUSY);
    assert_eq!(usb.notice(), Some([0x80 | 20, 0]));
    assert_eq!(usb.read_stb(), Ok(0));
}

#[test]
fn each_service_request_is_notified_once() {
    let mut usb = usb();
    usb.bench.status = 0x20;
    assert_eq!(usb.notice(), None);
    for _ in 0..3 {
        usb.bench.requests = true;
        assert_eq!(usb.notice(), Some([0x81, 0x60]));
        assert_eq!(usb.notice(), None);
        assert_eq!(usb.read_stb(), Ok(0x20), "the notification has taken RQS away");
    }
}

#[test]
fn a_service_request_that_the_host_has_not_seen_shows_in_the_status_byte() {
    let mut usb = usb();
    usb.bench.status = 0x20;
    usb.bench.requests = true;
    usb.settle();
    assert_eq!(usb.read_stb(), Ok(0x60));
    assert_eq!(usb.read_stb(), Ok(0x20));
}

#[test]
fn requests_while_one_waits_become_one_more() {
    let mut usb = usb();
    usb.bench.status = 0x20;
    for _ in 0..4 {
        usb.bench.requests = true;
        usb.settle();
    }
    let seen = std::iter::from_fn(|| usb.notice()).count();
    assert_eq!(seen, 3, "at the endpoint, behind it, and in the instrument");
}

#[test]
fn remote_and_local_reach_the_instrument_in_turn() {
    let mut usb = usb();
    for (request, value) in [(160, 1), (162, 0), (161, 0), (160, 0)] {
        assert_eq!(usb.of_interface(request, value), [status::SUCCESS]);
    }
    assert_eq!(usb.of_interface(request::GO_TO_LOCAL, 0), [status::FAILED], "the instrument had no turn");
    usb.settle();
    assert_eq!(usb.bench.panels, [Panel::Enable, Panel::LockOut, Panel::Local, Panel::Disable]);
}

#[test]
fn a_packet_from_before_a_reset_is_not_taken_for_a_header() {
    let message = message_out(9, &[b'x'; 300], true);
    let mut usb = usb();
    usb.bench.work = 1000;
    usb.put(&message[..64]).unwrap();
    usb.put(&message[64..128]).unwrap();
    usb.settle();
    let waits = usb.wire.out.take();
    assert!(waits.is_some());
    usb.reset();
    usb.wire.out = waits;
    usb.bench.work = 0;
    usb.settle();
    assert!(usb.wire.out.is_none());
    assert_eq!(usb.query("again?").as_deref(), Ok("again?"));
}
