//! What a scan says of itself at any time, and what may change while it runs, waits, or is stopped.

mod light;

use host_sim::board::{Board, Interleaving};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use light::{Bench, DONE_WITH_PEAK, Spot};
use stage_controller::controller::links::Links;

const LINE: &str = "SENS:AVER 1;:SCAN:DEF:LINE 0,1,1,20,0.05,-40,PEAK";
const RUNNING: u16 = 512;
const STOPPED: u16 = 128;

fn bench(seed: u64) -> Bench {
    let mut bench = Bench::new(Spot::new([2000.0, 0.0, 0.0]), seed);
    bench.good(LINE);
    bench
}

/// Status word and whether a peak is told.
fn told(bench: &mut Bench) -> (u16, bool) {
    let result = bench.result(0);
    let unknown = result.axes.iter().all(|axis| axis[0] > 9e37) && result.level > 9e37;
    assert!(unknown || result.axes.iter().all(|axis| axis[0].abs() < 1e3) && result.level < 10.0, "{result:?}");
    (result.status, !unknown)
}

/// Runs until light was seen.
fn until_light(bench: &mut Bench) {
    for _ in 0..10_000 {
        bench.run(10);
        if bench.result(0).status & 4 != 0 {
            return;
        }
    }
    panic!("no light");
}

#[test]
fn no_peak_is_told_before_it_is_found() {
    for (end, status) in [("ABOR", STOPPED), ("SCAN:STOP;*WAI", STOPPED), ("SYST:ERR?", RUNNING)] {
        let mut bench = bench(1);
        bench.good("SCAN:STAR 0");
        until_light(&mut bench);
        bench.line(end);
        bench.run(300);
        let (word, peak) = told(&mut bench);
        assert_eq!((word & (STOPPED | RUNNING), peak), (status, false), "{end}");
    }
    let mut bench = bench(1);
    let outcome = bench.scan(0);
    assert_eq!(outcome.status & !32, DONE_WITH_PEAK);
    assert!((outcome.axes[0][0] - 2.0).abs() < 0.02, "{outcome:?}");
}

#[test]
fn settings_by_which_the_route_was_checked_stay_while_it_runs_or_waits() {
    let settings = [
        "AXIS1:BACK:MARG 20000",
        "AXIS1:ACC MIN",
        "AXIS1:JERK MIN",
        "AXIS1:VEL 1",
        "AXIS1:LIM:SOFT:UPP 2",
        "AXIS2:BACK:DEAD 1",
    ];
    let mut undisturbed = 0.0;
    for (trigger, settings) in [("IMM", &[][..]), ("IMM", &settings), ("BUS", &settings)] {
        let mut bench = bench(2);
        bench.good(&format!("TRIG:SOUR {trigger}"));
        bench.good("SCAN:STAR 0");
        bench.run(100);
        for setting in settings {
            bench.line(setting);
            assert_eq!(bench.error(), "-213,\"Init ignored;scan running\"", "{trigger} {setting}");
        }
        if trigger == "BUS" {
            bench.good("*TRG");
        }
        let mut farthest = 0.0_f64;
        while bench.result(0).status & RUNNING != 0 {
            bench.run(50);
            farthest = farthest.max((bench.truth()[0] / 1000.0).abs());
        }
        if settings.is_empty() {
            undisturbed = farthest;
        }
        assert!((farthest - undisturbed).abs() < 0.1, "{farthest} um, else {undisturbed} um");
        assert_eq!(bench.result(0).status & !32, DONE_WITH_PEAK);
        for setting in settings {
            bench.good(setting);
        }
    }
}

#[test]
fn a_way_that_no_longer_fits_its_limits_is_not_gone() {
    let mut bench = bench(3);
    // with a late meter the way beyond a line is longer the faster it goes
    bench.good("SENS:DEL 0.1;:VEL 1;:AXIS1:LIM:SOFT:UPP 175;LOW -175");
    bench.good("SCAN:DEF:RAST 0,1,1,2,20,4,0.5,1,-40");
    bench.good("SCAN:STAR 0");
    bench.run(3000);
    bench.good("VEL 100");
    let mut farthest = 0.0_f64;
    for _ in 0..200_000 {
        bench.run(10);
        farthest = farthest.max((bench.truth()[0] / 1000.0).abs());
        if !bench.console.board.front.is_scanning() {
            break;
        }
    }
    assert!(farthest < 175.5, "{farthest} um");
    assert!(bench.error().starts_with("-222,\"Data out of range;"), "the limit is told");
    let (word, peak) = told(&mut bench);
    assert_eq!((word & (256 | RUNNING), peak), (256, false));
}

#[test]
fn a_refused_start_leaves_a_stopped_scan_and_an_accepted_one_ends_it() {
    let mut bench = bench(4);
    bench.good("SCAN:DEF:LINE 1,1,1,100000,0.5;:SCAN:DEF:PAR 2,1,1,4,5,-60");
    assert_eq!(bench.scan(0).status & !32, DONE_WITH_PEAK);
    bench.good("AXIS1:MOVE 0;*OPC?");
    bench.good("SCAN:STAR 0");
    until_light(&mut bench);
    bench.good("SCAN:STOP;*OPC?");
    assert_eq!(bench.line("SCAN:STAT?"), "STOP,0");
    bench.line("SCAN:STAR 1");
    assert!(bench.error().starts_with("-222"), "out of the travel");
    assert_eq!(bench.line("SCAN:STAT?"), "STOP,0");
    let stopped = bench.result(0);
    bench.good("SCAN:CONT;*OPC?");
    let outcome = bench.result(0);
    assert_eq!(outcome.status & !32, DONE_WITH_PEAK);
    assert!((outcome.axes[0][0] - 2.0).abs() < 0.02 && stopped.samples > 0, "{outcome:?}");
    // and now one that begins
    bench.good("AXIS1:MOVE 0;*OPC?");
    bench.good("SCAN:STAR 0");
    until_light(&mut bench);
    bench.good("SCAN:STOP;*OPC?");
    bench.line("SCAN:STAR 2;*OPC?");
    let (word, peak) = told(&mut bench);
    assert_eq!(
        (word & (1 | STOPPED | RUNNING), peak),
        (STOPPED, false),
        "of the one that was stopped, not of an older run"
    );
    while !bench.error().starts_with("0,") {}
    bench.line("SCAN:CONT");
    assert!(bench.error().starts_with("-221"));
}

#[test]
fn a_stopped_scan_does_not_go_on_with_another_input() {
    let mut bench = bench(5);
    bench.good("SCAN:STAR 0");
    bench.run(500);
    bench.good("SCAN:STOP;*OPC?");
    bench.good("SENS:INP LIN,0.002");
    bench.line("SCAN:CONT");
    assert_eq!(bench.error(), "-221,\"Settings conflict;no stopped scan\"");
}

#[test]
fn only_its_own_axes_stop_a_scan() {
    let mut bench = bench(6);
    for other in ["AXIS3:MOVE:JOG 0", "AXIS5:STOP"] {
        bench.good("AXIS1:MOVE 0;*OPC?");
        bench.good("SCAN:STAR 0");
        bench.run(300);
        bench.good(other);
        bench.run(50);
        assert!(bench.console.board.front.is_scanning(), "{other}");
        assert_eq!(bench.line("*OPC?"), "1");
        assert_eq!(bench.result(0).status & !32, DONE_WITH_PEAK);
    }
    bench.good("SCAN:STAR 0");
    bench.run(300);
    bench.good("AXIS1:STOP;*OPC?");
    assert_eq!(bench.line("SCAN:STAT?"), "STOP,0");
}

#[test]
fn an_axis_that_ends_in_one_direction_is_scanned_in_that_one() {
    let mut bench = bench(7);
    for (mode, good, bad) in [("UNIP", "POS", "NEG"), ("UNIN", "NEG", "POS")] {
        bench.good(&format!("AXIS1:MOVE 0;*OPC?;:AXIS1:BACK:MODE {mode}"));
        bench.good(&format!("SCAN:DEF:LINE 0,1,1,20,0.05,-40,PEAK,{bad}"));
        bench.line("SCAN:STAR 0");
        assert_eq!(bench.error(), "-221,\"Settings conflict;the first axis' BACK:MODE ends on the other flank\"");
        assert_eq!(bench.line("AXIS1:POS?"), "0.000");
        bench.good(&format!("SCAN:DEF:LINE 0,1,1,20,0.05,-40,PEAK,{good}"));
        let outcome = bench.scan(0);
        assert_eq!(outcome.status & !32, DONE_WITH_PEAK);
        assert!((outcome.axes[0][0] - 2.0).abs() < 0.02, "{mode}: {outcome:?}");
        assert_eq!(bench.line("AXIS1:BACK:STAT?")[..3], *good, "{mode}");
        // the coordinate means the same from where it is left
        bench.good(&format!("AXIS1:MOVE 0;*OPC?;:AXIS1:MOVE {:.3};*OPC?", outcome.axes[0][0]));
        assert!((bench.truth()[0] - 2000.0).abs() < 30.0, "{mode}: {:?}", bench.truth());
    }
}

#[test]
fn what_was_seen_before_an_emergency_stop_is_not_told_as_the_light_of_now() {
    let mut bench = bench(8);
    let level: f64 = bench.line("SENS:POW?").parse().unwrap();
    assert!((level - bench.level()).abs() < 0.1);
    bench.console.board.press_stop(true);
    bench.run(200);
    bench.spot.top = -20.0;
    assert_eq!(bench.line("SENS:POW?"), "9.91E37");
    bench.console.board.press_stop(false);
    bench.run(5);
    bench.line("SYST:EST:CLE");
    bench.run(50);
    let level: f64 = bench.line("SENS:POW?").parse().unwrap();
    assert!((level - bench.level()).abs() < 0.1, "{level} {}", bench.level());
}

#[test]
fn an_answer_ends_in_the_format_in_which_it_began() {
    let machine = Machine::paper();
    let mut board = Board::new(&machine, power_up(&machine, false).unwrap(), Interleaving::Prompt, 1);
    assert!(board.settle());
    let mut links: Links<2> = Links::new();
    let (asks, disturbs) = (links.open(0).unwrap(), links.open(0).unwrap());
    links.receive(asks, b"TRAC:CONF SAMP;ARM\n", 0);
    for _ in 0..600 {
        links.poll(&mut board.front, 0);
        board.step(|_| ());
    }
    for (format, other) in [("ASC", "PACK"), ("PACK", "ASC")] {
        links.receive(asks, format!("FORM {format}\n").as_bytes(), 0);
        links.poll(&mut board.front, 0);
        let (mut whole, mut answer) = (Vec::new(), [0; 100]);
        for disturbed in [false, true] {
            links.receive(asks, b"TRAC:DATA? 0,100\n", 0);
            let mut got = Vec::new();
            for n in 0..2000 {
                links.poll(&mut board.front, 0);
                let length = links.transmit(asks, &mut answer);
                got.extend_from_slice(&answer[..length]);
                if disturbed && n == 3 {
                    assert!(
                        !got.is_empty() && got.len() < whole.len() / 2,
                        "{format}: {} of {}",
                        got.len(),
                        whole.len()
                    );
                    links.receive(disturbs, format!("FORM {other}\n").as_bytes(), 0);
                }
            }
            if disturbed {
                assert!(got == whole, "{format}: the answer changed");
                assert_eq!(board.front.format() as usize, usize::from(other == "PACK"));
            }
            whole = got;
        }
        assert!(whole.len() > 3000, "{format}: {}", whole.len());
    }
}
