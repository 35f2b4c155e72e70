//! How steep the law is along a path: bounds on every motor's rates and range, in integers, conservative.
//!
//! A motor's position over the path parameter s has slope m', curvature m'' and third derivative m'''.
//! Linear axes make it straight; rotary ones bend it through the rotation centre: with a lever r and an angular
//! way theta per path unit, |c''| <= r theta^2 and |c'''| <= r theta^3 (sums over the rotary axes), to which the
//! second-order term of q_a adds its own part. The slope is taken from samples of the law itself; between two
//! samples h apart it differs from their mean by at most m'' h / 2. Where nothing else turns meanwhile the curvature
//! is taken from the samples too: a second difference is the curvature somewhere between its three samples, from
//! which it differs by at most m''' 2 h.

use crate::compensation::law::{Law, Remembered};
use crate::motion::track::scale;
use crate::units::rough::Rough;
use crate::units::{AXES, FinePose, FineSteps};

/// Path position 1.0 in Q60.
pub const PATH_ONE: i64 = 1 << 60;

/// Samples of the law along a path that turns.
const SAMPLES: i64 = 8;
/// Stretches between the samples, at most.
pub const MOST_STRETCHES: usize = SAMPLES as usize;

/// Radians of a nanoradian.
pub const NANO: Rough = Rough::ONE.over_up(Rough::down(1_000_000_000, 0));

/// A path: where it begins, one path unit of it, and the stretch of path positions to look at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Path {
    /// Pose at path position 0, nm and nrad in Q32.
    pub origin: FinePose,
    /// One path unit, nm and nrad in Q32.
    pub direction: [i64; AXES],
    /// Lowest path position, Q60.
    pub from: i64,
    /// Highest path position, Q60.
    pub to: i64,
}

impl Path {
    /// True when it is a single pose.
    pub fn goes_nowhere(&self) -> bool {
        self.direction.iter().all(|d| *d == 0)
    }

    fn at(&self, s: i64) -> FinePose {
        let mut pose = self.origin;
        if s != 0 {
            for (u, d) in pose.0.iter_mut().zip(&self.direction) {
                *u = u.saturating_add(scale(*d, s));
            }
        }
        pose
    }
}

/// Where the motors are along a path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Range {
    /// Lowest motor position, Q32 steps, one half included.
    pub lowest: [i64; AXES],
    /// Highest motor position, Q32 steps, one half included.
    pub highest: [i64; AXES],
    /// Motor positions at the two ends of the stretch, Q32 steps, one half included.
    pub ends: [[i64; AXES]; 2],
    /// Bit n: motor n makes at least one step.
    pub steps: u8,
}

/// Bounds of all motors along a path.
#[derive(Clone, Debug, Default)]
pub struct Bounds {
    /// Motor positions between the stretches, Q32 steps, one half included.
    samples: [FineSteps; MOST_STRETCHES + 1],
    /// Stretches whose slopes can be told one by one: of a path that turns, while nothing else does.
    pub stretches: usize,
    /// Length of a stretch, path units.
    pub stretch: Rough,
    /// Its inverse.
    per_stretch: Rough,
    /// What the slope within a stretch may be more than its way is long: for the rounding of the law, and its bend.
    more: [Rough; AXES],
    /// The path begins and ends at rest at 0 and 1, and is never left beyond them.
    pub rests: bool,
    /// |m'|, steps per path unit.
    pub slope: [Rough; AXES],
    /// |m''|, steps per path unit squared.
    pub curvature: [Rough; AXES],
    /// The same however others turn meanwhile.
    bent: [Rough; AXES],
    /// |m'''|, steps per path unit cubed.
    pub third: [Rough; AXES],
    /// Where the motors are.
    pub range: Range,
    /// Angular way of one path unit, nrad, summed over the rotary axes.
    pub turning: u64,
}

/// A length turned by an angle (nrad).
fn turned(length: Rough, angle: Rough) -> Rough {
    length.times_up(angle).times_up(NANO)
}

/// With a quarter added for what the bound leaves out (tilted axes, the lever's own change).
pub fn and_a_quarter(length: Rough) -> Rough {
    length.plus_up(length.shifted(-2))
}

impl Bounds {
    /// Becomes the bounds along a path, while nothing else turns: in place, because they are large.
    #[inline(never)]
    pub fn survey(&mut self, law: &Law, path: &Path) {
        let turning: u64 = path.direction[3..].iter().map(|d| (d.unsigned_abs() >> 32) + u64::from(*d != 0)).sum();
        self.range.steps = 0;
        self.turning = turning + turning / 32;
        let turns = turning != 0;
        if turns {
            self.bend(law);
        }
        let length = path.to.abs_diff(path.from);
        // a milliradian bends the slope by less than a thousandth: samples would only add their rounding
        let bends = Rough::up(turning, 0).times_up(Rough::up(length, 60)) > Rough::down(1_000_000, 0);
        let (count, each) =
            if bends { (MOST_STRETCHES, (path.to - path.from) / SAMPLES) } else { (1, path.to - path.from) };
        self.stretch = Rough::up(each.unsigned_abs().max(1), 60);
        self.per_stretch = Rough::ONE.over_up(Rough::down(each.unsigned_abs().max(1), 60));
        self.look(law, path, count, each);
        self.stretches = if count > 1 { count } else { 0 };
        for i in 0..AXES {
            self.follow(law, i, count, turns);
        }
        if !turns {
            (self.curvature, self.third) = ([Rough::ZERO; AXES], [Rough::ZERO; AXES]);
            self.run_straight(law, path);
        }
    }

    /// Curvature and third derivative by what a turn can do at most.
    fn bend(&mut self, law: &Law) {
        let angle = Rough::up(self.turning, 0);
        let lever = turned(turned(Rough::up(law.lever_nm(), 0), angle), angle);
        let third = turned(lever, angle);
        // q'' = second * angle^2 in radians
        let second = turned(Rough::up(law.second_order_bound(), 32).times_up(angle), angle);
        let (lever, third) = (and_a_quarter(lever), and_a_quarter(third));
        for i in 0..AXES {
            let per_unit = law.per_unit(i);
            if i < 3 {
                self.curvature[i] = lever.times_up(per_unit);
                self.third[i] = third.times_up(per_unit);
            } else {
                self.curvature[i] = second.times_up(per_unit);
            }
        }
        self.bent = self.curvature;
    }

    /// Samples of the law at the ends of `count` stretches of `each` (Q60).
    #[inline(never)]
    fn look(&mut self, law: &Law, path: &Path, count: usize, each: i64) {
        let mut remembered = Remembered::default();
        let mut pose = path.at(path.from);
        let way = path.direction.map(|d| scale(d, each));
        for (k, sample) in self.samples.iter_mut().enumerate().take(count + 1) {
            if k == count {
                pose = path.at(path.to);
            }
            law.write_targets(&pose, &mut remembered, sample);
            for (u, way) in pose.0.iter_mut().zip(&way) {
                *u = u.wrapping_add(*way);
            }
        }
        self.range.ends = [self.samples[0].0, self.samples.get(count).copied().unwrap_or_default().0];
    }

    /// Range, curvature and slope of a motor by what its samples show.
    fn follow(&mut self, law: &Law, i: usize, count: usize, turns: bool) {
        let samples = self.samples.get(..=count).unwrap_or_default();
        let [first, rest @ ..] = samples else { return };
        let (mut last, mut before) = (first.0[i], 0);
        let (mut lowest, mut highest, mut bent) = (i64::MAX, i64::MIN, 0);
        for sample in rest {
            let way = sample.0[i].wrapping_sub(last);
            if lowest <= highest {
                bent = way.abs_diff(before).max(bent);
            }
            lowest = lowest.min(way);
            highest = highest.max(way);
            (last, before) = (sample.0[i], way);
        }
        let (shortest, longest) = {
            let (one, other) = (lowest.unsigned_abs(), highest.unsigned_abs());
            if one < other { (one, other) } else { (other, one) }
        };
        let mut bulge = 0;
        if turns {
            if count > 1 {
                self.straighten(law, i, bent);
            }
            let bend = self.curvature[i].times_up(self.stretch).shifted(-1);
            // the law is rounded to a sixteenth nm or nrad
            self.more[i] = law.per_unit(i).shifted(-4).times_up(self.per_stretch).plus_up(bend);
            // half the curvature times the square of a stretch, Q32 steps
            bulge = bend.times_up(self.stretch).ceil(32);
            self.slope[i] = self.steepest(longest, i);
        }
        // where no stretch turns back its ends are its extremes
        let one_way = lowest ^ highest >= 0 && (shortest / 2 > bulge || !turns);
        let (low, high) = if one_way { self.between_ends(i) } else { self.between_samples(i, count, bulge) };
        (self.range.lowest[i], self.range.highest[i]) = (low, high);
        self.range.steps |= u8::from(low >> 32 != high >> 32) << i;
    }

    fn between_ends(&self, i: usize) -> (i64, i64) {
        let [first, last] = &self.range.ends;
        if first[i] < last[i] { (first[i], last[i]) } else { (last[i], first[i]) }
    }

    /// `bulge`: half of what a motor goes beyond its way over half a stretch.
    #[inline(never)]
    fn between_samples(&self, i: usize, count: usize, bulge: u64) -> (i64, i64) {
        let mut range = self.between_ends(i);
        for pair in self.samples.get(..=count).unwrap_or_default().windows(2) {
            let [last, at] = pair else { continue };
            let (lower, upper) = (last.0[i].min(at.0[i]), last.0[i].max(at.0[i]));
            let beyond = if upper.abs_diff(lower) / 2 <= bulge { (bulge / 4 + 1) as i64 } else { 0 };
            range = (range.0.min(lower - beyond), range.1.max(upper + beyond));
        }
        range
    }

    /// Lowers the curvature of a motor to what the largest second difference of its samples shows.
    fn straighten(&mut self, law: &Law, i: usize, bent: u64) {
        // it has four times the rounding of a sample
        let sum = Rough::up(bent, 32).plus_up(law.per_unit(i).shifted(-2));
        let shown = sum.times_up(self.per_stretch).times_up(self.per_stretch);
        let apart = self.third[i].times_up(self.stretch).shifted(1);
        self.curvature[i] = self.curvature[i].min(shown.plus_up(apart));
    }

    /// Slopes where nothing turns: the same everywhere, those of one path unit.
    fn run_straight(&mut self, law: &Law, path: &Path) {
        let at = |s| law.targets(&path.at(s), &mut Remembered::default()).0;
        let [from, to] = if (path.from, path.to) == (0, PATH_ONE) { self.range.ends } else { [at(0), at(PATH_ONE)] };
        const NOISE: u64 = 2;
        for (slope, (to, from)) in self.slope.iter_mut().zip(to.iter().zip(&from)) {
            let way = to.abs_diff(*from);
            *slope = if way > NOISE { Rough::up(way + NOISE, 32) } else { Rough::ZERO };
        }
    }

    /// |m'| within a stretch over which a motor goes by `way` (Q32 steps).
    #[inline(never)]
    fn steepest(&self, way: u64, i: usize) -> Rough {
        Rough::up(way, 32).times_up(self.per_stretch).plus_up(self.more[i])
    }

    /// |m'| of a motor, steps per path unit, within the [`Bounds::stretches`] of which the farther ends are as many
    /// stretches from one end of the path or the other.
    pub fn slope_at(&self, distance: usize, i: usize) -> Rough {
        let mut longest = 0;
        for k in [distance - 1, self.stretches - distance] {
            if let Some([from, to]) = self.samples.get(k..k + 2) {
                longest = to.0[i].abs_diff(from.0[i]).max(longest);
            }
        }
        self.steepest(longest, i)
    }

    /// From now on the bounds while other tracks may turn by `others` nrad, which bends the path.
    pub fn bend_by(&mut self, law: &Law, others: u64) {
        if self.turning == 0 || others == 0 {
            return;
        }
        let (angle, others) = (Rough::up(self.turning, 0), Rough::up(others, 0));
        for i in 0..AXES {
            // where others turn meanwhile the samples do not show all of the curvature, nor where it is steep
            let hidden = self.bent[i].times_up(self.stretch).shifted(-1);
            self.curvature[i] = self.bent[i];
            let crossed = if i < 3 {
                turned(turned(Rough::up(law.lever_nm(), 0), angle), others)
            } else {
                // what the second-order term makes of two angles is in nrad
                turned(Rough::up(law.second_order_bound(), 32).times_up(angle), others)
            };
            let more = and_a_quarter(crossed).times_up(law.per_unit(i));
            self.slope[i] = self.slope[i].plus_up(more).plus_up(hidden);
        }
        self.stretches = 0;
    }

    /// Angle by which the path turns in whole, nrad.
    pub fn swing(&self, path: &Path) -> u64 {
        if self.turning == 0 {
            return 0;
        }
        Rough::up(self.turning, 0).times_up(Rough::up(path.to.abs_diff(path.from), 60)).ceil(0).saturating_add(1)
    }
}
