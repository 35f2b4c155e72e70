//! The instrument by its messages.

use super::{SEGMENT_TICKS, Session};
use crate::bench_twin::{Bench, Options};
use crate::optics::MeterOptions;

/// A bench that stands, with one link to its meter.
struct Meter {
    bench: Bench,
    session: Session,
    segments: u64,
}

impl Meter {
    fn new(options: &Options) -> Self {
        let mut meter = Meter { bench: Bench::seeded(3, options), session: Session::new(), segments: 0 };
        meter.pass(10);
        meter
    }

    fn pass(&mut self, segments: u64) {
        for _ in 0..segments {
            self.segments += 1;
            let tick = self.segments * SEGMENT_TICKS;
            self.bench.light(tick, [[0.0; 6]; 2]);
            self.session.see(&self.bench, tick);
        }
    }

    /// The answer to a line, and how many segments it took.
    fn say(&mut self, line: &str) -> (String, u64) {
        let mut bytes = format!("{line}\n").into_bytes();
        let begun = self.segments;
        loop {
            let taken = self.session.receive(&bytes);
            bytes.drain(..taken);
            self.session.poll(&mut self.bench, self.segments * SEGMENT_TICKS);
            if bytes.is_empty() && !self.session.is_busy() {
                break;
            }
            assert!(self.segments - begun < 1000, "{line} waits for ever");
            self.pass(1);
        }
        let mut answer = vec![0; 10_000];
        let count = self.session.transmit(&mut answer);
        answer.truncate(count);
        (String::from_utf8(answer).unwrap(), self.segments - begun)
    }

    fn ask(&mut self, line: &str) -> String {
        self.say(line).0
    }
}

#[test]
fn a_reading_is_fresh_and_takes_its_time() {
    let mut meter = Meter::new(&Options::default());
    let (dark, took) = meter.say("ROUT:CLOS 1,OPEN;CLOS 2,DET;:READ:POW? (@1)");
    let [dark]: [f64; 1] = [dark.trim().parse().unwrap()];
    assert!((-61.0..-58.0).contains(&dark), "{dark}");
    assert!((40 + 40 + 40 + 32..40 * 3 + 40).contains(&took), "{took}");
    let both = meter.ask("READ?");
    let levels: Vec<f64> = both.trim().split(',').map(|level| level.parse().unwrap()).collect();
    assert!(levels.len() == 2 && levels[0] < -58.0 && levels[1] > levels[0], "{both}");
    let turned = meter.ask("READ:POW? (@2,1)");
    assert!(turned.starts_with(both.trim().split(',').nth(1).unwrap().split('.').next().unwrap()), "{both} {turned}");
}

#[test]
fn a_mean_is_that_of_the_light() {
    let quiet = MeterOptions { noise_db: 0.0, ..MeterOptions::default() };
    let mut meter = Meter::new(&Options { meter: quiet, drift_um_per_min: 0.0, ..Options::default() });
    let read: f64 = meter.ask("ROUT:CLOS 1,DET;:READ? (@1)").trim().parse().unwrap();
    let light = meter.bench.light(meter.segments * SEGMENT_TICKS, [[0.0; 6]; 2])[0];
    assert!(light > -40.0 && (read - light).abs() < 0.002, "{read} {light}");
}

#[test]
fn the_switch_tells_where_it_stands_and_reset_brings_it_back() {
    let mut meter = Meter::new(&Options::default());
    assert_eq!(meter.ask("ROUT:CLOS? 1;CLOS? 2"), "1;8\n");
    assert_eq!(meter.ask("route:close 1,3;:rout:clos 2,detector;*OPC?;CLOS? 1;CLOS? 2"), "1;3;DET\n");
    assert_eq!(meter.ask("*RST;ROUT:CLOS? 1;:ROUT:CLOS? 2"), "1;8\n");
    assert_eq!(meter.ask("SYST:ERR?"), "0,\"No error\"\n");
}

#[test]
fn bad_input_is_refused_with_number_and_value_and_changes_nothing() {
    let mut meter = Meter::new(&Options::default());
    for (line, error) in [
        ("NO:SUCH", "-113,\"Undefined header; NO:SUCH\""),
        ("*XYZ?", "-113,\"Undefined header; *XYZ?\""),
        ("READ:POW", "-113,\"Undefined header; READ:POW\""),
        ("READ:POW? (@3)", "-222,\"Data out of range; channel 3; 1 or 2\""),
        ("READ:POW? (@1,2,1)", "-222,\"Data out of range; (@1,2,1); each channel once\""),
        ("READ:POW? 1", "-104,\"Data type error; '1' is no channel list like (@1,2)\""),
        ("READ:POW? (@1),2", "-108,\"Parameter not allowed; 2\""),
        ("ROUT:CLOS 3,1", "-222,\"Data out of range; channel 3; 1 or 2\""),
        ("ROUT:CLOS 1,9", "-222,\"Data out of range; fibre 9; 1 to 8\""),
        ("ROUT:CLOS 1,1.5", "-222,\"Data out of range; 1.5; whole numbers, fibre 1 to 8\""),
        ("ROUT:CLOS 1,NOWHERE", "-224,\"Illegal parameter value; 'NOWHERE'; fibre 1 to 8, DETector or OPEN\""),
        ("ROUT:CLOS 1", "-109,\"Missing parameter; ROUT:CLOS needs a channel and its light\""),
        ("ROUT:CLOS 1,2,3", "-108,\"Parameter not allowed; 3\""),
        ("ROUT:CLOS?", "-109,\"Missing parameter; ROUT:CLOS? needs a channel\""),
        ("*ESE 256", "-222,\"Data out of range; *ESE 256; 0 to 255\""),
        ("*IDN? 1", "-108,\"Parameter not allowed; 1\""),
    ] {
        assert_eq!(meter.ask(line), "", "{line}");
        assert_eq!(meter.ask("SYST:ERR?"), format!("{error}\n"), "{line}");
        assert_eq!(meter.ask("SYST:ERR:COUN?;:ROUT:CLOS? 1"), "0;1\n", "{line}");
    }
    let long = "X".repeat(600);
    assert_eq!(meter.ask(&long), "");
    assert!(meter.ask("SYST:ERR?").starts_with("-363,"));
}

#[test]
fn after_a_command_error_the_rest_of_a_message_is_dropped_and_after_others_not() {
    let mut meter = Meter::new(&Options::default());
    assert_eq!(meter.ask("*OPC?;NO:SUCH;*OPC?"), "1\n");
    assert_eq!(meter.ask("ROUT:CLOS 7,1;*OPC?"), "1\n");
    assert_eq!(meter.ask("*ESE 48;*ESR?"), "176\n");
    assert_eq!(meter.ask("*STB?;*CLS;*STB?;:SYST:ERR:COUN?"), "4;0;0\n");
}

#[test]
fn a_queue_that_is_full_says_so() {
    let mut meter = Meter::new(&Options::default());
    (0..40).for_each(|_| drop(meter.ask("NO:SUCH")));
    let entries: Vec<String> = (0..16).map(|_| meter.ask("SYST:ERR?")).collect();
    assert!(entries[..15].iter().all(|entry| entry.starts_with("-113")) && entries[15].starts_with("-350"));
    assert!(meter.ask("SYST:ERR?").starts_with("0,"));
}

#[test]
fn a_saturated_channel_is_over_its_range() {
    let mut meter = Meter::new(&Options { laser_dbm: 30.0, ..Options::default() });
    meter.bench.connect(1, crate::bench_twin::Sees::Nothing);
    meter.bench.connect(0, crate::bench_twin::Sees::Detector);
    let answer = meter.ask("READ:POW?");
    assert!(answer.starts_with("9.9E37,-"), "{answer}");
}

#[test]
fn a_collision_is_told_once_on_each_link_and_no_reading_is_a_level_any_more() {
    let mut meter = Meter::new(&Options::default());
    let seat = meter.bench.seat(crate::bench_twin::Side::Output);
    let tick = (meter.segments + 1) * SEGMENT_TICKS;
    meter.segments += 1;
    let inside = std::array::from_fn(|i| if i == 2 { seat[i] + 50_000.0 } else { seat[i] });
    meter.bench.light(tick, [[0.0; 6], inside]);
    for _ in 0..2 {
        let entry = meter.ask("SYST:ERR?");
        assert!(entry.starts_with("201,\"Collision; collision on the output side"), "{entry}");
        assert!(meter.ask("SYST:ERR?").starts_with("0,"));
        // another link
        meter.session = Session::new();
    }
    meter.ask("*CLS");
    assert_eq!(meter.ask("READ:POW?"), "9.91E37,9.91E37\n");
    assert!(meter.ask("SYST:ERR?").starts_with("201,"));
}
