//! Between the bytes of a client's two connections and its instrument: no socket, no clock.

use super::client::Client;
use super::errors::{Fatal, Over};
use super::frame::Frames;
use super::locks::Locks;
use crate::gpib::Instrument;
use std::time::Duration;

/// Which of the two connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Messages and answers.
    Synchronous,
    /// Status, clear, locks.
    Asynchronous,
}

/// A client with both its connections.
#[derive(Clone, Debug)]
pub struct Link {
    client: Client,
    frames: [Frames; 2],
}

impl Link {
    /// Number `id` among the clients of an instrument, in synchronised mode.
    pub fn new(id: usize) -> Self {
        Link { client: Client::new(id), frames: Default::default() }
    }

    /// Takes bytes of a connection at a `wall` time; says how many. The others are to be offered again.
    ///
    /// # Errors
    /// The session is over.
    pub fn receive(
        &mut self,
        channel: Channel,
        bytes: &[u8],
        instrument: &mut dyn Instrument,
        locks: &mut Locks,
        wall: Duration,
    ) -> Result<usize, Over> {
        let mut at = 0;
        loop {
            if !self.client.has_room(channel) {
                return Ok(at);
            }
            let frames = &mut self.frames[channel as usize];
            let (taken, frame) = frames.take(&bytes[at..]).map_err(|_| Over::Refused(Fatal::BadHeader))?;
            at += taken;
            let Some(frame) = frame else { return Ok(at) };
            match channel {
                Channel::Synchronous => self.client.hear(frame, instrument)?,
                Channel::Asynchronous => self.client.hear_aside(frame, instrument, locks, wall)?,
            }
            self.client.turn(instrument, locks, wall);
        }
    }

    /// Goes on at a `wall` time: what the instrument takes and answers, whether it requests service, who has the lock.
    pub fn turn(&mut self, instrument: &mut dyn Instrument, locks: &mut Locks, wall: Duration) {
        self.client.turn(instrument, locks, wall);
    }

    /// To be sent on a connection; what is sent is taken out.
    pub fn output(&mut self, channel: Channel) -> &mut Vec<u8> {
        self.client.output(channel)
    }

    /// Something that has come is not done yet.
    pub fn has_work(&self) -> bool {
        self.client.has_work()
    }

    /// The instrument is at work on a message, or takes it.
    pub fn is_busy(&self) -> bool {
        self.client.is_busy()
    }
}
