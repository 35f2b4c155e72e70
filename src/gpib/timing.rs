//! Times of IEEE 488.1-1987 (table of time values, section 5), in nanoseconds.
//!
//! Capital T is a least time that who acts must wait, small t a longest time in which who is told must answer.
//!
//! | name | function | what | value | who keeps it |
//! |---|---|---|---|---|
//! | T1 | SH | data settle before DAV | >= 2 us open collector, >= 1.1 us three-state, >= 500 ns after the first byte | [`crate::source`] |
//! | t2 | SH AH T L | answer to ATN | <= 200 ns | gates, [`ATTENTION_ANSWER`] |
//! | T3 | AH | time to accept an interface message | > 0 | [`crate::acceptor`]: until the next step |
//! | t4 | T L RL | answer to IFC, or to REN false | < 100 us | whoever calls `step` |
//! | t5 | PP | answer to a parallel poll | <= 200 ns | PP0: never answers |
//! | T6 | C | length of a parallel poll | >= 2 us | controller |
//! | T7 | C | from ATN to the first use of DIO, so that a talker can leave | >= 500 ns | controller |
//! | T8 | C | length of IFC, or of REN false | >= 100 us | controller |
//! | T9 | C | from a parallel poll to the next command | >= 1.5 us | controller |

/// Nanoseconds of a clock that never goes back.
pub type Nanoseconds = u64;

/// T1 with open-collector drivers on DIO, DAV or EOI: data must stand at least this long before DAV.
pub const SETTLE_OPEN_COLLECTOR: Nanoseconds = 2_000;
/// T1 of the first byte after ATN went false, with three-state drivers on DIO, DAV and EOI.
pub const SETTLE_FIRST: Nanoseconds = 1_100;
/// T1 of every following byte, with three-state drivers.
pub const SETTLE_NEXT: Nanoseconds = 500;
/// t2: a talker is off DIO, EOI and DAV, and an acceptor holds NRFD and NDAC, at most this long after ATN went true.
///
/// No polling loop and no interrupt of a small processor keeps this: gates outside answer first and the
/// [`crate::device::Device`] takes over from them (docs/GPIB-BOARD.md).
pub const ATTENTION_ANSWER: Nanoseconds = 200;
/// t4: everything is unaddressed less than this long after IFC went true; local less than this after REN went false.
pub const CLEAR_ANSWER: Nanoseconds = 100_000;
/// t5: answer to a parallel poll, for a device that has one.
pub const POLL_ANSWER: Nanoseconds = 200;
/// T6: a controller waits at least this long for the answers to a parallel poll.
pub const POLL_EXECUTION: Nanoseconds = 2_000;
/// T7: a controller leaves DIO alone at least this long after it made ATN true.
pub const TALKER_LEAVES: Nanoseconds = 500;
/// T8: IFC stays true, and REN false, at least this long.
pub const CLEAR_LENGTH: Nanoseconds = 100_000;
/// T9: a controller waits at least this long after a parallel poll.
pub const POLL_RECOVERY: Nanoseconds = 1_500;
