//! Backlash: the inverse of play, one operator per motor, with absolute state.
//!
//! The stage follows the motor with play b: p = clamp(p, m - b/2, m + b/2). The inverse adds an overlay o to the
//! compensated target s: m = s + o with o = 0 on the reference flank and b against it on the other one
//! (docs/LAW.md 4). It is judged on the motor's whole-step target, never on a logical axis, and never accumulates.
//! The overlay changes along a jerk-limited curve of a fixed duration within what the planner keeps in reserve;
//! a take-up that has begun is finished before the next one begins. It begins only while something moves, or where
//! one ends during which the motor turned again.

use crate::units::wide;

/// Side of the play on which the gear rests: the direction in which the motor moved last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Flank {
    /// Reached moving in the positive direction: the reference after homing.
    #[default]
    Positive,
    /// Reached moving in the negative direction.
    Negative,
}

impl Flank {
    /// The other side.
    pub fn opposite(self) -> Self {
        match self {
            Flank::Positive => Flank::Negative,
            Flank::Negative => Flank::Positive,
        }
    }

    /// +1 or -1.
    pub fn sign(self) -> i32 {
        match self {
            Flank::Positive => 1,
            Flank::Negative => -1,
        }
    }
}

/// What the overlay follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overlay {
    /// The flank: taken up on every reversal.
    #[default]
    Follow,
    /// Nothing: it stays as it is, flanks are still tracked.
    Frozen,
    /// One flank, on which every move is made to end.
    Fixed(Flank),
}

/// What does not change while the motor moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlayConfig {
    /// Width of the play in steps.
    pub width: i32,
    /// Retreat from the extreme, in steps, that is not yet a reversal.
    pub dead_band: i32,
    /// The flank on which counts are true: the one on which homing ended.
    pub reference: Flank,
    /// A quarter of a take-up's duration, in segments; at least 1.
    pub quarter: u32,
    /// What the overlay follows.
    pub overlay: Overlay,
}

impl Default for PlayConfig {
    fn default() -> Self {
        PlayConfig { width: 0, dead_band: 1, reference: Flank::Positive, quarter: 1, overlay: Overlay::Follow }
    }
}

impl PlayConfig {
    /// Overlay in steps that belongs to a flank.
    pub fn overlay_of(&self, flank: Flank) -> i32 {
        if flank == self.reference { 0 } else { -self.reference.sign() * self.width }
    }
}

/// A take-up on its way; kept apart from the [`Play`], which a roll-back needs while it does not need this.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TakeUp {
    from: i32,
    to: i32,
    /// Segments since it began.
    elapsed: u32,
    /// A quarter of its duration.
    quarter: u32,
    /// 2^62 / quarter, and a twelfth of that times 16.
    inverse: [u64; 2],
}

impl TakeUp {
    /// Begins; the divisions are made here, once.
    #[cold]
    #[inline(never)]
    fn begin(from: i32, to: i32, quarter: u32) -> Self {
        let quarter = quarter.max(1);
        let inverse = wide::over_word(1 << 62, quarter);
        TakeUp { from, to, elapsed: 0, quarter, inverse: [inverse, wide::over_word(inverse, 3) * 4] }
    }

    /// Four phases of constant jerk, each a quarter: sigma = 16/3 x^3, then 1/2 - 2 y + 16/3 y^3 with y = 1/2 - x,
    /// and the mirror image. Peaks for a width b and duration T: 2 b/T, 8 b/T^2, 32 b/T^3. None at the end.
    #[inline(always)]
    fn advance(&mut self) -> Option<i64> {
        let TakeUp { from, to, quarter, inverse, .. } = *self;
        self.elapsed += 1;
        let n = self.elapsed;
        let duration = 4 * quarter;
        if n >= duration {
            return None;
        }
        let mirrored = n > 2 * quarter;
        let n = if mirrored { duration - n } else { n };
        let sigma = if n <= quarter {
            self.third(n)
        } else {
            // 1/2 - 2 y + 16/3 y^3 with y = m / (4 quarter)
            let m = 2 * quarter - n;
            let twice = u64::from(m).wrapping_mul(inverse[0]) >> 23; // m / (2 quarter) in Q40
            (1 << 39) - twice as i64 + self.third(m)
        };
        let sigma = if mirrored { (1 << 40) - sigma } else { sigma };
        let way = i64::from(to) - i64::from(from);
        Some((i64::from(from) << 32) + ((way * sigma) >> 8))
    }

    /// 16/3 (n/T)^3 in Q40, T being four quarters and n at most one: x^3 / 12 with x = n / quarter.
    #[inline(always)]
    fn third(&self, n: u32) -> i64 {
        let [inverse, twelfth] = self.inverse;
        let x = u64::from(n).wrapping_mul(inverse) >> 32; // Q30
        let y = u64::from(n).wrapping_mul(twelfth) >> 32; // x / 12 in Q34
        let square = (x as u32 as u64 * x as u32 as u64) >> 29; // Q31
        ((square as u32 as u64 * y as u32 as u64) >> 25) as i64
    }
}

/// On which side of the play a motor is, and since where: what the reversal rule remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Side {
    /// Farthest whole-step target reached on this flank.
    extreme: i32,
    flank: Flank,
    /// False after power-up, until homed or preloaded: the overlay then stays.
    known: bool,
}

/// State of one motor's play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Play {
    side: Side,
    /// Overlay at rest, whole steps.
    overlay: i32,
    /// No take-up is on its way, and the overlay is the wanted one as long as the motor does not turn.
    calm: bool,
    taking_up: bool,
}

impl Side {
    /// Steps beyond the extreme, in the direction of the flank.
    #[inline(always)]
    fn ahead(&self, target: i32) -> i32 {
        target.wrapping_sub(self.extreme).wrapping_mul(self.flank.sign())
    }
}

impl Play {
    /// At rest at a target with an overlay, on a known flank or on an unknown one.
    pub fn resting(target: i32, flank: Option<Flank>, overlay: i32) -> Self {
        Play {
            side: Side { extreme: target, flank: flank.unwrap_or_default(), known: flank.is_some() },
            overlay,
            calm: false,
            taking_up: false,
        }
    }

    /// The flank as tracked.
    pub fn flank(&self) -> Flank {
        self.side.flank
    }

    /// True once homed or preloaded.
    pub fn is_known(&self) -> bool {
        self.side.known
    }

    /// True while a take-up is on its way.
    pub fn is_taking_up(&self) -> bool {
        self.taking_up
    }

    /// True when a take-up would begin with the next move.
    pub fn owes(&self, config: &PlayConfig) -> bool {
        !self.is_taking_up() && self.wanted(config) != self.overlay
    }

    /// The overlay that the configuration wants now.
    #[inline(always)]
    fn wanted(&self, config: &PlayConfig) -> i32 {
        match config.overlay {
            Overlay::Follow if self.side.known => config.overlay_of(self.side.flank),
            Overlay::Fixed(flank) if self.side.known => config.overlay_of(flank),
            _ => self.overlay,
        }
    }

    /// Overlay at rest in whole steps (of a take-up on its way: where it began).
    pub fn overlay(&self) -> i32 {
        self.overlay
    }

    /// The reversal rule alone: true when the target turned the flank.
    #[inline(always)]
    pub fn turn(&mut self, target: i32, dead_band: i32) -> bool {
        let side = &mut self.side;
        let ahead = side.ahead(target);
        if ahead >= 0 {
            side.extreme = target;
            return false;
        }
        if -ahead <= dead_band {
            return false;
        }
        side.flank = side.flank.opposite();
        side.extreme = target;
        true
    }

    /// Most segments: the motor does not turn and nothing is to be taken up, so that the overlay stays. False when
    /// it may be otherwise: then [`Play::advance`] is due, and nothing has been changed.
    #[inline(always)]
    pub fn goes_on(&mut self, target: i32) -> bool {
        let goes_on = self.calm && self.side.ahead(target) >= 0;
        if goes_on {
            self.side.extreme = target;
        }
        goes_on
    }

    /// The configuration has changed.
    pub fn disturb(&mut self) {
        self.calm = false;
    }

    /// One segment that ends at `target` (whole steps): returns the overlay there in Q32 steps, and whether anything
    /// else than the overlay of a take-up on its way has changed.
    /// `moving`: a move is under way, so that a take-up may begin.
    #[inline(never)]
    pub fn advance(&mut self, take_up: &mut TakeUp, target: i32, moving: bool, config: &PlayConfig) -> (i64, bool) {
        let mut news = self.turn(target, config.dead_band);
        if !self.taking_up {
            let wanted = self.wanted(config);
            self.calm = self.overlay == wanted;
            if !moving || self.calm {
                return (i64::from(self.overlay) << 32, true);
            }
            *take_up = TakeUp::begin(self.overlay, wanted, config.quarter);
            self.taking_up = true;
            news = true;
        }
        if let Some(overlay) = take_up.advance() {
            return (overlay, news);
        }
        self.overlay = take_up.to;
        // the motor turned again meanwhile: the next one follows at once, even if the move is over
        let wanted = self.wanted(config);
        self.taking_up = wanted != self.overlay;
        if self.taking_up {
            *take_up = TakeUp::begin(self.overlay, wanted, config.quarter);
        }
        (i64::from(self.overlay) << 32, true)
    }

    /// Rolls back to rest at `target` with `overlay` whole steps, after an abort in the segment of which this
    /// is the start state. An unfinished take-up goes on with the next move.
    pub fn abort(&mut self, target: i32, overlay: i32, dead_band: i32) {
        self.turn(target, dead_band);
        self.overlay = overlay;
        self.taking_up = false;
        self.calm = false;
    }

    /// Moves the tracked extreme by whole steps when the count of the motor is re-anchored.
    pub fn shift(&mut self, by: i32) {
        self.side.extreme = self.side.extreme.wrapping_add(by);
    }
}
