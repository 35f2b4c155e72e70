//! What survives: settings in flash, and where the motors stand.
//!
//! # Design
//! - [`record`] is what `*SAV` keeps: one sealed record, version, sequence number and CRC in front of it.
//! - [`flash`] keeps records in two sectors. A record is appended to the sector that holds the newest one; the other
//!   sector is erased only when that one is full, so the newest record is never in danger.
//! - [`standstill`] is where the motors stand: in every record, and in two copies in memory that outlives a reset.
//! - [`service`] joins them with the front: at start, and when a command asks for it.
//!
//! # Wear
//! Flash is written by `*SAV` and `SYSTem:PARK` alone, never by itself: an erase stalls the processor for up to half a
//! second, and a stage that comes to rest every other minute would wear its sectors out in a year and a half (1000
//! saves erase each of them 26 times, and it bears 10000 erases). Standstill between two saves is kept in the memory
//! that outlives a reset; a power cut in between costs the home position.

pub mod flash;
pub mod record;
pub mod service;
pub mod standstill;

pub use flash::Store;
pub use record::{Buffer, RECORD_CAPACITY, Record, Saved};
pub use standstill::Standstill;

use crate::error::{Error, ErrorNumber};

/// Why nothing could be saved or loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StoreError {
    /// The flash is not blank, and no record in it is whole.
    Damaged,
    /// The newest record is of this version, which is not known here.
    Version(u16),
    /// The record is whole, but what it says is not: a value beyond its range, a calibration that is none.
    Contents,
    /// The flash does not do as it is told.
    Flash,
    /// The record is longer than [`RECORD_CAPACITY`].
    TooLong,
}

impl StoreError {
    const fn reason(self) -> &'static str {
        match self {
            StoreError::Damaged => "no saved record is whole: set up anew and *SAV",
            StoreError::Version(_) => "saved by another version of the firmware: set up anew and *SAV",
            StoreError::Contents => "a saved value is beyond its range: set up anew and *SAV",
            StoreError::Flash => "the flash memory fails: replace the board",
            StoreError::TooLong => "record too long",
        }
    }

    /// The error of a start without the saved settings: 106.
    pub const fn at_start(self) -> Error {
        Error::text(ErrorNumber::SettingsLost, self.reason())
    }

    /// The error of a command that saves or recalls: -320.
    pub const fn at_work(self) -> Error {
        Error::text(ErrorNumber::StorageFault, self.reason())
    }
}
