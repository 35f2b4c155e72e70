//! What a new track may use of the motors beside those that run.

use super::{Capability, Planner, SINGLE_SHARE_1024, WAIT_BELOW};
use crate::compensation::law::Remembered;
use crate::error::Error;
use crate::motion::bounds::{Bounds, NANO, PATH_ONE, Path, and_a_quarter};
use crate::motion::budget::{Grant, RATE_BITS, Rates, Turning};
use crate::units::rough::Rough;
use crate::units::{AXES, Axis, wide};

/// Angle beyond which a turn bends nothing further, nrad: the lever itself is the most it can add.
const ONE_RADIAN: u64 = 1_000_000_000;

/// A path that asks for its share.
#[derive(Clone, Copy)]
pub(super) struct Asking<'a> {
    /// The way that it will go.
    pub path: &'a Path,
    /// Where its slopes are looked for, if that is more than the way.
    pub region: Option<&'a Path>,
    /// Its slot.
    pub slot: usize,
    /// The segment at which it begins.
    pub segment: u64,
    /// It leaves a little to the others.
    pub single: bool,
    /// The motion begins at the upper end of the way, or at the lower one; none where it first goes on and turns back.
    pub starts_high: Option<bool>,
}

/// What a path from rest to rest may use while nothing else runs.
///
/// # Errors
/// A limit that the path breaks.
pub(super) fn alone(capability: &Capability, path: &Path, grant: &mut Grant) -> Result<(), Error> {
    let Capability { law, motors, wanted, limits, .. } = capability;
    let mut bounds = Bounds::default();
    bounds.survey(law, path);
    limits.check_motors(law, &bounds.range, Some(false))?;
    bounds.rests = true;
    grant.within(&bounds, motors, wanted, &path.direction, Turning::default(), &|_, _| 0);
    grant.swing = bounds.swing(path);
    Ok(())
}

/// What the running tracks leave.
pub(super) struct Left {
    /// Of each motor.
    pub motors: [Rates; AXES],
    /// Angular rates of the others.
    pub others: Turning,
    /// Angle that the others may still turn, nrad.
    pub remaining: u64,
}

impl Planner {
    /// What a path may use, or none while the others leave it too little.
    ///
    /// # Errors
    /// A limit that the path breaks by itself, or together with what the others have still to go.
    pub(super) fn grant(&self, capability: &Capability, asking: &Asking<'_>) -> Result<Option<Grant>, Error> {
        let Capability { law, motors, wanted, limits, .. } = capability;
        let mut bounds = Bounds::default();
        bounds.survey(law, asking.path);
        limits.check_motors(law, &bounds.range, asking.starts_high)?;
        self.check_beside_others(capability, asking, &bounds)?;
        let swing = bounds.swing(asking.path);
        let mut left = Left { motors: *motors, others: Turning::default(), remaining: 0 };
        self.left(capability, asking.slot, asking.segment, swing, &mut left);
        if let Some(region) = asking.region {
            bounds.survey(law, region);
        }
        bounds.bend_by(law, left.remaining);
        bounds.rests = !asking.single && asking.path.from == 0 && asking.path.to == PATH_ONE;
        let crossed = |i: usize, nrad2_q40: u128| law_crossed(capability, i, nrad2_q40);
        if asking.single {
            left.motors.iter_mut().for_each(|m| *m = m.share(SINGLE_SHARE_1024));
        }
        let direction = &asking.path.direction;
        let mut grant = Grant::default();
        grant.within(&bounds, &left.motors, wanted, direction, left.others, &crossed);
        grant.swing = swing;
        if self.slots.iter().enumerate().any(|(i, s)| i != asking.slot && s.is_taken()) {
            let alone = if asking.single { motors.map(|m| m.share(SINGLE_SHARE_1024)) } else { *motors };
            let mut best = Grant::default();
            best.within(&bounds, &alone, wanted, direction, Turning::default(), &crossed);
            let (a, b) = (grant.limits, best.limits);
            let enough = |have: i64, want: i64| have >= want / WAIT_BELOW && have > 1;
            if !(enough(a.velocity, b.velocity) && enough(a.acceleration, b.acceleration) && enough(a.jerk, b.jerk)) {
                return Ok(None);
            }
        }
        Ok(Some(grant))
    }

    /// What the others leave to a track that turns by `swing` nrad and thereby bends what they do.
    /// `left` says what all of them may use.
    pub(super) fn left(&self, capability: &Capability, own: usize, segment: u64, swing: u64, left: &mut Left) {
        for (i, slot) in self.slots.iter().enumerate() {
            let Some(active) = slot.latest().filter(|_| i != own) else {
                continue;
            };
            let bend = bend(capability, active.grant.turning, swing.min(ONE_RADIAN - active.grant.bent));
            for (m, left) in left.motors.iter_mut().enumerate() {
                *left = left.less(active.grant.uses[m]).less(bend[m]);
            }
            left.others = left.others.plus(active.grant.turning);
            let (low, high) = slot.reach(segment);
            let angle: u64 = active.track.direction[3..].iter().map(|d| (d.unsigned_abs() >> 32) + 1).sum::<u64>();
            let way = low.unsigned_abs().max(high.unsigned_abs());
            left.remaining += wide::mul_shift(angle, way, 60);
        }
    }

    /// Checks the path together with what the others have still to go.
    ///
    /// # Errors
    /// The limit that could be left.
    fn check_beside_others(&self, capability: &Capability, asking: &Asking<'_>, way: &Bounds) -> Result<(), Error> {
        let Capability { law, limits, .. } = capability;
        let mut range = way.range;
        let mut low = [0i64; AXES];
        let mut high = [0i64; AXES];
        let swing = way.swing(asking.path);
        let mut rest = None;
        let mut other = Bounds::default();
        for (i, slot) in self.slots.iter().enumerate() {
            let Some(active) = slot.latest().filter(|_| i != asking.slot) else {
                continue;
            };
            let rest = rest.get_or_insert_with(|| law.targets(&self.rest(), &mut Remembered::default()).0);
            let (from, to) = slot.reach(asking.segment);
            let end = active.track.profile.end_position();
            let path = Path {
                origin: self.rest_without(i),
                direction: active.track.direction,
                from: end.saturating_add(from),
                to: end.saturating_add(to),
            };
            other.survey(law, &path);
            let angles = u128::from(swing) * u128::from(other.swing(&path));
            for (m, rest) in rest.iter().enumerate() {
                let crossed = (law_crossed(capability, m, angles << 40) >> 12) as i64;
                let down = other.range.lowest[m].saturating_sub(*rest).min(0).saturating_sub(crossed);
                let up = other.range.highest[m].saturating_sub(*rest).max(0).saturating_add(crossed);
                range.lowest[m] = range.lowest[m].saturating_add(down);
                range.highest[m] = range.highest[m].saturating_add(up);
            }
            for (a, d) in active.track.direction.iter().enumerate() {
                let [one, other] = [from, to].map(|s| along(*d, s));
                low[a] = low[a].saturating_add(one.min(other));
                high[a] = high[a].saturating_add(one.max(other));
            }
        }
        if rest.is_none() {
            return Ok(());
        }
        for axis in Axis::ALL {
            let i = axis.index();
            let (lower, upper) = limits.range(law, axis);
            let own = [asking.path.from, asking.path.to]
                .map(|s| asking.path.origin.0[i].saturating_add(along(asking.path.direction[i], s)));
            if low[i] == high[i] || asking.path.direction[i] == 0 {
                continue;
            }
            let (lowest, highest) =
                (own[0].min(own[1]).saturating_add(low[i]), own[0].max(own[1]).saturating_add(high[i]));
            if lowest < i64::from(lower) << 32 {
                return Err(Error::limit(axis, lowest >> 32, i64::from(lower), false));
            }
            if highest > i64::from(upper) << 32 {
                return Err(Error::limit(axis, highest >> 32, i64::from(upper), false));
            }
        }
        limits.check_motors(law, &range, asking.starts_high)
    }

    /// A new track turns: what the others do is bent by so much more from now on.
    pub(super) fn bend_others(&mut self, capability: &Capability, own: usize, swing: u64) {
        for (_, slot) in self.slots.iter_mut().enumerate().filter(|(i, slot)| *i != own && slot.is_taken()) {
            for active in slot.each_mut() {
                let more = swing.min(ONE_RADIAN - active.grant.bent);
                active.grant.bent += more;
                let bend = bend(capability, active.grant.turning, more);
                for (uses, bend) in active.grant.uses.iter_mut().zip(&bend) {
                    *uses = uses.plus(*bend);
                }
            }
        }
    }
}

/// A length (Q32) times a path position (Q60), rounded down.
#[inline(never)]
fn along(length: i64, position: i64) -> i64 {
    ((i128::from(length) * i128::from(position)) >> 60) as i64
}

/// Steps (Q44) of motor `i` by the product of two angles (nrad^2 in Q40): the lever for linear motors, the
/// second-order term for rotary ones; a quarter added.
#[inline(never)]
fn law_crossed(capability: &Capability, i: usize, nrad2_q40: u128) -> u64 {
    let law = &capability.law;
    let nano = Rough::wide_up(nrad2_q40).shifted(-40).times_up(NANO);
    let units = if i < 3 {
        nano.times_up(NANO).times_up(Rough::up(law.lever_nm(), 0))
    } else {
        nano.times_up(Rough::up(law.second_order_bound(), 32))
    };
    and_a_quarter(units).times_up(law.per_unit(i)).ceil(RATE_BITS as i32).min(u64::MAX >> 2)
}

/// How much more of each motor a turning track needs once another one has turned by `angle` nrad.
fn bend(capability: &Capability, turning: Turning, angle: u64) -> [Rates; AXES] {
    let mut rates = [Rates::default(); AXES];
    if angle == 0 || turning.velocity == 0 {
        return rates;
    }
    let angle = u128::from(angle) << 20;
    for (i, rates) in rates.iter_mut().enumerate() {
        let by = |rate: u64| law_crossed(capability, i, angle * u128::from(rate));
        *rates =
            Rates { velocity: by(turning.velocity), acceleration: by(turning.acceleration), jerk: by(turning.jerk) };
    }
    rates
}
