//! The server: boards in virtual time behind TCP sockets and pseudo terminals.
//!
//! # Design
//! One thread, one loop: bytes in, commands, segments of virtual time, bytes out. Bytes that a session refuses stay
//! with the link and are offered again. At `--speed max` virtual time stands still while nothing moves.
//!
//! A client that sends no more (end of file, hang-up) keeps its link until what it has sent is executed and answered,
//! or waits for motion; its jogs end at once. Virtual time that does not fit a turn is made up for later or given up:
//! clients come first. A terminal that is opened again before its hang-up is seen goes on with the same link.

mod link;
mod pty;
mod station;

pub use pty::{Pty, make_raw};
pub use station::{Options, Speed, Station};

use crate::control::Control;
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

/// Serves until `stop` says so. `status` is given the live line now and then, `hand` is asked what a hand does at the
/// stage.
///
/// # Errors
/// Those of the system's poll.
pub fn serve(
    stations: &mut [Station],
    mut poll: Poll,
    mut status: impl FnMut(&str),
    hand: impl Fn() -> Option<Control>,
    stop: impl Fn() -> bool,
) -> io::Result<()> {
    let start = Instant::now();
    let budget = TURN / stations.len().max(1) as u32;
    let mut events = Events::with_capacity(64);
    let mut next_status = start;
    while !stop() {
        let mut busy = false;
        while let Some(control) = hand() {
            stations.iter_mut().for_each(|station| station.control(control));
        }
        for station in stations.iter_mut() {
            busy |= station.turn(start.elapsed(), budget);
        }
        if Instant::now() >= next_status {
            let lines: Vec<_> = stations.iter().map(Station::status).collect();
            status(&lines.join("   "));
            next_status = Instant::now() + STATUS_EVERY;
        }
        let sleep = match busy {
            true if stations.iter().any(Station::is_flat_out) => Duration::ZERO,
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
