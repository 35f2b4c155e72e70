//! Critical sections below the refill: interrupts that move or stop motors are never masked by a library.
//!
//! Priorities (the upper four bits of a byte, smaller is more urgent; PM0214, 4.3):
//! stops above the refill above everything that Embassy runs. A critical section raises BASEPRI to the first priority
//! below the refill. Hence the refill and the stops must touch nothing that a critical section guards: they speak to
//! the thread through atomics and single-producer queues alone, and wake it through an interrupt of their own.

use cortex_m::register::{basepri, basepri_max};

/// Emergency stop, limit switches, errors of the step output.
pub const STOPS: u8 = 0x00;
/// The refill.
pub const REFILL: u8 = 0x10;
/// Critical sections mask this and what is less urgent.
pub const CEILING: u8 = 0x20;
/// What the refill wakes the thread through.
pub const WAKE: u8 = 0x20;

struct BelowTheRefill;
critical_section::set_impl!(BelowTheRefill);

// SAFETY: all that shares data under a critical section runs at CEILING or below; nesting restores what was.
unsafe impl critical_section::Impl for BelowTheRefill {
    unsafe fn acquire() -> critical_section::RawRestoreState {
        let before = basepri::read();
        basepri_max::write(CEILING);
        cortex_m::asm::isb();
        u32::from(before)
    }

    unsafe fn release(before: critical_section::RawRestoreState) {
        // SAFETY: restores the mask of before the section.
        unsafe { basepri::write(before as u8) };
    }
}
