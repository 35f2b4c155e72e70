//! Flash sectors 1 and 2: what the settings are kept in.
//!
//! # Limitations
//! The chip has one bank: while a sector is erased (400 ms, at most 800 ms: byte by byte, data sheet table 40) or a
//! word is programmed (16 us), the processor stands, interrupts and all. The step stream must stand too; DMA still
//! takes bytes in.

use super::supervision;
use embassy_stm32::flash::{Bank1Region1, Blocking, Error as FlashError, Flash, WRITE_SIZE};
use embassy_stm32::{Peri, pac, peripherals};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// Caches and prefetch on: without them five wait states are paid at every branch (RM0090, 3.5.2). The HAL leaves them
/// off.
pub fn accelerate() {
    pac::FLASH.acr().modify(|w| {
        w.set_icen(true);
        w.set_dcen(true);
        w.set_prften(true);
    });
}

/// What was read before it was erased or written is forgotten (RM0090, 3.5.2: only while the cache is off).
fn forget_what_was_read() {
    let acr = pac::FLASH.acr();
    acr.modify(|w| w.set_dcen(false));
    acr.modify(|w| w.set_dcrst(true));
    acr.modify(|w| w.set_dcrst(false));
    acr.modify(|w| w.set_dcen(true));
}

/// Where sector 1 begins, from the begin of the flash.
pub const START: u32 = 16 * 1024;

/// The four sectors of 16 KB, of which the settings use the second and third.
pub struct SettingsFlash(Bank1Region1<'static, Blocking>);

impl SettingsFlash {
    /// The chip's flash.
    pub fn new(flash: Peri<'static, peripherals::FLASH>) -> Self {
        SettingsFlash(Flash::new_blocking(flash).into_blocking_regions().bank1_region1)
    }
}

/// An error of the chip's flash controller.
#[derive(Debug)]
pub struct Failure(FlashError);

impl NorFlashError for Failure {
    fn kind(&self) -> NorFlashErrorKind {
        match self.0 {
            FlashError::Size => NorFlashErrorKind::OutOfBounds,
            FlashError::Unaligned => NorFlashErrorKind::NotAligned,
            _ => NorFlashErrorKind::Other,
        }
    }
}

impl ErrorType for SettingsFlash {
    type Error = Failure;
}

impl ReadNorFlash for SettingsFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.0.blocking_read(offset, bytes).map_err(Failure)
    }

    fn capacity(&self) -> usize {
        4 * Self::ERASE_SIZE
    }
}

impl NorFlash for SettingsFlash {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = 16 * 1024;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        let sectors = (from..to).step_by(Self::ERASE_SIZE);
        for sector in sectors {
            supervision::before_an_erase();
            let erased = self.0.blocking_erase(sector, sector + Self::ERASE_SIZE as u32);
            forget_what_was_read();
            erased.map_err(Failure)?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        let written = self.0.blocking_write(offset, bytes);
        forget_what_was_read();
        written.map_err(Failure)
    }
}
