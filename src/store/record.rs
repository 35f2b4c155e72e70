//! The record that `*SAV` keeps.
//!
//! Layout: magic `SREC`, version (u16), zero (u16), sequence number (u32), CRC-32 (ISO-HDLC, of all but itself), where
//! the motors stood (64 bytes, [`Standstill`]), payload (postcard's bytes, by [`Wire`]). The first sixteen bytes are
//! the same in every version, so that a record of another version is known as one.

use super::StoreError;
use super::standstill::{STANDSTILL_BYTES, Standstill};
use crate::controller::front::PIVOTS;
use crate::settings::Settings;
use crate::wire::Wire;
use serde::{Deserialize, Serialize};

/// Version of the record. Raised when a field changes; `decode` then reads the older ones too.
pub const RECORD_VERSION: u16 = 2;
/// Longest record in bytes: the largest calibration block and every number at its longest.
pub const RECORD_CAPACITY: usize = 2304;
/// Room for a record, for everything that reads or writes one; may be used for other things in between.
pub type Buffer = [u8; RECORD_CAPACITY];

const MAGIC: [u8; 4] = *b"SREC";
const CRC_AT: usize = 12;
const STANDSTILL_AT: usize = 16;
const PAYLOAD_AT: usize = STANDSTILL_AT + STANDSTILL_BYTES;
const CRC: crc::Crc<u32, crc::NoTable> = crc::Crc::<u32, crc::NoTable>::new(&crc::CRC_32_ISO_HDLC);

/// Everything that `*SAV` keeps, but where the motors stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record<'a> {
    /// The settings.
    pub settings: Settings,
    /// Rotation centres in the fibre array frame, 1/16 nm.
    pub pivots: [Option<[i32; 3]>; PIVOTS],
    /// The one in use.
    pub pivot: u8,
    /// The calibration block as loaded; empty without one.
    pub block: &'a [u8],
}

impl<'a> Record<'a> {
    #[inline(never)]
    fn wire(&mut self, wire: &mut Wire<'a>, version: u16) {
        self.settings.wire(wire, version);
        for pivot in &mut self.pivots {
            if let Some(point) = wire.some(pivot) {
                wire.all_signed(point);
            }
        }
        wire.byte(&mut self.pivot);
        wire.bytes(&mut self.block);
    }
}

/// What a record gives back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Saved<'a> {
    /// The settings and the calibration.
    pub record: Record<'a>,
    /// Where the motors stood when it was saved; none if that was in motion or is not whole.
    pub standstill: Option<Standstill>,
}

/// Writes a record; says how long it is.
///
/// # Errors
/// [`StoreError::TooLong`].
pub fn seal(
    record: &Record<'_>,
    standstill: &Standstill,
    sequence: u32,
    buffer: &mut Buffer,
) -> Result<usize, StoreError> {
    let (_, payload) = buffer.split_at_mut_checked(PAYLOAD_AT).ok_or(StoreError::TooLong)?;
    let mut wire = Wire::write(payload);
    let mut copy = *record;
    copy.wire(&mut wire, RECORD_VERSION);
    let length = PAYLOAD_AT + wire.end().ok_or(StoreError::TooLong)?;
    let head = MAGIC.into_iter().chain(RECORD_VERSION.to_le_bytes()).chain([0, 0]);
    buffer.iter_mut().zip(head).for_each(|(to, from)| *to = from);
    reseal(standstill, sequence, buffer.get_mut(..length).ok_or(StoreError::TooLong)?)?;
    Ok(length)
}

/// Lets a record say that the motors stand somewhere else; everything else in it stays.
///
/// # Errors
/// [`StoreError::Damaged`] when it is too short for one.
pub fn reseal(standstill: &Standstill, sequence: u32, bytes: &mut [u8]) -> Result<(), StoreError> {
    let place = bytes.get_mut(STANDSTILL_AT..PAYLOAD_AT).ok_or(StoreError::Damaged)?;
    place.copy_from_slice(&standstill.encode(sequence));
    let (head, rest) = bytes.split_at_mut_checked(STANDSTILL_AT).ok_or(StoreError::Damaged)?;
    let (front, crc) = head.split_at_mut_checked(CRC_AT).ok_or(StoreError::Damaged)?;
    if let Some(place) = front.last_chunk_mut() {
        *place = sequence.to_le_bytes();
    }
    crc.copy_from_slice(&checksum(front, rest).to_le_bytes());
    Ok(())
}

fn checksum(front: &[u8], rest: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(front);
    digest.update(rest);
    digest.finalize()
}

/// Version and sequence number of a record that is whole, of whatever version.
pub fn inspect(bytes: &[u8]) -> Option<(u16, u32)> {
    let (head, rest) = bytes.split_at_checked(STANDSTILL_AT)?;
    let (front, crc) = head.split_at_checked(CRC_AT)?;
    if !front.starts_with(&MAGIC) || checksum(front, rest).to_le_bytes() != *crc {
        return None;
    }
    let version = u16::from_le_bytes(*front.get(4..)?.first_chunk()?);
    Some((version, u32::from_le_bytes(*front.last_chunk()?)))
}

/// Reads a record.
///
/// # Errors
/// [`StoreError::Damaged`], [`StoreError::Version`], [`StoreError::Contents`].
pub fn decode(bytes: &[u8]) -> Result<Saved<'_>, StoreError> {
    let (version, _) = inspect(bytes).ok_or(StoreError::Damaged)?;
    if !(1..=RECORD_VERSION).contains(&version) {
        return Err(StoreError::Version(version));
    }
    let place = bytes.get(STANDSTILL_AT..).and_then(|rest| rest.first_chunk()).ok_or(StoreError::Contents)?;
    let payload = bytes.get(PAYLOAD_AT..).ok_or(StoreError::Contents)?;
    let mut record = Record { settings: Settings::defaults(None), pivots: [None; PIVOTS], pivot: 0, block: &[] };
    let mut wire = Wire::read(payload);
    record.wire(&mut wire, version);
    wire.end().ok_or(StoreError::Contents)?;
    let standstill =
        Standstill::decode(place).map(|(_, standstill)| standstill).filter(|standstill| !standstill.moving);
    Ok(Saved { record, standstill })
}
