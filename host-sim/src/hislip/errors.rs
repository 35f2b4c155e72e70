//! What the protocol calls errors (IVI-6.1, tables 14 and 16).

/// Ends the session: sent, then both connections are closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Fatal {
    /// What came is no message.
    BadHeader = 1,
    /// Used before the asynchronous connection was there.
    NotBothChannels = 2,
    /// The connection did not begin, or began again, as it must; or there is no such instrument.
    BadInitialization = 3,
    /// No room for another client.
    TooMany = 4,
}

impl Fatal {
    /// In words, which the client is told.
    pub const fn text(self) -> &'static str {
        match self {
            Fatal::BadHeader => "Poorly formed message header",
            Fatal::NotBothChannels => "Attempt to use connection without both channels established",
            Fatal::BadInitialization => "Invalid initialization sequence",
            Fatal::TooMany => "Server refused connection due to maximum number of clients exceeded",
        }
    }
}

/// The session goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Mistake {
    Unidentified = 0,
    UnknownMessage = 1,
    UnknownControl = 2,
    UnknownVendorMessage = 3,
    TooLarge = 4,
}

/// Why a session is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Over {
    /// The client is to be told.
    Refused(Fatal),
    /// The client has said so.
    Left,
}
