//! The watchdog is fed only while refill, controller and timer all run.

use core::sync::atomic::{AtomicU8, Ordering};
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::Timer;

/// The watchdog bites after this time without food, us: longer than the erase of a sector, 800 ms at most (data sheet,
/// table 40).
pub const BITE_US: u32 = 2_000_000;
/// Between two looks, ms.
const LOOK_MS: u64 = 100;

const REFILL: u8 = 1 << 0;
const CONTROLLER: u8 = 1 << 1;
const ALL: u8 = REFILL | CONTROLLER;
static SEEN: AtomicU8 = AtomicU8::new(0);

/// The refill ran.
#[inline(always)]
pub fn refill_ran() {
    if SEEN.load(Ordering::Relaxed) & REFILL == 0 {
        SEEN.fetch_or(REFILL, Ordering::Relaxed);
    }
}

/// The controller ended a turn.
pub fn controller_ran() {
    SEEN.fetch_or(CONTROLLER, Ordering::Relaxed);
}

/// Starts the watchdog; feed it with [`supervise`].
pub fn start(watchdog: embassy_stm32::Peri<'static, IWDG>) -> IndependentWatchdog<'static, IWDG> {
    let mut watchdog = IndependentWatchdog::new(watchdog, BITE_US);
    watchdog.unleash();
    watchdog
}

/// Feeds the watchdog while everybody runs.
#[embassy_executor::task]
pub async fn supervise(mut watchdog: IndependentWatchdog<'static, IWDG>) {
    loop {
        Timer::after_millis(LOOK_MS).await;
        let seen = SEEN.load(Ordering::Relaxed);
        if seen == ALL {
            SEEN.fetch_and(!ALL, Ordering::Relaxed);
            watchdog.pet();
        }
    }
}

/// Feeds the watchdog before the processor stands still for the erase of a sector.
pub fn before_an_erase() {
    embassy_stm32::pac::IWDG.kr().write(|w| w.set_key(embassy_stm32::pac::iwdg::vals::Key::RESET));
}
