//! Counts of a motor to lengths and angles, and back. A step size is Q32: units (nm or nrad) a step times 2^32.

use super::wide;

/// Whole units of a step count; saturates.
#[inline(never)]
pub fn steps_to_units(steps: i64, step_q32: u64) -> i64 {
    // in 64 bits where that is enough
    let (whole, part) = ((step_q32 >> 32) as u32, i64::from(step_q32 as u32));
    if let (Ok(steps), Ok(whole)) = (i32::try_from(steps), i32::try_from(whole)) {
        let (steps, whole) = (i64::from(steps), i64::from(whole));
        return steps * whole + ((steps * part + (1 << 31)) >> 32);
    }
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
