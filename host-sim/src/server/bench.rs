//! A bench with two boards and its power meter, in one virtual time.

use super::meter::MeterStation;
use super::pace::{Pace, Turn};
use super::{FIRST_ADDRESS, Served, Speed, Station};
use crate::bench_twin::Bench;
use crate::control::Hand;
use crate::gpib::{Bus, Claims, Instrument, Ports};
use crate::rig::Rig;
use std::time::Duration;

/// Place of the meter, behind the boards.
const METER: usize = 2;

/// Two boards, input side first, before one bench, and the meter behind it.
pub struct BenchStation {
    stations: [Station; 2],
    meter: MeterStation,
    rig: Rig,
    pace: Pace,
    /// A collision has been said.
    told: bool,
    /// The links on the bus.
    bus: Option<[usize; 3]>,
    claims: Claims,
}

impl BenchStation {
    /// Puts boards, whose stages are those of the bench, and a meter before it.
    pub fn new(bench: Bench, stations: [Station; 2], meter: MeterStation, speed: Speed) -> Self {
        let (rig, pace) = (Rig::new(bench), Pace::new(speed));
        BenchStation { stations, meter, rig, pace, told: false, bus: None, claims: Claims::default() }
    }

    /// Puts boards and meter on a bus. False when one has no link left.
    pub fn attach(&mut self) -> bool {
        let ports = [0, 1, METER].map(|place| self.open(place, Duration::ZERO));
        self.bus = match ports {
            [Some(input), Some(output), Some(meter)] => Some([input, output, meter]),
            _ => None,
        };
        self.bus.is_some()
    }

    /// One segment of virtual time for all.
    fn step(&mut self, now_ms: u64) {
        self.stations.iter_mut().for_each(|station| station.step(now_ms));
        self.rig.border(self.stations.each_mut().map(Station::board));
        self.meter.see(&mut self.rig);
        if let Some(collision) = self.rig.bench.collision().filter(|_| !self.told) {
            self.told = true;
            eprintln!("\n{collision}");
        }
    }

    /// On either side something moves, or a client waits for a reading.
    fn wants_time(&self) -> bool {
        self.stations.iter().any(Station::wants_time) || self.meter.wants_time()
    }
}

impl Bus for BenchStation {
    fn addresses(&self) -> Vec<u8> {
        (FIRST_ADDRESS..=FIRST_ADDRESS + 2).collect()
    }

    fn instrument(&mut self, address: u8, wall: Duration) -> Option<Box<dyn Instrument + '_>> {
        let place = usize::from(address.checked_sub(FIRST_ADDRESS)?);
        self.port(place, *self.bus?.get(place)?, wall)
    }

    fn release(&mut self, address: u8) {
        let place = address.checked_sub(FIRST_ADDRESS).map_or(METER, usize::from);
        if let (Some(station), Some(links)) = (self.stations.get_mut(place), self.bus) {
            station.release(links[place]);
        }
    }

    fn claims(&mut self) -> &mut Claims {
        &mut self.claims
    }
}

/// The boards, input side first, and the meter behind them.
impl Ports for BenchStation {
    fn places(&self) -> usize {
        METER + 1
    }

    fn open(&mut self, place: usize, wall: Duration) -> Option<usize> {
        match self.stations.get_mut(place) {
            Some(station) => station.attach(wall.as_millis() as u64),
            None if place == METER => self.meter.attach(),
            None => None,
        }
    }

    fn close(&mut self, place: usize, port: usize) {
        match self.stations.get_mut(place) {
            Some(station) => station.detach(port),
            None => self.meter.detach(port),
        }
    }

    fn port(&mut self, place: usize, port: usize, _: Duration) -> Option<Box<dyn Instrument + '_>> {
        match self.stations.get_mut(place) {
            Some(station) => station.instrument(port),
            None => self.meter.instrument(port, &mut self.rig),
        }
    }
}

impl Served for BenchStation {
    fn turn(&mut self, wall: Duration, budget: Duration) -> bool {
        let now_ms = wall.as_millis() as u64;
        let heard = self.stations.each_mut().map(|station| station.hear(now_ms));
        let asked = self.meter.hear(&mut self.rig);
        let mut turn = Turn::new(wall, budget);
        while self.pace.takes(&mut turn, self.wants_time()) {
            self.step(now_ms);
        }
        self.stations.iter_mut().for_each(|station| station.tell(now_ms));
        let waits = self.meter.hear(&mut self.rig);
        heard.contains(&true) || asked || waits || self.stations.iter().any(Station::is_busy)
    }

    fn hand(&mut self, hand: Hand) {
        match hand {
            Hand::Light(light) => light.apply(&mut self.rig.bench),
            Hand::Stage(_) => self.stations.iter_mut().for_each(|station| station.hand(hand)),
        }
    }

    fn is_flat_out(&self) -> bool {
        self.pace.is_flat_out()
    }

    fn status(&self) -> String {
        let [input, output] = self.stations.each_ref().map(Station::line);
        let [one, two] = self.rig.bench.readings();
        format!("{one:7.2} {two:7.2} dBm  in {input}   out {output}")
    }
}
