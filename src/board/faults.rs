//! The safe state: no step, drivers disabled, the watchdog starts the board anew.

use super::{gpio, pins, step_dma};
use core::sync::atomic::{AtomicU8, Ordering};
use cortex_m_rt::exception;
use embassy_stm32::pac;

/// Levels of the enable lines at which all drivers are disabled: active low until settings say otherwise.
static DISABLED: AtomicU8 = AtomicU8::new(0x3f);

/// Names the levels of the enable lines at which all drivers are disabled.
pub fn set_disabled_levels(levels: u8) {
    DISABLED.store(levels, Ordering::Relaxed);
}

/// Stops the steps and disables all drivers, whatever else is broken.
pub fn make_safe() {
    step_dma::stop();
    gpio::write(pac::GPIOC, pins::enable_word(DISABLED.load(Ordering::Relaxed)));
    gpio::write(pac::GPIOD, pins::LIGHTS[2].bit());
}

/// The safe state until the watchdog starts the board anew (error 111).
fn halt() -> ! {
    cortex_m::interrupt::disable();
    make_safe();
    loop {
        cortex_m::asm::nop();
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    make_safe();
    // its text and place would bring every message, every file name and core::fmt into the flash: 2 KB
    defmt::error!("panic");
    halt()
}

/// Anything that the processor cannot do, an overflow of the stack among it: the stack that is left cannot be trusted,
/// so it begins anew.
#[exception(trampoline = false)]
unsafe fn HardFault() -> ! {
    // SAFETY: nothing returns to what was interrupted.
    unsafe {
        core::arch::asm!(
            "movw r0, #:lower16:_stack_start",
            "movt r0, #:upper16:_stack_start",
            "mov sp, r0",
            "b {broken}",
            broken = sym broken,
            options(noreturn)
        )
    }
}

extern "C" fn broken() -> ! {
    cortex_m::interrupt::disable();
    make_safe();
    defmt::error!("hard fault");
    halt()
}

/// Any interrupt that nobody handles.
#[exception]
unsafe fn DefaultHandler(_number: i16) {
    halt();
}

/// The crystal has died: the hardware runs on the internal oscillator now, at a tenth of the speed. Everything is timed
/// wrongly, so the board starts anew and finds out by itself.
#[exception]
unsafe fn NonMaskableInt() {
    make_safe();
    pac::RCC.cir().modify(|w| w.set_cssc(true));
    cortex_m::peripheral::SCB::sys_reset();
}
