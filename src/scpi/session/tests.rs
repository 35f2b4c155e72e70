extern crate std;
use super::*;
use crate::scpi::response::ANSWER_MAX;
use std::borrow::ToOwned;
use std::format;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// Moves last until `finish` or an abort; remembers what was called.
#[derive(Default)]
struct Stage {
    moving: bool,
    log: Vec<String>,
}

const DATA: usize = 1000;

impl Instrument for Stage {
    fn execute(&mut self, _: u8, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error> {
        let mut params = call.params;
        match call.command {
            Command::Identify => out.text("maker,stage,0,1"),
            Command::AxisMove => {
                let target = params.coordinate(call.axis())?;
                if target > 5_000_000 {
                    return Err(Error::axis(ErrorNumber::DataOutOfRange, call.axis()));
                }
                self.moving = true;
                self.log.push(format!("move {}", target));
            }
            Command::AxisVelocity if call.query => {
                out.axis_quantity(call.axis(), 1_000, 1);
            }
            Command::AxisVelocity => self.log.push(format!("velocity {}", params.rate(call.axis(), 1)?)),
            Command::AxisPosition => out.axis_quantity(call.axis(), 1_500, 0),
            Command::CompensationLoad => self.log.push(format!("load {}", params.block()?.len())),
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
            Command::CompensationMatrix => (0..ANSWER_MAX).for_each(|_| out.integer(1)),
            _ => {}
        }
        Ok(Flow::Done)
    }

    fn abort(&mut self, _: u8) {
        self.moving = false;
        self.log.push("abort".into());
    }

    fn operation_pending(&self) -> bool {
        self.moving
    }

    fn conditions(&self) -> Conditions {
        let moving = u16::from(self.moving);
        Conditions { operation: moving << 8, operation_instrument: moving << 1, ..Conditions::default() }
    }
}

struct Bench {
    session: Session,
    stage: Stage,
}

impl Bench {
    fn new() -> Self {
        Bench { session: Session::new(0), stage: Stage::default() }
    }

    /// Everything that the link can take now.
    fn drain(&mut self) -> String {
        let (mut all, mut buffer) = (Vec::new(), [0; 64]);
        loop {
            self.session.poll(&mut self.stage);
            match self.session.transmit(&mut buffer) {
                0 => return String::from_utf8_lossy(&all).into_owned(),
                count => all.extend_from_slice(&buffer[..count]),
            }
        }
    }

    fn send(&mut self, text: impl AsRef<[u8]>) -> String {
        let bytes = text.as_ref();
        assert_eq!(self.session.receive(bytes), bytes.len(), "everything is taken");
        self.drain()
    }

    fn finish(&mut self) -> String {
        self.stage.moving = false;
        self.drain()
    }

    fn log(&mut self) -> Vec<String> {
        core::mem::take(&mut self.stage.log)
    }
}

#[test]
fn a_session_stays_below_7_kilobytes() {
    assert!(size_of::<Session>() < 7 * 1024, "{}", size_of::<Session>());
}

#[test]
fn several_queries_of_a_message_answer_on_one_line() {
    let mut bench = Bench::new();
    assert_eq!(bench.send("*IDN?;AXIS1:POS?;VEL?;*ESE 4;*ESE?\r\n"), "maker,stage,0,1;1.500;1.000;4\n");
    assert_eq!(bench.send("\n ; \n*CLS\n"), "");
}

#[test]
fn units_before_a_bad_one_count_and_after_a_command_error_the_rest_is_dropped() {
    let mut bench = Bench::new();
    assert_eq!(bench.send("AXIS1:VEL 5;*IDN?;FOO;VEL 6\n"), "maker,stage,0,1\n");
    assert_eq!(bench.log(), ["velocity 5000"]);
    assert_eq!(bench.send("SYST:ERR?;ERR?\n"), "-113,\"Undefined header;FOO\";0,\"No error\"\n");
    assert_eq!(bench.send("AXIS1:VEL 5 DEG;*IDN?\nSYST:ERR?\n"), "-131,\"Invalid suffix;5 DEG\"\n");
}

#[test]
fn an_execution_error_does_not_drop_the_rest() {
    let mut bench = Bench::new();
    assert_eq!(bench.send("AXIS2:MOVE 5001;*IDN?;*ESR?\n"), "maker,stage,0,1;144\n");
    assert_eq!(bench.send("SYST:ERR:COUN?;ALL?\n"), "1;-222,\"Data out of range;AXIS2\"\n");
}

#[test]
fn a_pending_query_holds_the_link_until_motion_has_ended() {
    let mut bench = Bench::new();
    assert_eq!(bench.send("AXIS1:MOVE 5;*OPC?;:AXIS1:POS?\n*IDN?\n"), "");
    assert_eq!(bench.finish(), "1;1.500\nmaker,stage,0,1\n");
    assert_eq!(bench.send("AXIS1:MOVE 1;*WAI;VEL 1\n"), "");
    assert_eq!(bench.log(), ["move 5000", "move 1000"]);
    bench.finish();
    assert_eq!(bench.log(), ["velocity 1000"]);
}

#[test]
fn operation_complete_sets_its_bit_at_the_end_of_motion() {
    let mut bench = Bench::new();
    bench.send("*CLS;*ESE 1;*SRE 32;AXIS1:MOVE 5;*OPC\n");
    assert_eq!(bench.session.status_byte(), 0);
    bench.finish();
    assert_eq!(bench.session.status_byte(), 0x60);
    assert_eq!(bench.send("*ESR?;*ESR?\n"), "1;0\n");
}

#[test]
fn an_abort_is_seen_while_the_link_waits_and_the_waiting_query_answers() {
    let mut bench = Bench::new();
    bench.send("AXIS1:MOVE 5;*OPC?\n");
    bench.log();
    assert_eq!(bench.send("!\n"), "1\n");
    assert_eq!(bench.log()[0], "abort");
}

#[test]
fn nothing_sent_before_an_abort_moves_on_after_it() {
    let mut bench = Bench::new();
    bench.send("AXIS1:MOVE 5;*WAI;MOVE 0;*WAI;VEL 3\nAXIS1:MOVE 1\n! stop\nAXIS1:VEL 4\n");
    let log = bench.log();
    assert!(!bench.stage.moving);
    assert_eq!(log[0], "abort");
    for (n, line) in log.iter().enumerate().filter(|(_, line)| line.starts_with("move")) {
        assert_eq!(log[n + 1], "abort", "{line}");
    }
    assert_eq!(log.last().unwrap(), "velocity 4000");
}

#[test]
fn abort_and_clear_are_seen_even_behind_refused_bytes() {
    for stop in ["\n!\n", "\x18"] {
        let mut bench = Bench::new();
        bench.send("AXIS1:MOVE 5;*OPC?\n");
        bench.log();
        let input = "AXIS1:VEL 1\n".repeat(60) + stop + "*IDN?\n";
        let mut taken = bench.session.receive(input.as_bytes());
        bench.session.poll(&mut bench.stage);
        let mut answers = String::new();
        if stop == "\x18" {
            assert_eq!(bench.log(), Vec::<String>::new());
            assert!(bench.stage.moving);
            assert_eq!(taken, input.len());
            answers += &bench.drain();
            assert_eq!(answers, "maker,stage,0,1\n", "the pending query is gone");
        } else {
            assert_eq!(taken, BACKLOG, "the rest is refused");
            assert_eq!(bench.stage.log[0], "abort");
            assert!(!bench.stage.moving);
            while taken < input.len() {
                taken += bench.session.receive(&input.as_bytes()[taken..]);
                answers += &bench.drain();
            }
            assert_eq!(answers, "1\nmaker,stage,0,1\n");
            assert_eq!(bench.log().iter().filter(|line| *line == "velocity 1000").count(), 60, "none is lost");
        }
    }
}

#[test]
fn a_device_clear_keeps_registers_and_drops_everything_else() {
    let mut bench = Bench::new();
    bench.send("*CLS;*ESE 1;AXIS1:MOVE 5;*OPC;*OPC?\n");
    bench.session.receive(b"*IDN?\nAXIS");
    bench.session.device_clear();
    assert_eq!(bench.finish(), "");
    assert_eq!(bench.send("*ESE?;*ESR?\n"), "1;0\n");
}

#[test]
fn no_answer_is_lost_when_nobody_reads() {
    let mut bench = Bench::new();
    let input = "*IDN?\n".repeat(400);
    let (mut taken, mut polls) = (0, 0);
    while polls < 100 {
        taken += bench.session.receive(&input.as_bytes()[taken..]);
        bench.session.poll(&mut bench.stage);
        polls += 1;
    }
    assert!(taken < input.len(), "the input is held back");
    let mut answers = bench.drain();
    while taken < input.len() {
        taken += bench.session.receive(&input.as_bytes()[taken..]);
        answers += &bench.drain();
    }
    assert_eq!(answers, "maker,stage,0,1\n".repeat(400));
}

#[test]
fn long_answers_come_in_parts_and_arrive_whole() {
    let mut bench = Bench::new();
    assert_eq!(
        bench.send("*IDN?;COMP:DATA?;*IDN?\n"),
        format!("maker,stage,0,1;#41000{};maker,stage,0,1\n", "\n".repeat(DATA))
    );
    let help = bench.send("SYST:HELP:HEAD?\n");
    let digits = usize::from(help.as_bytes()[1] - b'0');
    let length: usize = help[2..2 + digits].parse().unwrap();
    assert_eq!(help.len(), 2 + digits + length + 1);
    assert!(
        help.contains("\n:AXIS#:MOVE[:ABSolute]/nquery/\n")
            && help.contains("\n*ESE\n")
            && help.contains("\n*ESR/qonly/\n")
    );
    bench.send("FOO\n".repeat(20));
    assert_eq!(bench.send("SYST:ERR:ALL?\n").matches("Undefined header").count(), 15);
}

#[test]
fn an_answer_that_breaks_its_bound_is_an_error_and_not_a_torn_line() {
    let mut bench = Bench::new();
    assert_eq!(bench.send("*IDN?;COMP:MATR?;*IDN?\n"), "maker,stage,0,1;maker,stage,0,1\n");
    assert!(bench.send("SYST:ERR?\n").starts_with("-310"));
}

#[test]
fn a_block_that_stops_short_is_given_up_by_the_time_out() {
    let mut bench = Bench::new();
    bench.send("*ESE 3;COMP:LOAD #3100abc\n*RST\n!\n");
    assert!(bench.session.awaits_block());
    assert_eq!(bench.log(), Vec::<String>::new());
    bench.session.timeout();
    assert!(bench.send("SYST:ERR?;*ESE?\n").starts_with("-161,\"Invalid block data;"));
    assert_eq!(bench.send("*ESE?;:COMP:LOAD #3100".to_owned() + &"!".repeat(100) + "\n"), "3\n");
    assert_eq!(bench.log(), ["load 100"]);
    bench.session.timeout();
    assert_eq!(bench.send("SYST:ERR?\n"), "0,\"No error\"\n");
}

#[test]
fn too_long_and_unterminated_messages_leave_the_next_one_alone() {
    let mut bench = Bench::new();
    assert_eq!(
        bench.send("A".repeat(513) + "\nSYST:ERR?\n"),
        "-363,\"Input buffer overrun;message longer than 512 bytes\"\n"
    );
    assert_eq!(
        bench.send("*ESE 2;AXIS1:MOVE \"5;*ESE 7\n*ESE?;:SYST:ERR?\n"),
        "2;-151,\"Invalid string data;?5;*ESE 7\"\n"
    );
}

#[test]
fn status_registers_are_written_and_read_by_their_headers() {
    let mut bench = Bench::new();
    assert_eq!(bench.send("STAT:OPER:ENAB 65535;ENAB?;PTR 0;PTR?;NTR 256;NTR?;COND?\n"), "32767;0;256;0\n");
    bench.send("AXIS1:MOVE 1\n");
    assert_eq!(bench.send("STAT:OPER:COND?;:STAT:OPER:INST?;:STAT:OPER?\n"), "8448;2;0\n");
    bench.finish();
    assert_eq!(bench.send("STAT:OPER?;:STAT:PRES;OPER:PTR?\n"), "256;32767\n");
    assert_eq!(bench.send("STAT:OPER:ENAB 65536;ENAB?\n"), "0\n");
}

/// A cheap generator of sequences.
fn random(seed: &mut u64) -> usize {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 33) as usize
}

#[test]
fn chunking_changes_nothing_and_no_input_panics() {
    let pieces: [&[u8]; 32] = [
        b"AXIS1:VEL 5",
        b"*IDN?",
        b";",
        b"\n",
        b"\r\n",
        b":",
        b"::",
        b",",
        b"#15;\n!\x18,",
        b"#",
        b"#3",
        b"\"",
        b"'",
        b"(@1:6)",
        b"(",
        b")",
        b"*ESR?",
        b"SYST:ERR?",
        b"SYST:ERR:ALL?",
        b" ",
        b"\t",
        b"AXIS9:POS?",
        b"POSE 1,2,3,4,5,6",
        b"STAT:OPER?",
        b"1E99999",
        b"\xff",
        b"\x18",
        b"?",
        b"COMP:LOAD ",
        b"COMP:DATA?",
        b"\n!\n",
        b"-12.5 UM/S",
    ];
    let mut seed = 7;
    for _ in 0..3000 {
        let mut input = Vec::new();
        for _ in 0..random(&mut seed) % 40 {
            match random(&mut seed) % 8 {
                0 => input.push(random(&mut seed) as u8),
                _ => input.extend_from_slice(pieces[random(&mut seed) % pieces.len()]),
            }
        }
        let whole = run(&input, &mut || usize::MAX);
        let bytes = run(&input, &mut || 1);
        let chunks = run(&input, &mut || random(&mut seed) % 9 + 1);
        // Answers of messages in front of a clear depend on when the link drained them.
        if !input.contains(&0x18) {
            assert_eq!(whole, bytes, "{}", input.escape_ascii());
            assert_eq!(whole, chunks, "{}", input.escape_ascii());
        }
    }
}

fn run(input: &[u8], chunk: &mut dyn FnMut() -> usize) -> (String, Vec<String>) {
    let mut bench = Bench::new();
    let (mut taken, mut answers) = (0, String::new());
    while taken < input.len() {
        let end = taken.saturating_add(chunk()).min(input.len());
        taken += bench.session.receive(&input[taken..end]);
        answers += &bench.drain();
    }
    bench.session.timeout();
    answers += &bench.drain();
    bench.stage.log.retain(|line| line != "abort");
    (answers, bench.log())
}

/// A client of a stream may send anything, cut it anywhere, clear or go at any byte, and not read.
#[test]
fn no_client_wedges_a_stream() {
    const SEQUENCES: usize = 100_000;
    let pieces: [&[u8]; 14] = [
        b"*ESE?\n",
        b"*IDN?;*ESE?\n",
        b"AXIS1:MOVE 1;*OPC?\n",
        b"*WAI\n",
        b"COMP:DATA?\n",
        b"COMP:LOAD #15\n!\x18,;\n",
        b"COMP:LOAD #3100",
        b"FOO\n",
        b"'",
        b"\x18",
        b"\n!\n",
        b"AXIS1:VEL",
        b";",
        b"\n",
    ];
    let (mut seed, mut unread) = (99, 0);
    for sequence in 0..SEQUENCES {
        let mut bench = Bench::new();
        let mut input = Vec::new();
        for _ in 0..random(&mut seed) % 12 {
            input.extend_from_slice(pieces[random(&mut seed) % pieces.len()]);
        }
        let gone = random(&mut seed) % (input.len() + 1);
        let (mut taken, mut stuck) = (0, 0);
        while taken < gone && stuck < 3 {
            let end = (taken + 1 + random(&mut seed) % 40).min(gone);
            let more = bench.session.receive(&input[taken..end]);
            (taken, stuck) = (taken + more, if more == 0 { stuck + 1 } else { 0 });
            bench.session.poll(&mut bench.stage);
            match random(&mut seed) % 8 {
                0 => bench.stage.moving = false,
                1 => drop(bench.session.transmit(&mut [0; 50])),
                _ => {}
            }
        }
        unread += usize::from(bench.session.has_output());
        // it goes, or clears; what moves comes to its end by itself
        bench.session.device_clear();
        bench.stage.moving = false;
        let mark = random(&mut seed) % 256;
        assert_eq!(bench.send(format!("*ESE {mark};*ESE?\n")), format!("{mark}\n"), "sequence {sequence}");
        assert!(!bench.session.is_waiting());
    }
    std::println!("{SEQUENCES} sequences, seed 99, none wedged; {unread} ended with answers that nobody had read");
    assert!(unread > SEQUENCES / 10);
}

/// How a client of a stream gives up what it has begun.
#[derive(Clone, Copy, Debug, PartialEq)]
enum GivesUp {
    /// The byte 0x18.
    Clear,
    /// A BREAK, as the interrupt tells it.
    Break,
    /// It closes, and the next one opens.
    Close,
}

/// A stream has none of the errors of a bus: what was begun or not read is gone, what was whole was executed.
#[test]
fn giving_up_at_each_byte_of_a_question_or_of_its_answer_leaves_a_working_stream() {
    let talks: [(&[u8], &str); 6] = [
        (b"*IDN?\n", "maker,stage,0,1\n"),
        (b"AXIS1:VEL 5;VEL?;*SRE?\r\n", "1.000;0\n"),
        (b"AXIS1:POS?;*ESE?;:SYST:ERR?\n", "1.500;0;0,\"No error\"\n"),
        (b"STAT:OPER:NTR 3;NTR?\n", "3\n"),
        (b"FOO\n", ""),
        (b"COMP:LOAD #15a\n!\x18b\n", ""),
    ];
    // 0x18 is data in here
    let block = b"COMP:LOAD #15".len()..b"COMP:LOAD #15a\n!\x18b".len();
    let mut places = 0;
    for ((talk, answer), way) in
        talks.into_iter().flat_map(|t| [GivesUp::Clear, GivesUp::Break, GivesUp::Close].map(|way| (t, way)))
    {
        for at in 0..talk.len() + answer.len() {
            let context = format!("{} {at} {way:?}", talk.escape_ascii());
            let mut bench = Bench::new();
            let sent = at.min(talk.len());
            assert_eq!(bench.session.receive(&talk[..sent]), sent);
            bench.session.poll(&mut bench.stage);
            let mut read = vec![0; at - sent];
            let count = bench.session.transmit(&mut read);
            assert_eq!(read, &answer.as_bytes()[..count], "{context}");
            assert_eq!(count, at - sent, "{context}");
            bench.log();
            let is_data = way == GivesUp::Clear && talk.starts_with(b"COMP") && block.contains(&at);
            match way {
                // what is still missing of the block, which then is executed
                GivesUp::Clear if is_data => {
                    let mut rest = b"a\n!\x18b".to_vec();
                    rest.truncate(block.end - at);
                    rest[0] = 0x18;
                    assert_eq!(bench.send([&rest[..], b"\n"].concat()), "", "{context}");
                    assert_eq!(bench.log(), ["load 5"], "{context}");
                }
                GivesUp::Clear => assert_eq!(bench.session.receive(b"\x18"), 1),
                GivesUp::Break => bench.session.device_clear(),
                GivesUp::Close => {
                    bench.session.device_clear();
                    bench.session = Session::new(0);
                }
            }
            assert_eq!(bench.drain(), "", "{context}");
            assert!(!bench.session.is_waiting() && !bench.session.awaits_block(), "{context}");
            let kept = talk.starts_with(b"STAT") && at >= talk.len() && way != GivesUp::Close;
            assert_eq!(bench.send("STAT:OPER:NTR?\n"), if kept { "3\n" } else { "0\n" }, "{context}");
            let own = talk == b"FOO\n" && at >= talk.len() && way != GivesUp::Close;
            let errors = if own { "-113,\"Undefined header;FOO\"\n" } else { "0,\"No error\"\n" };
            assert_eq!(bench.send("SYST:ERR:ALL?\n"), errors, "{context}");
            assert_eq!(bench.send("*IDN?\n"), "maker,stage,0,1\n", "{context}");
            places += 1;
        }
    }
    assert!(places > 400, "{places}");
}
