//! Backup SRAM: keeps where the motors stand over a reset, and over a power cut where VBAT is fed (RM0090, 5.1.2).

use core::ptr::{read_volatile, write_volatile};
use embassy_stm32::pac;
use stage_controller::store::standstill::{Copies, STANDSTILL_BYTES};

/// Begin of the backup SRAM (RM0090, table 1).
const START: usize = 0x4002_4000;
/// Looks at the regulator's ready flag; it takes well below a millisecond.
const LOOKS: u32 = 100_000;

/// The two copies.
pub struct Backup(());

impl Backup {
    /// Opens the domain for writing.
    ///
    /// # Panics
    /// When called a second time.
    pub fn open() -> Self {
        static ONCE: static_cell::ConstStaticCell<()> = static_cell::ConstStaticCell::new(());
        ONCE.take();
        pac::RCC.apb1enr().modify(|w| w.set_pwren(true));
        pac::PWR.cr1().modify(|w| w.set_dbp(true));
        pac::RCC.ahb1enr().modify(|w| w.set_bkpsramen(true));
        pac::PWR.csr1().modify(|w| w.set_bre(true));
        // without its regulator it still keeps over a reset: the bound is no error
        let _ = (0..LOOKS).any(|_| pac::PWR.csr1().read().brr());
        Backup(())
    }

    /// What the copies hold, whole or not.
    pub fn read(&self) -> Copies {
        let mut copies = [[0; STANDSTILL_BYTES]; 2];
        for (n, byte) in copies.as_flattened_mut().iter_mut().enumerate() {
            // SAFETY: inside the backup SRAM, which is clocked.
            *byte = unsafe { read_volatile((START + n) as *const u8) };
        }
        copies
    }

    /// Writes one of the copies.
    pub fn write(&mut self, copy: usize, bytes: &[u8; STANDSTILL_BYTES]) {
        let start = START + (copy & 1) * STANDSTILL_BYTES;
        for (n, word) in bytes.as_chunks::<4>().0.iter().enumerate() {
            // SAFETY: inside the backup SRAM, clocked and open for writing; aligned.
            unsafe { write_volatile((start + 4 * n) as *mut u32, u32::from_le_bytes(*word)) };
        }
    }
}
