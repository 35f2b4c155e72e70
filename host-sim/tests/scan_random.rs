//! Thousands of random lines about scans: none wedges the controller, and the next scan is right.

mod light;

use host_sim::board::Seeded;
use light::{Bench, DONE_WITH_PEAK, Spot};

const LINES: [&str; 34] = [
    "SCAN:DEF:LINE 0,1,1,6,0.05,-60,PEAK",
    "SCAN:DEF:LINE 0,2,2,4,0.1,-60,FIRS,NEG",
    "SCAN:DEF:LINE 1,1,5,0.02,0.0005,-60,STAY",
    "SCAN:DEF:RAST 1,1,1,2,4,4,0.1,1",
    "SCAN:DEF:SPIR 2,1,1,2,6,0.2,2,-3,FIRS",
    "SCAN:DEF:HILL 3,1,(@1,2),8,1,0.2,2",
    "SCAN:DEF:PAR 4,1,3,8,5,-60,STAR",
    "SCAN:DEF:LINE 5,1,3,20000,5",
    "SCAN:STAR 0",
    "SCAN:STAR 1",
    "SCAN:STAR 2",
    "SCAN:STAR 3",
    "SCAN:STAR 4",
    "SCAN:STAR 5",
    "SCAN:STOP",
    "SCAN:CONT",
    "SCAN:STAT?",
    "SCAN:RES? 0",
    "SCAN:RES? 2;:SCAN:DEF:HILL? 3",
    "TRIG:SOUR BUS",
    "TRIG:SOUR IMM",
    "*TRG",
    "TRAC:CONF SCAN,2;ARM",
    "TRAC:DATA? 0,20",
    "SENS:AVER 1;POW?",
    "SENS:AVER 8;DEL 3 MS",
    "STOP",
    "ABOR",
    "!",
    "AXIS1:MOVE:REL 1",
    "POSE:REL 0.5,-0.5,0.5,0,0,0",
    "COMP:BACK:STAT OFF;STAT ON",
    "VEL 40;:SCAN:STOP;CONT",
    "*RST",
];

#[test]
fn no_string_of_commands_wedges_a_scan() {
    let rounds = if cfg!(debug_assertions) { 60 } else { 300 };
    let mut commands = 0;
    for seed in 0..rounds {
        let mut bench = Bench::new(Spot::new([300.0, -200.0, 0.0]), seed);
        let mut dice = Seeded::new(seed ^ 0xabcd);
        for _ in 0..4 {
            let _ = dice.next_u64();
        }
        bench.console.exchange(format!("SENS:AVER 2\n{}\n", LINES[..5].join("\n")).as_bytes());
        for _ in 0..40 {
            let line = LINES[dice.below(LINES.len() as u64) as usize];
            bench.console.exchange(format!("{line}\n").as_bytes());
            commands += 1;
            bench.run(dice.below(2) * dice.below(400));
        }
        // whatever it was: an abort ends it
        bench.console.exchange(b"!\n");
        bench.run(50);
        bench.console.exchange(b"*RST\n");
        bench.run(50);
        bench.line("*CLS;*OPC?");
        assert_eq!(bench.line("SCAN:STAT?"), "IDLE,0", "{seed}");
        assert_eq!(bench.console.board.twin().motors(), bench.console.board.front.motor_counts(), "{seed}");
        let here = bench.truth();
        bench.spot.at = [here[0] + 800.0, here[1], here[2]];
        bench.spot.late = 0;
        bench.run(10);
        bench.line("SENS:DEL 0;AVER 2;*CLS");
        bench.good("SCAN:DEF:LINE 0,1,1,8,0.1,-60,PEAK");
        let outcome = bench.scan(0);
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK, "{seed}: {outcome:?}");
        assert!((bench.truth()[0] - bench.spot.at[0]).abs() < 60.0, "{seed}");
    }
    assert!(commands >= 2000);
}
