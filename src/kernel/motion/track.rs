//! A track: one straight line in logical space and the profile that runs along it.

use super::profile::Profile;
use crate::units::{AXES, FinePose};

/// The path unit of a single-axis track is 2^28 nm or nrad, whatever its length, so that a re-plan never
/// rescales and a coordinate in Q32 is its path position in Q60.
pub const SINGLE_AXIS_UNIT_BITS: u32 = 28;

/// One straight line in logical space with a jerk-limited profile. What a track adds to the pose is
/// `origin + direction * s`, and exactly `end` once the profile has ended.
#[derive(Clone, Copy, Debug, Default)]
pub struct Track {
    /// Contribution at path position 0, nm or nrad in Q32.
    pub origin: [i64; AXES],
    /// Contribution of one path unit, nm or nrad in Q32.
    pub direction: [i64; AXES],
    /// Contribution once the profile has ended, exact.
    pub end: [i64; AXES],
    /// Path position over time.
    pub profile: Profile,
}

impl Track {
    /// What the track adds to the pose `elapsed` segments after its start, nm and nrad in Q32.
    /// `cursor` is the caller's memory of the phase, see [`Profile::position`].
    #[inline(always)]
    pub fn contribution(&self, elapsed: u32, cursor: &mut u8) -> [i64; AXES] {
        if elapsed >= self.profile.duration() {
            return self.end;
        }
        self.at(self.profile.position(elapsed, cursor))
    }

    /// What the track adds at a path position (Q60).
    pub fn at(&self, position: i64) -> [i64; AXES] {
        let mut sum = FinePose::default();
        self.add_to(&mut sum, position);
        sum.0
    }

    /// Adds to a pose what the track adds at a path position (Q60). Without a branch for axes that do not move: with
    /// one the compiler no longer sees that factors are 32 bits wide.
    #[inline(never)]
    pub fn add_to(&self, pose: &mut FinePose, position: i64) {
        // written out, because a loop over four arrays costs as much as half of what is in it
        let mut add = |i: usize| {
            pose.0[i] = pose.0[i].wrapping_add(self.origin[i]).wrapping_add(scale(self.direction[i], position));
        };
        add(0);
        add(1);
        add(2);
        add(3);
        add(4);
        add(5);
    }

    /// The axes that the track moves, bit n = axis n.
    pub fn axes(&self) -> u8 {
        let mut mask = 0;
        for (i, d) in self.direction.iter().enumerate() {
            mask |= u8::from(*d != 0) << i;
        }
        mask
    }
}

/// `length` (Q32) times `position` (Q60) in Q32, low to 64 units in the last place for lengths to 2^30: three products
/// of signed 32-bit numbers, the lower halves cut to 31 bits. The shift comes last, lest the compiler put it into a
/// factor, which would then need more than 32 bits.
#[inline(always)]
pub fn scale(length: i64, position: i64) -> i64 {
    let (lh, ll) = ((length >> 32) as i32, (length as u32 >> 1) as i32);
    let (ph, pl) = ((position >> 32) as i32, (position as u32 >> 1) as i32);
    let mixed = i64::from(lh) * i64::from(pl) + i64::from(ll) * i64::from(ph);
    (i64::from(lh) * i64::from(ph)).wrapping_add(mixed >> 31) << 4
}
