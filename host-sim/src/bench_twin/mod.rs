//! The digital twin of an alignment bench: two true stages, a splitter chip between them, a power meter, all seeded.
//!
//! [`Bench::machine`] is the true stage of a side: what a [`Board`](crate::board::Board) must turn. Its true poses go
//! into [`Bench::light`] once a segment, and what the boards' converters see comes out of [`Bench::codes`].
//! [`Bench::calibrated`] is what the controller may know of a stage. docs/BENCH.md has sizes and sources.

mod calibrated;
mod collision;
mod optimum;
mod options;
mod port;
mod random;
mod settling;
mod stage;
mod station;

pub use calibrated::MeasuredWith;
pub use collision::Collision;
pub use optimum::{Optimum, STARTS};
pub use options::{Options, Sees, Sheets, Side, Start};
pub use port::Face;
pub use settling::SettlingOptions;
pub use stage::StageErrors;

use crate::identify::{Identification, Refusal};
use crate::machine::Machine;
use crate::model::{Chain, Truth};
use crate::optics::{
    Array, ArraySize, Burst, DARK_DBM, Medium, Meter, Misalignment, Mode, Pair, Splitter, dbm, milliwatts,
};
use nalgebra::Vector3;
use random::Chance;
use station::Station;

/// A bench: two true stages before a chip, the light that goes through, and what the boards see of it.
#[derive(Clone, Debug)]
pub struct Bench {
    seed: u64,
    options: Options,
    stations: [Station; 2],
    splitter: Splitter,
    /// Of all outputs together, a share.
    total: f64,
    dead: Vec<bool>,
    laser_dbm: f64,
    sees: [Sees; 2],
    meters: [Meter; 2],
    /// Time of the last call of `light`.
    tick: Option<u64>,
    collision: Option<Collision>,
}

impl Bench {
    /// A bench drawn by a seed; the same seed and options give the same one.
    ///
    /// Lengths and radii of the options must be positive, and the splitter must have an output.
    ///
    /// # Panics
    /// When the lead of the screw is not positive.
    pub fn seeded(seed: u64, options: &Options) -> Self {
        let mut chance = Chance::new(seed, 0);
        let splitter = Splitter::draw(&options.splitter, || chance.normal());
        let size = ArraySize {
            channels: options.splitter.channels,
            pitch_um: options.splitter.pitch_um,
            core_sigma_um: options.core_sigma_um,
        };
        let arrays = [Array::single(), Array::draw(&size, || chance.normal())];
        let mut arrays = arrays.into_iter();
        let mut chance = Chance::new(seed, 8);
        let sheets = options.sheets;
        let refraction = (options.medium.index - 1.0) * (1.0 + sheets.refraction * chance.normal());
        let medium = Medium { index: 1.0 + refraction, ..options.medium };
        let mut mode = |mode: Mode| {
            let times = 1.0 + sheets.radius * chance.normal();
            Mode { radius_um: mode.radius_um.map(|radius| radius * times) }
        };
        let guide = mode(options.guide);
        let pairs = Side::BOTH.map(|_| Pair::new(guide, mode(options.fibre), medium));
        let stations = Side::BOTH.map(|side| {
            let array = arrays.next().expect("two sides");
            Station::draw(side, (array, pairs[side.index()]), options, &mut Chance::new(seed, 1 + side as u64))
        });
        let mut chance = Chance::new(seed, 3);
        Bench {
            seed,
            stations,
            total: splitter.total(),
            dead: vec![false; splitter.loss_db.len()],
            splitter,
            laser_dbm: options.laser_dbm,
            sees: options.sees,
            meters: [0; 2].map(|_| Meter::new(options.meter, chance.bits())),
            tick: None,
            collision: None,
            options: options.clone(),
        }
    }

    /// The true stage of a side.
    pub fn machine(&self, side: Side) -> &Machine {
        &self.stations[side.index()].machine
    }

    /// The options that it was drawn of.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The stage of a side as its controller may know it: from noisy measurements, never from the truth.
    ///
    /// # Errors
    /// When the measurements contradict each other or do not tell all constants.
    pub fn calibrated(&self, side: Side) -> Result<Identification, Refusal> {
        let seed = Chance::new(self.seed, 4 + side as u64).bits();
        calibrated::calibrated(self.machine(side), &self.options.drawing, &self.options.measured, seed)
    }

    /// The light at a tick (us; never before that of the last call), when the stages stand at true poses (nm and nrad
    /// from home, as [`Mechanics::true_pose`](crate::twin::Mechanics::true_pose) gives them): what falls into the two
    /// channels of the meter, dBm, at least [`DARK_DBM`].
    ///
    /// The stages rest before the first call. Between two calls they move evenly.
    pub fn light(&mut self, tick: u64, poses: [[f64; 6]; 2]) -> [f64; 2] {
        for (station, pose) in self.stations.iter_mut().zip(&poses) {
            let pose = match self.tick {
                Some(before) => station.settling.follow(&self.options.settling, tick.saturating_sub(before), pose),
                None => {
                    station.settling.rest(*pose);
                    *pose
                }
            };
            station.place = station.place(tick, &pose);
            station.clearance_um = station.port.clearance(&station.place);
        }
        if self.collision.is_none() {
            let touching = |side: &Side| self.stations[side.index()].clearance_um <= 0.0;
            self.collision = Side::BOTH.into_iter().find(touching).map(|side| {
                let clearance_um = self.stations[side.index()].clearance_um;
                Collision { side, tick, pose: poses[side.index()], clearance_um }
            });
        }
        let coupled = self.laser_dbm - self.stations[0].port.loss_db(&self.stations[0].place, 0);
        let light = self.sees.map(|sees| self.seen(sees, coupled));
        for (meter, mw) in self.meters.iter_mut().zip(light) {
            match self.tick {
                Some(_) => meter.see(tick, mw),
                None => meter.rest(tick, mw),
            }
        }
        self.tick = Some(tick);
        light.map(dbm)
    }

    /// Power in mW that a channel sees when so much (dBm) is in the input guide.
    fn seen(&self, sees: Sees, coupled_dbm: f64) -> f64 {
        match sees {
            Sees::Fibre(channel) if channel < self.dead.len() && !self.dead[channel] => {
                let output = &self.stations[1];
                let loss = self.splitter.loss_db[channel] + output.port.loss_db(&output.place, channel);
                milliwatts((coupled_dbm - loss).max(DARK_DBM))
            }
            Sees::Detector => self.total * milliwatts(coupled_dbm.max(DARK_DBM)),
            _ => 0.0,
        }
    }

    /// Samples of the two converter inputs of a side's board at the tick of the last call of [`Bench::light`]: the two
    /// channels of the meter.
    pub fn codes(&self, side: Side) -> [u16; 2] {
        let tick = self.tick.unwrap_or(0);
        std::array::from_fn(|i| {
            let volts = self.options.front_end.volts(self.meters[i].milliwatts());
            self.stations[side.index()].adc[i].sample(volts, tick)
        })
    }

    /// What the meter shows at the tick of the last call of [`Bench::light`], dBm.
    pub fn readings(&self) -> [f64; 2] {
        self.meters.each_ref().map(Meter::dbm)
    }

    /// Puts a channel of the meter (0, 1) before another light, from the next call of [`Bench::light`] on.
    pub fn connect(&mut self, channel: usize, sees: Sees) {
        self.sees[channel] = sees;
    }

    /// What the channels of the meter look at.
    pub fn sees(&self) -> [Sees; 2] {
        self.sees
    }

    /// Power in the input fibre from now on, dBm; `None` is off.
    pub fn laser(&mut self, dbm: Option<f64>) {
        self.laser_dbm = dbm.unwrap_or(DARK_DBM);
    }

    /// Breaks a fibre of the array, or mends it.
    pub fn break_fibre(&mut self, channel: usize, broken: bool) {
        self.dead[channel] = broken;
    }

    /// A channel of the meter (0, 1) is noisier for some time, or no longer.
    pub fn disturb(&mut self, channel: usize, burst: Option<Burst>) {
        self.meters[channel].burst = burst;
    }

    /// A channel of the meter is at the end of its range.
    pub fn is_saturated(&self, channel: usize) -> bool {
        self.meters[channel].is_saturated()
    }

    /// Insertion loss of every channel at a tick and true poses (nm, nrad), settled, dB: splitter, input and output.
    pub fn losses(&self, tick: u64, poses: &[[f64; 6]; 2]) -> Vec<f64> {
        let [input, output] = [0, 1].map(|i| self.stations[i].place(tick, &poses[i]));
        let coupled = self.stations[0].port.loss_db(&input, 0);
        let port = &self.stations[1].port;
        let each = self.splitter.loss_db.iter().enumerate();
        each.map(|(i, loss)| coupled + loss + port.loss_db(&output, i)).collect()
    }

    /// How a fibre of a side stands before its guide at a tick and a true pose (nm, nrad). The input side has only
    /// fibre 0.
    pub fn misalignment(&self, side: Side, channel: usize, tick: u64, pose: &[f64; 6]) -> Misalignment {
        let station = &self.stations[side.index()];
        station.port.misalignment(&station.place(tick, pose), channel)
    }

    /// Least distance of the corners of a side's array from the chip at a tick and a true pose (nm, nrad), um.
    pub fn clearance_um(&self, side: Side, tick: u64, pose: &[f64; 6]) -> f64 {
        let station = &self.stations[side.index()];
        station.port.clearance(&station.place(tick, pose))
    }

    /// The true pose of a side (nm, nrad) in which the array stands straight before the guides at tick 0, the fibre
    /// point on guide 0 and no gap between them: where the chip truly is. Core errors do not count here.
    pub fn seat(&self, side: Side) -> [f64; 6] {
        let port = &self.stations[side.index()].port;
        port.pose(Vector3::zeros(), port.straight())
    }

    /// Actuators (nm, nrad, as if the motors had no steps) that bring the true stage of a side to a pose (nm, nrad).
    /// None when the iteration does not converge: angles far beyond any travel.
    pub fn actuators(&self, side: Side, pose: &[f64; 6]) -> Option<[f64; 6]> {
        let machine = self.machine(side);
        let (chain, truth) = (Chain::new(machine), Truth::new(machine));
        let (mut wanted, mut actuators) = (*pose, chain.exact_inverse(*pose)?);
        // the chain has all but the kinematic errors, which hardly change over their own size
        for _ in 0..20 {
            let reached = truth.pose(actuators);
            let off: [f64; 6] = std::array::from_fn(|i| pose[i] - reached[i]);
            if off.iter().all(|off| off.abs() < 1e-3) {
                return Some(actuators);
            }
            wanted = std::array::from_fn(|i| wanted[i] + off[i]);
            actuators = chain.exact_inverse(wanted)?;
        }
        None
    }

    /// Least distance of the corners of both arrays from the chip as seen by the last call of [`Bench::light`], um.
    pub fn clearances_um(&self) -> [f64; 2] {
        self.stations.each_ref().map(|station| station.clearance_um)
    }

    /// By how much the chip has drifted against a stage since tick 0, um.
    pub fn drift_um(&self, side: Side, tick: u64) -> [f64; 3] {
        (self.stations[side.index()].drift * tick as f64).into()
    }

    /// The first contact of the faces.
    pub fn collision(&self) -> Option<Collision> {
        self.collision
    }

    /// Nothing has touched so far.
    ///
    /// # Errors
    /// The first contact.
    pub fn check(&self) -> Result<(), Collision> {
        self.collision.map_or(Ok(()), Err)
    }

    /// The best alignment that this bench allows at tick 0, with motors that go anywhere.
    pub fn optimum(&self) -> Optimum {
        optimum::optimum(self)
    }
}
