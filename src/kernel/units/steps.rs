//! Counts of a motor to lengths and angles, and back. A step size is Q32: units (nm or nrad) a step times 2^32.

use super::wide;

/// Whole units of a step count; saturates.
#[inline(never)]
pub fn steps_to_units(steps: i64, step_q32: u64) -> i64 {
    let units = (i128::from(steps) * i128::from(step_q32) + (1 << 31)) >> 32;
    wide::within(units, i64::MIN.into(), i64::MAX.into()) as i64
}

/// Steps nearest to a length, halves away from zero.
#[inline(never)]
pub fn units_to_steps(units: i64, step_q32: u64) -> i64 {
    let doubled = wide::div(u128::from(units.unsigned_abs()) << 33, u128::from(step_q32.max(1)));
    let steps = ((doubled + 1) >> 1) as i64;
    if units < 0 { -steps } else { steps }
}
