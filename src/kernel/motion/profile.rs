//! A jerk-limited profile of one path parameter and its evaluation in the refill interrupt.
//!
//! A phase is a cubic in `tau = n / 2^K`, where `n` counts segments from the start of the phase
//! and `2^K` is at least its length: tau is exact in 32 bits, and the products stay i64 × u32.

use crate::units::wide;

/// Most phases a profile can have: lead-in, settling, stop (3) and rest-to-rest move (7).
pub const MAX_PHASES: usize = 12;

/// Fractional bits of the coefficients c1 to c3: two bits fewer than a position, because the
/// terms of a cubic can be larger than the way it describes.
pub(super) const COEFFICIENT_BITS: u32 = 58;

/// Position, velocity and acceleration of the path parameter at a segment border.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State {
    /// Path, Q60.
    pub position: i64,
    /// Path per segment, Q90.
    pub velocity: i128,
    /// Path per segment², Q90.
    pub acceleration: i128,
}

impl State {
    /// At rest at `position` (path, Q60).
    pub const fn rest(position: i64) -> State {
        State { position, velocity: 0, acceleration: 0 }
    }
}

/// One cubic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Phase {
    /// First segment border that no longer belongs to the phase.
    pub end: u32,
    /// Bits by which a segment count is shifted to become tau in Q32: 32 − K.
    pub shift: u8,
    /// Position at the start, Q60, then the coefficients of tau, tau² and tau³, Q58.
    pub c: [i64; 4],
}

/// A jerk-limited profile s(t), t in whole segments from its start.
///
/// Beyond the end of a profile that ends at rest stands the exact end position. A jog profile
/// goes on at its end velocity; see [`super::plan::to_velocity`].
#[derive(Clone, Copy, Debug)]
pub struct Profile {
    /// Behind the last of `count` stands what was there before: profiles are made over others.
    pub(super) phases: [Phase; MAX_PHASES],
    pub(super) count: u8,
    /// Segments until the goal is reached.
    pub(super) duration: u32,
    /// Position after the last phase, Q60.
    pub(super) last: i64,
    /// Position at `duration`, Q60.
    pub(super) end_position: i64,
    /// Velocity from `duration` on, Q60.
    pub(super) end_velocity: i64,
}

/// `c · tau / 2^(32 − up)` rounded down, without a 128-bit product.
#[inline(always)]
fn scaled(c: i64, tau: u32, up: u32) -> i64 {
    let high = (c >> 32).wrapping_mul(i64::from(tau)).wrapping_shl(up);
    let low = (u64::from(c as u32) * u64::from(tau)) >> (32 - up);
    high.wrapping_add(low as i64)
}

impl Default for Profile {
    /// At rest at zero. A constant: fields set one by one would be code for each of the phases.
    fn default() -> Self {
        const PHASE: Phase = Phase { end: 0, shift: 0, c: [0; 4] };
        const RESTING: Profile =
            Profile { phases: [PHASE; MAX_PHASES], count: 0, duration: 0, last: 0, end_position: 0, end_velocity: 0 };
        RESTING
    }
}

impl Profile {
    /// A profile that rests at `position` for ever.
    pub fn resting(position: i64) -> Profile {
        Profile { last: position, end_position: position, ..Profile::default() }
    }

    /// Position in Q60 at segment border `n`.
    ///
    /// `cursor` is the caller's memory of the phase it is in: 0 at first, then left alone. Any
    /// value is safe, and `n` may go back; only the search gets longer.
    #[inline]
    pub fn position(&self, n: u32, cursor: &mut u8) -> i64 {
        let phases = self.phases.get(..usize::from(self.count)).unwrap_or(&[]);
        let mut index = usize::from(*cursor).min(phases.len());
        while index > 0 && phases.get(index - 1).is_some_and(|before| n < before.end) {
            index -= 1;
        }
        while phases.get(index).is_some_and(|phase| n >= phase.end) {
            index += 1;
        }
        *cursor = index as u8;
        let Some(phase) = phases.get(index) else {
            return self.last;
        };
        let start = if index > 0 { phases[index - 1].end } else { 0 };
        // 2^K is at least the length, so the shift loses no bit.
        let tau = (n - start) << phase.shift;
        let [c0, c1, c2, c3] = phase.c;
        let inner = c2.wrapping_add(scaled(c3, tau, 0));
        let middle = c1.wrapping_add(scaled(inner, tau, 0));
        c0.wrapping_add(scaled(middle, tau, 60 - COEFFICIENT_BITS))
    }

    /// State at segment border `n`, from which a new profile can be planned. Not for the
    /// interrupt: 128-bit products.
    ///
    /// The position is bit for bit that of [`Profile::position`].
    pub fn state(&self, n: u32) -> State {
        let mut cursor = 0;
        let position = self.position(n, &mut cursor);
        if n >= self.duration {
            let running = usize::from(cursor) < usize::from(self.count);
            let velocity = if running { i128::from(self.end_velocity) << 30 } else { 0 };
            return State { position, velocity, acceleration: 0 };
        }
        let index = usize::from(cursor).min(MAX_PHASES - 1);
        let start = if index > 0 { self.phases[index - 1].end } else { 0 };
        let phase = &self.phases[index];
        let tau = (n - start) << phase.shift;
        // never beyond 128 bits: three of 64, 32 and 32
        let by_tau = |x: i128| wide::times(x, tau).unwrap_or(0);
        let [_, c1, c2, c3] = phase.c.map(i128::from);
        let k = 32 - u32::from(phase.shift);
        // Q58 with the 32 bits of tau is Q90.
        let steep = by_tau(c3) * 3;
        let velocity = ((c1 << 32) + 2 * by_tau(c2) + (by_tau(steep >> 16) >> 16)) >> k;
        let acceleration = ((c2 << 33) + 2 * steep) >> (2 * k);
        State { position, velocity, acceleration }
    }

    /// Lowest and highest position at the segment borders of a profile that ends at rest, Q60. Not for the interrupt,
    /// see [`Profile::state`].
    pub fn extent(&self) -> (i64, i64) {
        let (mut low, mut high) = (self.end_position, self.end_position);
        let mut from = 0;
        for phase in self.phases.iter().take(usize::from(self.count)) {
            // until its acceleration changes its sign the velocity is monotone, and has at most one zero
            let bend = self.change_of_sign(from, phase.end, |state| state.acceleration);
            for (from, to) in [(from, bend), (bend, phase.end)] {
                let turn = self.change_of_sign(from, to, |state| state.velocity);
                for n in [from, turn.saturating_sub(1), turn] {
                    let position = self.position(n, &mut 0);
                    (low, high) = (low.min(position), high.max(position));
                }
            }
            from = phase.end;
        }
        (low, high)
    }

    /// The first segment border behind `from` at which `rate`, monotone on the way to `to`, no longer has the sign
    /// that it has there; `to` if it keeps its sign.
    #[inline(never)]
    fn change_of_sign(&self, from: u32, to: u32, rate: fn(State) -> i128) -> u32 {
        let sign = rate(self.state(from)).signum();
        if sign * rate(self.state(to)).signum() >= 0 {
            return to;
        }
        let (mut same, mut other) = (from, to);
        while other - same > 1 {
            let middle = same.midpoint(other);
            if rate(self.state(middle)).signum() == sign { same = middle } else { other = middle }
        }
        other
    }

    /// Segments until the goal is reached.
    pub fn duration(&self) -> u32 {
        self.duration
    }

    /// Position in Q60 when the goal is reached: for a move to a position its exact target.
    pub fn end_position(&self) -> i64 {
        self.end_position
    }

    /// Velocity in Q60 path per segment from [`Profile::duration`] on: 0 unless a jog.
    pub fn end_velocity(&self) -> i64 {
        self.end_velocity
    }
}
