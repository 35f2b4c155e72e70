//! What the tests of saving share.

#![allow(dead_code)] // each test file uses its part

use host_sim::board::{Board, Interleaving};
use host_sim::console::Console;
use host_sim::flash::{Flash, SECTOR, at_once};
use host_sim::machine::Machine;
use host_sim::session::{block_of, power_up};
use proptest::prelude::*;
use sequential_storage::cache::Cache;
use sequential_storage::queue::{QueueConfig, QueueStorage};
use stage_controller::controller::front::Front;
use stage_controller::scpi::tree::{Form, Kind, TABLE};
use stage_controller::settings::{self, BAUD_MAX, BAUD_MIN, BacklashMode, Settings};
use stage_controller::store::record::seal;
use stage_controller::store::{Buffer, RECORD_CAPACITY, Record, Standstill, Store, service};
use std::sync::OnceLock;

/// The part of `full` to do: all of it in a release build.
pub fn volume(full: u64) -> u64 {
    if cfg!(debug_assertions) { (full / 50).max(20) } else { full }
}

pub fn buffer() -> Buffer {
    [0; RECORD_CAPACITY]
}

fn block() -> &'static [u8] {
    static BLOCK: OnceLock<Vec<u8>> = OnceLock::new();
    BLOCK.get_or_init(|| block_of(&Machine::paper()).unwrap())
}

/// A front whose every saved part depends on a number.
pub fn of_number(number: u32) -> Front {
    let mut front = Front::new();
    front.load(block()).unwrap();
    while front.next_order().is_some() {}
    let mut record = front.record();
    record.settings.jog_timeout_ms = 1000 + number;
    record.settings.baud = 9600 + number;
    for (i, axis) in record.settings.axes.iter_mut().enumerate() {
        axis.velocity -= u64::from(number) + i as u64;
        axis.soft_lower += number as i32;
        axis.backlash.margin = number as i32;
    }
    record.pivots[1 + number as usize % 7] = Some([number as i32; 3]);
    let mut other = Front::new();
    other.apply_record(&record).unwrap();
    other
}

pub fn board_with(front: Front) -> Board {
    let mut board = Board::new(&Machine::paper(), front, Interleaving::Jittered(2), 3);
    assert!(board.settle());
    board
}

/// A homed board of the paper's machine with this flash.
pub fn board_of(flash: Flash) -> Board {
    let mut board = board_with(power_up(&Machine::paper(), false).unwrap());
    board.store = flash.store();
    board
}

/// A front that has been started from a store; something must have been saved.
pub fn loaded(store: &mut Store<Flash>) -> Front {
    let mut front = Front::new();
    let found = at_once(service::start(store, &mut front, &mut buffer()));
    assert!(found.record && front.settings_lost().is_none());
    front
}

/// A front with settings, with the paper's calibration or without one.
pub fn front_with(settings: Settings, calibrated: bool) -> Front {
    let mut front = Front::new();
    let pivots = [None, Some([16_000_000, -48_000_000, 320_000_000]), None, None, None, None, Some([7; 3]), None];
    let record = match calibrated {
        true => Record { settings, pivots, pivot: 1, block: block() },
        false => Record { settings, pivots: [None; 8], pivot: 0, block: &[] },
    };
    front.apply_record(&record).unwrap();
    front
}

/// The bytes of a front's record.
pub fn sealed(front: &Front) -> Vec<u8> {
    let mut buffer = buffer();
    let length = seal(&front.record(), &Standstill::default(), 1, &mut buffer).unwrap();
    buffer[..length].to_vec()
}

/// Gives changed bytes the CRC that they need.
pub fn seal_again(bytes: &mut [u8], sequence: u32) {
    stage_controller::store::record::reseal(&Standstill::default(), sequence, bytes).unwrap();
}

/// A flash to whose first sector something is appended, as another firmware would.
pub fn appended(mut flash: Flash, bytes: &[u8]) -> Flash {
    let config = QueueConfig::try_new(0..SECTOR as u32).unwrap();
    let mut queue = QueueStorage::new(&mut flash, config, Cache::new_uncached());
    at_once(queue.push(bytes, false)).unwrap();
    flash
}

/// Settings that the commands would take.
pub fn any_settings() -> impl Strategy<Value = (Settings, bool)> {
    (any::<u64>(), any::<bool>()).prop_map(|(seed, calibrated)| {
        let mut dice = host_sim::board::Seeded::new(seed);
        let front = of_number(0);
        let mut settings = if calibrated { *front.settings() } else { Settings::defaults(None) };
        if !calibrated {
            let within = |axis: &mut settings::AxisSettings, dice: &mut host_sim::board::Seeded| {
                axis.step_q32 += dice.below(axis.step_q32);
            };
            settings.axes.iter_mut().for_each(|axis| within(axis, &mut dice));
        }
        let motors = if calibrated { front.motors() } else { settings::motors(None, Some(&settings)) };
        let mut below = |most: u64| dice.below(most + 1);
        for (axis, motor) in settings.axes.iter_mut().zip(&motors) {
            axis.velocity = 1 + below(motor.velocity - 1);
            axis.start_velocity = below(motor.velocity);
            axis.acceleration = 1000 + below(motor.acceleration - 1000);
            axis.jerk = 1000 + below(motor.jerk - 1000);
            axis.soft_lower = -(below(1 << 29) as i32);
            axis.soft_upper = 1 + below((1 << 29) - 1) as i32;
            (axis.soft_on, axis.inverted) = (below(1) == 1, below(1) == 1);
            axis.timing.high_ns = below(1000) as u32;
            axis.timing.low_ns = below(1000) as u32;
            axis.timing.setup_ns = below(128_000) as u32;
            axis.timing.hold_ns = below(128_000) as u32;
            let play = &mut axis.backlash;
            play.mode =
                [BacklashMode::Off, BacklashMode::Reversal, BacklashMode::UniPositive, BacklashMode::UniNegative]
                    [below(3) as usize];
            play.distance = below(1 << 20) as i32;
            play.velocity = 1 + below(motor.velocity / 2 - 1);
            (play.dead_band, play.margin) = (below(1 << 20) as i32, below(1 << 20) as i32);
        }
        let switches = &mut settings.switches;
        for switch in [&mut switches.compensation, &mut switches.coupling, &mut switches.pivot, &mut switches.backlash]
        {
            *switch = below(1) == 1;
        }
        settings.override_percent = 1 + below(99) as u8;
        settings.jog_timeout_ms = 10 + below(3_599_990) as u32;
        settings.baud = BAUD_MIN + below(u64::from(BAUD_MAX - BAUD_MIN)) as u32;
        (settings, calibrated)
    })
}

/// Headers of every setting that is kept, with the number of the axis.
pub fn kept_settings() -> Vec<String> {
    let entries = TABLE.iter().filter(|entry| {
        let setting = entry.form == Form::Both && entry.query_params.iter().any(|p| p.kind == Kind::Extreme);
        // the drivers are off after every start, and how records are answered or begun is not kept
        setting && !["AXIS#:ENABle", "FORMat", "TRIGger:SOURce"].contains(&entry.pattern)
    });
    let headers = entries.flat_map(|entry| {
        let axes = if entry.pattern.contains('#') { entry.numbers() } else { 1..=1 };
        axes.map(|n| entry.pattern.replace('#', &n.to_string()).replace(['[', ']'], ""))
    });
    headers.collect()
}

/// What the queries of settings answer.
pub fn lines(console: &mut Console, headers: &[String]) -> Vec<String> {
    headers.iter().map(|header| format!("{header} {}", console.line(&format!("{header}?"), |_| ()))).collect()
}

/// Numbers of the queued errors; takes them.
pub fn errors(console: &mut Console) -> Vec<i32> {
    let mut numbers = Vec::new();
    loop {
        let text = console.line("SYST:ERR?", |_| ());
        match text.split(',').next().and_then(|number| number.parse().ok()) {
            Some(0) | None => return numbers,
            Some(number) => numbers.push(number),
        }
    }
}
