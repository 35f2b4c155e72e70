//! A move that was checked, kept so that it need not be planned again.

use super::DryRun;
use crate::motion::budget::{Grant, Rates};
use crate::motion::profile::Profile;
use crate::units::{Pose, wide};
use core::ops::{Deref, DerefMut};

/// A value that counts how often it was given out to be changed: what was made of it can be told to be stale.
#[derive(Clone, Copy, Debug)]
pub struct Versioned<T> {
    value: T,
    version: u32,
}

impl<T> Versioned<T> {
    /// The first version.
    pub const fn new(value: T) -> Self {
        Versioned { value, version: 0 }
    }

    /// Changes so far; wraps.
    pub const fn version(&self) -> u32 {
        self.version
    }
}

impl<T> Deref for Versioned<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for Versioned<T> {
    fn deref_mut(&mut self) -> &mut T {
        self.version = self.version.wrapping_add(1);
        &mut self.value
    }
}

/// What a move from rest to rest, with nothing else running, is granted, and how it runs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Checked {
    pub from: Pose,
    pub to: Pose,
    /// Version of the capability that it was made of.
    pub version: u32,
    pub grant: Grant,
    pub profile: Profile,
}

impl Checked {
    pub fn dry_run(&self) -> DryRun {
        let peak = peak_velocity(&self.profile);
        let granted = u128::from(self.grant.limits.velocity.unsigned_abs().max(1));
        let rate = |uses: Rates| wide::div(u128::from(uses.velocity) * peak, granted) as u64;
        DryRun { segments: u64::from(self.profile.duration()), step_rates: self.grant.uses.map(rate) }
    }
}

/// Largest velocity of a profile from rest to rest, path units per segment in Q60.
fn peak_velocity(profile: &Profile) -> u128 {
    // the peak of a move from rest lies in its cruise, hence at half its duration
    let state = profile.state(profile.duration() / 2);
    state.velocity.unsigned_abs() >> 30
}
