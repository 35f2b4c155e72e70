//! Where the motors stand, so that a reset knows it.
//!
//! # Design
//! Sixty-four bytes with a sequence number and a CRC, in two copies that are written in turn: a reset while one is
//! written leaves the other one. The mark `moving` is written before the first order of a motion goes to the
//! generator; what is found with it after a reset was in motion, and its counts are not known.

use crate::units::{AXES, MotorSteps};

/// Bytes of a copy.
pub const STANDSTILL_BYTES: usize = 64;
/// Two copies: what is kept in memory that outlives a reset.
pub type Copies = [[u8; STANDSTILL_BYTES]; 2];

const VERSION: u8 = 1;
const CRC_AT: usize = STANDSTILL_BYTES - 4;
const COUNTS_AT: usize = 12;
const OVERLAY_AT: usize = COUNTS_AT + 4 * AXES;
const CRC: crc::Crc<u32, crc::NoTable> = crc::Crc::<u32, crc::NoTable>::new(&crc::CRC_32_ISO_HDLC);

/// Counts, overlays, flanks and what is known of them. Bit n of a mask: motor or axis n.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Standstill {
    /// Motor counts, overlay included.
    pub counts: MotorSteps,
    /// Overlays of the backlash, whole steps.
    pub overlay: [i32; AXES],
    /// The flank of the motor is known.
    pub known: u8,
    /// The motor rests on the negative flank.
    pub negative: u8,
    /// The axis is homed.
    pub homed: u8,
    /// The position of the axis is uncertain.
    pub uncertain: u8,
    /// Something moves, or is about to: the counts are those of the last standstill.
    pub moving: bool,
}

impl Standstill {
    /// The bytes of a copy.
    pub fn encode(&self, sequence: u32) -> [u8; STANDSTILL_BYTES] {
        let mut bytes = [0; STANDSTILL_BYTES];
        let flags =
            [VERSION, u8::from(self.moving), self.known, self.negative, self.homed, self.uncertain, 0, 0].into_iter();
        let numbers = self.counts.0.iter().chain(&self.overlay).flat_map(|n| n.to_le_bytes());
        let all = flags.chain(sequence.to_le_bytes()).chain(numbers);
        bytes.iter_mut().zip(all).for_each(|(to, from)| *to = from);
        let (body, crc) = bytes.split_at_mut(CRC_AT);
        crc.copy_from_slice(&CRC.checksum(body).to_le_bytes());
        bytes
    }

    /// The sequence number and the content of a copy; none when it is not whole or of another version.
    pub fn decode(bytes: &[u8; STANDSTILL_BYTES]) -> Option<(u32, Self)> {
        let word = |at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
        let [VERSION, moving @ 0..=1, known, negative, homed, uncertain, 0, 0, ..] = *bytes else { return None };
        if word(CRC_AT)? != CRC.checksum(bytes.get(..CRC_AT)?) {
            return None;
        }
        let mut standstill = Standstill { known, negative, homed, uncertain, moving: moving == 1, ..Self::default() };
        for i in 0..AXES {
            standstill.counts.0[i] = word(COUNTS_AT + 4 * i)? as i32;
            standstill.overlay[i] = word(OVERLAY_AT + 4 * i)? as i32;
        }
        Some((word(8)?, standstill))
    }
}

/// Decides when a copy is written, and which one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Keeper {
    sequence: u32,
    last: Option<Standstill>,
    /// The copy that says that motion begins, made beforehand: a move need not wait for it.
    begin: Option<[u8; STANDSTILL_BYTES]>,
}

impl Keeper {
    /// What the copies tell after a start: the newest whole one.
    pub fn recover(copies: &Copies) -> (Self, Option<Standstill>) {
        let [first, second] = copies.each_ref().map(Standstill::decode);
        let newest = match (first, second) {
            (Some(a), Some(b)) if b.0.wrapping_sub(a.0) < 1 << 31 => Some(b),
            (Some(a), _) => Some(a),
            (None, b) => b,
        };
        let (sequence, last) = newest.unzip();
        (Keeper { sequence: sequence.unwrap_or(0), last, begin: None }, last)
    }

    /// The copy to be written before anything else happens, and its number; none while nothing has changed.
    /// Of a motion only its begin is written: the counts of the standstill before it.
    pub fn update(&mut self, now: Standstill) -> Option<(usize, [u8; STANDSTILL_BYTES])> {
        if self.last == Some(now) || now.moving && self.last.is_some_and(|last| last.moving) {
            return None;
        }
        let (mut rest, mut start) = (now, now);
        (rest.moving, start.moving) = (false, true);
        let prepared = self.begin.take().filter(|_| now.moving && self.last == Some(rest));
        self.sequence = self.sequence.wrapping_add(1);
        self.last = Some(now);
        let copy = prepared.unwrap_or_else(|| now.encode(self.sequence));
        self.begin = (!now.moving).then(|| start.encode(self.sequence.wrapping_add(1)));
        Some(((self.sequence & 1) as usize, copy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Standstill {
        Standstill {
            counts: MotorSteps([1, -2, 3, i32::MAX, i32::MIN, 0]),
            overlay: [0, -6, 0, 7, 0, 1 << 20],
            known: 0b111110,
            negative: 0b1010,
            homed: 0b110000,
            uncertain: 0b1,
            moving: false,
        }
    }

    #[test]
    fn a_copy_comes_back() {
        assert_eq!(Standstill::decode(&example().encode(7)), Some((7, example())));
    }

    #[test]
    fn no_single_wrong_bit_and_no_memory_of_one_value_passes() {
        let bytes = example().encode(7);
        for bit in 0..8 * STANDSTILL_BYTES {
            let mut wrong = bytes;
            wrong[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Standstill::decode(&wrong), None, "bit {bit}");
        }
        for value in 0..=255 {
            assert_eq!(Standstill::decode(&[value; STANDSTILL_BYTES]), None);
        }
    }

    #[test]
    fn a_reset_at_any_byte_of_a_copy_leaves_the_one_before_or_the_new_one() {
        let mut copies: Copies = [[0xa5; STANDSTILL_BYTES]; 2];
        let (mut keeper, found) = Keeper::recover(&copies);
        assert_eq!(found, None);
        // across the end of the sequence numbers too
        keeper.sequence = u32::MAX - 20;
        let mut before = None;
        for n in 0..41 {
            let now = Standstill { counts: MotorSteps([n / 2; AXES]), moving: n % 2 == 1, ..example() };
            let (which, bytes) = keeper.update(now).expect("it has changed");
            for cut in 0..=STANDSTILL_BYTES {
                let mut torn = copies;
                torn[which][..cut].copy_from_slice(&bytes[..cut]);
                let (_, found) = Keeper::recover(&torn);
                let expected = if torn[which] == bytes { Some(now) } else { before };
                assert_eq!(found, expected, "cut after {cut} bytes of copy {n}");
            }
            copies[which] = bytes;
            before = Some(now);
        }
    }

    #[test]
    fn nothing_is_written_while_nothing_changes_or_while_it_moves_on() {
        let (mut keeper, _) = Keeper::recover(&[[0; STANDSTILL_BYTES]; 2]);
        assert!(keeper.update(example()).is_some());
        assert!(keeper.update(example()).is_none());
        let moving = Standstill { moving: true, ..example() };
        assert!(keeper.update(moving).is_some());
        assert!(keeper.update(Standstill { counts: MotorSteps([9; AXES]), ..moving }).is_none());
        assert!(keeper.update(example()).is_some(), "at rest again, where it was");
    }
}
