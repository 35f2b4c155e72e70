//! Recordings: every record against the words.

mod light;

use host_sim::board::Played;
use host_sim::twin::after_word;
use light::{Bench, DONE_WITH_PEAK, Spot};
use stage_controller::stepgen::pins::{DIR_PINS, STEP_PINS};
use std::collections::HashMap;

/// Counts by edges of the words, at every border.
#[derive(Default)]
struct Decoder {
    lines: u32,
    counts: [i32; 6],
    at: HashMap<u64, [i32; 6]>,
}

impl Decoder {
    fn played(&mut self, played: &Played<'_>) {
        for word in played.words {
            let next = after_word(self.lines, *word);
            for m in 0..6 {
                if next & !self.lines & 1 << STEP_PINS[m] != 0 {
                    self.counts[m] += if next >> DIR_PINS[m] & 1 == 1 { 1 } else { -1 };
                }
            }
            self.lines = next;
        }
        self.at.insert((played.segment + 1) * 256, self.counts);
    }
}

#[test]
fn a_line_of_a_thousand_samples_is_recorded_exactly_and_its_peak_is_right() {
    let (mut squares, mut told, runs) = (0.0, 0.0, 12);
    for seed in 0..runs {
        let mut bench = Bench::new(Spot::new([0.0; 3]), seed);
        let mut decoder = Decoder::default();
        let flank = ["POS", "NEG"][seed as usize % 2];
        bench.spot.at = [bench.between(-4000.0, 4000.0), bench.between(-300.0, 300.0), 0.0];
        bench.good(&format!("SENS:AVER 1;:SCAN:DEF:LINE 0,1,1,20.06,0.02,-60,PEAK,{flank};:TRAC:CONF SCAN;ARM"));
        bench.console.exchange(b"SCAN:STAR 0\n");
        while bench.console.board.front.scan_state().0 != 0 || bench.console.board.front.operation_pending() {
            bench.step(|played| decoder.played(&played));
        }
        let outcome = bench.result(0);
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK);
        let points: usize = bench.good("TRAC:POIN?").parse().unwrap();
        assert!((1000..=1004).contains(&points) && outcome.samples as usize == points, "{points} {outcome:?}");
        let text = bench.good(&format!("TRAC:DATA? 0,{points}"));
        let values: Vec<f64> = text.split(',').map(|x| x.parse().unwrap()).collect();
        let mut last = None;
        for record in values.chunks(9) {
            let counts: Vec<i32> = record[1..7].iter().map(|x| *x as i32).collect();
            assert_eq!(decoder.at[&(record[0] as u64)].to_vec(), counts, "tick {}", record[0]);
            assert!(last.is_none_or(|last| record[0] == last + 256.0), "none is missing");
            last = Some(record[0]);
        }
        assert_eq!(values.len(), 9 * points);
        // the same in blocks
        bench.good("FORM PACK");
        let mut packed = Vec::new();
        let mut answer = bench.console.exchange(b"TRAC:DATA? 100,113\n");
        while answer.len() < 6 + 113 * 36 + 1 {
            answer.extend(bench.step(|_| ()));
        }
        assert_eq!(&answer[..6], b"#44068");
        packed.extend_from_slice(&answer[6..answer.len() - 1]);
        for (n, record) in packed.chunks(36).enumerate() {
            let text = &values[9 * (100 + n)..][..9];
            assert_eq!(u64::from_le_bytes(record[..8].try_into().unwrap()), text[0] as u64);
            for m in 0..6 {
                assert_eq!(i32::from_le_bytes(record[8 + 4 * m..][..4].try_into().unwrap()), text[1 + m] as i32);
            }
            let code = f64::from(u16::from_le_bytes(record[32..34].try_into().unwrap()));
            assert!((10.0 * (code * 3.3 / 32768.0).log10() - text[7]).abs() < 0.001);
        }
        // the truth is the peak along the line, which is the spot's x
        squares += (outcome.axes[0][0] * 1000.0 - bench.spot.at[0]).powi(2);
        told += outcome.axes[0][1] * 1000.0;
    }
    let scatter = (squares / runs as f64).sqrt();
    println!(
        "figure: a line of 1000 samples at 0.003 dB: peak to {scatter:.2} nm (told: {:.2} nm)",
        told / runs as f64
    );
    assert!(scatter < 10.0, "{scatter} nm");
}

#[test]
fn every_nth_sample_is_recorded_until_the_memory_is_full_and_a_trigger_may_begin_it() {
    let mut bench = Bench::new(Spot::new([0.0; 3]), 3);
    bench.good("TRIG:SOUR BUS;:TRAC:CONF SAMP,3;ARM");
    bench.run(100);
    assert_eq!(bench.good("TRAC:POIN?;:STAT:OPER:COND?"), "0;32");
    bench.good("*TRG");
    bench.run(300);
    let points: u32 = bench.good("TRAC:POIN?").parse().unwrap();
    assert!((99..=102).contains(&points), "{points}");
    bench.line("TRAC:ARM");
    assert!(bench.error().starts_with("-213,"));
    bench.run(4000);
    assert_eq!(bench.good("TRAC:POIN?"), "1024");
    let text = bench.good("TRAC:DATA? 1022,2");
    let values: Vec<f64> = text.split(',').map(|x| x.parse().unwrap()).collect();
    assert_eq!(values[9] - values[0], 3.0 * 256.0);
    bench.line("*TRG");
    assert!(bench.error().starts_with("-211,"));
    // a scan waits as well
    bench.good("SENS:AVER 1;:SCAN:DEF:LINE 0,1,1,10,0.1,-60,STAR;:SCAN:STAR 0");
    bench.run(200);
    assert_eq!(bench.good("SCAN:STAT?;:STAT:OPER:COND?"), "TRIG,0;40");
    assert!(bench.truth()[0].abs() < 1.0);
    bench.good("*TRG");
    assert_eq!(bench.line("*OPC?"), "1");
    assert_eq!(bench.result(0).status & !32, DONE_WITH_PEAK);
}

#[test]
fn the_power_is_that_of_where_the_stage_stands() {
    for late in [0, 20] {
        let mut bench = Bench::new(Spot::new([0.0; 3]), 4);
        bench.spot.late = late;
        bench.spot.noise = 0.0;
        bench.good(&format!("SENS:AVER 32;DEL {} US", 256 * late));
        for x in [3.0, -2.0, 0.0, 5.0] {
            let power: f64 = bench.good(&format!("AXIS1:MOVE {x};*WAI;:SENS:POW?")).parse().unwrap();
            assert!((power - bench.level()).abs() < 0.002, "{x}: {power} {}", bench.level());
        }
        bench.good("SENS:SCAL LIN");
        let watts: f64 = bench.good("SENS:POW?").parse().unwrap();
        assert!((10.0 * (watts * 1000.0).log10() - bench.level()).abs() < 0.002);
        // half the voltage on the other input
        let power: f64 = bench.good("SENS2:POW?").parse().unwrap();
        assert!((power - bench.level() + 3.0103).abs() < 0.003);
        // a logarithmic meter: the same voltage means something else
        let volts = 10f64.powf(bench.level() / 10.0);
        let power: f64 = bench.good("SENS2:INP LOG,20,-60;POW?").parse().unwrap();
        assert!((power - (-60.0 + 20.0 * volts / 2.0)).abs() < 0.003, "{power} {volts}");
    }
}
