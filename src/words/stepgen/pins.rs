//! The lines of the one port that carries every output, as bits of its set/reset register (BSRR).
//!
//! The lower half of a word sets lines, the upper half resets them, and where both name the same
//! line the set bit wins (RM0090, 8.4.7).

use crate::units::AXES;

/// STEP line of each motor.
pub const STEP_PINS: [u8; AXES] = [6, 14, 5, 13, 7, 15];

/// DIR line of each motor.
pub const DIR_PINS: [u8; AXES] = [4, 8, 9, 10, 11, 12];

/// Line of the trigger output (position compare).
pub const TRIGGER_PIN: u8 = 2;

/// Set bits of all STEP lines.
pub const STEP_MASK: u32 = mask(&STEP_PINS);

/// Set bits of all DIR lines.
pub const DIR_MASK: u32 = mask(&DIR_PINS);

/// Set bit of the trigger line.
pub const TRIGGER: u32 = 1 << TRIGGER_PIN;

/// The word that lowers every STEP line: what stands where no step is.
pub const RESET_STEPS: u32 = reset(STEP_MASK);

/// The bits that reset the lines which `set` sets.
pub const fn reset(set: u32) -> u32 {
    set << 16
}

const fn mask(pins: &[u8; AXES]) -> u32 {
    let mut mask = 0;
    let mut motor = 0;
    while motor < AXES {
        mask |= 1 << pins[motor];
        motor += 1;
    }
    mask
}

const _: () = {
    assert!(STEP_MASK.count_ones() as usize == AXES && DIR_MASK.count_ones() as usize == AXES);
    assert!(STEP_MASK & DIR_MASK == 0 && (STEP_MASK | DIR_MASK) & TRIGGER == 0);
    assert!((STEP_MASK | DIR_MASK) >> 16 == 0);
    // The Discovery board's accelerometer sits on these.
    assert!((STEP_MASK | DIR_MASK | TRIGGER) & 0b1011 == 0);
};
