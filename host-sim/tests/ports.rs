//! The controller's thread across the seam to a board: two ports at once, and what goes wrong on them.

use host_sim::board::Queue;
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use stage_controller::hal::{Hal, Port, PortEvent, Signs};
use stage_controller::refill::border::{Action, Order, Report, Sample};
use stage_controller::refill::generator::Generator;
use stage_controller::refill::safety::{Halt, Watch};
use stage_controller::stepgen::segment::Words;
use stage_controller::store::Standstill;
use stage_controller::tasks::Controller;
use stage_controller::units::SEGMENT_TICKS;
use std::collections::VecDeque;

/// A port whose other end is a test.
#[derive(Default)]
struct Wire {
    events: VecDeque<PortEvent>,
    input: Vec<u8>,
    output: Vec<u8>,
    /// Bytes that the PC still takes.
    room: usize,
}

impl Wire {
    fn open() -> Self {
        Wire { events: [PortEvent::Opened].into(), room: 1 << 20, ..Wire::default() }
    }

    fn type_in(&mut self, text: &str) {
        self.input.extend_from_slice(text.as_bytes());
    }

    fn answers(&mut self) -> String {
        String::from_utf8(std::mem::take(&mut self.output)).unwrap()
    }
}

impl Port for Wire {
    fn event(&mut self) -> Option<PortEvent> {
        self.events.pop_front()
    }

    fn received(&mut self) -> &[u8] {
        // as many as a driver holds together
        &self.input[..self.input.len().min(64)]
    }

    fn consume(&mut self, count: usize) {
        self.input.drain(..count);
    }

    fn room(&self) -> usize {
        self.room
    }

    fn send(&mut self, bytes: &[u8]) {
        self.room -= bytes.len();
        self.output.extend_from_slice(bytes);
    }
}

/// A board that plays whatever is made at once.
struct Desk {
    generator: Generator,
    orders: Queue,
    reports: VecDeque<Report>,
    kept: Vec<Standstill>,
    /// Standstills kept when the first order of a motion came.
    kept_before_motion: Option<Standstill>,
    halts: usize,
    watch: Option<Watch>,
    enables: Option<(u8, u8)>,
}

impl Desk {
    fn play(&mut self) {
        let mut words: Words = [0; SEGMENT_TICKS];
        let played = self.generator.next_segment();
        self.reports.push_back(self.generator.refill(&mut self.orders, played, &mut words));
    }
}

impl Hal for Desk {
    fn report(&mut self) -> Option<Report> {
        self.reports.pop_front()
    }

    fn sample(&mut self) -> Option<Sample> {
        None
    }

    fn can_order(&self) -> bool {
        self.orders.0.len() < 4
    }

    fn order(&mut self, order: Order) {
        if matches!(order.action, Action::Run { .. }) && self.kept_before_motion.is_none() {
            self.kept_before_motion = self.kept.last().copied();
        }
        self.orders.0.push_back(order);
    }

    fn halt(&mut self, _halt: Halt) {
        self.halts += 1;
        let next = self.generator.next_segment();
        self.generator.abort(next, 0, &[0; SEGMENT_TICKS]);
        self.reports.clear();
    }

    fn rearm(&mut self) {}

    fn set_watch(&mut self, watch: Watch) {
        self.watch = Some(watch);
    }

    fn set_enables(&mut self, levels: u8, disabled: u8) {
        self.enables = Some((levels, disabled));
    }

    fn keep(&mut self, standstill: Standstill) {
        self.kept.push(standstill);
    }

    fn show(&mut self, _signs: Signs) {}
}

struct Scene<'a> {
    controller: Controller<'a, 2>,
    desk: Desk,
    wires: [Wire; 2],
    now_ms: u64,
}

impl Scene<'_> {
    fn turns(&mut self, count: usize) {
        for _ in 0..count {
            self.desk.play();
            let [first, second] = &mut self.wires;
            self.controller.turn(&mut self.desk, &mut [first, second], self.now_ms);
            self.now_ms += 1;
        }
    }

    fn ask(&mut self, n: usize, text: &str) -> String {
        self.wires[n].type_in(text);
        self.turns(200);
        self.wires[n].answers()
    }
}

fn scene(test: impl FnOnce(Scene<'_>)) {
    let mut front: Front = power_up(&Machine::paper(), false).unwrap();
    let mut links = Links::new();
    let (law, timing) = front.generator_setup();
    let desk = Desk {
        generator: Generator::new(law, timing),
        orders: Queue::default(),
        reports: VecDeque::new(),
        kept: Vec::new(),
        kept_before_motion: None,
        halts: 0,
        watch: None,
        enables: None,
    };
    let controller = Controller::new(&mut front, &mut links);
    let mut scene = Scene { controller, desk, wires: [Wire::open(), Wire::open()], now_ms: 1000 };
    scene.turns(20);
    test(scene);
}

const ERRORS: &str = "SYST:ERR:ALL?\n";
const NONE: &str = "0,\"No error\"\n";

#[test]
fn both_ports_are_answered_at_the_same_time() {
    scene(|mut s| {
        s.wires[0].type_in("AXIS1:MOVE 20;*OPC?\n");
        let other = s.ask(1, "AXIS2:POS?\n");
        assert_eq!(other, "0.000\n");
        s.turns(20_000);
        assert_eq!(s.wires[0].answers(), "1\n");
        assert_eq!(s.ask(1, "AXIS1:POS?\n"), "20.000\n");
    });
}

#[test]
fn what_moves_is_marked_before_its_first_order() {
    scene(|mut s| {
        s.ask(0, "AXIS1:MOVE 20\n");
        assert!(s.desk.kept_before_motion.expect("it was kept before").moving);
        s.turns(20_000);
        let at_rest = s.desk.kept.last().unwrap();
        assert!(!at_rest.moving && at_rest.counts.0[0] != 0);
    });
}

#[test]
fn a_pc_that_reads_nothing_blocks_nobody_else() {
    scene(|mut s| {
        s.wires[0].room = 3;
        s.wires[0].type_in(&"*IDN?\n".repeat(300));
        assert_eq!(s.ask(1, "*IDN?\n").lines().count(), 1);
        s.wires[0].room = 1 << 20;
        s.turns(2_000);
        assert_eq!(s.wires[0].answers().lines().count(), 300, "and nothing is lost when it reads at last");
    });
}

#[test]
fn a_pc_that_goes_away_in_mid_line_leaves_nothing_behind() {
    scene(|mut s| {
        s.wires[1].type_in("AXIS1:MOVE 99");
        s.turns(5);
        s.wires[1].events.push_back(PortEvent::Closed);
        s.wires[1].type_in("9\n");
        s.turns(5);
        s.wires[1].events.push_back(PortEvent::Opened);
        assert_eq!(s.ask(1, ERRORS), NONE);
        assert_eq!(s.ask(1, "AXIS1:POS:COMM?\n"), "0.000\n");
    });
}

#[test]
fn a_break_clears_what_came_and_no_more() {
    scene(|mut s| {
        s.wires[0].type_in("AXIS1:MOVE 99");
        s.turns(5);
        s.wires[0].events.push_back(PortEvent::Break);
        s.turns(1);
        assert_eq!(s.ask(0, "AXIS1:POS:COMM?\n"), "0.000\n");
        assert_eq!(s.ask(0, ERRORS), NONE);
    });
}

#[test]
fn lost_bytes_are_told_and_the_rest_of_their_message_is_dropped() {
    for (event, number) in [(PortEvent::Overrun, "-363,"), (PortEvent::Framing, "-362,")] {
        scene(|mut s| {
            s.wires[0].type_in("AXIS1:MO");
            s.turns(5);
            s.wires[0].events.push_back(event);
            s.wires[0].type_in("VE 99\n");
            assert!(s.ask(0, ERRORS).starts_with(number));
            assert_eq!(s.ask(0, "AXIS1:POS:COMM?\n"), "0.000\n", "nothing moves");
            assert_eq!(s.ask(1, ERRORS), NONE, "it is no matter of the other link");
        });
    }
}

#[test]
fn noise_long_before_a_message_does_not_drop_it() {
    scene(|mut s| {
        s.wires[0].events.push_back(PortEvent::Framing);
        s.turns(30);
        assert_eq!(s.ask(0, "AXIS1:POS?\n"), "0.000\n");
    });
}

#[test]
fn an_exclamation_mark_stops_at_once() {
    scene(|mut s| {
        s.wires[0].type_in("AXIS1:MOVE 1000\n");
        s.turns(300);
        s.wires[1].type_in("!\n");
        s.turns(3);
        assert_eq!(s.desk.halts, 1);
    });
}

#[test]
fn enables_and_watch_follow_the_settings() {
    scene(|mut s| {
        assert_eq!(s.desk.enables, Some((0, 0x3f)), "enabled, active low");
        s.ask(0, "AXIS2:ENAB OFF;:AXIS3:ENAB:POL HIGH;:AXIS4:LIM:HARD:STAT ON\n");
        assert_eq!(s.ask(0, ERRORS), NONE);
        assert_eq!(s.desk.enables, Some((0b000110, 0b111011)));
        assert_eq!(s.desk.watch.map(|watch| (watch.limits, watch.faults)), Some((0b001000, 0b111101)));
    });
}
