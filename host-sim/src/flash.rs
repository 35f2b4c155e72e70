//! The flash that keeps settings: two sectors of 16 KB with the rules of the chip, and its ways to fail.
//!
//! # Design
//! A word of four bytes can be written once after an erase, an erase takes a whole sector. Work is counted in units,
//! one for each word and [`ERASE_UNITS`] for each erase, so that a test can cut the power in front of any unit; what is
//! under way is then left half done. With a file everything that is done goes there at once.

use crate::board::Seeded;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use stage_controller::store::Store;
use stage_controller::store::flash::SECTORS;
use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

/// Bytes of a sector.
pub const SECTOR: usize = 16 * 1024;
/// Bytes of all sectors.
pub const SIZE: usize = SECTOR * SECTORS as usize;
/// Units of work of an erase.
pub const ERASE_UNITS: u64 = 8;
/// Bytes that are written at a time.
const WORD: usize = 4;
const BLANK: u8 = 0xff;

/// How an erase, or the writing of a word, is left half done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// Erased from the lower end.
    FromStart,
    /// Erased from the upper end.
    FromEnd,
    /// Some bits everywhere; of a word too.
    Scattered(u64),
}

/// What does not work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// Everything works.
    #[default]
    None,
    /// The power fails in front of this unit of work, counted from now.
    PowerCut(u64, Cut),
    /// Writing fails, and says so.
    Writes,
    /// Writing does nothing, and does not say so.
    SilentWrites,
    /// Erasing fails, and says so.
    Erases,
    /// Erasing does nothing, and does not say so.
    SilentErases,
    /// Reading fails.
    Reads,
}

/// Why the flash refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// Address or length is no multiple of a word, or of a sector for an erase.
    NotAligned,
    /// Beyond the end.
    OutOfBounds,
    /// A word that is not erased was to be written.
    NotErased,
    /// The power has failed.
    NoPower,
    /// It is broken.
    Broken,
    /// Its file cannot be written.
    File,
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            FlashError::NotAligned => NorFlashErrorKind::NotAligned,
            FlashError::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// Two sectors.
#[derive(Debug)]
pub struct Flash {
    bytes: Vec<u8>,
    file: Option<File>,
    fault: Fault,
    units: u64,
    erases: [u64; SECTORS as usize],
}

impl Default for Flash {
    fn default() -> Self {
        Flash::blank()
    }
}

impl Flash {
    /// As it comes from the factory.
    pub fn blank() -> Self {
        Flash::holding(vec![BLANK; SIZE])
    }

    /// With this content, [`SIZE`] bytes.
    pub fn holding(mut bytes: Vec<u8>) -> Self {
        bytes.resize(SIZE, BLANK);
        Flash { bytes, file: None, fault: Fault::None, units: 0, erases: [0; SECTORS as usize] }
    }

    /// With the content of a file, which follows every change; one that does not exist is made.
    ///
    /// # Errors
    /// Those of the file; one of another length is none of ours.
    pub fn file(path: &Path) -> io::Result<Self> {
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        if bytes.is_empty() {
            bytes = vec![BLANK; SIZE];
            file.write_all_at(&bytes, 0)?;
        }
        if bytes.len() != SIZE {
            let text = format!("not a settings file: {} bytes instead of {SIZE}; name another one", bytes.len());
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        Ok(Flash { file: Some(file), ..Flash::holding(bytes) })
    }

    /// Its store, at address 0.
    pub const fn store(self) -> Store<Flash> {
        Store::new(self, 0)
    }

    /// What it holds.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Units of work done.
    pub const fn units(&self) -> u64 {
        self.units
    }

    /// Erases of each sector.
    pub const fn erases(&self) -> [u64; SECTORS as usize] {
        self.erases
    }

    /// From now on something does not work; [`Fault::None`]: power is back, everything works.
    pub const fn set_fault(&mut self, fault: Fault) {
        self.fault = fault;
    }

    /// True once the power has failed.
    pub fn is_dead(&self) -> bool {
        matches!(self.fault, Fault::PowerCut(0, _))
    }

    /// One unit of work; none when the power fails in front of it.
    fn work(&mut self) -> Option<()> {
        if let Fault::PowerCut(left, _) = &mut self.fault {
            if *left == 0 {
                return None;
            }
            *left -= 1;
            // the last one is left half done by whoever asks
        }
        self.units += 1;
        Some(())
    }

    fn check(&self, from: usize, length: usize, unit: usize) -> Result<(), FlashError> {
        if self.is_dead() {
            return Err(FlashError::NoPower);
        }
        if !from.is_multiple_of(unit) || !length.is_multiple_of(unit) {
            return Err(FlashError::NotAligned);
        }
        if from + length > self.bytes.len() { Err(FlashError::OutOfBounds) } else { Ok(()) }
    }

    fn keep(&self, from: usize, length: usize) -> Result<(), FlashError> {
        let Some(file) = &self.file else { return Ok(()) };
        file.write_all_at(&self.bytes[from..from + length], from as u64).map_err(|_| FlashError::File)
    }

    fn write_words(&mut self, from: usize, bytes: &[u8]) -> Result<(), FlashError> {
        for (word, new) in bytes.chunks(WORD).enumerate() {
            let at = from + word * WORD;
            if self.bytes[at..at + WORD] != [BLANK; WORD] {
                return Err(FlashError::NotErased);
            }
            let cut = self.fault;
            self.work().ok_or(FlashError::NoPower)?;
            if self.is_dead() {
                if let Fault::PowerCut(_, Cut::Scattered(seed)) = cut {
                    let bits = (Seeded::new(seed ^ self.units).next_u64() as u32).to_le_bytes();
                    (0..WORD).for_each(|k| self.bytes[at + k] = new[k] | bits[k]);
                }
                return Err(FlashError::NoPower);
            }
            if self.fault != Fault::SilentWrites {
                self.bytes[at..at + WORD].copy_from_slice(new);
            }
        }
        Ok(())
    }

    fn erase_sector(&mut self, sector: usize) -> Result<(), FlashError> {
        let range = sector * SECTOR..(sector + 1) * SECTOR;
        for done in 0..ERASE_UNITS as usize {
            let cut = self.fault;
            self.work().ok_or(FlashError::NoPower)?;
            if !self.is_dead() {
                continue;
            }
            let Fault::PowerCut(_, cut) = cut else { return Err(FlashError::NoPower) };
            let (whole, part) = (&mut self.bytes[range], SECTOR * done / (ERASE_UNITS as usize - 1));
            match cut {
                Cut::FromStart => whole[..part].fill(BLANK),
                Cut::FromEnd => whole[SECTOR - part..].fill(BLANK),
                Cut::Scattered(seed) => {
                    let mut seeded = Seeded::new(seed ^ self.units);
                    for byte in whole {
                        // the longer it has lasted, the more bits are back
                        for bit in 0..8 {
                            *byte |= u8::from(seeded.below(ERASE_UNITS) < done as u64) << bit;
                        }
                    }
                }
            }
            return Err(FlashError::NoPower);
        }
        if self.fault != Fault::SilentErases {
            self.bytes[range].fill(BLANK);
        }
        self.erases[sector] += 1;
        Ok(())
    }
}

impl ErrorType for Flash {
    type Error = FlashError;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let from = offset as usize;
        self.check(from, bytes.len(), Self::READ_SIZE)?;
        if self.fault == Fault::Reads {
            return Err(FlashError::Broken);
        }
        bytes.copy_from_slice(&self.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let (from, to) = (from as usize, to as usize);
        self.check(from, to.saturating_sub(from), SECTOR)?;
        if self.fault == Fault::Erases {
            return Err(FlashError::Broken);
        }
        let result = (from / SECTOR..to / SECTOR).try_for_each(|sector| self.erase_sector(sector));
        self.keep(from, to - from)?;
        result
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let from = offset as usize;
        self.check(from, bytes.len(), WORD)?;
        if self.fault == Fault::Writes {
            return Err(FlashError::Broken);
        }
        let result = self.write_words(from, bytes);
        self.keep(from, bytes.len())?;
        result
    }
}

/// Runs what never waits, as everything here.
///
/// # Panics
/// When it waits after all.
pub fn at_once<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("the virtual flash never waits"),
    }
}
