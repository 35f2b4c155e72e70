//! The 12 bytes in front of a transfer (USBTMC, tables 1 to 9; USB488, table 1).

/// Bytes of a header.
pub const SIZE: usize = 12;

/// MsgID (USBTMC, table 2; USB488, table 2).
mod id {
    pub const DEV_DEP_MSG_OUT: u8 = 1;
    pub const DEV_DEP_MSG_IN: u8 = 2;
    pub const TRIGGER: u8 = 128;
}

/// End of message, in bmTransferAttributes of either direction.
pub const EOM: u8 = 1;
/// TermChar: enabled in a request, met in an answer.
pub const TERM_CHAR: u8 = 2;

/// What a header on bulk OUT says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// DEV_DEP_MSG_OUT: bytes of a message follow.
    Message {
        /// So many in this transfer.
        size: u32,
        /// The last of them ends the message.
        end: bool,
    },
    /// REQUEST_DEV_DEP_MSG_IN: the host is going to read.
    Request {
        /// At most so many bytes.
        size: u32,
        /// The transfer ends at this character.
        term: Option<u8>,
    },
    /// TRIGGER.
    Trigger,
}

/// Tag and meaning of a header; none when it is malformed, or asks for what is not supported.
pub fn parse(packet: &[u8]) -> Option<(u8, Command)> {
    let (&[id, tag, inverse, _, s0, s1, s2, s3, attributes, term, _, _], rest) = packet.split_first_chunk::<SIZE>()?;
    if tag == 0 || inverse != !tag {
        return None;
    }
    let size = u32::from_le_bytes([s0, s1, s2, s3]);
    let command = match id {
        id::DEV_DEP_MSG_OUT => Command::Message { size, end: attributes & EOM != 0 },
        id::DEV_DEP_MSG_IN if rest.is_empty() && size > 0 => {
            Command::Request { size, term: (attributes & TERM_CHAR != 0).then_some(term) }
        }
        id::TRIGGER if rest.is_empty() => Command::Trigger,
        _ => return None,
    };
    Some((tag, command))
}

/// The header of an answer.
pub const fn answer(tag: u8, size: u32, attributes: u8) -> [u8; SIZE] {
    let [s0, s1, s2, s3] = size.to_le_bytes();
    [id::DEV_DEP_MSG_IN, tag, !tag, 0, s0, s1, s2, s3, attributes, 0, 0, 0]
}

/// Bytes that fill up to the next multiple of four.
pub const fn alignment(size: usize) -> usize {
    size.wrapping_neg() & 3
}
