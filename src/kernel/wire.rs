//! Numbers to bytes and back: one description of a record serves both ways.
//!
//! The bytes are those of postcard: a `u8` and a `bool` as they are, larger numbers seven bits a byte from the least on
//! with the top bit saying that more follow, signed ones zigzag, the place of a variant or a length as a number of 32
//! bits, `Option` as a `bool` in front. A reader and a writer per field, as serde has them, take several times the
//! code.

use crate::units::Axis;

/// Where the bytes come from or go to.
enum Way<'b> {
    Read(&'b [u8]),
    Write { to: &'b mut [u8], at: usize },
}

/// Reads fields, or writes them. What goes wrong is remembered until [`Wire::end`].
pub struct Wire<'b> {
    way: Way<'b>,
    fault: bool,
}

impl<'b> Wire<'b> {
    /// Every field is read from these bytes.
    pub const fn read(from: &'b [u8]) -> Self {
        Wire { way: Way::Read(from), fault: false }
    }

    /// Every field is written to these bytes.
    pub const fn write(to: &'b mut [u8]) -> Self {
        Wire { way: Way::Write { to, at: 0 }, fault: false }
    }

    /// How many bytes were written; 0 after reading.
    ///
    /// # Errors
    /// None when bytes were missing or left over, or when a field was none of its type.
    pub const fn end(&self) -> Option<usize> {
        match &self.way {
            _ if self.fault => None,
            Way::Read(rest) if !rest.is_empty() => None,
            Way::Read(_) => Some(0),
            Way::Write { at, .. } => Some(*at),
        }
    }

    /// A byte.
    #[inline(never)]
    pub fn byte(&mut self, value: &mut u8) {
        let done = match &mut self.way {
            Way::Read(from) => from.split_first().map(|(first, rest)| (*value, *from) = (*first, rest)),
            Way::Write { to, at } => to.get_mut(*at).map(|place| {
                *place = *value;
                *at += 1;
            }),
        };
        self.fault |= done.is_none();
    }

    /// A switch.
    #[inline(never)]
    pub fn flag(&mut self, value: &mut bool) {
        let mut byte = u8::from(*value);
        self.byte(&mut byte);
        self.fault |= byte > 1;
        *value = byte == 1;
    }

    /// A number of this many bits, at most 64.
    #[inline(never)]
    fn number(&mut self, value: &mut u64, bits: u32) {
        let (mut left, mut sum) = (*value, 0);
        for shift in (0..bits).step_by(7) {
            let more = u8::from(left > 0x7f) << 7;
            let mut byte = left as u8 & 0x7f | more;
            left >>= 7;
            self.byte(&mut byte);
            let part = u64::from(byte & 0x7f);
            self.fault |= shift + 7 > bits && part >> (bits - shift) != 0;
            sum |= part << shift;
            if byte & 0x80 == 0 {
                *value = sum;
                return;
            }
        }
        self.fault = true;
    }

    /// A number of 64 bits.
    pub fn long(&mut self, value: &mut u64) {
        self.number(value, 64);
    }

    /// A number of 32 bits.
    #[inline(never)]
    pub fn word(&mut self, value: &mut u32) {
        let mut long = u64::from(*value);
        self.number(&mut long, 32);
        *value = long as u32;
    }

    /// A signed number of 32 bits.
    #[inline(never)]
    pub fn signed(&mut self, value: &mut i32) {
        let mut word = (*value << 1 ^ *value >> 31) as u32;
        self.word(&mut word);
        *value = (word >> 1) as i32 ^ -((word & 1) as i32);
    }

    /// Signed numbers of 32 bits.
    #[inline(never)]
    pub fn all_signed(&mut self, values: &mut [i32]) {
        values.iter_mut().for_each(|value| self.signed(value));
    }

    /// One of these.
    pub fn choice<T: Copy + PartialEq>(&mut self, value: &mut T, all: &[T]) {
        let mut place = all.iter().position(|one| one == value).unwrap_or(0) as u32;
        self.word(&mut place);
        match all.get(place as usize) {
            Some(one) => *value = *one,
            None => self.fault = true,
        }
    }

    /// An axis.
    #[inline(never)]
    pub fn axis(&mut self, axis: &mut Axis) {
        self.choice(axis, &Axis::ALL);
    }

    /// Whether there is a value, and the value to go on with.
    pub fn some<'v, T: Default>(&mut self, value: &'v mut Option<T>) -> Option<&'v mut T> {
        let mut is_some = value.is_some();
        self.flag(&mut is_some);
        if !is_some {
            *value = None;
            return None;
        }
        Some(value.get_or_insert_with(T::default))
    }

    /// Bytes with their length in front.
    pub fn bytes(&mut self, value: &mut &'b [u8]) {
        let mut length = value.len() as u32;
        self.word(&mut length);
        let length = length as usize;
        let done = match &mut self.way {
            Way::Read(from) => from.split_at_checked(length).map(|(bytes, rest)| (*value, *from) = (bytes, rest)),
            Way::Write { to, at } => to.get_mut(*at..).and_then(|to| to.get_mut(..length)).map(|place| {
                place.copy_from_slice(value);
                *at += length;
            }),
        };
        self.fault |= done.is_none();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(value: u64, bits: u32) -> ([u8; 12], usize) {
        let mut bytes = [0; 12];
        let mut wire = Wire::write(&mut bytes);
        wire.number(&mut value.clone(), bits);
        let length = wire.end().expect("there is room");
        (bytes, length)
    }

    #[test]
    fn numbers_have_the_bytes_of_postcard_and_come_back() {
        let mut seed = 1u64;
        for n in 0..100_000 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let value = seed >> (n % 64);
            let mut buffer = [0; 12];
            let (bytes, length) = written(value, 64);
            assert_eq!(&bytes[..length], postcard::to_slice(&value, &mut buffer).unwrap());
            let (bytes, length) = written(value >> 32, 32);
            assert_eq!(&bytes[..length], postcard::to_slice(&((value >> 32) as u32), &mut buffer).unwrap());
            let mut signed = value as i32;
            let mut bytes = [0; 12];
            let mut wire = Wire::write(&mut bytes);
            wire.signed(&mut signed);
            let length = wire.end().unwrap();
            assert_eq!(&bytes[..length], postcard::to_slice(&signed, &mut buffer).unwrap());
            let mut again = 0;
            let mut wire = Wire::read(&bytes[..length]);
            wire.signed(&mut again);
            assert_eq!((again, wire.end()), (signed, Some(0)));
        }
    }

    /// What postcard takes for a number and what it refuses.
    #[test]
    fn bytes_that_are_no_number_are_refused_as_postcard_does() {
        let mut seed = 1u64;
        let mut refused = 0;
        for n in 0..200_000 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let mut bytes = [0xff; 12];
            bytes[..8]
                .copy_from_slice(&(seed | 0x8080_8080_8080_8080u64.checked_shr(n % 65).unwrap_or(0)).to_le_bytes());
            bytes[8..10].copy_from_slice(&[(seed >> 20) as u8 | 0x80, (seed >> 60) as u8 & 3]);
            let (mut long, mut word) = (0, 0);
            let mut wire = Wire::read(&bytes);
            wire.long(&mut long);
            assert_eq!(postcard::take_from_bytes::<u64>(&bytes).ok().map(|(v, _)| v), (!wire.fault).then_some(long));
            let mut wire = Wire::read(&bytes);
            wire.word(&mut word);
            assert_eq!(postcard::take_from_bytes::<u32>(&bytes).ok().map(|(v, _)| v), (!wire.fault).then_some(word));
            refused += u32::from(wire.fault);
        }
        assert!((1000..199_000).contains(&refused), "{refused}");
    }

    #[test]
    fn too_few_and_too_many_bytes_and_other_switches_are_refused() {
        let mut wire = Wire::read(&[1, 2]);
        let mut on = false;
        wire.flag(&mut on);
        assert_eq!((on, wire.end()), (true, None), "left over");
        wire.flag(&mut on);
        assert_eq!(wire.end(), None, "no switch");
        let mut wire = Wire::read(&[]);
        wire.flag(&mut on);
        assert_eq!(wire.end(), None);
        let mut room = [0];
        let mut wire = Wire::write(&mut room);
        wire.word(&mut 127);
        assert_eq!(wire.end(), Some(1));
        wire.word(&mut 0);
        assert_eq!(wire.end(), None);
        let mut block: &[u8] = &[];
        let mut wire = Wire::read(&[3, 1, 2]);
        wire.bytes(&mut block);
        assert_eq!(wire.end(), None);
    }
}
