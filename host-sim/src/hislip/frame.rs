//! Messages of the protocol (IVI-6.1, table 3): a header of 16 bytes and a payload.

use super::PAYLOAD_MOST;

const HEADER: usize = 16;

macro_rules! kinds {
    ($($(#[$doc:meta])* $name:ident = $number:literal,)*) => {
        /// What a message is.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[allow(missing_docs)]
        #[repr(u8)]
        pub enum Kind {
            $($name = $number,)*
        }

        impl Kind {
            fn from_number(number: u8) -> Option<Self> {
                match number {
                    $($number => Some(Kind::$name),)*
                    _ => None,
                }
            }
        }
    };
}

kinds! {
    Initialize = 0,
    InitializeResponse = 1,
    FatalError = 2,
    Error = 3,
    AsyncLock = 4,
    AsyncLockResponse = 5,
    Data = 6,
    DataEnd = 7,
    DeviceClearComplete = 8,
    DeviceClearAcknowledge = 9,
    AsyncRemoteLocalControl = 10,
    AsyncRemoteLocalResponse = 11,
    Trigger = 12,
    Interrupted = 13,
    AsyncInterrupted = 14,
    AsyncMaxMsgSize = 15,
    AsyncMaxMsgSizeResponse = 16,
    AsyncInitialize = 17,
    AsyncInitializeResponse = 18,
    AsyncDeviceClear = 19,
    AsyncServiceRequest = 20,
    AsyncStatusQuery = 21,
    AsyncStatusResponse = 22,
    AsyncDeviceClearAcknowledge = 23,
    AsyncLockInfo = 24,
    AsyncLockInfoResponse = 25,
}

/// A message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// What it is; none for a number that is not in the standard.
    pub kind: Option<Kind>,
    /// Its number, also without a kind; 128 and above are a maker's own.
    pub number: u8,
    /// Its control code.
    pub control: u8,
    /// Its parameter.
    pub parameter: u32,
    /// Its payload; none when it was longer than is taken.
    pub payload: Option<Vec<u8>>,
}

impl Frame {
    /// The bytes of a message.
    pub fn bytes(kind: Kind, control: u8, parameter: u32, payload: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + payload.len());
        bytes.extend(b"HS");
        bytes.extend([kind as u8, control]);
        bytes.extend(parameter.to_be_bytes());
        bytes.extend((payload.len() as u64).to_be_bytes());
        bytes.extend(payload);
        bytes
    }
}

/// Collects messages.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    bytes: Vec<u8>,
    /// Bytes of a payload that is too long, still to come.
    skip: u64,
}

impl Frames {
    /// Takes bytes up to the end of a message, and that message; says how many bytes.
    ///
    /// # Errors
    /// Bytes that are no message: the connection is of no use any more.
    pub fn take(&mut self, bytes: &[u8]) -> Result<(usize, Option<Frame>), NotHislip> {
        let skipped = self.skip.min(bytes.len() as u64) as usize;
        self.skip -= skipped as u64;
        let mut taken = skipped;
        loop {
            let wanted = self.wanted()?;
            if wanted == self.bytes.len() {
                return Ok((taken, Some(self.finish())));
            }
            let count = (wanted - self.bytes.len()).min(bytes.len() - taken);
            if count == 0 {
                return Ok((taken, None));
            }
            self.bytes.extend_from_slice(&bytes[taken..taken + count]);
            taken += count;
        }
    }

    /// Bytes of what is collected now.
    fn wanted(&self) -> Result<usize, NotHislip> {
        if !b"HS".starts_with(&self.bytes[..self.bytes.len().min(2)]) {
            return Err(NotHislip);
        }
        let length = self.length();
        Ok(HEADER + if length > PAYLOAD_MOST { 0 } else { length as usize })
    }

    /// Of the payload; 0 until the header is there.
    fn length(&self) -> u64 {
        let field = self.bytes.get(8..HEADER).and_then(|field| field.try_into().ok());
        field.map_or(0, u64::from_be_bytes)
    }

    fn finish(&mut self) -> Frame {
        let length = self.length();
        let bytes = std::mem::take(&mut self.bytes);
        let (header, payload) = bytes.split_at(HEADER);
        let too_long = length > PAYLOAD_MOST;
        if too_long {
            self.skip = length;
        }
        Frame {
            kind: Kind::from_number(header[2]),
            number: header[2],
            control: header[3],
            parameter: u32::from_be_bytes([header[4], header[5], header[6], header[7]]),
            payload: (!too_long).then(|| payload.to_vec()),
        }
    }
}

/// The bytes do not begin as a message does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no HiSLIP message")]
pub struct NotHislip;

#[cfg(test)]
mod tests {
    use super::*;

    fn run(bytes: &[u8], chunk: usize) -> Result<Vec<Frame>, NotHislip> {
        let (mut frames, mut found) = (Frames::default(), Vec::new());
        for part in bytes.chunks(chunk) {
            let mut at = 0;
            loop {
                let (taken, frame) = frames.take(&part[at..])?;
                at += taken;
                match frame {
                    Some(frame) => found.push(frame),
                    None => break,
                }
            }
            assert_eq!(at, part.len());
        }
        Ok(found)
    }

    #[test]
    fn messages_come_whole_however_their_bytes_come() {
        let one = Frame::bytes(Kind::DataEnd, 1, 0xffff_ff00, b"*IDN?\n");
        assert_eq!(one[..16], *b"HS\x07\x01\xff\xff\xff\x00\0\0\0\0\0\0\0\x06");
        let bytes = [one, Frame::bytes(Kind::AsyncStatusQuery, 0, 7, b"")].concat();
        let expected = [
            Frame {
                kind: Some(Kind::DataEnd),
                number: 7,
                control: 1,
                parameter: 0xffff_ff00,
                payload: Some(b"*IDN?\n".to_vec()),
            },
            Frame { kind: Some(Kind::AsyncStatusQuery), number: 21, control: 0, parameter: 7, payload: Some(vec![]) },
        ];
        for chunk in 1..bytes.len() {
            assert_eq!(run(&bytes, chunk).unwrap(), expected, "{chunk}");
        }
    }

    #[test]
    fn a_payload_that_is_too_long_is_skipped_and_other_bytes_are_no_message() {
        let long = vec![b'H'; PAYLOAD_MOST as usize + 1];
        let bytes = [Frame::bytes(Kind::Data, 0, 1, &long), Frame::bytes(Kind::Trigger, 0, 3, b"")].concat();
        let found = run(&bytes, 1000).unwrap();
        assert_eq!((found[0].payload.as_ref(), found[1].kind), (None, Some(Kind::Trigger)));
        assert_eq!(run(b"GET / HTTP/1.1", 3), Err(NotHislip));
        assert_eq!(run(b"HX", 1), Err(NotHislip));
        let mut unknown = Frame::bytes(Kind::Data, 0, 1, b"x");
        unknown[2] = 99;
        assert_eq!(run(&unknown, 5).unwrap()[0].kind, None);
    }
}
