//! IFC and ATN at every step of every handshake, controllers that hang up, and long random sequences.

mod bus;

use bus::board::{Board, Pace};
use bus::controller::*;
use bus::instrument::Instrument;
use bus::{Bench, DEVICE, INSTRUMENT, Random, between, once_in};
use stage_gpib::acceptor::AH;
use stage_gpib::addressing::{Addressing, L, SP, T};
use stage_gpib::device::Event;
use stage_gpib::remote::RL;
use stage_gpib::source::SH;

/// What a device that follows the standard makes of what everybody was told.
#[derive(Default, PartialEq, Debug)]
struct Reference {
    listens: bool,
    talks: bool,
    polls: bool,
    enabled: bool,
    remote: bool,
    locked: bool,
    clears: u32,
    triggers: u32,
}

impl Reference {
    fn of(said: &[Said]) -> Reference {
        let mut all = Reference::default();
        for said in said {
            all.hear(*said);
        }
        all
    }

    fn hear(&mut self, said: Said) {
        let code = match said {
            Said::Clear => {
                (self.listens, self.talks, self.polls) = (false, false, false);
                return;
            }
            Said::Remote(on) => {
                self.enabled = on;
                self.remote &= on;
                self.locked &= on;
                return;
            }
            Said::Command(code) => code & 0x7F,
        };
        match code {
            UNL => self.listens = false,
            DCL => self.clears += 1,
            SDC => self.clears += self.listens as u32,
            GET => self.triggers += self.listens as u32,
            SPE => self.polls = true,
            SPD => self.polls = false,
            LLO => self.locked |= self.enabled,
            GTL => self.remote &= !self.listens,
            _ if code == listen(DEVICE) => {
                (self.listens, self.talks) = (true, false);
                self.remote |= self.enabled;
            }
            _ if code == talk(DEVICE) => (self.listens, self.talks) = (false, true),
            0x40..=0x5F => self.talks = false,
            _ => {}
        }
    }

    fn seen(bench: &Bench) -> Reference {
        let states = bench.board.firmware.device.states();
        Reference {
            listens: states.addressing.listener != L::LIDS,
            talks: states.addressing.talker != T::TIDS,
            polls: states.addressing.poll == SP::SPMS,
            enabled: bench.lines.has(stage_gpib::lines::Lines::REN),
            remote: states.remote.is_remote(),
            locked: matches!(states.remote, RL::LWLS | RL::RWLS),
            clears: bench.board.firmware.exchange.clears,
            triggers: bench.board.firmware.exchange.triggers,
        }
    }
}

/// If nobody was torn off in the middle of a command, the device knows what the standard says.
fn agrees(bench: &mut Bench) {
    bench.rest(60_000);
    if !bench.controller.torn {
        assert_eq!(
            Reference::seen(bench),
            Reference::of(&bench.controller.said),
            "{:?} {}",
            bench.controller.said,
            bench.describe()
        );
    }
}

/// After all that, the bus must work at once: no time-out, no second try.
fn works(bench: &mut Bench) {
    bench.controller.abuse = None;
    agrees(bench);
    bench.controller.recover();
    bench.controller.script.push_back(Op::Pause(100_000));
    bench.finish();
    let states = bench.board.firmware.device.states();
    assert_eq!(states.addressing, Addressing::IDLE);
    assert_eq!((states.acceptor, states.source), (AH::AIDS, SH::SIDS));
    assert!(!bench.board.pull().lines.has(stage_gpib::lines::Lines::NRFD | stage_gpib::lines::Lines::NDAC));

    let before = (bench.ledger.device.got.len(), bench.ledger.controller.got.len());
    bench.controller.say(&[DEVICE], &[(0xA0, false), (0xA1, false), (0xA2, true)]);
    bench.controller.read(DEVICE, &[], 5);
    bench.controller.poll(DEVICE);
    bench.finish();
    agrees(bench);
    assert_eq!(bench.ledger.device.got.len(), before.0 + 3);
    assert!(bench.ledger.controller.got.len() > before.1);
    bench.check();
}

fn bench(seed: u64, pace: Pace) -> Bench {
    let mut bench = Bench::new(seed, Board::new(pace), Instrument::new(true));
    bench.board.firmware.exchange.endless = Some(0x40);
    // data that would do something, were they taken for interface messages
    bench.instrument.endless = Some(0);
    bench.controller.script.push_back(Op::Remote(true));
    bench
}

/// Times that each step is broken off, each with other delays.
const SEEDS: u64 = 5;

/// A bit of everything: the device hears the controller and the instrument, speaks to both, is polled.
fn everything(bench: &mut Bench) {
    bench.board.status(0x21, true);
    bench.controller.say(&[DEVICE, INSTRUMENT], &[(0x80, false), (0x81, false), (0x82, true)]);
    bench.controller.read(DEVICE, &[INSTRUMENT], 4);
    bench.controller.poll(DEVICE);
    bench.controller.read(INSTRUMENT, &[DEVICE], 3);
    bench.controller.command(&[LLO, listen(DEVICE), GET, SDC, GTL, UNL]);
}

#[test]
fn a_controller_that_breaks_off_at_any_step_loses_no_byte_and_wedges_nothing() {
    let blips = [250, 700, 3_000, 30_000].map(Abuse::Blip);
    let abuses = [Abuse::Clear, Abuse::Seize, Abuse::HangUp(1_000_000)].into_iter().chain(blips);
    let mut broken_off = 0;
    for abuse in abuses {
        for pace in [Pace::FAST, Pace::SLOW] {
            for seed in 0..SEEDS {
                for step in 1.. {
                    let mut bench = bench(step * SEEDS + seed, pace);
                    everything(&mut bench);
                    bench.controller.abuse = Some((step, abuse));
                    bench.finish();
                    if !bench.controller.abused {
                        break;
                    }
                    broken_off += 1;
                    works(&mut bench);
                }
            }
        }
    }
    println!("{broken_off} places to break off");
    assert!(broken_off > 3_000 * SEEDS);
}

#[test]
fn without_the_gates_slow_firmware_breaks_the_rule_of_200_ns() {
    let late = |fitted| {
        let mut bench = bench(1, Pace::SLOW);
        bench.board.fitted = fitted;
        everything(&mut bench);
        for _ in 0..50_000 {
            bench.tick();
        }
        bench.watch.late.len()
    };
    assert_eq!(late(true), 0);
    assert!(late(false) > 0);
}

/// One random sequence: what it ran and what it counted.
#[derive(Default)]
struct Tally {
    edges: u64,
    bytes: usize,
    sent: u64,
    polls: usize,
    abused: u64,
    compared: u64,
    cut: usize,
}

fn sequence(seed: u64, tally: &mut Tally) {
    let random = &mut Random(seed ^ 0x1234_5678);
    let mut bench = bench(seed, Pace::any(random));
    bench.instrument = Instrument::new(!once_in(random, 8));
    bench.instrument.endless = Some(random.bits() as u8 & 0x1F);
    let with_instrument = bench.instrument.powered;
    let mut word = 0_u8;
    for _ in 0..between(random, 2, 5) {
        match random.bits() % 10 {
            0..=2 => {
                let both: &[u8] = if once_in(random, 2) && with_instrument { &[INSTRUMENT, DEVICE] } else { &[DEVICE] };
                let bytes = between(random, 1, 5);
                let text: Vec<_> = (0..bytes).map(|at| (word.wrapping_add(at as u8), at + 1 == bytes)).collect();
                word = word.wrapping_add(bytes as u8);
                bench.controller.say(both, &text);
            }
            3..=5 => {
                let also: &[u8] = if once_in(random, 2) && with_instrument { &[INSTRUMENT] } else { &[] };
                bench.controller.read(DEVICE, also, between(random, 1, 9) as u32);
            }
            6 if with_instrument => bench.controller.read(INSTRUMENT, &[DEVICE], between(random, 1, 5) as u32),
            7 => bench.controller.poll(if once_in(random, 4) && with_instrument { INSTRUMENT } else { DEVICE }),
            8 => bench.controller.script.extend([Op::Remote(once_in(random, 3)), Op::Pause(100_000), Op::Remote(true)]),
            _ => {
                let codes = [GTL, SDC, PPC, GET, TCT, LLO, DCL, PPU, SPE, SPD, UNL, UNT, listen(DEVICE), talk(DEVICE)];
                let any: Vec<u8> = (0..between(random, 1, 6))
                    .map(|_| {
                        if once_in(random, 5) {
                            random.bits() as u8
                        } else {
                            codes[random.bits() as usize % codes.len()]
                        }
                    })
                    .collect();
                bench.controller.command(&any);
                bench.controller.command(&[SPD]);
                if once_in(random, 3) {
                    bench.controller.script.push_back(Op::ParallelPoll);
                }
            }
        }
    }
    if once_in(random, 2) {
        bench.board.status(random.bits() as u8, true);
    }
    if !once_in(random, 3) {
        let abuse = match random.bits() % 4 {
            0 => Abuse::Clear,
            1 => Abuse::Seize,
            2 => Abuse::HangUp(between(random, 1_000, 300_000)),
            _ => Abuse::Blip(between(random, 250, 40_000)),
        };
        bench.controller.abuse = Some((between(random, 1, 150), abuse));
    }
    let limit = bench.now + 100_000_000;
    while !bench.controller.done() {
        bench.tick();
        tally.edges += 1;
        assert!(bench.watch.late.is_empty(), "{:?} {}", bench.watch.late, bench.describe());
        assert!(bench.now < limit, "wedged: {}", bench.describe());
    }
    works(&mut bench);
    assert!(bench.controller.parallel.iter().all(|answer| *answer == 0), "a parallel poll was answered");
    let accounts = [&bench.ledger.device, &bench.ledger.instrument, &bench.ledger.controller];
    tally.bytes += accounts.iter().map(|account| account.got.len()).sum::<usize>();
    tally.cut += accounts.iter().flat_map(|account| &account.owed).filter(|(_, cut)| *cut).count();
    tally.sent +=
        bench.board.firmware.exchange.events.iter().filter(|event| matches!(event, Event::Sent { .. })).count() as u64;
    tally.polls += bench.controller.statuses.len();
    tally.abused += bench.controller.abused as u64;
    tally.compared += !bench.controller.torn as u64;
}

/// 10^5 sequences in a release build; `GPIB_SEQUENCES` for another number.
#[test]
fn random_sequences_lose_no_byte_and_wedge_nothing() {
    let usual = if cfg!(debug_assertions) { 20_000 } else { 100_000 };
    let sequences = std::env::var("GPIB_SEQUENCES").map_or(usual, |number| number.parse().expect("a number"));
    let mut tally = Tally::default();
    for seed in 0..sequences {
        let run = std::panic::AssertUnwindSafe(|| sequence(seed, &mut tally));
        if let Err(reason) = std::panic::catch_unwind(run) {
            eprintln!("sequence {seed}");
            std::panic::resume_unwind(reason);
        }
    }
    println!(
        "{sequences} sequences, {} broken off; {} acts of the parties, {} bytes taken, {} cut, {} sent by the device, {} \
         polls; states compared with the reference in {}",
        tally.abused, tally.edges, tally.bytes, tally.cut, tally.sent, tally.polls, tally.compared
    );
    assert!(tally.abused > sequences / 3 && tally.compared > sequences / 2 && tally.cut > 0);
}
