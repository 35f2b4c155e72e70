//! Limit switches on the stages: where they trip, how their contacts bounce.
//!
//! # Design
//! A switch sits on the driven side of the play. It trips at its position, a fraction of a step earlier or later each
//! time, and opens again a hysteresis farther back. Around every change its contact bounces for up to
//! [`BOUNCE_TICKS`], beginning with the new state. All of it is seeded. Far from every switch nothing has to be looked
//! at: [`Switches::is_far`] is what keeps the twin fast.

use crate::board::Seeded;
use crate::machine::Machine;
use stage_controller::units::AXES;

/// Longest time that a contact bounces, ticks of 1 us.
pub const BOUNCE_TICKS: u64 = 2_000;
/// How far before or behind its position a switch trips, steps.
const SCATTER: f64 = 0.5;
/// Way back until it opens again, nm or nrad: a snap-action switch.
const HYSTERESIS: [f64; 2] = [50e3, 0.872_665e6];
/// Steps around a switch in which it is looked at in every tick: more than a segment can make.
const NEAR: f64 = 256.0;
/// One tick in so many turns a bouncing contact over.
const BOUNCE_TURNS: u64 = 40;

/// One switch.
#[derive(Clone, Copy, Debug)]
struct Contact {
    /// Where it trips, steps on the driven side, signed so that it trips upwards.
    at: f64,
    hysteresis: f64,
    /// This time.
    scatter: f64,
    pressed: bool,
    bounces_until: u64,
    /// What the line says.
    tripped: bool,
}

impl Contact {
    fn look(&mut self, position: f64, tick: u64, random: &mut Seeded) {
        let trips = self.at + self.scatter;
        let pressed = if self.pressed { position > trips - self.hysteresis } else { position >= trips };
        if pressed != self.pressed {
            self.pressed = pressed;
            self.tripped = pressed;
            self.bounces_until = tick + random.below(BOUNCE_TICKS);
            if !pressed {
                self.scatter = SCATTER * (random.below(2001) as f64 / 1000.0 - 1.0);
            }
        } else if tick >= self.bounces_until {
            self.tripped = self.pressed;
        } else if random.below(BOUNCE_TURNS) == 0 {
            self.tripped = !self.tripped;
        }
    }
}

/// All limit switches of a stage.
#[derive(Clone, Debug)]
pub struct Switches {
    /// Lower and upper one of each motor.
    contacts: [[Contact; 2]; AXES],
    /// Motor counts between which the switches of a motor are far away and open.
    far: [[i32; 2]; AXES],
    /// One is tripped.
    tripped: bool,
    /// All contacts rest from this tick on.
    rest_from: u64,
    random: Seeded,
}

impl Switches {
    /// The switches of a machine; `seed` of their scatter and bounces.
    pub fn new(machine: &Machine, seed: u64) -> Self {
        let mut far = [[0; 2]; AXES];
        let contacts = std::array::from_fn(|i| {
            let drive = &machine.drives[i];
            let hysteresis = HYSTERESIS[usize::from(i >= 3)] / drive.step;
            let [lower, upper] = drive.switches.map(|at| at / drive.step);
            let margin = NEAR + hysteresis + drive.backlash / drive.step;
            far[i] = [(lower + margin).ceil() as i32, (upper - margin).floor() as i32];
            [-lower, upper].map(|at| Contact {
                at,
                hysteresis,
                scatter: 0.0,
                pressed: false,
                bounces_until: 0,
                tripped: false,
            })
        });
        Switches { contacts, far, tripped: false, rest_from: 0, random: Seeded::new(seed) }
    }

    /// No switch can change in the next segment, none is tripped and none bounces.
    pub fn is_far(&self, motors: &[i32; AXES], tick: u64) -> bool {
        let far = |(motor, [lower, upper]): (&i32, &[i32; 2])| (lower..upper).contains(&motor);
        !self.tripped && self.rest_from <= tick && motors.iter().zip(&self.far).all(far)
    }

    /// Looks at all switches after a word. `driven`: positions of the driven sides in steps.
    pub fn look(&mut self, driven: &[f64; AXES], tick: u64) {
        let Switches { contacts, random, .. } = self;
        for ([lower, upper], position) in contacts.iter_mut().zip(driven) {
            lower.look(-position, tick, random);
            upper.look(*position, tick, random);
        }
        self.tripped = contacts.iter().flatten().any(|c| c.tripped);
        self.rest_from = contacts.iter().flatten().map(|c| c.bounces_until).max().unwrap_or(0);
    }

    /// Lines that say tripped: lower and upper ones, bit n of motor n.
    pub fn tripped(&self) -> [u8; 2] {
        let mut lines = [0; 2];
        for (i, pair) in self.contacts.iter().enumerate() {
            for (line, contact) in lines.iter_mut().zip(pair) {
                *line |= u8::from(contact.tripped) << i;
            }
        }
        lines
    }
}
