//! What is remembered of the last segments.

/// Segments whose start state is kept: the ring of the board, the one in the making, and slack.
pub const HISTORY: usize = 8;

/// What reports say of a segment, bit n = axis or motor n.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Flags {
    pub(super) moving: u8,
    pub(super) taking_up: u8,
    pub(super) negative: u8,
    pub(super) known: u8,
    pub(super) owing: u8,
}

/// What is remembered of the start of a segment beside where the motors stand.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Start {
    pub(super) segment: u64,
    pub(super) flags: Flags,
    /// Pulses of the position compare before it.
    pub(super) pulsed: u16,
}

/// Where the start of a segment is remembered.
#[inline(always)]
pub(super) fn place_of(segment: u64) -> usize {
    segment as usize % HISTORY
}

/// Motors that stepped up, down, in each of the last eight segments: a byte a segment, the last one lowest.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stepping {
    up: u64,
    down: u64,
}

impl Stepping {
    #[inline(always)]
    pub(super) fn push(&mut self, up: u8, down: u8) {
        self.up = self.up << 8 | u64::from(up);
        self.down = self.down << 8 | u64::from(down);
    }

    /// Motors that stepped up, down, in any of the last segments.
    #[inline(always)]
    pub(super) fn last(&self, segments: u32) -> (u8, u8) {
        // the ring holds four: anything else is rare
        if segments > 4 {
            return self.of_many(segments);
        }
        let kept = (0xFFFF_FFFFu64 << (8 * segments) >> 32) as u32;
        (any(self.up as u32 & kept), any(self.down as u32 & kept))
    }

    /// Takes back segments in which nothing stepped.
    pub(super) fn take_back(&mut self, segments: u64) {
        self.up >>= 8 * segments;
        self.down >>= 8 * segments;
    }

    #[inline(never)]
    fn of_many(&self, segments: u32) -> (u8, u8) {
        let kept = if segments < 8 { (1 << (8 * segments)) - 1 } else { u64::MAX };
        let any = |history: u64| any((history & kept) as u32 | ((history & kept) >> 32) as u32);
        (any(self.up), any(self.down))
    }
}

/// The four bytes of a word, all in one.
#[inline(always)]
fn any(bytes: u32) -> u8 {
    let half = bytes | bytes >> 16;
    (half | half >> 8) as u8
}
