//! What the device says of itself: interface, endpoints, capabilities.

use crate::PACKET;

/// Class of the interface: application-specific (USBTMC, table 43).
pub const CLASS: u8 = 0xfe;
/// Subclass: test and measurement.
pub const SUBCLASS: u8 = 0x03;
/// Protocol: USB488 (USB488, table 10).
pub const PROTOCOL: u8 = 0x01;

/// Interval of the interrupt endpoint, ms.
pub const INTERVAL_MS: u8 = 1;
/// Largest packet of the interrupt endpoint: a notification.
pub const NOTIFICATION: u16 = crate::notify::SIZE as u16;

/// Where an interface has its endpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoints {
    /// Address of bulk OUT, 1 to 15.
    pub bulk_out: u8,
    /// Address of bulk IN, with bit 7.
    pub bulk_in: u8,
    /// Address of interrupt IN, with bit 7.
    pub interrupt_in: u8,
}

/// Bytes of the descriptors of an interface.
pub const INTERFACE_SIZE: usize = 9 + 3 * 7;

/// The descriptors of an interface: its own, bulk OUT, bulk IN, interrupt IN (USB 2.0, tables 9-12 and 9-13).
pub const fn interface(number: u8, at: Endpoints) -> [u8; INTERFACE_SIZE] {
    let [low, high] = (PACKET as u16).to_le_bytes();
    let [notify_low, notify_high] = NOTIFICATION.to_le_bytes();
    let (out, answers, notices) = (at.bulk_out, at.bulk_in, at.interrupt_in);
    [
        9,
        4,
        number,
        0,
        3,
        CLASS,
        SUBCLASS,
        PROTOCOL,
        0, //
        7,
        5,
        out,
        2,
        low,
        high,
        0, //
        7,
        5,
        answers,
        2,
        low,
        high,
        0, //
        7,
        5,
        notices,
        3,
        notify_low,
        notify_high,
        INTERVAL_MS,
    ]
}

/// Bytes of the capabilities.
pub const CAPABILITIES_SIZE: usize = 24;

/// The answer to GET_CAPABILITIES (USBTMC, table 37; USB488, table 8).
///
/// TermChar; USB488 with trigger, remote and local; SCPI, SR1, RL1 and DT1 in full. No indicator, and neither talk-only
/// nor listen-only.
pub const CAPABILITIES: [u8; CAPABILITIES_SIZE] = [
    0x01, 0, // STATUS_SUCCESS
    0x00, 0x01, // USBTMC 1.00
    0x00, // interface: D2 indicator, D1 talk-only, D0 listen-only
    0x01, // device: D0 TermChar
    0, 0, 0, 0, 0, 0, //
    0x00, 0x01, // USB488 1.00
    0x07, // interface: D2 USB488, D1 REN_CONTROL and the like, D0 TRIGGER
    0x0f, // device: D3 SCPI, D2 SR1, D1 RL1, D0 DT1
    0, 0, 0, 0, 0, 0, 0, 0,
];
