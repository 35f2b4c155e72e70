//! Where a scan goes: the points of its route, and the check of all of them before it starts.

use super::{Next, Phase, Scan, WAYS};
use crate::compensation::law::Remembered;
use crate::controller::front::Front;
use crate::error::Error;
use crate::scan::{Definition, Kind, SCAN_AXES};
use crate::settings::BacklashMode;
use crate::units::steps::steps_to_units;
use crate::units::{Axis, Pose, SEGMENT_NS, wide};

/// Offsets of a scan's axes from where it began, nm or nrad.
type Offsets = [i64; SCAN_AXES];

/// A leg that is sampled in motion.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Leg {
    /// Which of the scan's axes it follows.
    pub along: u8,
    /// Motor that tells where a sample was taken.
    pub motor: u8,
    /// Offsets at which its samples begin and end.
    pub from: i64,
    pub to: i64,
    /// Offset of the other axis.
    pub beside: i64,
    /// Speed, nm/s or nrad/s.
    pub velocity: u64,
    /// How far the stage goes while the meter lags behind, with its sign.
    pub lag: i64,
    /// Where the leg begins by command: offset, and target of the motor in Q32.
    origin: (i64, i64),
    /// nm or nrad a step, Q32.
    slope: i64,
}

impl Leg {
    /// +1 or -1.
    pub fn sign(&self) -> i64 {
        if self.to < self.from { -1 } else { 1 }
    }

    /// Offset at a motor count in Q32.
    pub fn offset(&self, steps_q32: i64) -> i64 {
        let way = i128::from(steps_q32 - self.origin.1) * i128::from(self.slope);
        self.origin.0 + ((way + (1 << 63)) >> 64) as i64
    }
}

/// Way in which a speed is reached from rest, not below it: v/2 (v/a + a/j) where the acceleration is reached, and above
/// v sqrt(v/j) where it is not.
fn run_up(velocity: u64, acceleration: u64, jerk: u64) -> i64 {
    let v = u128::from(velocity);
    let by_acceleration = wide::div_up(v * v, u128::from(acceleration.max(1)));
    let by_jerk = wide::div_up(v * u128::from(acceleration), u128::from(jerk.max(1)));
    ((by_acceleration + by_jerk) / 2 + 1).min(1 << 30) as i64
}

impl Front {
    /// Speed of a leg: a pitch in the time of a mean, at most that of the axis; nm/s or nrad/s.
    fn scan_velocity(&self, definition: &Definition, axis: Axis) -> u64 {
        let average = u64::from(self.sense_settings(definition.channel.into()).average);
        let wanted = u64::from(definition.pitch.unsigned_abs()) * 1_000_000_000 / (SEGMENT_NS * average.max(1));
        wanted.clamp(1, self.settings.axes[axis.index()].velocity.max(1))
    }

    /// How far the stage goes at a speed while the meter lags behind; nm or nrad.
    fn lag(&self, definition: &Definition, velocity: u64) -> i64 {
        let delay = u64::from(self.sense_settings(definition.channel.into()).delay_ns);
        let percent = u64::from(self.settings.override_percent);
        wide::div(u128::from(velocity * percent) * u128::from(delay), 100_000_000_000) as i64
    }

    /// Steps beyond the play, as a distance of the axis.
    fn clear_way(&self, axis: Axis) -> i64 {
        let clear = self.clearance(axis).saturating_add(1);
        steps_to_units(clear.into(), self.law().step_q32(axis.index())).min(1 << 30)
    }

    /// Way before and behind a leg: to its speed, and what the meter lags behind.
    fn beyond(&self, definition: &Definition, axis: Axis) -> i64 {
        let own = &self.settings.axes[axis.index()];
        let velocity = self.scan_velocity(definition, axis);
        run_up(velocity, own.acceleration, own.jerk) + self.lag(definition, velocity)
    }

    /// A pose by the offsets of a scan's axes.
    pub(super) fn offset_pose(scan: &Scan, offsets: Offsets) -> Pose {
        let mut pose = scan.start;
        for (axis, offset) in scan.definition.axes().zip(offsets) {
            let x = &mut pose.0[axis.index()];
            *x = i64::from(*x).saturating_add(offset).clamp(i32::MIN.into(), i32::MAX.into()) as i32;
        }
        pose
    }

    /// Where a point is approached from: all axes beyond their play. Bit n of `downwards`: axis n downwards.
    pub(super) fn before(&self, definition: &Definition, offsets: Offsets, downwards: u8) -> Offsets {
        let mut before = offsets;
        for (n, (axis, offset)) in definition.axes().zip(&mut before).enumerate() {
            let clear = self.clear_way(axis);
            *offset += if downwards >> n & 1 != 0 { clear } else { -clear };
        }
        before
    }

    /// Bit n: axis n of the scan is sampled downwards.
    pub(super) fn sides(definition: &Definition) -> u8 {
        u8::from(definition.negative)
    }

    /// Offset of a line of a raster.
    fn line_offset(definition: &Definition, n: u16) -> i64 {
        let span = i64::from(definition.legs().saturating_sub(1)) * i64::from(definition.step);
        i64::from(n) * i64::from(definition.step) - span / 2
    }

    /// The ways to the part of a scan whose turn it is, and what is done there.
    pub(super) fn part_of(&self, scan: &Scan) -> ([Option<Pose>; WAYS], Next) {
        let definition = &scan.definition;
        let sign = definition.sign();
        let sides = Self::sides(definition);
        let pose = |offsets| Some(Self::offset_pose(scan, offsets));
        match definition.kind {
            Kind::Line | Kind::Raster => {
                let beyond = self.beyond(definition, definition.axis(0));
                let first = -sign * (i64::from(definition.range[0]) / 2 + beyond);
                let beside =
                    if definition.kind == Kind::Raster { Self::line_offset(definition, scan.index) } else { 0 };
                let begin = [first, beside, 0];
                ([pose(self.before(definition, begin, sides)), pose(begin), None], Next::Leg)
            }
            Kind::Spiral => {
                let [a, b] = Definition::corner(scan.index).map(|corner| corner * i64::from(definition.step));
                ([pose([a, b, 0]), None, None], Next::Leg)
            }
            Kind::Parabola => {
                let points = i64::from(definition.number.max(2)) - 1;
                let at = i64::from(definition.range[0]) * (2 * i64::from(scan.index) - points) / (2 * points);
                let point = [sign * at, 0, 0];
                // the next points lie on the same flank; after a stop the play is taken up anew
                let fresh = scan.index == 0 || scan.phase == Phase::Paused;
                let before = if fresh { pose(self.before(definition, point, sides)) } else { None };
                ([before, pose(point), None], Next::Measure)
            }
            Kind::Hill => {
                let there = Self::offset_pose(scan, scan.climb.here.map(i64::from));
                ([self.overshoot(self.commanded(), there), Some(there), None], Next::Measure)
            }
        }
    }

    /// Begins the leg at whose begin the stage stands.
    pub(super) fn start_leg(&mut self) {
        let Some(scan) = self.scan else { return };
        let definition = &scan.definition;
        let along = if definition.kind == Kind::Spiral { usize::from(scan.index % 2) } else { 0 };
        let axis = definition.axis(along);
        let velocity = self.scan_velocity(definition, axis);
        let (from, to, beside, beyond) = match definition.kind {
            Kind::Spiral => {
                let step = i64::from(definition.step);
                let [begin, end] =
                    [scan.index, scan.index + 1].map(|n| Definition::corner(n).map(|corner| corner * step));
                (begin[along & 1], end[along & 1], begin[1 - (along & 1)], 0)
            }
            _ => {
                let half = definition.sign() * (i64::from(definition.range[0]) / 2);
                let beside =
                    if definition.kind == Kind::Raster { Self::line_offset(definition, scan.index) } else { 0 };
                (-half, half, beside, self.beyond(definition, axis))
            }
        };
        let mut leg =
            Leg { along: along as u8, motor: axis.index() as u8, from, to, beside, velocity, ..Leg::default() };
        leg.lag = leg.sign() * self.lag(definition, velocity);
        let [begin, end] = [from - leg.sign() * beyond, to + leg.sign() * beyond];
        let pose =
            |offset| Self::offset_pose(&scan, if along == 0 { [offset, beside, 0] } else { [beside, offset, 0] });
        let target = |pose: Pose| self.law().targets(&pose.fine(), &mut Remembered::default()).0[axis.index()];
        let (first, last) = (target(pose(begin)), target(pose(end)));
        // targets have one half added
        leg.origin = (begin, first - (1 << 31));
        leg.slope = wide::signed_div(i128::from(end - begin) << 64, i128::from(last - first)) as i64;
        let goal = pose(end);
        if let Some(scan) = &mut self.scan {
            (scan.leg, scan.phase) = (leg, Phase::Sampling);
            scan.block = Default::default();
        }
        self.refresh();
        self.planner.go(goal, None);
    }

    /// What a leg changes of what planning goes by: its speed.
    pub(in crate::controller::front) fn refresh_scan(&mut self) {
        let Some(scan) = self.scan.as_ref().filter(|scan| scan.phase == Phase::Sampling) else { return };
        let i = usize::from(scan.leg.motor);
        let mut own = self.settings.axes[i];
        own.velocity = scan.leg.velocity.min(own.velocity);
        self.capability.wanted[i] = own.wanted();
    }

    /// Checks a scan as a whole.
    ///
    /// # Errors
    /// -221 a climb that the play swallows; 108, 102 and -222 with axis and value.
    pub(super) fn check_scan(&self, scan: &Scan) -> Result<(), Error> {
        let definition = &scan.definition;
        if definition.kind == Kind::Hill {
            definition.axes().try_for_each(|axis| self.check_climb(definition, axis))?;
        }
        let (least, most) = self.extent(definition);
        let law = self.law();
        for (n, axis) in definition.axes().enumerate() {
            for offset in [least[n], most[n]] {
                let x = i64::from(scan.start.0[axis.index()]) + offset;
                self.capability.limits.check_coordinate(law, axis, x)?;
            }
        }
        // every corner in an order in which neighbours differ in one axis, and back
        let mut at = self.commanded();
        for n in 0..1u8 << definition.count {
            let corner = n ^ (n >> 1);
            let offsets = core::array::from_fn(|k| if corner >> k & 1 != 0 { most[k] } else { least[k] });
            let to = Self::offset_pose(scan, offsets);
            self.planner.check(&self.capability, at, to)?;
            self.check_switches(to)?;
            at = to;
        }
        self.planner.check(&self.capability, at, scan.start)?;
        Ok(())
    }

    /// Farthest offsets of a scan's axes.
    fn extent(&self, definition: &Definition) -> (Offsets, Offsets) {
        let (mut least, mut most) = ([0; SCAN_AXES], [0; SCAN_AXES]);
        for (n, axis) in definition.axes().enumerate() {
            let half = i64::from(definition.range[0]) / 2;
            let reach = match (definition.kind, n) {
                (Kind::Line | Kind::Raster, 0) => half + self.beyond(definition, axis),
                (Kind::Raster, _) => -Self::line_offset(definition, 0),
                (Kind::Spiral, _) => definition.outermost() * i64::from(definition.step),
                _ => half,
            };
            let clear = self.clear_way(axis);
            let (below, above) = match definition.kind {
                Kind::Hill => (clear, clear),
                _ if n == 0 && definition.negative => (0, clear),
                _ => (clear, 0),
            };
            (least[n], most[n]) = (-reach - below, reach + above);
        }
        (least, most)
    }

    /// # Errors
    /// -221 when the steps that a climb tries without gain are together not more than the play that is not compensated.
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
        let play = steps_to_units(steps.into(), self.law().step_q32(axis.index()));
        let patience = i64::from(definition.number.max(1));
        let least = i64::from(definition.least);
        if steps > 0 && least * patience <= play {
            return Err(Error::swallowed(axis, least, play / patience + 1));
        }
        Ok(())
    }
}
