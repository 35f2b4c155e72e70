//! Where a scan goes: the points of its route, and the check of all of them before it starts.

use super::sampling::Block;
use super::{Next, Phase, Scan, WAYS};
use crate::compensation::law::Remembered;
use crate::controller::front::Front;
use crate::error::{Error, ErrorNumber};
use crate::scan::{Definition, Kind, LEAST, NUMBER, PITCH, RANGE, SCAN_AXES, STEP, status};
use crate::settings::BacklashMode;
use crate::units::steps::steps_to_units;
use crate::units::{Axis, Pose, SEGMENT_NS, wide};

/// Offsets of a scan's axes from where it began, nm or nrad.
pub(super) type Offsets = [i32; SCAN_AXES];

/// A leg that is sampled in motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leg {
    /// Which of the scan's axes it follows.
    pub along: u8,
    /// Motor that tells where a sample was taken.
    pub motor: u8,
    /// Offsets at which its samples begin and end.
    pub from: i32,
    pub to: i32,
    /// Offset of the other axis.
    pub beside: i32,
    /// Speed, nm/s or nrad/s.
    pub velocity: u64,
    /// How far the stage goes while the meter lags behind, with its sign.
    pub lag: i32,
    /// Way before and behind it.
    beyond: i32,
    /// Where it begins by command: target of the motor in Q32.
    origin: i64,
    /// nm or nrad a step, Q32.
    slope: i64,
}

impl Leg {
    /// None; all bytes are zero.
    pub const NONE: Leg =
        Leg { along: 0, motor: 0, from: 0, to: 0, beside: 0, velocity: 0, lag: 0, beyond: 0, origin: 0, slope: 0 };

    /// +1 or -1.
    pub fn sign(&self) -> i32 {
        if self.to < self.from { -1 } else { 1 }
    }

    /// Offset of the axis before the leg and behind it.
    fn ends(&self) -> [i32; 2] {
        let beyond = self.sign() * self.beyond;
        [self.from - beyond, self.to + beyond]
    }

    /// The offsets of both axes where the first of them is at one.
    fn place(&self, along: i32) -> Offsets {
        if self.along == 0 { [along, self.beside, 0] } else { [self.beside, along, 0] }
    }

    /// Offset at a motor count in Q32.
    pub fn offset(&self, steps_q32: i64) -> i32 {
        let way = i128::from(steps_q32 - self.origin) * i128::from(self.slope);
        self.ends()[0].saturating_add(((way + (1 << 63)) >> 64) as i32)
    }
}

/// Way in which a speed is reached from rest, not below it: v/2 (v/a + a/j) where the acceleration is reached, and above
/// v sqrt(v/j) where it is not.
fn run_up(velocity: u64, acceleration: u64, jerk: u64) -> i32 {
    let v = u128::from(velocity);
    let by_acceleration = wide::div_up(v * v, u128::from(acceleration.max(1)));
    let by_jerk = wide::div_up(v * u128::from(acceleration), u128::from(jerk.max(1)));
    ((by_acceleration + by_jerk) / 2 + 1).min(1 << 28) as i32
}

/// A pose by offsets from where a scan's axes begin.
#[inline(never)]
fn offset_pose(definition: &Definition, start: Pose, offsets: Offsets) -> Pose {
    let mut pose = start;
    for (axis, offset) in definition.axes().iter().zip(offsets) {
        if let Some(x) = pose.0.get_mut(usize::from(*axis)) {
            *x = x.saturating_add(offset);
        }
    }
    pose
}

impl Front {
    /// How far the stage goes at a speed while the meter lags behind; nm or nrad.
    fn lag(&self, definition: &Definition, velocity: u64) -> i32 {
        let delay = u64::from(self.settings.sense[definition.channel()].delay_ns);
        let percent = u64::from(self.settings.override_percent);
        wide::div(u128::from(velocity * percent) * u128::from(delay), 100_000_000_000) as i32
    }

    /// Steps beyond the play, as a distance of the axis.
    fn clear_way(&self, axis: Axis) -> i32 {
        let clear = self.clearance(axis).saturating_add(1);
        steps_to_units(clear.into(), self.law().step_q32(axis.index())).min(1 << 29) as i32
    }

    /// A leg of a scan, but for what its motor says of it.
    #[inline(never)]
    fn leg_of(&self, definition: &Definition, index: i32) -> Leg {
        let values = &definition.values;
        let spiral = definition.kind == Kind::Spiral;
        let along = if spiral { index & 1 } else { 0 };
        let axis = definition.axis(along as usize);
        let own = &self.settings.axes[axis.index()];
        // a pitch in the time of a mean, at most the speed of the axis
        let sense = &self.settings.sense[definition.channel()];
        let (mut pitch, mut time) = (values[PITCH], SEGMENT_NS * u64::from(sense.average));
        if spiral {
            // its sides have no run-up: each gives a mean, and loses less than half a pitch to a late meter
            pitch = pitch.min(values[STEP]);
            time = time.max(2 * u64::from(sense.delay_ns));
        }
        let pitch = u64::from(pitch.unsigned_abs()) * 1_000_000_000;
        let velocity = pitch.checked_div(time).unwrap_or(0).min(own.velocity).max(1);
        let half = definition.sign() * (values[RANGE] / 2);
        let mut leg =
            Leg { along: along as u8, motor: axis.index() as u8, from: -half, to: half, velocity, ..Leg::NONE };
        if spiral {
            let [begin, end] = [index, index + 1].map(|n| Definition::corner(n).map(|corner| corner * values[STEP]));
            let k = along as usize & 1;
            (leg.from, leg.to, leg.beside) = (begin[k], end[k].min(definition.reach()), begin[1 - k]);
        } else {
            leg.beyond = run_up(velocity, own.acceleration, own.jerk) + self.lag(definition, velocity);
        }
        if definition.kind == Kind::Raster {
            leg.beside = index * values[STEP] - (definition.legs() - 1) * values[STEP] / 2;
        }
        leg.lag = leg.sign() * self.lag(definition, velocity);
        leg
    }

    /// A pose by the offsets of a scan's axes.
    pub(super) fn offset_pose(scan: &Scan, offsets: Offsets) -> Pose {
        offset_pose(&scan.definition, scan.start, offsets)
    }

    /// Where a point is approached from: all axes beyond their play. Bit n of `downwards`: axis n downwards.
    #[inline(never)]
    pub(super) fn before(&self, scan: &Scan, offsets: Offsets, downwards: u8) -> Pose {
        let mut before = offsets;
        for (n, offset) in before.iter_mut().enumerate().take(scan.definition.count.into()) {
            let axis = scan.definition.axis(n);
            let clear = self.clear_way(axis);
            // an axis that ends in one direction ends in that
            let ending = self.settings.axes[axis.index()].backlash.mode.ending();
            let down = ending.map_or(downwards >> n & 1 != 0, |flank| flank.sign() < 0);
            *offset += if down { clear } else { -clear };
        }
        Self::offset_pose(scan, before)
    }

    /// The ways to the part of a scan whose turn it is, and what is done there.
    #[inline(never)]
    pub(super) fn part_of(&self, scan: &Scan) -> ([Option<Pose>; WAYS], Next) {
        let definition = &scan.definition;
        let sides = u8::from(definition.is_negative());
        let point = match definition.kind {
            Kind::Hill => {
                let there = Self::offset_pose(scan, scan.climb.here);
                return ([self.overshoot(self.commanded(), there), Some(there)], Next::Measure);
            }
            Kind::Parabola => {
                let gaps = definition.values[NUMBER].max(2) - 1;
                let way = i64::from(definition.values[RANGE]) * i64::from(2 * scan.index - gaps);
                [definition.sign() * way.wrapping_div(2 * i64::from(gaps)) as i32, 0, 0]
            }
            _ => {
                let leg = self.leg_of(definition, scan.index);
                leg.place(leg.ends()[0])
            }
        };
        let next = if definition.kind == Kind::Parabola { Next::Measure } else { Next::Leg };
        // further points lie on the same flank; after a stop the play is taken up anew
        let goes_on = definition.kind == Kind::Parabola && scan.index > 0 && scan.phase != Phase::Paused;
        let plain = goes_on || definition.kind == Kind::Spiral;
        let before = if plain { None } else { Some(self.before(scan, point, sides)) };
        ([before, Some(Self::offset_pose(scan, point))], next)
    }

    /// Begins the leg at whose begin the stage stands.
    #[inline(never)]
    pub(super) fn start_leg(&mut self) {
        let Some(scan) = self.light.scan() else { return };
        let mut leg = self.leg_of(&scan.definition, scan.index);
        let i = usize::from(leg.motor);
        let [begin, end] = leg.ends();
        let [first, goal] = [begin, end].map(|along| Self::offset_pose(scan, leg.place(along)));
        let [from, to] =
            [first, goal].map(|pose| self.law().targets(&pose.fine(), &mut Remembered::default()).0.get(i).copied());
        // targets have one half added
        leg.origin = from.unwrap_or(0) - (1 << 31);
        let steps = to.unwrap_or(0) - from.unwrap_or(0);
        leg.slope = wide::signed_div(i128::from(end - begin) << 64, steps.into()) as i64;
        let played = self.report.played;
        if let Some(scan) = self.light.scan_mut() {
            (scan.leg, scan.phase, scan.block, scan.since) = (leg, Phase::Sampling, Block::NONE, played);
        }
        self.refresh();
        self.go_on(goal);
    }

    /// Goes to the next point of a scan. Where what came meanwhile does not let it, the scan ends with that error.
    pub(super) fn go_on(&mut self, to: Pose) {
        let at = self.commanded();
        match self.planner.prepare(&self.capability, at, to).and_then(|()| self.check_switches(to)) {
            Ok(()) => self.planner.go(to, None),
            Err(error) => {
                self.end_scan(status::FAILED);
                self.events.scan = Some(error);
            }
        }
    }

    /// What a leg changes of what planning goes by: its speed.
    pub(in crate::controller::front) fn refresh_scan(&mut self) {
        let Some(leg) = self.light.scan().filter(|scan| scan.phase == Phase::Sampling).map(|scan| &scan.leg) else {
            return;
        };
        let (i, velocity) = (usize::from(leg.motor), leg.velocity);
        if let (Some(own), Some(wanted)) = (self.settings.axes.get(i), self.capability.wanted.get_mut(i)) {
            *wanted = crate::settings::AxisSettings { velocity: velocity.min(own.velocity), ..*own }.wanted();
        }
    }

    /// Checks a scan as a whole.
    ///
    /// # Errors
    /// -221 a climb that the play swallows, or samples on a flank on which the axis never ends; 108, 102 and -222 with
    /// axis and value.
    pub(super) fn check_scan(&self, definition: &Definition, start: Pose) -> Result<(), Error> {
        if definition.kind == Kind::Hill {
            (0..definition.count.into()).try_for_each(|n| self.check_climb(definition, definition.axis(n)))?;
        }
        let (law, leg) = (self.law(), self.leg_of(definition, 0));
        let (mut least, mut most) = ([0; SCAN_AXES], [0; SCAN_AXES]);
        for n in 0..usize::from(definition.count).min(SCAN_AXES) {
            let axis = definition.axis(n);
            let reach = match (definition.kind, n) {
                (Kind::Line | Kind::Raster, 0) => leg.ends()[1].abs(),
                (Kind::Raster, _) => -leg.beside,
                (Kind::Spiral, _) => definition.reach(),
                _ => definition.values[RANGE] / 2,
            };
            let clear = self.clear_way(axis);
            let downwards = n == 0 && definition.is_negative();
            let ending = self.settings.axes[axis.index()].backlash.mode.ending();
            if n == 0 && definition.samples_one_way() && ending.is_some_and(|flank| (flank.sign() < 0) != downwards) {
                return Err(Error::text(
                    ErrorNumber::SettingsConflict,
                    "the first axis' BACK:MODE ends on the other flank",
                ));
            }
            // a climb may end on either flank
            let either = definition.kind == Kind::Hill || ending.is_some();
            (least[n], most[n]) = (-reach, reach);
            if either || !downwards {
                least[n] = least[n].saturating_sub(clear);
            }
            if either || downwards {
                most[n] = most[n].saturating_add(clear);
            }
            for offset in [least[n], most[n]] {
                let x = i64::from(start.0[axis.index()]) + i64::from(offset);
                self.capability.limits.check_coordinate(law, axis, x)?;
            }
        }
        // every corner in an order in which neighbours differ in one axis, and back
        let mut at = self.commanded();
        for n in 0..=1u8 << definition.count {
            let corner = n ^ (n >> 1);
            let mut offsets = least;
            for (k, (offset, most)) in offsets.iter_mut().zip(&most).enumerate() {
                *offset = if corner >> k & 1 != 0 { *most } else { *offset };
            }
            let last = n >> definition.count != 0;
            let to = if last { start } else { offset_pose(definition, start, offsets) };
            self.planner.check(&self.capability, at, to)?;
            self.check_switches(to)?;
            at = to;
        }
        Ok(())
    }

    /// # Errors
    /// -221 when the steps that a climb tries without gain are together not more than the play that is not compensated, or
    /// when its range has no room for more than it.
    fn check_climb(&self, definition: &Definition, axis: Axis) -> Result<(), Error> {
        let own = &self.settings.axes[axis.index()];
        let switches = self.settings.switches;
        let steps = match own.backlash.mode {
            BacklashMode::UniPositive | BacklashMode::UniNegative => 0,
            BacklashMode::Reversal if switches.compensation && switches.backlash && self.flank(axis).is_some() => {
                // a retreat within the dead band is no reversal
                own.backlash.dead_band.min(own.backlash_steps(&self.motor(axis)))
            }
            _ => own.backlash_steps(&self.motor(axis)),
        };
        // of a definition no value is beyond 2^30
        let play = steps_to_units(steps.into(), self.law().step_q32(axis.index())).min(1 << 28) as u32;
        let value = |slot: usize| definition.values[slot].unsigned_abs().max(1);
        let (least, range) = (value(LEAST), value(RANGE));
        let enough = play / value(NUMBER) + 1;
        let by_range = least >= enough;
        // whole steps to either side of where it begins
        let (value, bound) = if by_range { (range, 2 * (play / least + 1) * least) } else { (least, enough) };
        if steps > 0 && value < bound {
            return Err(Error::swallowed(axis, value.into(), bound.into()));
        }
        Ok(())
    }
}
