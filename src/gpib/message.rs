//! Interface messages: what a byte means while ATN is true (IEEE 488.1, table of remote message coding).

use crate::device::Address;

/// What an interface message says to a device with one primary address and no secondary one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message {
    /// Go to local, to addressed listeners.
    GTL,
    /// Selected device clear, to addressed listeners.
    SDC,
    /// Group execute trigger, to addressed listeners.
    GET,
    /// Local lockout.
    LLO,
    /// Device clear.
    DCL,
    /// Serial poll enable.
    SPE,
    /// Serial poll disable.
    SPD,
    /// My listen address.
    MLA,
    /// Unlisten.
    UNL,
    /// My talk address.
    MTA,
    /// Other talk address; untalk is one of them.
    OTA,
    /// All others: listen addresses of others, secondary commands, parallel poll, take control, codes without meaning.
    Ignored,
}

/// Universal and addressed commands that this device follows.
const COMMANDS: [(u8, Message); 7] = [
    (0x01, Message::GTL),
    (0x04, Message::SDC),
    (0x08, Message::GET),
    (0x11, Message::LLO),
    (0x14, Message::DCL),
    (0x18, Message::SPE),
    (0x19, Message::SPD),
];

/// Code without DIO8, which interface messages leave open.
const CODE: u8 = 0x7F;
/// Bits that tell the address groups apart.
const GROUP: u8 = 0x60;
/// Bits of an address.
const ADDRESS: u8 = 0x1F;
/// Listen address group; its address 31 is unlisten.
const LISTEN: u8 = 0x20;
/// Talk address group; its address 31 is untalk.
const TALK: u8 = 0x40;
/// Address 31: unlisten, untalk.
const NOBODY: u8 = 0x1F;

impl Message {
    /// What `byte` says to the device at `mine`.
    pub fn read(byte: u8, mine: Address) -> Message {
        let code = byte & CODE;
        let to = code & ADDRESS;
        match code & GROUP {
            LISTEN if to == NOBODY => Message::UNL,
            LISTEN if to == mine.get() => Message::MLA,
            TALK if to == mine.get() => Message::MTA,
            TALK => Message::OTA,
            _ => COMMANDS.iter().find(|(of, _)| *of == code).map_or(Message::Ignored, |(_, message)| *message),
        }
    }
}
