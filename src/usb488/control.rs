//! Requests of the class on endpoint 0 (USBTMC, 4.2; USB488, 4.3).

use crate::descriptor::{CAPABILITIES, CAPABILITIES_SIZE};
use crate::instrument::Panel;
use crate::interface::{Interface, Split};

/// The setup packet of a request that the device answers (USB 2.0, table 9-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// bmRequestType.
    pub kind: u8,
    /// bRequest.
    pub request: u8,
    /// wValue.
    pub value: u16,
    /// wIndex: interface or endpoint.
    pub index: u16,
}

/// USBTMC_status (USBTMC, table 16; USB488, table 12).
pub mod status {
    /// STATUS_SUCCESS.
    pub const SUCCESS: u8 = 0x01;
    /// STATUS_PENDING.
    pub const PENDING: u8 = 0x02;
    /// STATUS_INTERRUPT_IN_BUSY.
    pub const INTERRUPT_IN_BUSY: u8 = 0x20;
    /// STATUS_FAILED.
    pub const FAILED: u8 = 0x80;
    /// STATUS_TRANSFER_NOT_IN_PROGRESS.
    pub const TRANSFER_NOT_IN_PROGRESS: u8 = 0x81;
    /// STATUS_SPLIT_NOT_IN_PROGRESS.
    pub const SPLIT_NOT_IN_PROGRESS: u8 = 0x82;
    /// STATUS_SPLIT_IN_PROGRESS.
    pub const SPLIT_IN_PROGRESS: u8 = 0x83;
}

/// bRequest (USBTMC, table 15; USB488, table 9).
pub mod request {
    /// INITIATE_ABORT_BULK_OUT.
    pub const INITIATE_ABORT_BULK_OUT: u8 = 1;
    /// CHECK_ABORT_BULK_OUT_STATUS.
    pub const CHECK_ABORT_BULK_OUT_STATUS: u8 = 2;
    /// INITIATE_ABORT_BULK_IN.
    pub const INITIATE_ABORT_BULK_IN: u8 = 3;
    /// CHECK_ABORT_BULK_IN_STATUS.
    pub const CHECK_ABORT_BULK_IN_STATUS: u8 = 4;
    /// INITIATE_CLEAR.
    pub const INITIATE_CLEAR: u8 = 5;
    /// CHECK_CLEAR_STATUS.
    pub const CHECK_CLEAR_STATUS: u8 = 6;
    /// GET_CAPABILITIES.
    pub const GET_CAPABILITIES: u8 = 7;
    /// READ_STATUS_BYTE.
    pub const READ_STATUS_BYTE: u8 = 128;
    /// REN_CONTROL.
    pub const REN_CONTROL: u8 = 160;
    /// GO_TO_LOCAL.
    pub const GO_TO_LOCAL: u8 = 161;
    /// LOCAL_LOCKOUT.
    pub const LOCAL_LOCKOUT: u8 = 162;
}

/// bmRequestType: to the host, of the class, of an interface; of an endpoint.
pub const OF_INTERFACE: u8 = 0xa1;
/// See [`OF_INTERFACE`].
pub const OF_ENDPOINT: u8 = 0xa2;

/// The data of an answer, zeros behind it.
pub type Answer = [u8; CAPABILITIES_SIZE];

impl Interface {
    /// Answers a request to the interface or to one of its bulk endpoints: how many bytes. None: it is to be stalled.
    pub fn control(&mut self, setup: Setup, answer: &mut Answer) -> Option<usize> {
        use request::*;
        let [low, _] = setup.value.to_le_bytes();
        let own_kind = match setup.request {
            INITIATE_ABORT_BULK_OUT..=CHECK_ABORT_BULK_IN_STATUS => OF_ENDPOINT,
            _ => OF_INTERFACE,
        };
        let [place, _] = setup.index.to_le_bytes();
        let into = setup.request >= INITIATE_ABORT_BULK_IN;
        if setup.kind != own_kind || own_kind == OF_ENDPOINT && (place & 0x80 != 0) != into {
            return None;
        }
        let (length, code, second, count) = match setup.request {
            INITIATE_ABORT_BULK_OUT => (2, self.abort_out(low), self.receive.tag(), 0),
            INITIATE_ABORT_BULK_IN => (2, self.abort_in(low), self.send.tag(), 0),
            INITIATE_CLEAR => (1, self.begin_clear(), 0, 0),
            CHECK_ABORT_BULK_OUT_STATUS | CHECK_ABORT_BULK_IN_STATUS | CHECK_CLEAR_STATUS => {
                let (split, length, count) = match setup.request {
                    CHECK_ABORT_BULK_OUT_STATUS => (Split::AbortOut, 8, self.receive.received()),
                    CHECK_ABORT_BULK_IN_STATUS => (Split::AbortIn, 8, self.send.sent()),
                    _ => (Split::Clear, 2, 0),
                };
                let (code, more) = self.check(split);
                (length, code, more, count)
            }
            GET_CAPABILITIES => {
                *answer = CAPABILITIES;
                return Some(CAPABILITIES_SIZE);
            }
            READ_STATUS_BYTE => (3, self.read_status(low), low, 0),
            REN_CONTROL => (1, self.panel(if low & 1 == 0 { Panel::Disable } else { Panel::Enable }), 0, 0),
            GO_TO_LOCAL => (1, self.panel(Panel::Local), 0, 0),
            LOCAL_LOCKOUT => (1, self.panel(Panel::LockOut), 0, 0),
            _ => return None,
        };
        *answer = [0; CAPABILITIES_SIZE];
        let [c0, c1, c2, c3] = u32::to_le_bytes(count);
        answer.iter_mut().zip([code, second, 0, 0, c0, c1, c2, c3]).for_each(|(to, from)| *to = from);
        Some(length)
    }
}
