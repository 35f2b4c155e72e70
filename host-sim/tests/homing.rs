//! Homing on limit switches that bounce, from anywhere, interrupted anywhere.

use host_sim::board::{Board, Interleaving, Seeded};
use host_sim::console::Console;
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::compensation::backlash::Flank;
use stage_controller::units::{AXES, Axis, MotorSteps, Pose};

const NO_ERROR: &str = "0,\"No error\"";

/// The paper's stage with a short travel and stiffer stages, so that a test homes it often.
fn short(part: f64) -> Machine {
    let mut machine = Machine::paper();
    for drive in &mut machine.drives {
        drive.travel = drive.travel.map(|end| (end * part).round());
        let [lower, upper] = drive.travel;
        let beyond = if drive.step > 1000.0 { 3_490_659.0 } else { 200_000.0 };
        drive.switches = [lower - beyond, upper + beyond];
        drive.acceleration *= 10.0;
        drive.jerk *= 50.0;
    }
    machine
}

/// One that is so fast that several steps go by between the contact and the stop.
fn fast() -> Machine {
    let mut machine = short(0.1);
    for drive in &mut machine.drives {
        drive.velocity *= 8.0;
        drive.acceleration *= 2.0;
        drive.jerk *= 4.0;
    }
    machine
}

fn console(machine: &Machine, seed: u64) -> Console {
    let interleaving = if seed.is_multiple_of(3) { Interleaving::Prompt } else { Interleaving::Jittered(seed % 7) };
    let mut board = Board::new(machine, power_up(machine, false).unwrap(), interleaving, seed);
    assert!(board.settle());
    let mut c = Console::new(board);
    for n in 1..=AXES {
        say(&mut c, &format!("AXIS{n}:LIM:HARD:STAT ON"));
    }
    c
}

fn say(c: &mut Console, line: &str) -> String {
    c.line(line, |_| ())
}

fn errors(c: &mut Console) -> String {
    say(c, "SYST:ERR:ALL?")
}

fn steps(c: &mut Console, segments: u64) {
    (0..segments).for_each(|_| drop(c.step(|_| ())));
}

/// What the law makes of some poses: the same numbers, the same law.
fn law_of(c: &Console) -> [MotorSteps; 3] {
    let law = c.board.front.law();
    [[1, 2, 3, 4, 5, 6], [700_000, -300_000, 100_000, 9_000_000, -8_000_000, 7_000_000], [0; AXES]]
        .map(|u| law.steps(Pose(u)))
}

fn others(motors: MotorSteps, own: usize) -> MotorSteps {
    MotorSteps(std::array::from_fn(|i| if i == own { 0 } else { motors.0[i] }))
}

#[test]
fn two_hundred_homings_end_at_the_same_step_and_turn_one_motor_only() {
    let mut worst = [0; AXES];
    for seed in 0..200 {
        let machine = fast();
        let mut random = Seeded::new(seed);
        random.next_u64();
        let mut c = console(&machine, seed);
        let law = law_of(&c);
        let axis = Axis::ALL[random.below(6) as usize];
        let (i, n) = (axis.index(), axis.index() + 1);
        let upper = random.below(2) == 1;
        let velocity = ["DEF", "MAX"][random.below(2) as usize];
        say(&mut c, &format!("AXIS{n}:HOME:TYPE {};VEL {velocity}", if upper { "UPP" } else { "LOW" }));
        let start: [i64; AXES] = std::array::from_fn(|m| {
            let travel = (machine.drives[m].travel[1] * 0.9) as i64;
            random.below(2 * travel as u64) as i64 - travel
        });
        c.board.front.pose_absolute(start).unwrap();
        assert!(c.settle(|_| ()));
        let before = c.board.twin().motors();
        let front_before = c.board.front.motor_counts();
        // an axis that was never homed, or one whose count is off
        c.board.front.set_position(axis, random.below(2_000_000) as i64 - 1_000_000).unwrap();
        assert_eq!(say(&mut c, &format!("AXIS{n}:HOME;*OPC?;:AXIS{n}:HOME:STAT?")), "1;1");
        assert_eq!(errors(&mut c), NO_ERROR, "seed {seed} {axis:?}");
        let after = c.board.twin().motors();
        let reference = (machine.drives[i].travel[usize::from(upper)] / machine.drives[i].step).round() as i32;
        let off = after.0[i] - reference;
        worst[i] = worst[i].max(off.abs());
        assert!(off.abs() <= 1, "seed {seed} {axis:?} upper {upper}: {} instead of {reference}", after.0[i]);
        assert_eq!(others(after, i), others(before, i), "seed {seed}: another motor turned");
        let front = &c.board.front;
        assert_eq!(others(front.motor_counts(), i), others(front_before, i));
        assert_eq!(front.motor_counts().0[i], reference, "it stands where HOME:OFFSet says");
        assert_eq!(law_of(&c), law, "seed {seed}: the law has come back");
        assert_eq!((front.flank(axis), front.overlay_steps(axis)), (Some(Flank::Positive), 0));
        assert_eq!(front.axis_condition(axis) & (1 << 10), 0, "not uncertain");
        // and the next move is exact, play and all
        c.board.front.pose_absolute(start).unwrap();
        assert!(c.settle(|_| ()));
        let front = &c.board.front;
        assert_eq!(front.law().steps(front.commanded()), front.report().steps);
        let apart = c.board.twin().motors().0[i] - front.motor_counts().0[i];
        assert_eq!(apart, off);
    }
    println!("figure: homing: farthest from the reference {worst:?} steps in 200 homings");
}

#[test]
fn a_homing_that_is_interrupted_anywhere_brings_the_law_back_and_homes_nothing() {
    let mut interrupted = 0;
    for seed in 0..220 {
        let machine = short(0.1);
        let mut random = Seeded::new(seed + 1000);
        random.next_u64();
        let mut c = console(&machine, seed);
        let law = law_of(&c);
        let axis = Axis::ALL[random.below(6) as usize];
        let (i, n) = (axis.index(), axis.index() + 1);
        let start: [i64; AXES] = std::array::from_fn(|m| (machine.drives[m].travel[1] * 0.5) as i64 - 70 * m as i64);
        c.board.front.pose_absolute(start).unwrap();
        assert!(c.settle(|_| ()));
        say(&mut c, &format!("AXIS{n}:HOME:TYPE {}", ["LOW", "UPP"][random.below(2) as usize]));
        let before = c.board.twin().motors();
        say(&mut c, &format!("AXIS{n}:HOME"));
        steps(&mut c, random.below(6_000));
        if c.board.front.homing_axis().is_none() {
            continue;
        }
        interrupted += 1;
        let how = ["STOP", "ABOR", "!", "*RST", "STOP:IMM"][random.below(5) as usize];
        let line = if how == "STOP:IMM" { format!("AXIS{n}:{how}") } else { how.to_owned() };
        say(&mut c, &format!("{line}\n*OPC?"));
        assert!(c.settle(|_| ()));
        let front = &c.board.front;
        let what = format!("seed {seed} {axis:?} {how}");
        assert_eq!(front.homing_axis(), None, "{what}");
        assert_eq!(law_of(&c), law, "{what}: law");
        assert_eq!(say(&mut c, &format!("AXIS{n}:HOME:STAT?")), "0", "{what}");
        assert_eq!(errors(&mut c), NO_ERROR, "{what}");
        let (twin, front) = (c.board.twin().motors(), &c.board.front);
        assert_eq!(front.motor_counts(), twin, "{what}: counts");
        assert_eq!(others(twin, i), others(before, i), "{what}: another motor turned");
        // a move from here is one of the law, and exact
        let standing = front.report().steps;
        assert_eq!(front.law().steps(front.commanded()), standing, "{what}: where it stands");
        c.board.front.move_relative(axis, if twin.0[i] > 0 { -30_000 } else { 30_000 }).unwrap();
        assert!(c.settle(|_| ()));
        let front = &c.board.front;
        assert_eq!(front.law().steps(front.commanded()), front.report().steps, "{what}: next move");
        assert_eq!(errors(&mut c), NO_ERROR, "{what}: next move");
    }
    assert!(interrupted >= 200, "only {interrupted} were still homing");
}

#[test]
fn interruptions_come_in_every_part_of_a_homing() {
    // what the test above relies on: 6 000 segments are about as long as a homing
    let mut c = console(&short(0.1), 1);
    let start = c.board.now();
    say(&mut c, "AXIS1:HOME;*OPC?");
    let took = c.board.now() - start;
    println!("figure: homing of a 1 mm travel: {took} segments");
    assert!((3_000..15_000).contains(&took), "{took}");
}

#[test]
fn a_cold_board_is_homed_axis_by_axis_and_knows_its_true_pose() {
    let machine = short(0.1);
    let mut board = Board::new(&machine, power_up(&machine, true).unwrap(), Interleaving::Jittered(3), 11);
    board.settle();
    let mut c = Console::new(board);
    for n in 1..=AXES {
        assert_eq!(say(&mut c, &format!("AXIS{n}:ENAB ON;LIM:HARD:STAT ON;:AXIS{n}:HOME;*OPC?")), "1");
        assert_eq!(errors(&mut c), NO_ERROR);
    }
    assert_eq!(say(&mut c, "STAT:QUES:INST:COND?"), "0");
    let (twin, front) = (c.board.twin().motors(), c.board.front.motor_counts());
    for i in 0..AXES {
        assert!((twin.0[i] - front.0[i]).abs() <= 1, "{twin:?} {front:?}");
    }
    // a travel's corner is no pose to start from for all axes at once: one after the other
    for n in 1..=AXES {
        say(&mut c, &format!("AXIS{n}:MOVE 0;*OPC?"));
    }
    assert_eq!(errors(&mut c), NO_ERROR);
    let truth = c.board.twin().true_pose();
    for (i, u) in truth.iter().enumerate() {
        let step = machine.drives[i].step;
        assert!(u.abs() <= 3.0 * step + 200.0, "{truth:?}");
    }
}

#[test]
fn a_homing_that_begins_on_the_switch_backs_off_first() {
    for (side, velocity) in [("LOW", -1.0), ("UPP", 1.0)] {
        let machine = short(0.1);
        let mut board = Board::new(&machine, power_up(&machine, true).unwrap(), Interleaving::Jittered(2), 4);
        board.settle();
        let mut c = Console::new(board);
        say(&mut c, &format!("AXIS3:ENAB ON;LIM:HARD:STAT ON;:AXIS3:HOME:TYPE {side}"));
        say(&mut c, &format!("AXIS3:MOVE:JOG {velocity} MM/S"));
        assert!(c.settle(|_| ()));
        assert!(errors(&mut c).starts_with("102,"));
        steps(&mut c, 40);
        assert_eq!(say(&mut c, "AXIS3:HOME;*OPC?;:AXIS3:HOME:STAT?"), "1;1");
        assert_eq!(errors(&mut c), NO_ERROR);
        let (twin, front) = (c.board.twin().motors().0[2], c.board.front.motor_counts().0[2]);
        assert!((twin - front).abs() <= 1, "{side}: {twin} {front}");
    }
}

#[test]
fn what_cannot_be_homed_is_refused_and_moves_nothing() {
    let mut c = console(&Machine::paper(), 1);
    let refused = |c: &mut Console, line: &str, error: &str| {
        let before = c.board.twin().motors();
        say(c, line);
        let said = errors(c);
        assert!(said.starts_with(error), "{line}: {said}");
        assert_eq!(c.board.front.homing_axis(), None);
        assert_eq!(say(c, "AXIS2:HOME:STAT?"), "1", "still homed");
        steps(c, 20);
        assert_eq!(c.board.twin().motors(), before);
    };
    say(&mut c, "AXIS2:LIM:HARD:STAT OFF");
    refused(&mut c, "AXIS2:HOME", "-221,\"Settings conflict;AXIS2 limit switches not watched; set LIM:HARD:STAT ON\"");
    say(&mut c, "AXIS2:LIM:HARD:STAT ON;:AXIS2:ENAB OFF");
    refused(&mut c, "AXIS2:HOME", "108,\"Axis disabled;AXIS2\"");
    say(&mut c, "AXIS2:ENAB ON;:AXIS1:MOVE 100");
    steps(&mut c, 20);
    say(&mut c, "AXIS2:HOME");
    assert!(errors(&mut c).starts_with("104,"));
    assert_eq!(say(&mut c, "*OPC?;:AXIS2:HOME:STAT?"), "1;1");
}

#[test]
fn while_an_axis_is_homed_others_wait_and_positions_stay_sensible() {
    let mut c = console(&short(0.1), 5);
    assert_eq!(say(&mut c, "POSE 100,-50,80,0.1,0.1,0.2;*OPC?"), "1");
    let pose = |c: &mut Console| -> Vec<f64> { say(c, "POSE?").split(',').map(|x| x.parse().unwrap()).collect() };
    let start = pose(&mut c);
    say(&mut c, "AXIS5:HOME");
    steps(&mut c, 40);
    assert_eq!(say(&mut c, "AXIS5:HOME:STAT?;:STAT:OPER:COND?").split(';').next(), Some("0"));
    for line in ["AXIS5:HOME", "AXIS1:HOME", "AXIS1:MOVE 1", "AXIS1:MOVE:JOG 1", "POSE:REL 1,1,1,0,0,0"] {
        say(&mut c, line);
        assert_eq!(errors(&mut c), "-213,\"Init ignored;AXIS5 homing\"", "{line}");
    }
    assert!(say(&mut c, "POSE:CHEC? 0,0,0,0,0,0").starts_with("-213,"));
    for line in ["AXIS1:POS:SET 0", "COMP:COUP:STAT OFF", "PIV:SEL 0", "AXIS1:ENAB OFF", "AXIS5:LIM:HARD:STAT OFF"] {
        say(&mut c, line);
        assert!(errors(&mut c).starts_with("104,"), "{line}");
    }
    let mut last = start[4];
    let mut seen = 0;
    while c.board.front.homing_axis().is_some() {
        let operation: u16 = say(&mut c, "STAT:OPER:COND?").parse().unwrap();
        assert_eq!(operation & 1, 1);
        let at = pose(&mut c);
        // half a degree a second; linear axes hold the fibre point by the law, whose motors stand: it moves a little
        assert!((at[4] - last).abs() < 0.01, "{at:?} after {last}");
        last = at[4];
        seen += 1;
        steps(&mut c, 60);
        if c.board.front.homing_axis().is_none() {
            break;
        }
    }
    assert!(seen > 20, "{seen}");
    assert_eq!(say(&mut c, "*OPC?;:AXIS5:HOME:STAT?"), "1;1");
    assert_eq!(say(&mut c, "STAT:OPER:COND?").parse::<u16>().unwrap() & 1, 0);
    assert_eq!(errors(&mut c), NO_ERROR);
}

#[test]
fn a_switch_that_is_not_there_ends_the_homing_with_what_was_looked_for() {
    let mut machine = short(0.1);
    machine.drives[0].switches[0] = -50e6;
    let mut c = console(&machine, 2);
    let law = law_of(&c);
    say(&mut c, "AXIS1:HOME;*OPC?");
    assert_eq!(
        errors(&mut c),
        "101,\"Axis not homed;AXIS1 lower limit switch not found within the travel and a tenth\""
    );
    assert_eq!((say(&mut c, "AXIS1:HOME:STAT?").as_str(), law_of(&c)), ("0", law));
    // 1 mm of travel, a tenth, and two reference distances
    assert_eq!(c.board.twin().motors().0[0], -(20_000 + 2_000 + 8_000));
    assert_eq!(c.board.front.motor_counts(), c.board.twin().motors());
}

#[test]
fn a_switch_that_never_opens_ends_the_homing_with_a_hint() {
    let mut machine = short(0.1);
    machine.drives[0].switches = [10e6, 20e6];
    let mut c = console(&machine, 1);
    steps(&mut c, 40);
    say(&mut c, "AXIS1:HOME;*OPC?");
    assert_eq!(errors(&mut c), "102,\"Limit switch active;AXIS1 limit switch does not open; see LIM:HARD:POL\"");
    assert_eq!(say(&mut c, "AXIS1:HOME:STAT?"), "0");
}

#[test]
fn switches_of_the_wrong_polarity_are_found_out_before_anything_moves() {
    let mut board = Board::new(&short(0.1), power_up(&short(0.1), false).unwrap(), Interleaving::Prompt, 1);
    board.rewire(0b1, 0);
    board.settle();
    let mut c = Console::new(board);
    say(&mut c, "AXIS1:LIM:HARD:STAT ON;:AXIS1:HOME;*OPC?");
    assert_eq!(errors(&mut c), "102,\"Limit switch active;AXIS1 both limit switches; see LIM:HARD:POL\"");
    assert_eq!((say(&mut c, "AXIS1:HOME:STAT?").as_str(), c.board.twin().motors()), ("1", MotorSteps::default()));
}

#[test]
fn a_stop_from_outside_ends_a_homing_and_the_next_one_succeeds() {
    for seed in 0..10 {
        let mut c = console(&short(0.1), seed);
        let law = law_of(&c);
        say(&mut c, "AXIS2:HOME");
        steps(&mut c, 100 + 450 * seed);
        let error = if seed % 2 == 0 {
            c.board.press_stop(true);
            "103,"
        } else {
            c.board.set_fault(4, true);
            "112,"
        };
        assert!(c.settle(|_| ()));
        assert!(errors(&mut c).starts_with(error));
        assert_eq!((law_of(&c), say(&mut c, "AXIS2:HOME:STAT?").as_str()), (law, "0"));
        assert_eq!(c.board.front.motor_counts(), c.board.twin().motors());
        c.board.press_stop(false);
        c.board.set_fault(4, false);
        steps(&mut c, 20);
        say(&mut c, "SYST:EST:CLE;:AXIS5:ENAB ON");
        assert_eq!(say(&mut c, "AXIS2:HOME;*OPC?;:AXIS2:HOME:STAT?"), "1;1", "seed {seed}");
        assert_eq!(errors(&mut c), NO_ERROR);
    }
}

#[test]
fn the_offset_names_where_the_axis_stands_once_homed() {
    let mut c = console(&short(0.1), 8);
    assert_eq!(say(&mut c, "AXIS1:HOME:OFFS?;TYPE UPP;OFFS?"), "-500.000;500.000");
    assert_eq!(say(&mut c, "AXIS1:HOME:OFFS 123.45;*WAI;:AXIS1:HOME;*OPC?;:AXIS1:POS:MOT?"), "1;2469");
    say(&mut c, "COMP:STAT OFF");
    let at: f64 = say(&mut c, "AXIS1:POS?").parse().unwrap();
    assert!((at - 123.45).abs() < 0.026, "{at}");
    assert_eq!(say(&mut c, "AXIS1:HOME:OFFS DEF;OFFS?;TYPE LOW;OFFS?"), "500.000;-500.000");
}
