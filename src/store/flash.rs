//! Records in two flash sectors.
//!
//! # Design
//! Each sector is a queue of `sequential-storage` with a single page; the newest record is the whole one with the
//! highest sequence number in either. A save appends to the sector of the newest record and reads it back. When that
//! sector is full, or does not take it, the *other* one is erased and written. So a power cut at any moment leaves the
//! old record or the new one: a record that is cut short has a wrong CRC, and a sector whose erase is cut short holds
//! nothing but older records.
//!
//! The queue can erase pages by itself to repair them; here it is never given the chance, because what looks damaged to
//! it may be the only copy: the sector that it is given can be written at most, not erased.

use super::StoreError;
use super::record::{self, Buffer, Record, Saved};
use super::standstill::Standstill;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::queue::{QueueConfig, QueueStorage};

/// Sectors that are used in turn.
pub const SECTORS: u32 = 2;
/// Bytes looked at in one go for whether a sector is blank.
const CHUNK: usize = 64;

/// Two neighbouring sectors, each one erase unit of the flash.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    start: u32,
}

/// Where the newest record is.
#[derive(Clone, Copy, Debug)]
struct Newest {
    sector: u32,
    sequence: u32,
}

impl<F: NorFlash> Store<F> {
    /// The sectors begin at `start`, an address of the flash and a multiple of its erase unit.
    pub const fn new(flash: F, start: u32) -> Self {
        Store { flash, start }
    }

    /// The flash.
    pub const fn flash(&mut self) -> &mut F {
        &mut self.flash
    }

    /// The newest record; none on a blank flash, where nothing was ever saved. Writes nothing.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Version`], [`StoreError::Contents`], [`StoreError::Flash`].
    pub async fn load<'b>(&mut self, buffer: &'b mut Buffer) -> Result<Option<Saved<'b>>, StoreError> {
        let Some(newest) = self.newest(buffer).await? else {
            return if self.is_blank(0).await? && self.is_blank(1).await? {
                Ok(None)
            } else {
                Err(StoreError::Damaged)
            };
        };
        let length = self.fetch(newest, buffer).await?;
        record::decode(buffer.get(..length).ok_or(StoreError::Damaged)?).map(Some)
    }

    /// Saves a record. With an error the one before is still there.
    ///
    /// # Errors
    /// [`StoreError::Flash`], [`StoreError::TooLong`].
    pub async fn save(
        &mut self,
        record: &Record<'_>,
        standstill: &Standstill,
        buffer: &mut Buffer,
    ) -> Result<(), StoreError> {
        let newest = self.newest(buffer).await?;
        self.append(newest, None, record, standstill, buffer).await
    }

    /// Saves where the motors stand; the saved settings stay as they are. Where none are saved, `record` is.
    ///
    /// # Errors
    /// As [`Store::save`].
    pub async fn park(
        &mut self,
        record: &Record<'_>,
        standstill: &Standstill,
        buffer: &mut Buffer,
    ) -> Result<(), StoreError> {
        let newest = self.newest(buffer).await?;
        let mut kept = None;
        if let Some(newest) = newest {
            let length = self.fetch(newest, buffer).await?;
            // what cannot be read by this firmware cannot be kept either
            kept = buffer.get(..length).is_some_and(|bytes| record::decode(bytes).is_ok()).then_some(newest);
        }
        self.append(newest, kept, record, standstill, buffer).await
    }

    /// Writes behind the newest record, or into the other sector.
    async fn append(
        &mut self,
        newest: Option<Newest>,
        kept: Option<Newest>,
        record: &Record<'_>,
        standstill: &Standstill,
        buffer: &mut Buffer,
    ) -> Result<(), StoreError> {
        let sequence = newest.map_or(1, |newest| newest.sequence.wrapping_add(1));
        let places = match newest {
            Some(Newest { sector, .. }) => [(sector, false), (1 - sector, true)],
            None => [(0, !self.is_blank(0).await?), (1, true)],
        };
        let mut result = Err(StoreError::Flash);
        for (sector, erase) in places {
            if erase {
                let (from, to) = self.range(sector);
                if self.flash.erase(from, to).await.is_err() {
                    continue;
                }
            }
            // the buffer is needed to read back, so it is filled anew for each attempt
            let length = match kept {
                Some(kept) => {
                    let length = self.fetch(kept, buffer).await?;
                    record::reseal(standstill, sequence, buffer.get_mut(..length).ok_or(StoreError::Damaged)?)?;
                    length
                }
                None => record::seal(record, standstill, sequence, buffer)?,
            };
            let bytes = buffer.get(..length).ok_or(StoreError::TooLong)?;
            let written = match self.queue(sector, true) {
                Some(mut queue) => queue.push(bytes, false).await.is_ok(),
                None => false,
            };
            if written && self.newest_in(sector, buffer).await?.is_some_and(|found| found.sequence == sequence) {
                result = Ok(());
                break;
            }
        }
        result
    }

    async fn newest(&mut self, buffer: &mut Buffer) -> Result<Option<Newest>, StoreError> {
        let first = self.newest_in(0, buffer).await?;
        let second = self.newest_in(1, buffer).await?;
        Ok(match (first, second) {
            (Some(a), Some(b)) if b.sequence.wrapping_sub(a.sequence) < 1 << 31 => Some(b),
            (a, b) => a.or(b),
        })
    }

    async fn newest_in(&mut self, sector: u32, buffer: &mut Buffer) -> Result<Option<Newest>, StoreError> {
        let mut newest: Option<u32> = None;
        self.walk(sector, buffer, |_, sequence| {
            if newest.is_none_or(|newest| sequence.wrapping_sub(newest) < 1 << 31) {
                newest = Some(sequence);
            }
            false
        })
        .await?;
        Ok(newest.map(|sequence| Newest { sector, sequence }))
    }

    /// Leaves a record in the buffer; says how long it is.
    async fn fetch(&mut self, which: Newest, buffer: &mut Buffer) -> Result<usize, StoreError> {
        let found = self.walk(which.sector, buffer, |_, sequence| sequence == which.sequence).await?;
        found.ok_or(StoreError::Damaged)
    }

    /// Visits the whole records of a sector until `visit` says that it has found what it wanted: the length of that
    /// one, which is then in the buffer.
    async fn walk(
        &mut self,
        sector: u32,
        buffer: &mut Buffer,
        mut visit: impl FnMut(u16, u32) -> bool,
    ) -> Result<Option<usize>, StoreError> {
        let Some(mut queue) = self.queue(sector, false) else { return Err(StoreError::Flash) };
        let mut items = match queue.iter().await {
            Ok(items) => items,
            Err(error) => return nothing_unless_flash(&error),
        };
        loop {
            let length = match items.next(buffer).await {
                Ok(Some(item)) => {
                    let found = record::inspect(&item).is_some_and(|(version, sequence)| visit(version, sequence));
                    if !found {
                        continue;
                    }
                    item.len()
                }
                Ok(None) => return Ok(None),
                Err(error) => return nothing_unless_flash(&error),
            };
            return Ok(Some(length));
        }
    }

    async fn is_blank(&mut self, sector: u32) -> Result<bool, StoreError> {
        let (mut at, end) = self.range(sector);
        let mut chunk = [0; CHUNK];
        while at < end {
            let part = chunk.get_mut(..CHUNK.min((end - at) as usize)).ok_or(StoreError::Flash)?;
            self.flash.read(at, part).await.map_err(|_| StoreError::Flash)?;
            if part.iter().any(|byte| *byte != 0xff) {
                return Ok(false);
            }
            at += part.len() as u32;
        }
        Ok(true)
    }

    const fn range(&self, sector: u32) -> (u32, u32) {
        let from = self.start + sector * F::ERASE_SIZE as u32;
        (from, from + F::ERASE_SIZE as u32)
    }

    fn queue(&mut self, sector: u32, writable: bool) -> Option<Queue<'_, F>> {
        let start = self.range(sector).0;
        let config = QueueConfig::try_new(0..F::ERASE_SIZE as u32).ok()?;
        Some(QueueStorage::new(Sector { flash: &mut self.flash, start, writable }, config, Cache::new_uncached()))
    }
}

type Queue<'f, F> = QueueStorage<Sector<'f, F>, Cache<Uncached, Uncached, Uncached>>;

/// Whatever the queue cannot read is no record; a flash that cannot be read is another matter.
fn nothing_unless_flash<T>(error: &sequential_storage::Error<SectorError>) -> Result<Option<T>, StoreError> {
    match error {
        sequential_storage::Error::Storage { value: SectorError::Flash, .. } => Err(StoreError::Flash),
        _ => Ok(None),
    }
}

/// One sector as the queue sees it, from address 0.
struct Sector<'f, F> {
    flash: &'f mut F,
    start: u32,
    writable: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SectorError {
    /// The flash itself.
    Flash,
    /// An erase, or a write while only reading.
    Refused,
}

impl NorFlashError for SectorError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<F> ErrorType for Sector<'_, F> {
    type Error = SectorError;
}

impl<F: NorFlash> ReadNorFlash for Sector<'_, F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), SectorError> {
        self.flash.read(self.start + offset, bytes).await.map_err(|_| SectorError::Flash)
    }

    fn capacity(&self) -> usize {
        F::ERASE_SIZE
    }
}

impl<F: NorFlash> NorFlash for Sector<'_, F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, _: u32, _: u32) -> Result<(), SectorError> {
        Err(SectorError::Refused)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), SectorError> {
        if !self.writable {
            return Err(SectorError::Refused);
        }
        self.flash.write(self.start + offset, bytes).await.map_err(|_| SectorError::Flash)
    }
}
