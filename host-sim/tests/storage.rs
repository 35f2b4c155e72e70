//! Settings in flash: whatever happens to the power, to the flash or to its bytes, the old ones or the new ones.

mod saving;

use host_sim::board::Seeded;
use host_sim::console::Console;
use host_sim::flash::{Cut, ERASE_UNITS, Fault, Flash, SECTOR, SIZE, at_once};
use proptest::prelude::*;
use saving::{any_settings, board_of, buffer, errors, front_with, kept_settings, lines, loaded, of_number, volume};
use stage_controller::controller::front::Front;
use stage_controller::settings::Settings;
use stage_controller::store::record::{RECORD_VERSION, decode, inspect};
use stage_controller::store::{RECORD_CAPACITY, Record, Standstill, StoreError, service};

const CUTS: [Cut; 3] = [Cut::FromStart, Cut::FromEnd, Cut::Scattered(5)];

/// Saves a record that is known by its number.
fn save(flash: Flash, number: u32) -> (Flash, Result<(), StoreError>) {
    let mut store = flash.store();
    let front = of_number(number);
    let result = at_once(store.save(&front.record(), &Standstill::default(), &mut buffer()));
    (std::mem::take(store.flash()), result)
}

fn saved(flash: Flash, number: u32) -> Flash {
    let (flash, result) = save(flash, number);
    assert_eq!(result, Ok(()), "{number}");
    flash
}

/// The number of the record that a start finds; the whole record must be that one.
fn number_of(flash: &mut Flash) -> Result<Option<u32>, StoreError> {
    let mut store = std::mem::take(flash).store();
    let mut buffer = buffer();
    let result = at_once(store.load(&mut buffer)).map(|saved| {
        saved.map(|saved| {
            let number = saved.record.settings.jog_timeout_ms - 1000;
            assert_eq!(saved.record, of_number(number).record(), "a mixture of records");
            number
        })
    });
    *flash = std::mem::take(store.flash());
    result
}

/// A flash after `count` saves, numbered from 1.
fn after(count: u32) -> Flash {
    (1..=count).fold(Flash::blank(), saved)
}

/// Saves after which the next one goes to the other sector, for the first and for the second time.
fn changes_of_sector() -> [u32; 2] {
    let (mut flash, mut found, mut count) = (Flash::blank(), Vec::new(), 0);
    let used = |flash: &Flash, sector: usize| {
        flash.bytes()[sector * SECTOR..(sector + 1) * SECTOR].iter().any(|byte| *byte != 0xff)
    };
    while found.len() < 2 {
        let (erases, second) = (flash.erases(), used(&flash, 1));
        flash = saved(flash, count + 1);
        if flash.erases() != erases || used(&flash, 1) != second {
            found.push(count);
        }
        count += 1;
    }
    [found[0], found[1]]
}

#[test]
fn a_power_cut_at_any_word_or_in_any_part_of_an_erase_leaves_the_old_or_the_new_settings() {
    let stride = if cfg!(debug_assertions) { 23 } else { 1 };
    let [first, second] = changes_of_sector();
    let mut cuts = 0;
    // the first save of all, and three in a row with a change of sector in the middle
    for (before, row) in [(0, 1), (first - 1, 3), (second - 1, 3)] {
        let start = after(before);
        let whole = (1..=row).fold(Flash::holding(start.bytes().to_vec()), |flash, n| saved(flash, before + n));
        assert!(whole.units() > 100, "{}", whole.units());
        assert_eq!(whole.erases() != [0, 0], before > 0, "a change of sector erases");
        for (unit, cut) in (1..=whole.units()).step_by(stride).flat_map(|unit| CUTS.map(|cut| (unit, cut))) {
            let mut flash = Flash::holding(start.bytes().to_vec());
            flash.set_fault(Fault::PowerCut(unit, cut));
            let (mut done, mut result) = (before, Ok(()));
            for n in 1..=row {
                (flash, result) = save(flash, before + n);
                if result.is_err() {
                    break;
                }
                done = before + n;
            }
            assert!(result.is_err() && flash.is_dead(), "unit {unit} of {} {cut:?}", whole.units());
            flash.set_fault(Fault::None);
            let found = number_of(&mut flash);
            let expected = |n: u32| found == Ok(Some(n));
            // the first save of all has no old settings: a start says that there are none, or that they are damaged
            let nothing = done == 0 && matches!(found, Ok(None) | Err(StoreError::Damaged));
            assert!(expected(done) || expected(done + 1) || nothing, "unit {unit} {cut:?}: {found:?}, not {done}");
            flash = saved(flash, 500);
            assert_eq!(number_of(&mut flash), Ok(Some(500)), "unit {unit} {cut:?}: saved anew");
            cuts += 1;
        }
    }
    println!("figure: {cuts} power cuts in saves and erases, after each the old or the new settings");
}

#[test]
fn power_that_fails_again_and_again_never_costs_the_settings() {
    let mut dice = Seeded::new(42);
    let mut flash = saved(Flash::blank(), 1);
    let (mut number, mut survived) = (1, 0);
    for n in 0..volume(4000) as u32 {
        let unit = 1 + dice.below(2 * 230);
        let cut = [Cut::FromStart, Cut::FromEnd, Cut::Scattered(dice.next_u64())][dice.below(3) as usize];
        flash.set_fault(Fault::PowerCut(unit, cut));
        let result;
        (flash, result) = save(flash, n + 2);
        let failed = flash.is_dead();
        assert_eq!(result.is_err(), failed);
        flash.set_fault(Fault::None);
        let found = number_of(&mut flash).unwrap().unwrap();
        assert!(found == n + 2 || failed && found == number, "{found} instead of {number} or {}", n + 2);
        number = found;
        survived += u32::from(failed);
    }
    assert!(survived > 10, "{survived}");
}

#[test]
fn any_bytes_in_the_flash_end_in_whole_settings_or_in_defaults_that_say_so() {
    let mut dice = Seeded::new(7);
    let full = after(25);
    let (mut whole, mut lost) = (0, 0);
    let count = volume(10_000);
    for n in 0..count {
        let mut bytes = full.bytes().to_vec();
        match n % 4 {
            // some bits
            0 => (0..1 + dice.below(400)).for_each(|_| bytes[dice.below(SIZE as u64) as usize] ^= 1 << dice.below(8)),
            // a stretch of anything
            1 => {
                let (from, length) = (dice.below(SIZE as u64) as usize, dice.below(SIZE as u64) as usize);
                bytes.iter_mut().skip(from).take(length).for_each(|byte| *byte = dice.next_u64() as u8);
            }
            // erased or programmed stretches
            2 => {
                let (value, from) = ([0x00, 0xff][dice.below(2) as usize], dice.below(SIZE as u64) as usize);
                bytes[from..].fill(value);
                let to = dice.below(SIZE as u64) as usize;
                bytes[..to].fill(0xff - value);
            }
            // words, so that headers are hit and look nearly right
            _ => (0..1 + dice.below(2000)).for_each(|_| {
                let at = 4 * dice.below(SIZE as u64 / 4) as usize;
                let from = 4 * dice.below(SIZE as u64 / 4) as usize;
                bytes.copy_within(from..from + 4, at);
            }),
        }
        let mut store = Flash::holding(bytes).store();
        let mut front = Front::new();
        let found = at_once(service::start(&mut store, &mut front, &mut buffer()));
        let mut flash = std::mem::take(store.flash());
        if found.record {
            let number = front.settings().jog_timeout_ms - 1000;
            assert!((1..=25).contains(&number) && front.record() == of_number(number).record());
            assert!(front.settings_lost().is_none());
            whole += 1;
        } else {
            let blank = flash.bytes().iter().all(|byte| *byte == 0xff);
            assert_eq!(front.settings_lost().map(|e| e.number.code()), (!blank).then_some(106));
            assert_eq!(front.record(), Front::new().record(), "defaults");
            lost += 1;
        }
        flash = saved(flash, 600);
        assert_eq!(number_of(&mut flash), Ok(Some(600)), "saved anew");
    }
    assert!(whole > count / 10 && lost > count / 20, "{whole} {lost}");
    println!("figure: {count} damaged flashes, {whole} starts with whole settings, {lost} with defaults and 106");
}

#[test]
fn a_flash_that_fails_says_so_and_keeps_what_it_has() {
    let [first, second] = changes_of_sector();
    for fault in [Fault::Writes, Fault::SilentWrites, Fault::Erases, Fault::SilentErases, Fault::Reads] {
        for before in [first - 1, first, second] {
            let mut flash = after(before);
            flash.set_fault(fault);
            let mut console = Console::new(board_of(flash));
            console.board.front.set_baud(57_600);
            assert_eq!(console.line("*SAV", |_| ()), "");
            let says = errors(&mut console);
            let erases = matches!(fault, Fault::Erases | Fault::SilentErases);
            // a sector with room needs no erase
            if erases && before == first - 1 {
                assert_eq!(says, Vec::<i32>::new(), "{fault:?} {before}");
                continue;
            }
            // blank from the factory, the other sector takes a record without an erase that works
            if fault == Fault::SilentErases && before == first {
                assert_eq!(says, Vec::<i32>::new(), "{fault:?} {before}");
                continue;
            }
            assert_eq!(says, [-320], "{fault:?} {before}");
            let mut flash = std::mem::take(console.board.store.flash());
            flash.set_fault(Fault::None);
            assert_eq!(number_of(&mut flash), Ok(Some(before)), "{fault:?}: what was saved before");
        }
    }
}

#[test]
fn a_thousand_saves_wear_both_sectors_alike() {
    let flash = after(1000);
    let [a, b] = flash.erases();
    assert!(a + b < 100 && a.abs_diff(b) <= 1, "{a} {b}");
    println!("figure: 1000 saves with a calibration: {a} and {b} erases, {} words written each", flash.units() / 1000);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: volume(500) as u32, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_settings_come_back_from_the_flash((settings, calibrated) in any_settings()) {
        let front = front_with(settings, calibrated);
        let mut store = Flash::blank().store();
        at_once(store.save(&front.record(), &Standstill::default(), &mut buffer())).unwrap();
        let again = loaded(&mut store);
        prop_assert_eq!(again.record(), front.record());
    }

    #[test]
    fn any_bytes_are_refused_as_a_record(bytes in prop::collection::vec(any::<u8>(), 0..RECORD_CAPACITY)) {
        prop_assert!(inspect(&bytes).is_none() && decode(&bytes) == Err(StoreError::Damaged));
    }

    #[test]
    fn a_record_that_is_whole_and_says_nonsense_is_refused_or_harmless(
        (settings, calibrated) in any_settings(),
        changes in prop::collection::vec((80usize..1000, any::<u8>()), 1..12),
    ) {
        let front = front_with(settings, calibrated);
        let mut bytes = saving::sealed(&front);
        for (at, value) in changes {
            let length = bytes.len();
            bytes[80 + at % (length - 80)] = value;
        }
        saving::seal_again(&mut bytes, 1);
        prop_assert!(inspect(&bytes).is_some());
        if let Ok(saved) = decode(&bytes) {
            let mut other = Front::new();
            if other.apply_record(&saved.record).is_ok() {
                prop_assert_eq!(other.record(), saved.record);
                let mut board = saving::board_with(other);
                prop_assert!(board.settle());
                for axis in stage_controller::units::Axis::ALL {
                    board.front.set_enabled(axis, true).unwrap();
                    let _ = board.front.move_relative(axis, 1000);
                    prop_assert!(board.run(200_000, |_| ()) || board.front.operation_pending());
                    board.front.abort();
                    prop_assert!(board.settle());
                }
            }
        }
    }
}

#[test]
fn no_record_with_a_wrong_bit_and_none_of_another_version_is_read() {
    let bytes = saving::sealed(&of_number(5));
    assert!(decode(&bytes).is_ok());
    for bit in 0..8 * bytes.len() {
        let mut wrong = bytes.clone();
        wrong[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(decode(&wrong), Err(StoreError::Damaged), "bit {bit}");
    }
    let mut newer = bytes.clone();
    newer[4] = RECORD_VERSION as u8 + 1;
    saving::seal_again(&mut newer, 1);
    assert_eq!(decode(&newer), Err(StoreError::Version(RECORD_VERSION + 1)));
}

#[test]
fn a_record_with_pivots_and_no_calibration_is_refused_and_changes_nothing() {
    let mut front = of_number(3);
    let pivots = front.record().pivots;
    for (pivots, pivot) in [(pivots, 0), ([None; 8], 1)] {
        let record = Record { settings: Settings::defaults(None), pivots, pivot, block: &[] };
        assert_eq!(front.apply_record(&record).map_err(|error| error.number.code()), Err(-221));
    }
    assert_eq!(front.record(), of_number(3).record());
}

#[test]
fn settings_of_another_version_are_refused_at_start_and_can_be_saved_anew() {
    let mut flash = saved(Flash::blank(), 1);
    let mut bytes = saving::sealed(&of_number(2));
    bytes[4] = RECORD_VERSION as u8 + 1;
    saving::seal_again(&mut bytes, 2);
    flash = saving::appended(flash, &bytes);
    let mut store = flash.store();
    let mut front = Front::new();
    let found = at_once(service::start(&mut store, &mut front, &mut buffer()));
    assert!(!found.record);
    assert!(front.settings_lost().unwrap().to_string().contains("another version"));
    let mut flash = saved(std::mem::take(store.flash()), 3);
    assert_eq!(number_of(&mut flash), Ok(Some(3)));
}

#[test]
fn the_longest_record_fits() {
    let mut settings = Settings::defaults(None);
    for axis in &mut settings.axes {
        axis.velocity = u64::MAX;
        (axis.start_velocity, axis.acceleration, axis.jerk, axis.step_q32) = (u64::MAX, u64::MAX, u64::MAX, u64::MAX);
        (axis.soft_lower, axis.soft_upper) = (i32::MIN, i32::MAX);
        axis.timing.high_ns = u32::MAX;
        (axis.timing.low_ns, axis.timing.setup_ns, axis.timing.hold_ns) = (u32::MAX, u32::MAX, u32::MAX);
        (axis.backlash.distance, axis.backlash.velocity) = (i32::MIN, u64::MAX);
        (axis.backlash.dead_band, axis.backlash.margin) = (i32::MIN, i32::MIN);
        (axis.home.velocity, axis.home.offset) = (u64::MAX, Some(i32::MIN));
    }
    (settings.jog_timeout_ms, settings.baud) = (u32::MAX, u32::MAX);
    let block = [0xff; stage_controller::compensation::calibration::BLOCK_CAPACITY];
    let record = Record { settings, pivots: [Some([i32::MIN; 3]); 8], pivot: 7, block: &block };
    let length =
        stage_controller::store::record::seal(&record, &Standstill::default(), u32::MAX, &mut buffer()).unwrap();
    // room for settings to come
    assert!(length + 200 <= RECORD_CAPACITY, "{length}");
    println!(
        "figure: longest record {length} bytes, with the paper's calibration {}",
        saving::sealed(&of_number(1)).len()
    );
}

#[test]
fn the_longest_calibration_fits() {
    use stage_controller::compensation::calibration::{BLOCK_CAPACITY, Calibration, MotorData, ScrewAxis};
    let motor = MotorData {
        step_q32: u64::MAX,
        row_bits: u8::MAX,
        backlash_steps: u32::MAX,
        travel_lower: i32::MIN,
        travel_upper: i32::MIN,
        velocity: u64::MAX,
        acceleration: u64::MAX,
        jerk: u64::MAX,
    };
    let longest = Calibration {
        name: [u8::MAX; 16],
        order: stage_controller::units::Axis::ALL,
        motors: [motor; 6],
        inverse_slides: [[i32::MIN; 3]; 3],
        rotary_gain: [i32::MIN; 3],
        tilt: [[i32::MIN; 3]; 3],
        second_order: [[i32::MIN; 6]; 3],
        screws: [ScrewAxis { axis: stage_controller::units::Axis::X, direction: [i32::MIN; 3], point: [i32::MIN; 3] };
            3],
        home_rotation: [[i32::MIN; 3]; 3],
        home_origin: [i32::MIN; 3],
        fibre_point: [i32::MIN; 3],
    };
    assert_eq!(longest.encode(&mut [0; BLOCK_CAPACITY]), Some(733));
}

#[test]
fn every_setting_of_the_language_comes_back_after_a_restart() {
    for (calibrated, extreme) in [(true, "MIN"), (true, "MAX"), (false, "MIN"), (false, "MAX")] {
        let front = if calibrated { of_number(0) } else { Front::new() };
        let mut console = Console::new(saving::board_with(front));
        let mut changed = 0;
        for header in kept_settings() {
            let arguments = if header.ends_with("STEP:TIMing") { [extreme; 4].join(",") } else { extreme.to_owned() };
            let before = console.line(&format!("{header}?"), |_| ());
            console.line(&format!("{header} {arguments}"), |_| ());
            changed += usize::from(console.line(&format!("{header}?"), |_| ()) != before);
        }
        assert!(changed > 30, "{changed} settings changed");
        console.line("*CLS", |_| ());
        let answers = lines(&mut console, &kept_settings());
        console.line("*SAV", |_| ());
        assert_eq!(errors(&mut console), Vec::<i32>::new());
        let mut store = std::mem::take(console.board.store.flash()).store();
        let mut again = Console::new(saving::board_with(loaded(&mut store)));
        assert_eq!(lines(&mut again, &kept_settings()), answers, "{calibrated} {extreme}");
    }
}

#[test]
fn the_erase_of_the_virtual_flash_takes_all_its_units() {
    let mut flash = Flash::blank();
    at_once(embedded_storage_async::nor_flash::NorFlash::erase(&mut flash, 0, SECTOR as u32)).unwrap();
    assert_eq!((flash.units(), flash.erases()), (ERASE_UNITS, [1, 0]));
}
