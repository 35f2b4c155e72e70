//! Clocks: 168 MHz from the 8 MHz crystal, or from the internal oscillator when the crystal is dead.
//!
//! The HAL waits for ever on a crystal that does not start, so it is probed first, with a bound.

use embassy_stm32::pac;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
};
use embassy_stm32::time::Hertz;

/// Core clock, Hz.
pub const CORE_HZ: u32 = 168_000_000;
/// Frequency of the board's crystal, Hz.
const CRYSTAL_HZ: u32 = 8_000_000;
/// A crystal starts within 2 ms (data sheet, table 39); this many looks at the internal 16 MHz take some 10 ms.
const LOOKS: u32 = 20_000;

/// True when the crystal starts.
pub fn probe_crystal() -> bool {
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    let alive = (0..LOOKS).any(|_| pac::RCC.cr().read().hserdy());
    if !alive {
        pac::RCC.cr().modify(|w| w.set_hseon(false));
    }
    alive
}

/// The clock tree: PLL input 2 MHz from either source, 336 MHz, 168 MHz core, 48 MHz USB, timers at 84 and 168 MHz.
pub fn configuration(crystal: bool) -> embassy_stm32::rcc::Config {
    let mut rcc = embassy_stm32::rcc::Config::default();
    let (source, divider) = if crystal { (PllSource::HSE, PllPreDiv::DIV4) } else { (PllSource::HSI, PllPreDiv::DIV8) };
    rcc.hse = crystal.then_some(Hse { freq: Hertz(CRYSTAL_HZ), mode: HseMode::Oscillator });
    rcc.hsi = !crystal;
    rcc.pll_src = source;
    rcc.pll = Some(Pll {
        prediv: divider,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    rcc.sys = Sysclk::PLL1_P;
    rcc.ahb_pre = AHBPrescaler::DIV1;
    rcc.apb1_pre = APBPrescaler::DIV4;
    rcc.apb2_pre = APBPrescaler::DIV2;
    rcc
}

/// From now on a crystal that dies raises the NMI (RM0090, 7.2.7).
pub fn guard_crystal() {
    pac::RCC.cr().modify(|w| w.set_csson(true));
}

/// Why the chip started.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum ResetCause {
    /// Power came (back).
    Power,
    /// The reset pin, or software: after flashing, or the crystal died.
    Request,
    /// The watchdog.
    Watchdog,
}

/// Reads the cause of the last reset, and clears it for the next one.
pub fn reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    if flags.wdgrstf() || flags.wwdgrstf() {
        ResetCause::Watchdog
    } else if flags.porrstf() || flags.borrstf() {
        ResetCause::Power
    } else {
        ResetCause::Request
    }
}
