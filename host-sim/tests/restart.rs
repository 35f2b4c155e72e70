//! What the controller knows after a restart: settings by *SAV, *RCL and SYST:PARK, positions by its copies.

mod saving;

use host_sim::board::{Board, Interleaving, Seeded};
use host_sim::console::Console;
use host_sim::flash::{Fault, Flash, at_once};
use host_sim::machine::Machine;
use host_sim::session::{power_up, power_up_from};
use saving::{board_with, buffer, errors, kept_settings, lines, volume};
use stage_controller::controller::front::{Front, Start, axis_condition};
use stage_controller::controller::links::Links;
use stage_controller::store::standstill::{Copies, Keeper, STANDSTILL_BYTES};
use stage_controller::store::{Standstill, service};
use stage_controller::units::{AXES, Axis};

fn homed() -> Console {
    Console::new(board_with(power_up(&Machine::paper(), false).unwrap()))
}

/// The same flash after the power was off.
fn restarted(console: &mut Console) -> Console {
    let mut store = std::mem::take(console.board.store.flash()).store();
    let front = power_up_from(&mut store, &Machine::paper(), true).unwrap();
    let mut board = board_with(front);
    board.store = store;
    Console::new(board)
}

#[test]
fn recall_puts_back_what_was_saved_and_moves_nothing() {
    let mut c = homed();
    c.line("PIV:DEF 3,0,0,4 MM;SEL 3;:AXIS1:VEL 700;BACK:DIST 3;:AXIS4:LIM:SOFT:UPP 1;:SYST:JOG:TIM 2 S", |_| ());
    c.line("*SAV", |_| ());
    let saved = lines(&mut c, &kept_settings());
    c.line("PIV:DEF 3,1,0,4 MM;SEL 0;:AXIS1:VEL DEF;BACK:DIST 0;:AXIS4:LIM:SOFT:UPP 2;:SYST:JOG:TIM DEF", |_| ());
    c.line("COMP:COUP:STAT OFF;:VEL 40;:AXIS5:STEP:INV ON;TIM 2 US,2 US,5 US,5 US", |_| ());
    c.line("POSE 100,-50,20,0.1,0,-0.2;*OPC?", |_| ());
    let (counts, position) = (c.board.front.motor_counts(), c.board.front.position());
    let mut edges = 0;
    c.line("*RCL", |played| edges += played.words.iter().filter(|word| **word & 0xffff != 0).count());
    assert_eq!(errors(&mut c), Vec::<i32>::new());
    assert_eq!(lines(&mut c, &kept_settings()), saved);
    assert_eq!(c.line("PIV?", |_| ()), "3,0.000,0.000,4000.000");
    assert_eq!((c.board.front.motor_counts(), edges), (counts, 0), "no motor has moved");
    assert_ne!(c.board.front.position(), position, "another law, another logical position");
    assert_eq!(c.board.front.law().steps(c.board.front.position()), c.board.front.report().steps);
    // and the next move starts from there
    c.line("POSE 0,0,0,0,0,0;*OPC?", |_| ());
    assert_eq!(c.board.front.position().0, [0; AXES]);
}

#[test]
fn what_follows_waits_for_the_end_on_every_link() {
    let mut board = board_with(power_up(&Machine::paper(), false).unwrap());
    let mut links: Links<2> = Links::new();
    let (a, b) = (links.open(0).unwrap(), links.open(0).unwrap());
    let ask = |links: &mut Links<2>, board: &mut Board, link: usize, bytes: &[u8]| {
        links.receive(link, bytes, 0);
        links.poll(&mut board.front, 0);
        let mut answer = [0; 256];
        let length = links.transmit(link, &mut answer);
        String::from_utf8_lossy(&answer[..length]).into_owned()
    };
    assert_eq!(ask(&mut links, &mut board, a, b"*SAV;:SYST:ERR:COUN?;*OPC?\n"), "", "saving");
    assert_eq!(ask(&mut links, &mut board, b, b"AXIS2:VEL?\n"), "2000.000\n", "a question needs no flash");
    assert_eq!(ask(&mut links, &mut board, b, b"*ESR?;*OPC\n"), "128\n");
    assert_eq!(ask(&mut links, &mut board, b, b"*ESR?\n"), "0\n", "*OPC waits for the save of the other link");
    assert_eq!(ask(&mut links, &mut board, b, b"AXIS2:VEL 500;VEL?\n"), "", "a command waits");
    assert_eq!(ask(&mut links, &mut board, a, b"!"), "", "nothing to abort");
    for _ in 0..20 {
        board.step(|_| ());
    }
    assert_eq!(ask(&mut links, &mut board, a, b""), "0;1\n");
    assert_eq!(ask(&mut links, &mut board, b, b"*ESR?\n"), "500.000\n1\n");
    // one that is cleared while it saves does not take the end of that for the end of the next one
    board.store.flash().set_fault(Fault::Writes);
    assert_eq!(ask(&mut links, &mut board, a, b"*SAV\n"), "");
    links.clear(a);
    for _ in 0..20 {
        board.step(|_| ());
    }
    board.store.flash().set_fault(Fault::None);
    assert_eq!(ask(&mut links, &mut board, a, b"*SAV;:SYST:ERR:COUN?\n"), "");
    board.step(|_| ());
    assert_eq!(ask(&mut links, &mut board, a, b""), "0\n");
}

#[test]
fn saving_wants_standstill_and_a_place_that_exists() {
    let mut c = homed();
    c.line("*SAV 0", |_| ());
    c.line("*RCL 0", |_| ());
    assert_eq!(errors(&mut c), Vec::<i32>::new());
    let before = c.board.store.flash().bytes().to_vec();
    for command in ["*SAV", "*RCL", "SYST:PARK"] {
        c.exchange(format!("AXIS1:MOVE 3000\n{command}\n").as_bytes());
        for _ in 0..100 {
            c.step(|_| ());
        }
        assert_eq!(c.line("AXIS1:STOP;*OPC?", |_| ()), "1");
        assert_eq!(errors(&mut c), [104], "{command}");
        c.line("AXIS1:MOVE 0;*OPC?", |_| ());
    }
    for (line, error) in [("*SAV 1", -222), ("*RCL 7", -222), ("*SAV 0,0", -108), ("*RCL X", -104), ("*SAV?", -113)] {
        c.line(line, |_| ());
        assert_eq!(errors(&mut c), [error], "{line}");
    }
    assert_eq!(c.board.store.flash().bytes(), before, "nothing was written");
}

#[test]
fn recall_with_nothing_saved_says_so_and_changes_nothing() {
    let mut c = homed();
    c.line("AXIS1:VEL 700;*RCL", |_| ());
    assert_eq!(errors(&mut c), [-221]);
    assert_eq!(c.line("AXIS1:VEL?", |_| ()), "700.000");
}

#[test]
fn parking_keeps_where_the_motors_stand_and_leaves_the_saved_settings() {
    let mut c = homed();
    c.line("AXIS1:VEL 700;*SAV", |_| ());
    c.line("AXIS1:VEL 800;:POSE 100,-50,20,0.1,0,-0.2;*OPC?;:AXIS2:MOVE 10;*OPC?;:SYST:PARK", |_| ());
    assert_eq!(errors(&mut c), Vec::<i32>::new());
    let (counts, position) = (c.board.front.motor_counts(), c.board.front.position());
    let flanks = Axis::ALL.map(|axis| (c.board.front.flank(axis), c.board.front.overlay_steps(axis)));
    assert!(flanks.iter().any(|(_, overlay)| *overlay != 0), "{flanks:?}");
    let mut c = restarted(&mut c);
    assert_eq!(c.line("AXIS1:VEL?", |_| ()), "700.000");
    assert_eq!((c.board.front.motor_counts(), c.board.front.position()), (counts, position));
    assert_eq!(Axis::ALL.map(|axis| (c.board.front.flank(axis), c.board.front.overlay_steps(axis))), flanks);
    c.line("AXIS1:ENAB ON;MOVE 10", |_| ());
    assert_eq!(errors(&mut c), [101], "after a power cut nothing is homed");
}

#[test]
fn lost_settings_are_told_once_to_every_link_until_they_are_saved_anew() {
    let mut store = Flash::holding((0..=255).cycle().take(2 * 16 * 1024).collect()).store();
    let front = power_up_from(&mut store, &Machine::paper(), false).unwrap();
    let mut board = board_with(front);
    board.store = store;
    let mut links: Links<2> = Links::new();
    let mut ask = |board: &mut Board, bytes: &[u8], open: usize| {
        while links.open(0).is_some_and(|n| n + 1 < open) {}
        links.receive(open - 1, bytes, 0);
        let mut answer = Vec::new();
        for _ in 0..20 {
            links.poll(&mut board.front, 0);
            let mut part = [0; 256];
            let length = links.transmit(open - 1, &mut part);
            answer.extend_from_slice(&part[..length]);
            board.step(|_| ());
        }
        String::from_utf8_lossy(&answer).into_owned()
    };
    for link in [1, 2] {
        assert!(ask(&mut board, b"SYST:ERR?\n", link).starts_with("106,\"Settings lost, defaults in use;"), "{link}");
        assert_eq!(ask(&mut board, b"SYST:ERR?;:STAT:QUES:COND?\n", link), "0,\"No error\";256\n");
    }
    assert_eq!(ask(&mut board, b"*SAV;:SYST:ERR?;:STAT:QUES:COND?\n", 1), "0,\"No error\";0\n");
    let mut c = restarted(&mut Console::new(board));
    assert_eq!(errors(&mut c), Vec::<i32>::new());
}

#[test]
fn the_speed_of_the_serial_port_is_a_setting_that_reset_leaves() {
    let mut c = homed();
    assert_eq!(c.line("SYST:COMM:SER:BAUD?;BAUD? MIN;BAUD? MAX;BAUD? DEF", |_| ()), "115200;9600;1000000;115200");
    c.line("SYST:COMM:SER:BAUD 1000000;*RST", |_| ());
    assert_eq!(c.board.front.baud(), 1_000_000);
    c.line("SYST:COMM:SER:BAUD 1000001;:SYST:COMM:SER:BAUD 9599", |_| ());
    assert_eq!(errors(&mut c), [-222, -222]);
    c.line("*SAV", |_| ());
    assert_eq!(restarted(&mut c).board.front.baud(), 1_000_000);
}

/// A board with the memory that outlives a reset.
struct Kept {
    board: Board,
    keeper: Keeper,
    copies: Copies,
    writes: u64,
}

impl Kept {
    fn new(front: Front) -> Self {
        let board = Board::new(&Machine::paper(), front, Interleaving::Jittered(3), 9);
        let mut kept = Kept { board, keeper: Keeper::default(), copies: [[0; STANDSTILL_BYTES]; 2], writes: 0 };
        kept.settle();
        kept
    }

    /// Before the orders go to the generator, as on a board.
    fn keep(&mut self) {
        self.board.front.plan();
        if let Some((which, bytes)) = self.keeper.update(self.board.front.standstill_record()) {
            self.copies[which] = bytes;
            self.writes += 1;
        }
    }

    fn step(&mut self) {
        self.keep();
        self.board.step(|_| ());
    }

    fn settle(&mut self) {
        for _ in 0..10_000_000 {
            self.step();
            if !self.board.front.operation_pending() {
                // the report that it stands has come: the copy follows
                return self.keep();
            }
        }
        panic!("hangs");
    }

    /// What a reset makes of it: the settings are those of *SAV.
    fn reset(&self, cause: Start) -> Kept {
        let mut store = Flash::blank().store();
        at_once(store.save(&self.board.front.record(), &Standstill::default(), &mut buffer())).unwrap();
        let mut front = Front::new();
        let found = at_once(service::start(&mut store, &mut front, &mut buffer()));
        let (_, kept) = Keeper::recover(&self.copies);
        service::stand(&mut front, cause, kept, found);
        Kept::new(front)
    }

    fn state(&self) -> impl PartialEq + std::fmt::Debug + use<> {
        let front = &self.board.front;
        let conditions = Axis::ALL.map(|axis| front.axis_condition(axis) & !axis_condition::ENABLED);
        let overlays = Axis::ALL.map(|axis| (front.flank(axis), front.overlay_steps(axis)));
        // what is commanded is then where it stands: less than half a step from what was asked for
        (front.motor_counts(), front.report().steps, front.position(), conditions, overlays)
    }
}

fn random_pose(dice: &mut Seeded) -> [i64; AXES] {
    std::array::from_fn(|i| {
        dice.below(if i < 3 { 400_000 } else { 4_000_000 }) as i64 - if i < 3 { 200_000 } else { 2_000_000 }
    })
}

#[test]
fn after_a_reset_at_standstill_everything_is_as_before_and_goes_on_the_same_way() {
    let mut dice = Seeded::new(3);
    for n in 0..volume(60) {
        let mut kept = Kept::new(power_up(&Machine::paper(), false).unwrap());
        for _ in 0..1 + dice.below(3) {
            kept.board.front.pose_absolute(random_pose(&mut dice)).unwrap();
            if dice.below(3) == 0 {
                (0..dice.below(1000)).for_each(|_| kept.step());
                kept.board.front.stop_all();
            }
            kept.settle();
        }
        assert!(kept.writes >= 3, "{}", kept.writes);
        let mut again = kept.reset(Start::Reset);
        assert_eq!(again.state(), kept.state(), "{n}");
        assert_eq!(again.board.front.standstill_record(), kept.board.front.standstill_record());
        Axis::ALL.iter().for_each(|axis| again.board.front.set_enabled(*axis, true).unwrap());
        for _ in 0..3 {
            let pose = random_pose(&mut dice);
            for board in [&mut kept, &mut again] {
                board.board.front.pose_absolute(pose).unwrap();
                board.settle();
            }
            assert_eq!(again.state(), kept.state(), "{n}: the next moves");
        }
    }
}

#[test]
fn after_a_reset_in_motion_every_position_is_uncertain_until_it_is_named() {
    let mut dice = Seeded::new(4);
    for _ in 0..volume(60) {
        let mut kept = Kept::new(power_up(&Machine::paper(), false).unwrap());
        kept.board.front.pose_absolute(random_pose(&mut dice)).unwrap();
        // from before the first order has left
        kept.keep();
        let segments = dice.below(3) * dice.below(200);
        (0..segments).for_each(|_| kept.step());
        assert!(kept.board.front.is_moving());
        let again = kept.reset(Start::Reset);
        let mut c = Console::new(again.board);
        for axis in 1..=AXES {
            let condition: u16 = c.line(&format!("STAT:AXIS{axis}?"), |_| ()).parse().unwrap();
            use axis_condition::*;
            assert_eq!(condition & (HOMED | UNCERTAIN | FLANK_KNOWN), UNCERTAIN, "after {segments} segments");
        }
        c.line("AXIS1:ENAB ON;MOVE 10", |_| ());
        assert_eq!(errors(&mut c), [109]);
        (2..=AXES).for_each(|axis| drop(c.line(&format!("AXIS{axis}:ENAB ON"), |_| ())));
        c.line("AXIS1:POS:SET 0;:AXIS1:MOVE 10;*OPC?", |_| ());
        assert_eq!(errors(&mut c), Vec::<i32>::new());
        let x: f64 = c.line("AXIS1:POS?", |_| ()).parse().unwrap();
        assert!((x - 10.0).abs() < 0.05, "{x}");
    }
}

#[test]
fn after_an_abort_and_a_reset_the_counts_are_exact_and_what_was_uncertain_still_is() {
    let mut kept = Kept::new(power_up(&Machine::paper(), false).unwrap());
    let mut settings = *kept.board.front.settings();
    settings.axes[0].start_velocity = 1000;
    kept.board.front.set_axes(&settings).unwrap();
    kept.settle();
    kept.board.front.move_absolute(Axis::X, 3_000_000).unwrap();
    (0..2000).for_each(|_| kept.step());
    kept.board.front.abort();
    kept.settle();
    assert!(kept.board.front.axis_condition(Axis::X) & axis_condition::UNCERTAIN != 0);
    let again = kept.reset(Start::Reset);
    assert_eq!(again.state(), kept.state());
    assert_eq!(again.board.front.report().counts, kept.board.front.report().counts);
}

#[test]
fn after_a_power_cut_the_copies_give_counts_and_flanks_and_nothing_is_homed() {
    let mut kept = Kept::new(power_up(&Machine::paper(), false).unwrap());
    kept.board.front.pose_absolute([100_000, -50_000, 20_000, 1_000_000, 0, -2_000_000]).unwrap();
    kept.settle();
    let again = kept.reset(Start::PowerOn);
    let (before, now) = (kept.board.front.standstill_record(), again.board.front.standstill_record());
    assert_eq!(now, Standstill { homed: 0, ..before });
    assert_eq!(before.homed, 0b111111);
}
