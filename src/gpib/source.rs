//! Source handshake, SH1 (IEEE 488.1, 2.3).

use crate::lines::Lines;
use crate::timing::{self, Nanoseconds};

/// Source handshake states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SH {
    /// Idle: takes no part.
    SIDS,
    /// Generates: waits for a byte.
    SGNS,
    /// Delays: the byte is on DIO and settles.
    SDYS,
    /// Transfers: DAV is true.
    STRS,
    /// Waits for a new cycle: the byte was accepted.
    SWNS,
    /// Idle, waits: interrupted while a byte was on the bus.
    SIWS,
}

/// A byte on its way to the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offer {
    /// The byte.
    pub byte: u8,
    /// Sent with EOI: the last byte of a message.
    pub end: bool,
}

/// What the source handshake looks at.
#[derive(Clone, Copy, Debug)]
pub struct Input {
    /// TACS or SPAS, so ATN is false.
    pub active: bool,
    /// The drivers are on: what was put on the lines stands there.
    pub enabled: bool,
    /// NRFD.
    pub not_ready: bool,
    /// NDAC.
    pub not_accepted: bool,
    /// What there is to send (nba).
    pub offer: Option<Offer>,
    /// The offer is the status byte: SPAS.
    pub polled: bool,
}

/// How a byte left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Left {
    /// ATN or IFC came between DAV and its acceptance: a listener may have it, and the standard forbids to repeat it.
    pub cut: bool,
}

/// Source handshake with the byte it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source {
    /// State.
    pub state: SH,
    offer: Offer,
    polled: bool,
    /// From when the byte settles; nothing before the drivers were seen on.
    since: Option<Nanoseconds>,
    /// The next byte is the first after ATN.
    first: bool,
}

impl Source {
    /// After power-on.
    pub const IDLE: Source =
        Source { state: SH::SIDS, offer: Offer { byte: 0, end: false }, polled: false, since: None, first: true };

    /// One arrow of the diagram; tells when a byte left.
    ///
    /// nba is false from the moment a byte left until the next `offer`, so SWNS and SIWS last one step. Beyond the
    /// diagram DAV waits for an acceptor: without NDAC nobody listens and a byte would be lost.
    pub fn step(&mut self, now: Nanoseconds, on: Input) -> Option<Left> {
        let interrupted = !on.active;
        let (state, left) = match self.state {
            SH::SIDS if on.active => (SH::SGNS, None),
            SH::SGNS | SH::SDYS if interrupted => (SH::SIDS, None),
            SH::SGNS if on.offer.is_some() => (SH::SDYS, None),
            SH::SDYS if on.offer != Some(self.offer) => (SH::SGNS, None),
            SH::SDYS if self.settled(now) && !on.not_ready && on.not_accepted => (SH::STRS, None),
            SH::STRS if interrupted => (SH::SIWS, Some(Left { cut: true })),
            SH::STRS if !on.not_accepted => (SH::SWNS, Some(Left { cut: false })),
            SH::SWNS if !interrupted => (SH::SGNS, None),
            SH::SWNS => (SH::SIWS, None),
            SH::SIWS => (SH::SIDS, None),
            same => (same, None),
        };
        match (self.state, state) {
            // the time runs when the byte is known to stand on the lines: the step after it was put there
            (SH::SDYS, SH::SDYS) if on.enabled && self.since.is_none() => self.since = Some(now),
            (SH::SGNS, SH::SDYS) => {
                self.since = None;
                self.polled = on.polled;
                self.offer = on.offer.unwrap_or(self.offer);
            }
            (SH::SIDS, SH::SGNS) => (self.since, self.first) = (None, true),
            (SH::STRS, SH::SWNS) => self.first = false,
            _ => {}
        }
        self.state = state;
        left
    }

    fn settled(&self, now: Nanoseconds) -> bool {
        let settle = if self.first { timing::SETTLE_FIRST } else { timing::SETTLE_NEXT };
        self.since.is_some_and(|since| now.saturating_sub(since) >= settle)
    }

    /// The byte that left last, or leaves.
    pub fn offer(&self) -> Offer {
        self.offer
    }

    /// Whether that byte is a status byte.
    pub fn polls(&self) -> bool {
        self.polled
    }

    /// Lines that the state makes true.
    pub fn lines(&self) -> Lines {
        let stands = matches!(self.state, SH::SDYS | SH::STRS);
        Lines::of_byte(self.offer.byte).when(stands)
            | Lines::EOI.when(stands && self.offer.end)
            | Lines::DAV.when(self.state == SH::STRS)
    }
}
