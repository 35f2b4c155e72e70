//! Two controllers on the sixteen lines of a GPIB, from the handshake of a byte to the stage that moves.

mod lines488;

use lines488::Bench;
use lines488::bus::board::Pace;
use lines488::bus::controller::*;
use lines488::bus::{Random, between, once_in};
use stage_controller::scpi::exchange::Control;
use std::collections::BTreeMap;

const IDENTITY: &str = "Stage Controller,SC6,0,0.1.0\n";
/// No errors.
const NONE: [i32; 0] = [];

fn bench(seed: u64) -> Bench {
    Bench::new(seed, Pace::FAST)
}

/// Both answer, at once.
fn works(bench: &mut Bench, context: &str) {
    for address in [5, 6] {
        assert_eq!(bench.ask(address, "*IDN?"), IDENTITY, "{context} {address}");
    }
    bench.check();
}

#[test]
fn both_say_who_they_are_and_keep_their_own_settings() {
    let mut bench = bench(1);
    works(&mut bench, "");
    bench.write(5, "AXIS1:VEL 321;*ESE 5");
    bench.write(6, "AXIS1:VEL 123.5;*ESE 6\r\n");
    assert_eq!(bench.ask(5, "AXIS1:VEL?;*ESE?"), "321.000;5\n");
    assert_eq!(bench.ask(6, "AXIS1:VEL?;*ESE?\n"), "123.500;6\n");
    // LF without EOI ends a message too
    bench.put(5, b"*ESE?\n", false);
    assert_eq!(bench.answer(5).as_deref(), Some("5\n"));
    assert_eq!((bench.errors(5), bench.errors(6)), (vec![], vec![]));
}

#[test]
fn a_long_answer_comes_whole_with_end_on_its_last_byte() {
    for pace in [Pace::FAST, Pace::SLOW] {
        let mut bench = Bench::new(2, pace);
        bench.write(5, "SYST:HELP:HEAD?");
        let (answer, end) = bench.read(5, 100_000);
        let digits = usize::from(answer[1] - b'0');
        let length: usize = std::str::from_utf8(&answer[2..2 + digits]).unwrap().parse().unwrap();
        assert!(end && length > 3000);
        assert_eq!(answer.len(), 2 + digits + length + 1);
        // in parts, with others in between
        bench.write(5, "POSE?");
        let mut parts = Vec::new();
        while let (part, end) = bench.read(5, 7)
            && parts.len() < 100
        {
            parts.extend(part);
            if end {
                break;
            }
            assert_eq!(bench.poll(5) & 16, 16, "the rest waits");
            works_at(&mut bench, 6);
        }
        assert_eq!(parts, b"0.000,0.000,0.000,0.00000000,0.00000000,0.00000000\n");
        assert_eq!((bench.poll(5) & 16, bench.errors(5)), (0, vec![]));
        bench.check();
    }
}

fn works_at(bench: &mut Bench, address: u8) {
    assert_eq!(bench.ask(address, "*IDN?"), IDENTITY);
}

#[test]
fn a_calibration_goes_up_and_comes_down_with_every_byte_in_it() {
    let mut bench = bench(3);
    bench.write(5, "COMP:DATA?");
    let (block, end) = bench.read(5, 100_000);
    let block = &block[..block.len() - 1];
    assert!(end && block.starts_with(b"#3") && block.contains(&b'\n'));
    bench.write(6, [b"COMP:LOAD ", block].concat());
    assert_eq!(bench.ask(6, "*OPC?"), "1\n");
    assert_eq!(bench.errors(6), NONE);
    let crc = bench.ask(5, "COMP:CRC?");
    assert_eq!(bench.ask(6, "COMP:CRC?"), crc);
    let mut broken = block.to_vec();
    *broken.last_mut().unwrap() ^= 1;
    bench.write(6, [b"COMP:LOAD ", &broken[..], b"\n"].concat());
    assert_eq!(bench.errors(6), [-230]);
    bench.write(6, &[b"COMP:LOAD ", block].concat()[..40]);
    assert_eq!(bench.errors(6), [-161], "END in the middle of it");
    assert_eq!((bench.ask(6, "COMP:CRC?"), bench.errors(5)), (crc, vec![]));
}

#[test]
fn a_trigger_begins_the_traces_of_both_which_come_down_as_blocks() {
    let mut bench = bench(4);
    for address in [5, 6] {
        bench.write(address, "FORM PACK;:TRIG:SOUR BUS;:TRAC:CONF SAMP,1;ARM");
        assert_eq!(bench.ask(address, "STAT:OPER:COND?"), "32\n");
        bench.stage(address).runs = true;
    }
    bench.rest(400_000);
    assert_eq!(bench.ask(5, "TRAC:POIN?"), "0\n");
    bench.command(&[UNL, listen(5), listen(6), GET]);
    bench.rest(2_000_000);
    for address in [5, 6] {
        assert_eq!(bench.ask(address, "STAT:OPER:COND?"), "0\n");
        assert!(bench.ask(address, "TRAC:POIN?").trim().parse::<u32>().unwrap() > 20);
        bench.write(address, "TRAC:DATA? 0,20");
        let (block, end) = bench.read(address, 100_000);
        assert!(end && block.starts_with(b"#3720"), "{}", block.escape_ascii());
        let ticks: Vec<u64> =
            block[5..725].chunks(36).map(|c| u64::from_le_bytes(c[..8].try_into().unwrap())).collect();
        assert!(ticks.windows(2).all(|pair| pair[1] - pair[0] == 256), "{ticks:?}");
        bench.stage(address).runs = false;
        assert_eq!(bench.errors(address), NONE);
    }
    bench.command(&[UNL, listen(6), GET]);
    assert_eq!((bench.errors(5), bench.errors(6)), (vec![], vec![-211]), "nothing waits for it");
}

#[test]
fn service_is_requested_when_an_operation_has_ended_and_when_something_is_wrong() {
    let mut bench = bench(5);
    assert!(!bench.requests_service());
    bench.write(5, "*CLS;*ESE 1;*SRE 32;:AXIS1:MOVE 5;*OPC");
    bench.write(6, "*CLS;*SRE 4");
    assert_eq!((bench.poll(5), bench.poll(6)), (0, 0));
    bench.until(|bench| bench.requests_service());
    assert!(!bench.stage(5).moves());
    assert_eq!(bench.poll(6), 0, "it was the other");
    assert!(bench.requests_service());
    assert_eq!(bench.poll(5), 0x60);
    bench.rest(50_000);
    assert!(!bench.requests_service());
    assert_eq!(bench.poll(5), 0x20, "RQS is told once");
    bench.write(6, "NO:SUCH");
    bench.until(|bench| bench.requests_service());
    assert_eq!((bench.poll(5), bench.poll(6), bench.poll(6)), (0x20, 0x44, 0x04));
    assert_eq!((bench.errors(6), bench.poll(6)), (vec![-113], 0));
    bench.write(6, "*SRE 16;POSE?");
    bench.until(|bench| bench.requests_service());
    assert_eq!((bench.poll(6), bench.poll(6)), (0x50, 0x10));
    bench.read(6, 3);
    assert_eq!((bench.poll(6), bench.requests_service()), (0x10, false), "a part is read: the rest still waits");
    bench.answer(6);
    assert_eq!(bench.poll(6), 0);
}

#[test]
fn no_request_for_service_is_lost_by_a_poll_that_is_broken_off_at_any_step() {
    let (mut twice, mut told) = (0, 0);
    for (seed, abuse) in [Abuse::Clear, Abuse::Seize, Abuse::HangUp(50_000), Abuse::Blip(2_000)].into_iter().enumerate()
    {
        let mut bench = bench(60 + seed as u64);
        bench.write(5, "*SRE 4");
        for step in 1.. {
            bench.write(5, "NO:SUCH");
            bench.until(|bench| bench.requests_service());
            bench.controller.statuses.clear();
            bench.controller.poll(5);
            bench.controller.abuse = Some((step, abuse));
            bench.follow();
            if !bench.broke_off() {
                break;
            }
            bench.interface_clear();
            bench.command(&[SPD, UNT]);
            let before = bench.controller.statuses.contains(&0x44);
            let waits = bench.requests_service();
            let after = bench.poll(5) == 0x44;
            assert_eq!(waits, after, "SRQ and RQS say the same, {abuse:?} {step}");
            assert!(before || after, "lost, {abuse:?} {step}");
            told += 1;
            twice += u32::from(before && after);
            bench.write(5, "*CLS");
        }
    }
    assert!(told > 150 && twice < told / 10, "{told} {twice}");
}

#[test]
fn two_stages_move_at_once() {
    let mut bench = bench(6);
    for (address, target) in [(5, "-20"), (6, "20")] {
        bench.write(address, format!("*CLS;*ESE 1;*SRE 32;:AXIS1:MOVE {target};*OPC"));
    }
    bench.rest(10_000);
    assert!(bench.stage(5).moves() && bench.stage(6).moves());
    let mut done = Vec::new();
    while done.len() < 2 {
        bench.until(|bench| bench.requests_service());
        for address in [5, 6] {
            if bench.poll(address) & 64 != 0 {
                done.push(address);
            }
        }
    }
    done.sort_unstable();
    assert_eq!(done, [5, 6]);
    for (address, target) in [(5, -20.0), (6, 20.0)] {
        let pose = bench.ask(address, "AXIS1:POS?").trim().parse::<f64>().unwrap();
        assert!((pose - target).abs() < 0.05, "{address} {pose}");
        assert_eq!(bench.errors(address), NONE);
    }
}

#[test]
fn query_errors_are_those_of_the_standard() {
    let mut bench = bench(7);
    assert_eq!(bench.read(5, 10), (vec![], false));
    assert_eq!((bench.errors(5), bench.errors(6)), (vec![-420], vec![]));
    bench.put(5, b"*ESE 7;*ESE?", false);
    assert_eq!(bench.read(5, 10), (vec![], false));
    assert_eq!(bench.ask(5, "*ESE?"), "0\n", "the half message is gone");
    assert_eq!(bench.errors(5), [-420]);
    for part in [0, 1, 6] {
        bench.write(5, "POSE?;*ESE?");
        if part > 0 {
            assert_eq!(bench.read(5, part).0.len(), part as usize);
        }
        assert_eq!(bench.ask(5, "*SRE?"), "0\n");
        assert_eq!(bench.errors(5), [-410], "{part}");
    }
    assert_eq!(bench.ask(5, "*ESE?;*IDN?;*ESE 2;*ESE?;*ESE 3"), format!("0;{IDENTITY}"));
    assert_eq!((bench.errors(5), bench.ask(5, "*ESE?")), (vec![-440], "2\n".into()));
    bench.put(5, b"*ESE", false);
    bench.command(&[UNL, listen(5), GET]);
    assert_eq!(bench.errors(5), [-105]);
    bench.write(5, "*SRE?");
    bench.command(&[UNL, listen(5), GET]);
    assert_eq!(bench.errors(5), [-410, -211]);
    works(&mut bench, "");
}

#[test]
fn a_talker_is_asked_only_by_who_is_ready_to_listen_and_not_behind_end() {
    let mut bench = bench(8);
    bench.command(&[UNL, talk(5)]);
    bench.controller.script.push_back(Op::StandBy);
    bench.finish();
    bench.rest(200_000);
    bench.command(&[UNT]);
    assert_eq!(bench.errors(5), NONE, "nobody listened");
    bench.write(5, "*ESE?");
    // the other listens, and is ready for more behind END
    bench.command(&[UNL, listen(6), talk(5)]);
    bench.controller.script.push_back(Op::StandBy);
    bench.finish();
    bench.rest(200_000);
    bench.command(&[UNL, UNT]);
    assert_eq!(bench.errors(5), NONE);
    assert!(matches!(bench.errors(6)[..], [-199..=-100]), "what it was told is no command");
}

#[test]
fn an_answer_that_waits_for_motion_comes_to_who_listens_and_polls_pass_by() {
    let mut bench = bench(9);
    bench.write(5, "AXIS1:MOVE 20;*OPC?");
    assert_eq!(bench.poll(5) & 16, 0);
    assert_eq!(bench.ask(6, "*IDN?"), IDENTITY, "the other is not held up");
    assert!(bench.stage(5).moves());
    bench.controller.read(5, &[], 100);
    let before = bench.heard();
    bench.finish();
    assert_eq!(bench.got(before), (b"1\n".to_vec(), true));
    assert_eq!(bench.errors(5), NONE);
}

#[test]
fn a_device_that_has_no_room_holds_nrfd_and_goes_on_or_is_cleared() {
    for clears in [false, true] {
        let mut bench = bench(10);
        bench.write(5, "AXIS1:VEL 100;MOVE 50;*WAI");
        bench.controller.say(&[5], &lines488::marks("*ESE 6\n".repeat(200).as_bytes(), true));
        bench.rest(10_000_000);
        assert!(!bench.controller.done() && bench.stage(5).moves());
        assert!(bench.lines.has(stage_gpib::lines::Lines::NRFD));
        let rest = std::mem::take(&mut bench.controller.script);
        assert!((1..1400).contains(&rest.len()), "{}", rest.len());
        // the controller takes its byte back, as the standard lets it before DAV, and asks how it goes
        bench.seize();
        assert_eq!(bench.poll(5), 0);
        works_at(&mut bench, 6);
        if clears {
            bench.clear(5);
            assert_eq!(bench.ask(5, "*ESE?"), "0\n");
            assert!(bench.stage(5).moves(), "a clear stops no motion");
        } else {
            bench.controller.script.extend([Op::Attention, Op::Command(UNL), Op::Command(listen(5)), Op::StandBy]);
            bench.controller.script.extend(rest);
            bench.finish();
            assert!(!bench.stage(5).moves());
            assert_eq!(bench.ask(5, "*ESE?"), "6\n");
        }
        assert_eq!(bench.errors(5), NONE, "{clears}");
    }
}

#[test]
fn triggers_that_must_wait_keep_their_place_and_too_many_are_told() {
    let mut bench = bench(11);
    bench.write(5, "AXIS1:VEL 100;MOVE 50;*WAI");
    bench.controller.say(&[5], &lines488::marks("*ESE 6\n".repeat(200).as_bytes(), true));
    bench.rest(10_000_000);
    bench.controller.script.clear();
    bench.seize();
    bench.command(&[UNL, listen(5), GET, GET, GET, GET, GET, GET, GET, GET, GET, GET]);
    bench.stand();
    bench.rest(1_000_000);
    bench.clear(5);
    let errors = bench.errors(5);
    // each is a -105, of the message that had begun, or a -211
    assert_eq!(errors.len(), 10, "{errors:?}");
    assert!(errors.iter().all(|error| [-105, -211].contains(error)), "{errors:?}");
    works(&mut bench, "");
}

#[test]
fn remote_and_local_with_lockout() {
    let mut bench = bench(12);
    let control = |bench: &mut Bench| [5, 6].map(|address| bench.stage(address).interface.control());
    assert_eq!(control(&mut bench), [Control::Local; 2]);
    bench.write(5, "*CLS");
    assert_eq!(control(&mut bench), [Control::Remote, Control::Local]);
    bench.stage(5).interface.set_local_key(true);
    bench.rest(10_000);
    bench.stage(5).interface.set_local_key(false);
    assert_eq!(control(&mut bench)[0], Control::Local);
    bench.command(&[LLO]);
    assert_eq!(control(&mut bench), [Control::LocalWithLockout; 2]);
    bench.write(5, "*CLS");
    bench.stage(5).interface.set_local_key(true);
    bench.rest(10_000);
    assert_eq!(control(&mut bench), [Control::RemoteWithLockout, Control::LocalWithLockout], "the key is dead");
    bench.stage(5).interface.set_local_key(false);
    bench.command(&[UNL, listen(5), GTL]);
    assert_eq!(control(&mut bench), [Control::LocalWithLockout; 2]);
    works(&mut bench, "commands work in every state");
    bench.controller.script.extend([Op::Remote(false), Op::Pause(150_000)]);
    bench.finish();
    assert_eq!(control(&mut bench), [Control::Local; 2]);
    works(&mut bench, "without REN too");
    assert_eq!(control(&mut bench), [Control::Local; 2]);
}

/// A question with what it answers.
const QUESTIONS: [(&str, &str); 4] = [
    ("*IDN?", IDENTITY),
    ("*ESE?;:SYST:ERR?\n", "0;0,\"No error\"\n"),
    ("AXIS2:POS:COMM?;*SRE?\r\n", "0.000;0\n"),
    ("*ESE 16;*ESE?", "16\n"),
];

#[test]
fn a_clear_at_each_byte_of_a_question_and_of_its_answer_leaves_nothing_of_it() {
    for (selected, (question, answer)) in [true, false].into_iter().flat_map(|s| QUESTIONS.map(|q| (s, q))) {
        let mut bench = bench(20);
        for at in 0..question.len() + answer.len() {
            let context = format!("{question:?} {at}");
            bench.write(6, "POSE?");
            match at.checked_sub(question.len()) {
                None => bench.put(5, &question.as_bytes()[..at], false),
                Some(read) => {
                    bench.write(5, question);
                    if read > 0 {
                        assert_eq!(bench.read(5, read as u32).0, &answer.as_bytes()[..read]);
                    }
                }
            }
            if selected {
                bench.clear(5);
            } else {
                bench.command(&[DCL]);
            }
            assert_eq!(bench.poll(5), 0, "{context}");
            // DCL is for all, SDC for one
            assert_eq!(bench.poll(6), if selected { 16 } else { 0 }, "{context}");
            if selected {
                assert_eq!(bench.answer(6).map(|pose| pose.len()), Some(51), "{context}");
            }
            works(&mut bench, &context);
            assert_eq!((bench.errors(5), bench.errors(6)), (vec![], vec![]), "{context}");
            bench.write(5, "*ESE 0");
        }
    }
}

#[test]
fn an_interface_clear_at_each_byte_ends_talking_and_listening_and_nothing_else() {
    for (question, answer) in QUESTIONS {
        let mut bench = bench(21);
        for at in 1..question.len() {
            bench.put(5, &question.as_bytes()[..at], false);
            bench.interface_clear();
            bench.put(5, &question.as_bytes()[at..], true);
            assert_eq!(bench.answer(5).as_deref(), Some(answer), "{question} {at}");
            assert_eq!(bench.errors(5), NONE, "{question} {at}");
            bench.write(5, "*ESE 0");
        }
        for at in 1..answer.len() {
            bench.write(5, question);
            let (mut got, _) = bench.read(5, at as u32);
            bench.interface_clear();
            let (rest, end) = bench.read(5, 1000);
            got.extend(rest);
            assert!(end && got == answer.as_bytes(), "{question} {at}: {}", got.escape_ascii());
            assert_eq!(bench.errors(5), NONE, "{question} {at}");
            // or the answer is not wanted any more
            bench.write(5, question);
            bench.read(5, at as u32);
            bench.interface_clear();
            assert_eq!(bench.ask(5, "*SRE?"), "0\n");
            assert_eq!(bench.errors(5), [-410], "{question} {at}");
            bench.write(5, "*ESE 0");
        }
        works(&mut bench, question);
    }
}

/// What came is a part of what was said: in order, and at most so many bytes are missing.
fn is_torn(part: &[u8], whole: &[u8], missing: usize) -> bool {
    let mut rest = whole.iter();
    part.iter().all(|byte| rest.any(|other| other == byte)) && whole.len() <= part.len() + missing
}

/// IFC, ATN, ATN for a moment, and a dead stop, at each step of the handshakes of a question, its answer and a poll.
#[test]
fn whoever_breaks_off_at_any_step_of_a_handshake_finds_a_working_link() {
    const ANSWER: &[u8] = b"0.000;0\n";
    let abuses = [Abuse::Clear, Abuse::Seize, Abuse::HangUp(300_000), Abuse::Blip(250), Abuse::Blip(5_000)];
    let (mut places, mut answered, mut kinds) = (0, 0, BTreeMap::new());
    for (seed, (abuse, pace)) in abuses.into_iter().flat_map(|a| [Pace::FAST, Pace::SLOW].map(|p| (a, p))).enumerate() {
        let mut bench = Bench::new(30 + seed as u64, pace);
        for step in 1.. {
            let context = format!("{abuse:?} {pace:?} {step}");
            let before = bench.heard();
            bench.controller.say(&[5], &lines488::marks(b"AXIS1:POS:COMM?;*SRE?\n", true));
            bench.controller.poll(5);
            bench.controller.read(5, &[], 100);
            bench.controller.abuse = Some((step, abuse));
            bench.follow();
            if !bench.broke_off() {
                break;
            }
            places += 1;
            // what has come so far is of this answer, and so is what is read on; or nobody wants the rest
            let (mut got, ended) = bench.got(before);
            let wanted = step % 3 > 0;
            if wanted && !ended {
                let (rest, _) = bench.read(5, 100);
                got.extend(rest);
            }
            answered += u32::from(!got.is_empty());
            let missing = if wanted || ended { 2 } else { ANSWER.len() };
            assert!(got.is_empty() || is_torn(&got, ANSWER, missing), "{context}: {}", got.escape_ascii());
            let clears = step % 2 == 0;
            if clears {
                bench.clear(5);
            } else {
                // END ends what has begun
                bench.write(5, "\n");
            }
            works(&mut bench, &context);
            for error in bench.errors(5) {
                *kinds.entry(error).or_insert(0) += 1;
                // a question that is torn is any mistake of the language, or no question
                assert!((-199..=-100).contains(&error) || [-410, -420].contains(&error), "{context}: {error}");
            }
            assert_eq!(bench.errors(6), NONE, "{context}");
        }
    }
    println!("{places} places to break off, {answered} answers; errors: {kinds:?}");
    assert!(places > 3_000 && answered > places / 3, "{places} {answered}");
}

/// Sequences of a controller that abuses the bus, of both whole controllers together.
const SEQUENCES: u64 = 100_000;

#[test]
fn no_controller_wedges_a_bus_of_two_stages() {
    let usual = if cfg!(debug_assertions) { 4_000 } else { SEQUENCES };
    let sequences = std::env::var("GPIB_SEQUENCES").map_or(usual, |number| number.parse().expect("a number"));
    let parts = 8;
    let threads: Vec<_> =
        (0..parts).map(|part| std::thread::spawn(move || random_sequences(part, sequences / parts))).collect();
    let mut all = Tally::default();
    for thread in threads {
        let tally = thread.join().expect("none is wedged");
        all.bytes += tally.bytes;
        all.abused += tally.abused;
        all.edges += tally.edges;
        tally.errors.into_iter().for_each(|(error, count)| *all.errors.entry(error).or_insert(0) += count);
    }
    println!(
        "{sequences} sequences, {} broken off, {} acts of the parties, {} bytes read, none wedged; errors: {:?}",
        all.abused, all.edges, all.bytes, all.errors
    );
    assert!(all.abused > sequences / 3);
    assert!([-410, -420].iter().all(|error| all.errors[error] > sequences / 100), "{:?}", all.errors);
    // 104: a calibration is sent while something moves
    let standard = |error: &i32| (-499..=-100).contains(error) || *error == 104;
    assert!(all.errors.keys().all(standard), "{:?}", all.errors);
}

#[derive(Default)]
struct Tally {
    abused: u64,
    edges: u64,
    bytes: usize,
    errors: BTreeMap<i32, u64>,
}

const PIECES: [&[u8]; 18] = [
    b"*ESE?",
    b"*IDN?\n",
    b"POSE?\n",
    b"*ESE?;*SRE?\n",
    b"*SRE 48;*ESE 255\n",
    b"*IDN?;*ESE?",
    b"FOO\n",
    b"COMP:LOAD #15abc",
    b"COMP:LOAD #3100",
    b"AXIS1:VEL?;*WAI",
    b"TRIG:SOUR BUS\n",
    b"\x18",
    b"\n!\n",
    b"'",
    b";",
    b"\n",
    b"*OPC?",
    b"*CLS\n",
];

fn any<T: Copy>(random: &mut Random, of: &[T]) -> T {
    of[random.bits() as usize % of.len()]
}

fn random_sequences(part: u64, count: u64) -> Tally {
    let paces = [Pace { answer: 400, pause: 400 }, Pace { answer: 3_000, pause: 3_000 }];
    let mut bench = Bench::new(part, paces[part as usize % 2]);
    let (mut tally, random) = (Tally::default(), &mut Random(part ^ 0xB0A2));
    for sequence in 0..count {
        let context = format!("part {part} sequence {sequence}");
        for _ in 0..between(random, 1, 5) {
            let at = between(random, 5, 6) as u8;
            let controller = &mut bench.controller;
            match random.bits() % 16 {
                0..=5 => {
                    let to: &[u8] = any(random, &[&[5][..], &[6], &[5, 6]]);
                    let end = !once_in(random, 3);
                    controller.say(to, &lines488::marks(any(random, &PIECES), end));
                }
                6..=9 => {
                    let other = [11 - at];
                    let also = if once_in(random, 6) { &other[..] } else { &[] };
                    controller.read(at, also, any(random, &[1, 3, 40, 300]));
                }
                10..=11 => controller.poll(at),
                12 => controller.command(any(random, &[&[GTL][..], &[LLO], &[DCL], &[UNL, UNT], &[SPE], &[SPD]])),
                13 => controller.command(&[UNL, listen(5), any(random, &[listen(6), SDC]), GET]),
                14 if once_in(random, 20) => {
                    controller.say(&[at], &lines488::marks(b"AXIS1:MOVE:REL 0.05;*OPC?", true))
                }
                _ => controller.command(&[random.bits() as u8, random.bits() as u8]),
            }
            if once_in(random, 3) {
                let abuse = match random.bits() % 4 {
                    0 => Abuse::Clear,
                    1 => Abuse::Seize,
                    2 => Abuse::HangUp(between(random, 1_000, 60_000)),
                    _ => Abuse::Blip(between(random, 250, 20_000)),
                };
                bench.controller.abuse = Some((between(random, 1, 120), abuse));
            }
            tally.edges += bench.follow();
            tally.abused += u64::from(bench.broke_off());
        }
        bench.controller.script.push_back(Op::Remote(true));
        if once_in(random, 5) {
            bench.interface_clear();
        } else {
            bench.seize();
        }
        bench.stand();
        let at = between(random, 5, 6) as u8;
        if once_in(random, 2) {
            bench.command(&[DCL]);
        } else {
            // END ends whatever has begun, and a message drops whatever was answered
            bench.write(at, ";\n");
        }
        let mark = random.bits() % 256;
        assert_eq!(bench.ask(at, format!("*ESE {mark};*ESE?")), format!("{mark}\n"), "{context} at {at}");
        assert_eq!(bench.ask(at, "*IDN?"), IDENTITY, "{context}");
        for error in bench.errors(at) {
            *tally.errors.entry(error).or_insert(0) += 1;
        }
        bench.check();
    }
    tally.bytes = bench.heard();
    tally
}
