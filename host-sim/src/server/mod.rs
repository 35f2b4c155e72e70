//! The server: boards in virtual time behind TCP sockets and pseudo terminals.
//!
//! # Design
//! One thread, one loop: bytes in, commands, segments of virtual time, bytes out. Bytes that a session refuses stay
//! with the link and are offered again. At `--speed max` virtual time stands still while nothing moves and no client
//! waits for a reading.
//!
//! With [`OnBus`] what is served is also on a GPIB bus, behind a gateway of its own;
//! with [`OnHislip`] HiSLIP clients have links to it.
//!
//! Boards run each for itself; a bench ([`BenchStation`]) plays every segment on both its boards before the next one.
//!
//! A client that sends no more (end of file, hang-up) keeps its link until what it has sent is executed and answered,
//! or waits for motion; its jogs end at once. Virtual time that does not fit a turn is made up for later or given up:
//! clients come first. A terminal that is opened again before its hang-up is seen goes on with the same link.

mod bench;
mod gpib;
mod hislip;
mod link;
mod meter;
mod pace;
mod pty;
mod socket;
mod station;

pub use bench::BenchStation;
pub use gpib::{Boards, FIRST_ADDRESS, OnBus};
pub use hislip::OnHislip;
pub use meter::MeterStation;
pub use pace::Speed;
pub use pty::{Pty, make_raw};
pub use station::{Options, Station};

use crate::control::Hand;
use mio::{Events, Poll};
use std::io;
use std::time::{Duration, Instant};

/// Longest time that virtual time takes in one turn over all boards: clients wait for it.
const TURN: Duration = Duration::from_millis(6);
/// How often the live line is renewed.
const STATUS_EVERY: Duration = Duration::from_millis(200);
/// Longest sleep while something moves: a few segments.
const BUSY_SLEEP: Duration = Duration::from_micros(500);
/// Longest sleep while nothing moves: a pseudo terminal that is opened must be seen soon.
const IDLE_SLEEP: Duration = Duration::from_millis(10);

/// What is served: a board, or a bench with two of them.
pub trait Served {
    /// One turn of the loop at this wall time since the start, of which virtual time may take `budget`; true while
    /// something moves or waits.
    fn turn(&mut self, wall: Duration, budget: Duration) -> bool;

    /// A hand does something there.
    fn hand(&mut self, hand: Hand);

    /// True when virtual time runs as fast as it can, or lags behind.
    fn is_flat_out(&self) -> bool;

    /// The live line.
    fn status(&self) -> String;
}

/// Serves until `stop` says so. `status` is given the live line now and then, `hand` is asked what a hand does at the
/// stage.
///
/// # Errors
/// Those of the system's poll.
pub fn serve<S: Served>(
    stations: &mut [S],
    mut poll: Poll,
    mut status: impl FnMut(&str),
    hand: impl Fn() -> Option<Hand>,
    stop: impl Fn() -> bool,
) -> io::Result<()> {
    let start = Instant::now();
    let budget = TURN / stations.len().max(1) as u32;
    let mut events = Events::with_capacity(64);
    let mut next_status = start;
    while !stop() {
        let mut busy = false;
        while let Some(hand) = hand() {
            stations.iter_mut().for_each(|station| station.hand(hand));
        }
        for station in stations.iter_mut() {
            busy |= station.turn(start.elapsed(), budget);
        }
        if Instant::now() >= next_status {
            let lines: Vec<_> = stations.iter().map(Served::status).collect();
            status(&lines.join("   "));
            next_status = Instant::now() + STATUS_EVERY;
        }
        let sleep = match busy {
            true if stations.iter().any(Served::is_flat_out) => Duration::ZERO,
            true => BUSY_SLEEP,
            false => IDLE_SLEEP,
        };
        match poll.poll(&mut events, Some(sleep)) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            other => other?,
        }
    }
    Ok(())
}
