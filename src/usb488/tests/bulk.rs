//! Bulk OUT and bulk IN: messages, answers, and what is against the rules.

mod fake;
mod host;

use fake::{pattern, usb};
use host::{Trouble, message_out, request_in, trigger};

#[test]
fn a_message_arrives_whole_whatever_its_length_and_transfers() {
    for size in 1..260 {
        for chunk in [1, 3, 4, 51, 52, 53, 64, 116, 117, 1000] {
            let mut usb = usb();
            usb.chunk = chunk;
            usb.bench.appetite = Some(7);
            let message: String = ('a'..='z').cycle().take(size).collect();
            usb.write(message.as_bytes()).unwrap();
            assert_eq!(usb.bench.messages, [message], "{size} in {chunk}");
        }
    }
}

#[test]
fn an_answer_arrives_whole_whatever_its_length_and_what_is_asked_for() {
    for size in 1..260 {
        for asked in [1, 2, 51, 52, 53, 64, 115, 116, 117, 1000, u32::MAX] {
            let mut usb = usb();
            usb.size = asked;
            usb.write(format!("send {size}").as_bytes()).unwrap();
            assert_eq!(usb.read().unwrap(), pattern(size), "{size} by {asked}");
            assert!(!usb.bench.held);
            assert_eq!(usb.peek(), None, "{size} by {asked}: one packet too many");
        }
    }
}

#[test]
fn a_transfer_of_whole_packets_ends_with_an_empty_one() {
    for (size, lengths) in [(49, &[64, 0][..]), (52, &[64, 0]), (53, &[64, 4]), (116, &[64, 64, 0]), (1, &[16])] {
        let mut usb = usb();
        usb.write(format!("send {size}").as_bytes()).unwrap();
        usb.ask_for(1000, None).unwrap();
        let sent: Vec<usize> = std::iter::from_fn(|| usb.peek()).map(|packet| packet.len()).collect();
        assert_eq!(sent, lengths, "{size}");
    }
}

#[test]
fn an_empty_packet_behind_whole_ones_is_no_header() {
    let mut usb = usb();
    usb.put(&message_out(1, &[b'a'; 52], true)).unwrap();
    usb.put(&[]).unwrap();
    assert_eq!(usb.query("go on?").unwrap(), "go on?");
    assert_eq!(usb.bench.messages[0].len(), 52);
}

#[test]
fn the_header_of_an_answer_has_tag_size_and_end() {
    let mut usb = usb();
    usb.write(b"four?").unwrap();
    usb.put(&request_in(0x5b, 3, None)).unwrap();
    let first = usb.peek().unwrap();
    assert_eq!((&first[..15], first.len()), (&b"\x02\x5b\xa4\0\x03\0\0\0\0\0\0\0fou"[..], 16));
    usb.put(&request_in(0x5c, 3, None)).unwrap();
    let second = usb.peek().unwrap();
    assert_eq!((&second[..14], second.len()), (&b"\x02\x5c\xa3\0\x02\0\0\0\x01\0\0\0r?"[..], 16));
}

#[test]
fn a_transfer_ends_at_the_character_that_was_asked_for() {
    let mut usb = usb();
    usb.write(b"one;two;three?").unwrap();
    for (part, attributes) in [("one;", 2), ("two;", 2), ("three?", 1)] {
        let tag = usb.ask_for(100, Some(b';')).unwrap();
        assert_eq!(usb.fetch(tag, 100), Ok((part.as_bytes().to_vec(), attributes)));
    }
    usb.write(b"one;two?").unwrap();
    let tag = usb.ask_for(100, Some(b'?')).unwrap();
    assert_eq!(usb.fetch(tag, 100), Ok((b"one;two?".to_vec(), 3)));
    usb.write(b"one;two?").unwrap();
    let tag = usb.ask_for(2, Some(b';')).unwrap();
    assert_eq!(usb.fetch(tag, 2), Ok((b"on".to_vec(), 0)));
}

#[test]
fn long_answers_up_to_a_character_lose_nothing() {
    let mut usb = usb();
    usb.write(b"send 5000").unwrap();
    let mut answer = Vec::new();
    loop {
        let tag = usb.ask_for(1000, Some(b'\n')).unwrap();
        let (data, attributes) = usb.fetch(tag, 1000).unwrap();
        assert_eq!(attributes & 2 != 0, data.ends_with(b"\n"));
        assert!(!data[..data.len() - 1].contains(&b'\n'));
        answer.extend(data);
        if attributes & 1 != 0 {
            break;
        }
    }
    assert_eq!(answer, pattern(5000));
}

#[test]
fn what_is_not_the_end_of_an_answer_has_no_eom() {
    let mut usb = usb();
    usb.write(b"part?").unwrap();
    usb.bench.more = true;
    let tag = usb.ask_for(100, None).unwrap();
    assert_eq!(usb.fetch(tag, 100), Ok((b"part?".to_vec(), 0)));
    let tag = usb.ask_for(100, None).unwrap();
    assert_eq!(usb.peek(), None);
    usb.bench.answer = b"rest".iter().copied().collect();
    usb.bench.more = false;
    assert_eq!(usb.fetch(tag, 100), Ok((b"rest".to_vec(), 1)));
}

#[test]
fn everything_malformed_halts_bulk_out_until_the_host_clears_that() {
    let good = message_out(7, b"abc", true);
    let mut bad: Vec<Vec<u8>> = (1..12).map(|length| good[..length].to_vec()).collect();
    let changed = |at: usize, value: u8| {
        let mut packet = good.clone();
        packet[at] = value;
        packet
    };
    bad.extend((0..=255).filter(|id| *id != 1).map(|id| changed(0, id)));
    bad.extend((0..=255).filter(|tag| *tag != 7).map(|tag| changed(1, tag)));
    bad.extend((0..=255).filter(|inverse| *inverse != 0xf8).map(|inverse| changed(2, inverse)));
    bad.push([&[1, 0, 255], &good[3..]].concat());
    bad.push(changed(4, 5)); // more than comes
    bad.push(changed(7, 1));
    bad.push([&good[..], &[0; 4]].concat()); // less than comes
    bad.push([&request_in(7, 10, None)[..], &[0]].concat());
    bad.push(request_in(7, 0, None));
    bad.push([&trigger(7)[..], &[0; 4]].concat());
    bad.push(changed(0, 126)); // of a vendor
    bad.push(changed(0, 127));
    for packet in bad {
        let mut usb = usb();
        usb.put(&packet).unwrap();
        assert_eq!(usb.put(&good), Err(Trouble::Stall), "{packet:?}");
        assert_eq!(usb.put(&[]), Err(Trouble::Stall));
        usb.clear_halt();
        assert_eq!(usb.query("again?").as_deref(), Ok("again?"), "{packet:?}");
        assert_eq!(usb.bench.messages.len(), 1, "{packet:?}");
    }
}

#[test]
fn a_short_packet_in_the_middle_of_a_transfer_halts_and_drops_the_message() {
    let message = message_out(1, &[b'x'; 200], true);
    for whole in 1..4 {
        for length in [0, 1, 63] {
            let mut usb = usb();
            message.chunks(64).take(whole).for_each(|packet| usb.put(packet).unwrap());
            if whole * 64 + length >= message.len() {
                continue;
            }
            usb.put(&vec![b'x'; length]).unwrap();
            assert_eq!(usb.put(b""), Err(Trouble::Stall), "{whole} packets and {length} bytes");
            usb.clear_halt();
            assert_eq!(usb.query("again?").as_deref(), Ok("again?"));
            assert_eq!((usb.bench.messages.len(), usb.bench.abandoned), (1, 1));
        }
    }
}

#[test]
fn reserved_bytes_and_transfers_without_data_do_no_harm() {
    let mut usb = usb();
    let mut packet = message_out(1, b"*?", true);
    (packet[3], packet[9], packet[11]) = (1, 2, 3);
    usb.put(&packet).unwrap();
    assert_eq!(usb.read().unwrap(), b"*?");
    usb.put(&message_out(9, b"", true)).unwrap();
    assert_eq!(usb.query("again?").as_deref(), Ok("again?"));
}

#[test]
fn a_read_without_a_query_brings_nothing_and_harms_nothing() {
    let mut usb = usb();
    assert_eq!(usb.read(), Err(Trouble::TimeOut));
    assert_eq!(usb.bench.unasked, 1);
    assert_eq!(usb.query("again?").as_deref(), Ok("again?"));
    assert_eq!(usb.bench.interrupted, 0);
}

#[test]
fn a_read_without_a_query_is_noticed_whatever_follows_at_once() {
    let mut usb = usb();
    usb.settle();
    // both packets are there before the instrument has its turn
    usb.wire.out = Some(request_in(1, 10, None));
    usb.wire.behind = Some(message_out(2, b"next?", true));
    assert!(usb.interface.pump(&mut usb.wire));
    usb.settle();
    assert_eq!(usb.bench.unasked, 1);
    usb.tag = 2;
    assert_eq!(usb.read().unwrap(), b"next?");
}

#[test]
fn a_message_interrupts_the_answer_at_every_packet() {
    for fetched in 0..5 {
        let mut usb = usb();
        usb.write(b"send 250").unwrap();
        usb.ask_for(1000, None).unwrap();
        (0..fetched).for_each(|_| assert!(usb.peek().is_some()));
        assert_eq!(usb.query("next?").as_deref(), Ok("next?"), "behind {fetched}");
        assert_eq!(usb.bench.interrupted, usize::from(fetched < 5));
    }
    let mut usb = usb();
    usb.write(b"send 250").unwrap();
    usb.read().unwrap();
    usb.query("next?").unwrap();
    assert_eq!(usb.bench.interrupted, 0);
}

#[test]
fn a_message_interrupts_an_answer_that_nobody_has_asked_for_yet() {
    let mut usb = usb();
    usb.write(b"first?").unwrap();
    assert_eq!(usb.query("second?").as_deref(), Ok("second?"));
    assert_eq!(usb.bench.interrupted, 1);
}

#[test]
fn a_second_request_gets_what_the_first_one_has_left() {
    for size in [1, 52, 53, 300] {
        for fetched in 0..4 {
            let mut usb = usb();
            usb.write(format!("send {size}").as_bytes()).unwrap();
            usb.ask_for(1000, None).unwrap();
            let before: Vec<u8> = (0..fetched).map_while(|_| usb.peek()).flatten().collect();
            let before = before.get(12..).unwrap_or(&[]);
            if before.len() >= size {
                continue;
            }
            assert_eq!([before, &usb.read().unwrap()].concat(), pattern(size), "{size}, {fetched} packets");
            assert_eq!(usb.bench.interrupted, 0);
        }
    }
}

#[test]
fn a_trigger_comes_behind_what_was_sent_before() {
    let mut usb = usb();
    usb.write(b"work").unwrap();
    usb.bench.work = 3;
    usb.trigger().unwrap();
    assert_eq!(usb.bench.triggers, 0);
    assert_eq!(usb.query("after?").as_deref(), Ok("after?"));
    assert_eq!((usb.bench.triggers, usb.bench.interrupted), (1, 0));
    usb.write(b"lost?").unwrap();
    usb.trigger().unwrap();
    assert_eq!((usb.bench.triggers, usb.bench.interrupted), (2, 1));
}
