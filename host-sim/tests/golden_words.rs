//! The golden suite on the desktop: what it plays, and that the virtual board plays the same.

use host_sim::board::{Board, Interleaving};
use host_sim::console::Console;
use host_sim::machine::Machine;
use host_sim::session::block_of;
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use stage_controller::refill::generator::Generator;
use stage_controller::stepgen::timing::MAX_GRID;
use stage_controller::units::SEGMENT_TICKS;
use std::path::{Path, PathBuf};
use target_tests::halves::{Halves, Wires};
use target_tests::play::{Reason, Rig, play};
use target_tests::record::Record;
use target_tests::suite::{BLOCKS, HEADER, SCRIPTS, WORDS};

/// Calls `f` with a controller without a stage.
fn with_halves<T>(f: impl FnOnce(&mut Halves<'_>) -> T) -> T {
    let mut front = Box::new(Front::new());
    let (law, timing) = front.generator_setup();
    let (mut generator, mut links, mut wires) =
        (Box::new(Generator::new(law, timing)), Box::new(Links::new()), Box::new(Wires::default()));
    f(&mut Halves::new(&mut front, &mut generator, &mut links, &mut wires))
}

/// The virtual board with its stage as the scripts' controller.
struct Simulated {
    machine: Machine,
    console: Console,
    /// Answers that came with the last segment.
    answers: Vec<u8>,
}

impl Simulated {
    fn new() -> Self {
        let machine = Machine::paper();
        let console = Console::new(Board::new(&machine, Front::new(), Interleaving::Prompt, 0));
        Simulated { machine, console, answers: Vec::new() }
    }
}

impl Rig for Simulated {
    fn power_up(&mut self, block: &[u8], cold: bool) -> bool {
        let mut front = Front::new();
        let loaded = front.load(block).is_ok();
        if !cold {
            front.assume_homed();
        }
        self.console = Console::new(Board::new(&self.machine, front, Interleaving::Prompt, 0));
        self.answers.clear();
        loaded
    }

    fn exchange(&mut self, bytes: &[u8], mut answered: impl FnMut(&[u8])) -> usize {
        answered(&std::mem::take(&mut self.answers));
        answered(&self.console.exchange(bytes));
        bytes.len()
    }

    fn step(&mut self, mut played: impl FnMut(&[u32])) {
        self.answers = self.console.step(|segment| {
            // after an immediate stop the board lets the pulses end: the words are those before
            let silence = if segment.motor.is_none() { MAX_GRID as usize } else { 0 };
            played(&segment.words[..segment.words.len() - silence]);
        });
    }

    fn is_pending(&self) -> bool {
        self.console.board.front.operation_pending()
    }

    fn stop_after(&mut self, tick: usize) {
        self.console.board.stop_after(tick);
    }
}

fn golden(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden").join(path)
}

#[test]
fn every_script_plays_its_golden_words() {
    with_halves(|halves| {
        for script in SCRIPTS {
            let record =
                play(script.text, halves, |_| ()).unwrap_or_else(|failure| panic!("{}: {failure}", script.name));
            let expected = Record::find(WORDS, script.name);
            assert_eq!(
                Some(record),
                expected,
                "{}: if it is meant so, {}",
                script.name,
                HEADER.lines().next().unwrap()
            );
        }
    });
}

#[test]
fn the_virtual_board_plays_the_same_words() {
    for script in SCRIPTS {
        let mut words = Vec::new();
        let bare = with_halves(|halves| play(script.text, halves, |segment| words.push(segment.to_vec())));
        let bare = bare.unwrap_or_else(|failure| panic!("{}: {failure}", script.name));
        let mut segment = 0;
        let simulated = play(script.text, &mut Simulated::new(), |played| {
            assert_eq!(words.get(segment).map(Vec::as_slice), Some(played), "{}: segment {segment}", script.name);
            segment += 1;
        });
        assert_eq!(simulated, Ok(bare), "{}", script.name);
        assert_eq!(segment, words.len(), "{}: the board stopped early", script.name);
    }
}

#[test]
fn the_suite_holds_every_script_and_each_moves_a_motor() {
    let mut files: Vec<String> = std::fs::read_dir(golden("scripts"))
        .expect("the scripts are there")
        .map(|entry| entry.expect("readable").path().file_stem().expect("a name").to_string_lossy().into_owned())
        .collect();
    let mut names: Vec<_> = SCRIPTS.iter().map(|script| script.name.to_owned()).collect();
    files.sort();
    names.sort();
    assert_eq!(files, names, "tests/target/src/suite.rs lists what is in tests/golden/scripts");
    for script in SCRIPTS {
        let record = Record::find(WORDS, script.name).expect("words.txt has a line for each script");
        assert!(record.steps.iter().filter(|steps| **steps > 100).count() >= 3, "{}: {record}", script.name);
    }
}

#[test]
fn the_kept_blocks_are_what_calibrate_makes() {
    for (name, block) in BLOCKS {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("machines/{name}.toml"));
        let text = std::fs::read_to_string(&file).expect("a machine file of that name");
        let made = block_of(&Machine::parse(&text).expect("a machine")).expect("it can be calibrated");
        assert_eq!(made, *block, "host-sim calibrate {} -o tests/golden/blocks/{name}.cal", file.display());
    }
}

#[test]
fn one_bit_of_one_word_makes_another_record() {
    let words: [u32; SEGMENT_TICKS] = std::array::from_fn(|i| (i as u32).wrapping_mul(0x9E37_79B9));
    let record = |words: &[u32]| {
        let mut record = Record::default();
        record.add_words(words);
        record.add_words(&[7; SEGMENT_TICKS]);
        record
    };
    for (word, bit) in [(0, 0), (0, 31), (63, 14), (127, 31)] {
        let mut other = words;
        other[word] ^= 1 << bit;
        assert_ne!(record(&words).words, record(&other).words, "word {word}, bit {bit}");
    }
    assert_ne!(record(&words).words, record(&words[..SEGMENT_TICKS - 1]).words, "a segment cut short");
}

#[test]
fn a_wrong_answer_and_a_line_that_is_none_stop_a_script() {
    let reason = |script: &str| {
        let failed = with_halves(|halves| play(script, halves, |_| ())).expect_err("a failure");
        (failed.number, failed.reason)
    };
    assert_eq!(reason("@machine paper\nAXIS1:POS?\n= 1"), (3, Reason::Answered("0.000".try_into().expect("short"))));
    assert_eq!(reason("# text\n@tick 257"), (2, Reason::Unreadable));
    assert_eq!(reason("@machine nowhere"), (1, Reason::NoMachine));
    assert_eq!(reason("@machine paper\nSYST:JOG:TIM 100\nAXIS1:MOVE 1\n= 1"), (4, Reason::Silent));
}
