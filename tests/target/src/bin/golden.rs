//! Plays the golden suite and compares every script's record with `tests/golden/words.txt`.
//!
//! On a Cortex-M4F (QEMU): `cargo qemu`. On the desktop: `cargo run -p target-tests --bin golden`, and with
//! `-- --write` the records become the expected ones.
#![cfg_attr(target_os = "none", no_std, no_main)]

use core::fmt::{self, Write};
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use stage_controller::refill::generator::Generator;
use target_tests::halves::{Halves, Wires};
use target_tests::play::play;
use target_tests::record::Record;
use target_tests::suite::{SCRIPTS, WORDS};

/// Where the parts of a controller lie.
struct Room {
    front: &'static mut Front,
    generator: &'static mut Generator,
    links: &'static mut Links<1>,
    wires: &'static mut Wires,
}

/// Plays all scripts and says how each one went; how many differ.
fn compare(room: Room, out: &mut impl Write) -> Result<usize, fmt::Error> {
    let mut halves = Halves::new(room.front, room.generator, room.links, room.wires);
    let (mut segments, mut differ) = (0, 0);
    for script in SCRIPTS {
        match play(script.text, &mut halves, |_| ()) {
            Ok(record) => {
                let same = Record::find(WORDS, script.name) == Some(record);
                differ += usize::from(!same);
                segments += record.segments;
                writeln!(out, "{:<14} {record} {}", script.name, if same { "ok" } else { "DIFFERS" })?;
            }
            Err(failure) => {
                differ += 1;
                writeln!(out, "{:<14} {failure} FAILED", script.name)?;
            }
        }
    }
    writeln!(out, "figure: {segments} segments of 256 us")?;
    writeln!(out, "golden: {} passed, {differ} failed", SCRIPTS.len() - differ)?;
    Ok(differ)
}

#[cfg(not(target_os = "none"))]
mod host {
    use super::*;
    use std::process::ExitCode;
    use target_tests::suite::HEADER;

    fn room() -> Room {
        let front = Box::leak(Box::new(Front::new()));
        let (law, timing) = front.generator_setup();
        let generator = Box::leak(Box::new(Generator::new(law, timing)));
        Room { front, generator, links: Box::leak(Box::default()), wires: Box::leak(Box::default()) }
    }

    /// The expected records as they should be: the whole file.
    fn table(room: Room) -> Result<String, String> {
        let mut halves = Halves::new(room.front, room.generator, room.links, room.wires);
        let mut table = HEADER.to_owned();
        for script in SCRIPTS {
            let record = play(script.text, &mut halves, |_| ())
                .map_err(|failure| format!("tests/golden/scripts/{}.txt: {failure}", script.name))?;
            table += &format!("{:<14} {record}\n", script.name);
        }
        Ok(table)
    }

    pub fn main() -> ExitCode {
        let result = match std::env::args().nth(1).as_deref() {
            None => {
                let mut report = String::new();
                let differ = compare(room(), &mut report);
                print!("{report}");
                if differ == Ok(0) { Ok(()) } else { Err("the words are not the golden ones".to_owned()) }
            }
            Some("--write") => {
                let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../golden/words.txt");
                table(room()).and_then(|table| std::fs::write(file, table).map_err(|error| format!("{file}: {error}")))
            }
            Some(other) => Err(format!("{other:?} is no option: give none, or --write")),
        };
        match result {
            Ok(()) => ExitCode::SUCCESS,
            Err(complaint) => {
                eprintln!("{complaint}");
                ExitCode::FAILURE
            }
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    host::main()
}

#[cfg(target_os = "none")]
mod target {
    use super::*;
    use cortex_m::singleton;
    use cortex_m_rt::entry;
    use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
    use cortex_m_semihosting::{hio, hprintln};
    use embassy_stm32 as _; // the interrupt vectors

    // Each part is made in a function of its own: what lies on the stack meanwhile is given back before the next one.

    #[inline(never)]
    fn front() -> &'static mut Front {
        singleton!(: Front = Front::new()).expect("taken once")
    }

    #[inline(never)]
    fn generator(front: &Front) -> &'static mut Generator {
        let (law, timing) = front.generator_setup();
        singleton!(: Generator = Generator::new(law, timing)).expect("taken once")
    }

    #[inline(never)]
    fn links() -> &'static mut Links<1> {
        singleton!(: Links<1> = Links::new()).expect("taken once")
    }

    #[inline(never)]
    fn wires() -> &'static mut Wires {
        singleton!(: Wires = Wires::default()).expect("taken once")
    }

    #[entry]
    fn main() -> ! {
        let front = front();
        let room = Room { generator: generator(front), front, links: links(), wires: wires() };
        let mut out = hio::hstdout().expect("run under a debugger or QEMU with semihosting");
        let differ = compare(room, &mut out);
        debug::exit(if differ == Ok(0) { EXIT_SUCCESS } else { EXIT_FAILURE });
        panic!("the emulator went on after the end");
    }

    #[panic_handler]
    fn panic(info: &core::panic::PanicInfo) -> ! {
        hprintln!("golden: {}", info);
        debug::exit(EXIT_FAILURE);
        loop {
            cortex_m::asm::wfi();
        }
    }
}
