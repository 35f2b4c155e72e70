//! A move that was checked, kept so that it need not be planned again.

use super::share::alone;
use super::{Capability, DryRun, go_along, straight, unplannable};
use crate::error::Error;
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
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Checked {
    /// There is one: it goes somewhere, and nothing is in its way.
    pub valid: bool,
    pub from: Pose,
    pub to: Pose,
    /// Version of the capability that it was made of.
    pub version: u32,
    pub grant: Grant,
    pub profile: Profile,
}

impl Checked {
    /// Looks at a move as if nothing else ran, here, because a profile is large.
    ///
    /// # Errors
    /// What [`Limits::check_move`] and [`Limits::check_motors`] say of it.
    ///
    /// [`Limits::check_move`]: crate::motion::limits::Limits::check_move
    /// [`Limits::check_motors`]: crate::motion::limits::Limits::check_motors
    #[inline(never)]
    pub fn look_at(&mut self, capability: &Versioned<Capability>, from: Pose, to: Pose) -> Result<(), Error> {
        self.valid = false;
        capability.limits.check_move(&capability.law, from, to)?;
        let path = straight(&from.fine(), &to.fine());
        if path.goes_nowhere() {
            return Ok(());
        }
        alone(capability, &path, &mut self.grant)?;
        go_along(capability, &self.grant, &mut self.profile).ok_or_else(unplannable)?;
        (self.from, self.to, self.version) = (from, to, capability.version());
        self.valid = true;
        Ok(())
    }

    pub fn dry_run(&self) -> DryRun {
        if !self.valid {
            return DryRun::default();
        }
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
