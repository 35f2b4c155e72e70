//! The controller's thread across the seam to a board: two ports and a bus at once, and what goes wrong on them.

#[path = "../../src/usb488/tests/host/mod.rs"]
mod host;

use host::{Bench, Usb};
use host_sim::board::Queue;
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use stage_controller::hal::{BusPort, Hal, Port, PortEvent, Signs};
use stage_controller::refill::border::{Action, Order, Report, Sample};
use stage_controller::refill::generator::Generator;
use stage_controller::refill::safety::{Halt, Watch};
use stage_controller::scpi::exchange::Attached;
use stage_controller::scpi::session::Session;
use stage_controller::stepgen::segment::Words;
use stage_controller::store::Standstill;
use stage_controller::tasks::Controller;
use stage_controller::units::SEGMENT_TICKS;
use stage_usb488::Interface;
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
    controller: Controller<'a, 3>,
    desk: Desk,
    wires: [Wire; 2],
    /// What has happened to the instrument on USB.
    cable: VecDeque<PortEvent>,
    /// So often nothing has moved when time was to pass.
    resting: usize,
    now_ms: u64,
}

impl Scene<'_> {
    fn turns(&mut self, count: usize) {
        for _ in 0..count {
            self.desk.play();
            let [first, second] = &mut self.wires;
            self.controller.turn(&mut self.desk, &mut [first, second, &mut Wire::default()], self.now_ms);
            self.now_ms += 1;
        }
    }

    fn ask(&mut self, n: usize, text: &str) -> String {
        self.wires[n].type_in(text);
        self.turns(200);
        self.wires[n].answers()
    }
}

/// The instrument on USB, for one turn.
struct Cable<'a> {
    interface: &'a mut Interface,
    events: &'a mut VecDeque<PortEvent>,
    changed: bool,
}

impl Port for Cable<'_> {
    fn event(&mut self) -> Option<PortEvent> {
        self.events.pop_front()
    }

    fn received(&mut self) -> &[u8] {
        &[]
    }

    fn consume(&mut self, _: usize) {}

    fn room(&self) -> usize {
        0
    }

    fn send(&mut self, bytes: &[u8]) {
        assert!(bytes.is_empty(), "a bus sends nothing that was not asked for");
    }

    fn bus(&mut self) -> Option<&mut dyn BusPort> {
        Some(self)
    }
}

impl BusPort for Cable<'_> {
    fn turn(&mut self, link: &mut Attached<'_, Session>) -> bool {
        let changed = self.interface.turn(link);
        self.changed |= changed;
        changed
    }
}

impl Bench for Scene<'_> {
    fn turn(&mut self, interface: &mut Interface) -> bool {
        self.desk.play();
        let [first, second] = &mut self.wires;
        let mut cable = Cable { interface, events: &mut self.cable, changed: false };
        self.controller.turn(&mut self.desk, &mut [first, second, &mut cable], self.now_ms);
        self.now_ms += 1;
        cable.changed
    }

    fn pass(&mut self) -> bool {
        let moves = self.controller.front.operation_pending();
        // what the end of motion brings comes a few turns later
        self.resting = if moves { 0 } else { self.resting + 1 };
        !self.resting.is_multiple_of(8) || moves
    }
}

/// With the instrument on USB configured by its host.
fn usb_scene(test: impl FnOnce(Usb<Scene<'_>>)) {
    scene(|mut scene| {
        scene.cable.push_back(PortEvent::Opened);
        test(Usb::new(scene));
    });
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
    let mut scene = Scene {
        controller,
        desk,
        wires: [Wire::open(), Wire::open()],
        cable: VecDeque::new(),
        resting: 0,
        now_ms: 1000,
    };
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
fn an_instrument_on_usb_keeps_the_rules_of_a_bus_beside_two_ports_that_are_streams() {
    usb_scene(|mut usb| {
        usb.write(b"AXIS1:MOVE 20;*OPC?").unwrap();
        let [serial, _] = &mut usb.bench.wires;
        serial.type_in("*ESE 1;*ESE?\n*ESE?\n");
        usb.settle();
        assert_eq!(usb.bench.wires[0].answers(), "1\n1\n");
        assert_eq!(usb.read().unwrap(), b"1\n");
        assert_eq!(usb.query("AXIS1:POS?;*ESE?").unwrap(), "20.000;0\n");
        usb.write(b"*IDN?").unwrap();
        assert_eq!(usb.query("*ESE?").unwrap(), "0\n");
        assert!(usb.query("SYST:ERR?").unwrap().starts_with("-410,"));
        assert_eq!(usb.bench.ask(0, ERRORS), NONE);
        assert_eq!(usb.bench.ask(1, ERRORS), NONE);
    });
}

#[test]
fn the_instrument_on_usb_asks_for_service_at_the_end_of_motion() {
    usb_scene(|mut usb| {
        usb.write(b"*ESE 1;*SRE 32;AXIS1:MOVE 20;*OPC").unwrap();
        assert_eq!(usb.notice(), None);
        while usb.bench.pass() {
            usb.settle();
        }
        usb.settle();
        assert_eq!(usb.notice(), Some([0x81, 0x60]));
    });
}

#[test]
fn another_configuration_of_usb_drops_what_was_on_its_way_at_every_packet() {
    usb_scene(|mut usb| {
        for fetched in 0..6 {
            for half in [&b"*ESE 7"[..], b"COMP:DATA?"] {
                usb.put(&host::message_out(1, half, half.ends_with(b"?"))).unwrap();
                usb.ask_for(10_000, None).unwrap();
                (0..fetched).for_each(|_| drop(usb.peek()));
                usb.reset();
                usb.bench.cable.extend([PortEvent::Closed, PortEvent::Opened]);
                assert_eq!(usb.query("*ESE?;:SYST:ERR:COUN?").unwrap(), "0;0\n", "behind {fetched} packets");
            }
        }
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
fn a_pc_that_falls_asleep_jogs_no_more_and_wakes_up_to_what_it_had() {
    scene(|mut s| {
        s.wires[1].type_in("*ESE 7;:SYST:JOG:TIM 60\nAXIS1:MOVE:JOG 1\nAXIS2:MOVE 3\n");
        s.turns(200);
        let here = s.ask(0, "AXIS1:POS?\n");
        s.turns(2_000);
        assert_ne!(s.ask(0, "AXIS1:POS?\n"), here, "it jogs");
        s.wires[1].events.push_back(PortEvent::Asleep);
        s.turns(20_000);
        let there = s.ask(0, "AXIS1:POS?\n");
        s.turns(5_000);
        assert_eq!(s.ask(0, "AXIS1:POS?\n"), there);
        assert_eq!(s.ask(1, "*ESE?;:AXIS2:POS?\n"), "7;3.000\n");
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
