//! Acceptor handshake, AH1 (IEEE 488.1, 2.4).

use crate::lines::Lines;

/// Acceptor handshake states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AH {
    /// Idle: takes no part.
    AIDS,
    /// Not ready.
    ANRS,
    /// Ready: NRFD released.
    ACRS,
    /// Accepts: the byte on DIO is being taken.
    ACDS,
    /// Waits for a new cycle: NDAC released.
    AWNS,
}

/// What the acceptor handshake looks at.
#[derive(Clone, Copy, Debug)]
pub struct Input {
    /// ATN.
    pub attention: bool,
    /// ATN has been seen true for t2 at least: no talker can still raise DAV.
    pub settled: bool,
    /// DAV.
    pub valid: bool,
    /// Addressed as listener (LADS or LACS).
    pub addressed: bool,
    /// There is room for one byte (rdy).
    pub ready: bool,
}

impl AH {
    /// The next state: one arrow at a time, so that each state is seen on the lines.
    ///
    /// Three arrows say more than the diagram of 1987.
    /// - A byte that stands on DIO when ATN comes is no interface message: ready only after t2, and with DAV false.
    /// - Who comes in while a command is on the bus lets it pass: ANRS to AWNS.
    /// - What was accepted is told in the step that enters ACDS, so the next step leaves it (T3): whoever was told has
    ///   acted before the source goes on.
    #[must_use]
    pub fn next(self, on: Input) -> AH {
        if !on.attention && !on.addressed {
            return AH::AIDS;
        }
        match self {
            AH::AIDS => AH::ANRS,
            AH::ANRS if on.attention && on.valid => AH::AWNS,
            AH::ANRS if on.attention && on.settled => AH::ACRS,
            AH::ANRS if !on.attention && on.ready => AH::ACRS,
            AH::ACRS if on.attention && !on.settled => AH::ANRS,
            AH::ACRS if !on.attention && !on.ready => AH::ANRS,
            AH::ACRS if on.valid => AH::ACDS,
            AH::ACDS if on.valid => AH::AWNS,
            AH::ACDS => AH::ACRS,
            AH::AWNS if !on.valid => AH::ANRS,
            same => same,
        }
    }

    /// Lines that the state makes true.
    pub fn lines(self) -> Lines {
        match self {
            AH::AIDS => Lines::NONE,
            AH::ANRS | AH::ACDS => Lines::NRFD | Lines::NDAC,
            AH::ACRS => Lines::NDAC,
            AH::AWNS => Lines::NRFD,
        }
    }
}
