//! Remote local function, RL1 (IEEE 488.1, 2.8).

use crate::message::Message;
use crate::table::{self, Arrow};

/// Remote local states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RL {
    /// Local.
    LOCS,
    /// Remote: the front panel obeys its local key alone.
    REMS,
    /// Remote with lockout: the local key is dead.
    RWLS,
    /// Local with lockout: becomes remote with lockout when next addressed.
    LWLS,
}

const ARROWS: [Arrow<RL, Message>; 6] = [
    (RL::LOCS, Message::MLA, RL::REMS),
    (RL::LOCS, Message::LLO, RL::LWLS),
    (RL::REMS, Message::LLO, RL::RWLS),
    (RL::REMS, Message::GTL, RL::LOCS),
    (RL::RWLS, Message::GTL, RL::LWLS),
    (RL::LWLS, Message::MLA, RL::RWLS),
];

impl RL {
    /// The state after an interface message with REN true; `listens` says LADS, which GTL needs, `local_key` the local
    /// message rtl, which keeps a device local that is addressed.
    #[must_use]
    pub fn on_message(self, message: Message, listens: bool, local_key: bool) -> RL {
        match (self, message) {
            (_, Message::GTL) if !listens => self,
            (RL::LOCS, Message::MLA) if local_key => self,
            _ => table::next(&ARROWS, self, message),
        }
    }

    /// The state after the local key (rtl), which does nothing under lockout.
    #[must_use]
    pub fn on_local_key(self) -> RL {
        if self == RL::REMS { RL::LOCS } else { self }
    }

    /// Whether the bus has the device, and not the front panel.
    pub fn is_remote(self) -> bool {
        matches!(self, RL::REMS | RL::RWLS)
    }
}
