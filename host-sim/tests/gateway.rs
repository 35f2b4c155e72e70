//! The GPIB gateway before two boards and a power meter, without sockets: what it understands, and what any client may
//! do to it.

mod lab;

use host_sim::board::Seeded;
use host_sim::gpib::Gateway;
use lab::Bench3;
use std::time::Duration;

/// A client with its gateway.
struct Client {
    bus: Bench3,
    gateway: Gateway,
    wall: Duration,
    /// What the gateway has not taken yet.
    waiting: Vec<u8>,
}

impl Client {
    fn new() -> Self {
        let mut client =
            Client { bus: Bench3::new(), gateway: Gateway::new(5), wall: Duration::ZERO, waiting: Vec::new() };
        client.bus.pass(4);
        assert_eq!(client.send("++eos 3\n++read_tmo_ms 50\n"), "");
        client
    }

    /// Sends bytes; what has come back.
    fn send(&mut self, bytes: impl AsRef<[u8]>) -> String {
        self.waiting.extend_from_slice(bytes.as_ref());
        self.turn()
    }

    fn turn(&mut self) -> String {
        self.gateway.go_on(&mut self.bus, self.wall);
        loop {
            let taken = self.gateway.receive(&self.waiting, &mut self.bus, self.wall);
            self.waiting.drain(..taken);
            if taken == 0 {
                break;
            }
        }
        let (mut all, mut chunk) = (Vec::new(), [0; 1000]);
        loop {
            match self.gateway.transmit(&mut chunk) {
                0 => return String::from_utf8_lossy(&all).into_owned(),
                count => all.extend_from_slice(&chunk[..count]),
            }
            self.gateway.go_on(&mut self.bus, self.wall);
        }
    }

    /// Time on the wall, ms.
    fn wait(&mut self, ms: u64) -> String {
        self.wall += Duration::from_millis(ms);
        self.turn()
    }

    /// Whatever moves or is measured comes to its end.
    fn rest(&mut self) -> String {
        let mut said = self.turn();
        for _ in 0..100_000 {
            if !self.bus.moves() {
                return said;
            }
            self.bus.pass(1);
            said += &self.turn();
        }
        panic!("it never rests");
    }

    fn ask(&mut self, line: &str) -> String {
        self.send(format!("{line}\n++read eoi\n")) + &self.rest()
    }

    /// Numbers of the queued errors at the current address.
    fn errors(&mut self) -> Vec<i32> {
        let mut found = Vec::new();
        loop {
            let told = self.ask("SYST:ERR?");
            match told.split(',').next().and_then(|number| number.parse().ok()) {
                Some(0) => return found,
                Some(number) => found.push(number),
                None => panic!("{told:?}"),
            }
        }
    }

    /// The client goes and another one comes.
    fn hang_up(&mut self) {
        self.gateway.hang_up(&mut self.bus, self.wall);
        (self.gateway, self.waiting) = (Gateway::new(5), Vec::new());
        self.send("++eos 3\n++read_tmo_ms 50\n");
    }
}

#[test]
fn three_instruments_answer_at_their_addresses() {
    let mut client = Client::new();
    assert_eq!(client.ask("*IDN?"), "Stage Controller,SC6,0,0.1.0\n");
    assert_eq!(client.send("++addr 6\n++addr\n"), "6\r\n");
    assert_eq!(client.ask("AXIS1:VEL 321;VEL?"), "321.000\n");
    client.send("++addr 5\n");
    assert_ne!(client.ask("AXIS1:VEL?"), "321.000\n");
    client.send("++addr 7\n");
    assert_eq!(client.ask("*IDN?"), "Stage Controller,Power meter and switch,0,0.1.0\n");
    let level = client.ask("READ:POW?");
    assert_eq!(level.trim().split(',').map(|level| level.parse::<f64>().unwrap()).filter(|dbm| *dbm < 0.0).count(), 2);
    for nobody in ["++addr 8\n", "++addr 5 96\n"] {
        client.send(nobody);
        assert_eq!(client.ask("*IDN?") + &client.wait(100), "");
    }
    assert_eq!(client.send("++spoll\n++spoll 5\n"), "0\r\n0\r\n");
    client.send("++addr 5\n");
    assert_eq!(client.errors(), NONE);
}

#[test]
fn settings_are_answered_as_they_were_set_and_others_are_not_understood() {
    let mut client = Client::new();
    for line in
        ["++auto 1", "++eoi 0", "++eos 2", "++eot_enable 1", "++eot_char 42", "++read_tmo_ms 3000", "++savecfg 0"]
    {
        let (name, value) = line.split_once(' ').unwrap();
        assert_ne!(client.send(format!("{name}\n")), format!("{value}\r\n"), "{line}");
        assert_eq!(client.send(format!("{line}\n{name}\n")), format!("{value}\r\n"));
    }
    for line in ["++eos 4", "++read_tmo_ms 0", "++addr 31", "++frobnicate", "++mode 0"] {
        assert_eq!(client.send(format!("{line}\n")), "Unrecognized command\r\n", "{line}");
    }
    assert!(client.send("++ver\n").contains("Prologix"));
    assert!(client.send("++help\n").lines().count() >= 20);
    assert_eq!(client.send("++rst\n++auto\n++eos\n++mode\n"), "0\r\n0\r\n1\r\n");
}

#[test]
fn what_is_appended_and_eoi_end_a_message_and_without_both_it_goes_on() {
    for (eos, eoi) in [(0, 0), (0, 1), (1, 1), (2, 0), (2, 1), (3, 1)] {
        let mut client = Client::new();
        client.send(format!("++eos {eos}\n++eoi {eoi}\n"));
        assert_eq!(client.ask("*ESE?"), "0\n", "eos {eos}, eoi {eoi}");
        assert_eq!(client.errors(), NONE, "eos {eos}, eoi {eoi}");
    }
    let mut client = Client::new();
    client.send("++eoi 0\n*ESE 3\n++eoi 1\n6;*ESE?\n");
    assert_eq!(client.send("++read eoi\n"), "36\n");
}

#[test]
fn a_read_ends_at_eoi_or_at_its_byte_and_tells_eoi_if_asked_to() {
    let mut client = Client::new();
    client.send("POSE?\n");
    assert_eq!(client.send("++read 44\n"), "0.000,");
    assert_eq!(client.send("++read 46\n++read eoi\n"), "0.000,0.000,0.00000000,0.00000000,0.00000000\n");
    client.send("++eot_enable 1\n++eot_char 33\nPOSE?\n");
    assert_eq!(client.send("++read 44\n"), "0.000,", "no EOI was seen");
    assert!(client.send("++read\n").ends_with("0\n!"));
    let mut client = Client::new();
    client.send("++auto 1\n");
    assert_eq!(client.send("*ESE?\n"), "0\n");
    client.send("*ESE 1\n++auto 0\n");
    assert_eq!(client.errors(), [-420], "what does not ask cannot be read");
}

#[test]
fn blocks_go_both_ways_with_every_byte_in_them() {
    let mut client = Client::new();
    let escaped = |bytes: &[u8]| -> Vec<u8> {
        bytes.iter().flat_map(|b| if b"\r\n\x1b+".contains(b) { vec![27, *b] } else { vec![*b] }).collect()
    };
    client.waiting.extend(b"COMP:DATA?\n++read eoi\n");
    client.gateway.go_on(&mut client.bus, client.wall);
    let taken = client.gateway.receive(&client.waiting, &mut client.bus, client.wall);
    client.waiting.drain(..taken);
    let mut block = vec![0; 20_000];
    let mut length = 0;
    loop {
        client.gateway.go_on(&mut client.bus, client.wall);
        match client.gateway.transmit(&mut block[length..]) {
            0 => break,
            count => length += count,
        }
    }
    let block = &block[..length - 1];
    assert!(block.starts_with(b"#3") && block.iter().any(|byte| b"\r\n\x1b+".contains(byte)));
    client.send([b"COMP:LOAD ", &escaped(block)[..], b"\n"].concat());
    assert_eq!(client.ask("*OPC?"), "1\n");
    assert_eq!(client.errors(), NONE);
    let mut broken = block.to_vec();
    *broken.last_mut().unwrap() ^= 1;
    client.send([b"COMP:LOAD ", &escaped(&broken)[..], b"\n"].concat());
    assert_eq!(client.errors(), [-230]);
}

#[test]
fn a_serial_poll_takes_the_service_request_of_one_instrument() {
    let mut client = Client::new();
    assert_eq!(client.send("++srq\n++spoll\n"), "0\r\n0\r\n");
    client.send("*CLS;*SRE 32;*ESE 1;AXIS1:MOVE 1;*OPC\n++addr 6\n*CLS;*SRE 4\nFOO\n++addr 7\n*CLS;*SRE 4;FOO\n");
    assert_eq!(client.send("++srq\n++spoll 6\n++spoll 6\n++srq\n++spoll\n++srq\n"), "1\r\n68\r\n4\r\n1\r\n68\r\n0\r\n");
    client.rest();
    assert_eq!(client.send("++srq\n++spoll 5\n++srq\n++spoll 5\n"), "1\r\n96\r\n0\r\n32\r\n");
}

#[test]
fn a_read_behind_a_serial_poll_asks_only_for_what_is_there() {
    let mut client = Client::new();
    assert_eq!(client.send("*ESE 1\n++spoll\n++read eoi\n"), "0\r\n");
    assert!(!client.gateway.is_busy());
    assert_eq!(client.send("*ESE?\n++spoll\n++read eoi\n"), "16\r\n1\n");
    assert_eq!(client.errors(), NONE);
    client.send("++spoll\n*ESE 2\n++read eoi\n");
    assert_eq!(client.errors(), [-420], "something was sent in between");
}

#[test]
fn a_late_answer_comes_to_a_client_that_waits_and_not_to_one_that_goes_on() {
    let mut client = Client::new();
    assert_eq!(client.send("AXIS1:MOVE 5;*OPC?\n++read eoi\n++ver\n") + &client.wait(40), "");
    assert!(client.gateway.is_busy(), "what is sent within the time-out waits");
    assert!(client.wait(20).contains("Prologix"), "and ends the read after it");
    assert_eq!(client.rest(), "");
    assert_eq!(client.send("++read eoi\n"), "1\n", "the answer is still there");
    assert_eq!(client.send("AXIS1:MOVE 0;*OPC?\n++read eoi\n") + &client.wait(500), "");
    assert_eq!(client.rest(), "1\n");
    assert_eq!(client.errors(), NONE);
}

#[test]
fn a_line_that_is_held_goes_on_in_the_end_or_is_cleared() {
    let many = "*ESE 6;".repeat(60) + "\n";
    for end in ["rest", "++clr\n", "++ifc\n", "hang up"] {
        let mut client = Client::new();
        client.send("AXIS1:MOVE 1;*WAI\n");
        client.send(many.repeat(3));
        assert!(client.gateway.is_busy(), "more than the instrument keeps");
        match end {
            "rest" => drop(client.rest()),
            "hang up" => client.hang_up(),
            clear => drop(client.send(clear)),
        }
        assert!(!client.gateway.is_busy(), "{end}");
        assert_eq!(client.ask("*ESE?"), if end == "rest" { "6\n" } else { "0\n" }, "{end}");
        client.rest();
        assert_eq!(client.errors(), NONE, "{end}");
    }
}

#[test]
fn triggers_begin_what_waits_for_them_on_several_instruments_at_once() {
    let mut client = Client::new();
    let arm = "TRIG:SOUR BUS;:TRAC:CONF SAMP,1;:TRAC:ARM\n";
    client.send(format!("{arm}++addr 6\n{arm}"));
    let waits = |client: &mut Client| client.ask("STAT:OPER:COND?").trim().parse::<u16>().unwrap() & 32;
    assert_eq!((client.errors(), waits(&mut client)), (vec![], 32));
    client.send("++trg 5 6 7\n");
    client.bus.pass(20);
    for address in [5, 6, 7] {
        client.send(format!("++addr {address}\n"));
        if address < 7 {
            assert_eq!(waits(&mut client), 0, "{address}");
        }
        assert_eq!(client.errors(), NONE, "{address}");
    }
}

#[test]
fn a_jog_ends_when_its_client_goes() {
    let mut client = Client::new();
    client.send("SYST:JOG:TIM 3600;:AXIS1:MOVE:JOG 100\n");
    client.bus.pass(200);
    assert!(client.bus.boards[0].front.is_moving());
    client.hang_up();
    client.rest();
    assert_eq!((client.bus.released, client.errors()), (1, vec![]));
}

/// What a careful client says at one instrument, with an escape in it.
const TALK: &str = "++addr 6\n*ESE 36;*ESE?\n++read eoi\n++spoll\nAXIS1:VEL 1\x1b+1;VEL?\n++read 48\n++trg\n";

#[test]
fn a_client_that_hangs_up_or_clears_at_each_byte_leaves_working_instruments() {
    for (at, clears) in (0..=TALK.len()).flat_map(|at| [(at, false), (at, true)]) {
        let mut client = Client::new();
        client.send(&TALK[..at]);
        if clears {
            client.send("\n++addr 6\n++clr\n");
        } else {
            client.hang_up();
        }
        for address in [5, 6, 7] {
            client.send(format!("++addr {address}\n"));
            assert_eq!(client.ask("*ESE 17;*ESE?"), "17\n", "{at} {clears} {address}");
            let known = |error: &i32| match address {
                // cut messages, an answer that was not read, a trigger that nothing waits for
                5 | 6 => [-420, -410, -211, -113, -109, -104, -108, -102].contains(error),
                _ => false,
            };
            let errors = client.errors();
            assert!(errors.iter().all(known), "{at} {clears} {address}: {errors:?}");
        }
    }
}

/// Questions, how much of each is sent by hand, and their answers.
const QUESTIONS: [(&str, &str); 4] = [
    ("*IDN?", "Stage Controller,SC6,0,0.1.0\n"),
    ("*ESE?;:SYST:ERR?", "0;0,\"No error\"\n"),
    ("POSE?", "0.000,0.000,0.000,0.00000000,0.00000000,0.00000000\n"),
    ("AXIS1:POS:COMM?;:COMP:STAT?;*SRE?", "0.000;1;0\n"),
];

impl Client {
    /// Reads so many bytes of an answer that is known.
    fn read_part(&mut self, answer: &str, most: usize) {
        let part = &answer.as_bytes()[..most];
        if let Some(last) = part.last() {
            let times = part.iter().filter(|byte| *byte == last).count();
            let read: String = (0..times).map(|_| self.send(format!("++read {last}\n"))).collect();
            assert_eq!(read.as_bytes(), part);
        }
    }
}

#[test]
fn a_clear_at_each_byte_of_a_question_or_of_its_answer_leaves_nothing_of_it_and_no_error() {
    let mut client = Client::new();
    for (question, answer) in QUESTIONS {
        for at in 0..=question.len() + answer.len() {
            match at.checked_sub(question.len()) {
                None => drop(client.send(format!("++eoi 0\n{}\n++eoi 1\n", &question[..at]))),
                Some(read) => {
                    client.send(format!("{question}\n"));
                    assert_eq!(client.send("++spoll\n"), "16\r\n", "{question}");
                    client.read_part(answer, read);
                }
            }
            assert_eq!(client.send("++clr\n++spoll\n"), "0\r\n", "{question} {at}");
            assert_eq!(client.ask("*IDN?"), QUESTIONS[0].1, "{question} {at}");
            assert_eq!(client.errors(), NONE, "{question} {at}");
        }
    }
}

#[test]
fn who_hangs_up_at_each_byte_leaves_no_half_line_and_an_unread_answer_is_told_to_the_next() {
    let mut client = Client::new();
    for (question, answer) in QUESTIONS {
        for at in 0..=question.len() + answer.len() {
            // a line goes to the instrument when it is whole
            client.send(&question[..at.min(question.len())]);
            let whole = at.checked_sub(question.len());
            if let Some(read) = whole {
                client.send("\n");
                client.read_part(answer, read);
            }
            client.hang_up();
            assert_eq!(client.ask("*IDN?"), QUESTIONS[0].1, "{question} {at}");
            let unread = whole.is_some_and(|read| read < answer.len());
            assert_eq!(client.errors(), if unread { vec![-410] } else { vec![] }, "{question} {at}");
        }
    }
}

#[test]
fn a_read_or_a_new_question_at_each_byte_ends_in_the_error_of_the_standard() {
    let mut client = Client::new();
    for (question, answer) in QUESTIONS {
        for at in 0..question.len() {
            client.send(format!("++eoi 0\n{}\n++eoi 1\n", &question[..at]));
            assert_eq!(client.send("++read eoi\n"), "", "{question} {at}");
            assert_eq!(client.ask("*IDN?"), QUESTIONS[0].1, "{question} {at}");
            assert_eq!(client.errors(), [-420], "{question} {at}");
        }
        for read in 0..=answer.len() {
            client.send(format!("{question}\n"));
            client.read_part(answer, read);
            assert_eq!(client.ask("*IDN?"), QUESTIONS[0].1, "{question} {read}");
            let unread = read < answer.len();
            assert_eq!(client.errors(), if unread { vec![-410] } else { vec![] }, "{question} {read}");
        }
    }
}

/// No errors.
const NONE: [i32; 0] = [];

const SEQUENCES: usize = 100_000;

#[test]
fn no_client_wedges_the_gateway_or_an_instrument() {
    const PIECES: [&str; 29] = [
        "++addr 5\n",
        "++addr 6\n",
        "++addr 7\n",
        "++addr 9\n",
        "++read eoi\n",
        "++read\n",
        "++read 44\n",
        "++spoll\n",
        "++clr\n",
        "++trg\n",
        "++auto 1\n",
        "++auto 0\n",
        "++eoi 0\n",
        "++eoi 1\n",
        "++eos 0\n",
        "++eos 3\n",
        "++eot_enable 1\n",
        "++loc\n++llo\n++ifc\n",
        "*IDN?\n",
        "*ESE?;*SRE?\n",
        "*ESE?\x1b\n*SRE?\n",
        "POSE?\n",
        "*SRE 48;*ESE 255\n",
        "FOO\n",
        "COMP:LOAD #15abc\n",
        "AXIS1:VEL?;*WAI",
        "\x1b",
        "\n",
        "+",
    ];
    let (mut client, mut random, mut seen) = (Client::new(), Seeded::new(1234), std::collections::BTreeMap::new());
    for sequence in 0..SEQUENCES {
        let mut sent = String::new();
        for _ in 0..random.below(14) {
            match random.below(200) {
                0..=4 => drop(client.wait(60)),
                5..=8 => client.bus.pass(2),
                9 => sent += "READ:POW?\n",
                10 => sent += "AXIS1:MOVE:REL 0.05;*OPC?\n",
                _ => sent += PIECES[random.below(PIECES.len() as u64) as usize],
            }
            if random.below(3) > 0 {
                client.send(std::mem::take(&mut sent));
            }
        }
        // every client ends in one of these ways
        match random.below(3) {
            0 => client.hang_up(),
            1 => {
                client.hang_up();
                for address in [5, 6, 7] {
                    client.send(format!("++addr {address}\n++clr\n"));
                }
            }
            // a line of its own, even behind an escape: what was begun is ended, what was asked is interrupted
            _ => {
                client.send("\n\n++rst\n");
                client.rest();
                client.wait(3001);
                client.send("++eos 3\n++read_tmo_ms 50\n");
            }
        }
        client.rest();
        let (at, mark) = (5 + random.below(3), random.below(256));
        client.send(format!("++addr {at}\n"));
        // whatever was unfinished in the instrument ends with this
        client.send("++eoi 1\n;\n");
        client.rest();
        client.turn();
        let told = client.ask(&format!("*ESE {mark};*ESE?"));
        assert_eq!(told, format!("{mark}\n"), "sequence {sequence} at {at}");
        for error in client.errors() {
            *seen.entry(error).or_insert(0) += 1;
        }
    }
    println!("{SEQUENCES} sequences, seed 1234, none wedged; errors: {seen:?}");
    assert!([-410, -420].iter().all(|error| seen[error] > SEQUENCES / 100), "{seen:?}");
    // 104: a calibration is sent while something moves
    let standard = |error: &i32| (-499..=-100).contains(error) || *error == 104;
    assert!(seen.keys().all(standard), "{seen:?}");
}
