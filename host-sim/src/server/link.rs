//! One byte stream with its buffers.

use std::io::{self, Read, Write};

/// Most bytes that are read ahead of the session; more wait in the system's buffers.
const READ_AHEAD: usize = 8192;

/// A byte stream that never blocks, and what waits on either side of it.
#[derive(Debug)]
pub struct Stream<S> {
    stream: S,
    input: Vec<u8>,
    output: Vec<u8>,
    /// Nobody reads any more: output is dropped.
    deaf: bool,
}

/// What became of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It goes on.
    Open,
    /// The other side sends no more; it may still read. A broken pipe too: it had sent its end before it went.
    Ended,
    /// The other side has gone.
    Gone,
}

impl<S: Read + Write> Stream<S> {
    /// A stream with empty buffers.
    pub fn new(stream: S) -> Self {
        Stream { stream, input: Vec::new(), output: Vec::new(), deaf: false }
    }

    /// Reads what there is, up to the read-ahead.
    pub fn fill(&mut self) -> State {
        let mut chunk = [0; 2048];
        while self.input.len() < READ_AHEAD {
            match self.stream.read(&mut chunk) {
                Ok(0) => return State::Ended,
                Ok(n) => self.input.extend_from_slice(&chunk[..n]),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return State::Open,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                    self.deafen();
                    return State::Ended;
                }
                Err(_) => return State::Gone,
            }
        }
        State::Open
    }

    /// Offers the input; `take` says how many bytes it took.
    pub fn offer(&mut self, take: impl FnOnce(&[u8]) -> usize) {
        if !self.input.is_empty() {
            let taken = take(&self.input).min(self.input.len());
            self.input.drain(..taken);
        }
    }

    /// Writes what waits and what `give` hands out, until either side is full.
    pub fn drain(&mut self, mut give: impl FnMut(&mut [u8]) -> usize) -> State {
        let mut chunk = [0; 1024];
        loop {
            if self.deaf {
                self.output.clear();
            }
            if self.output.is_empty() {
                let n = give(&mut chunk);
                if n == 0 {
                    return State::Open;
                }
                self.output.extend_from_slice(&chunk[..n]);
            }
            if self.deaf {
                continue;
            }
            match self.stream.write(&self.output) {
                Ok(0) => return State::Gone,
                Ok(n) => drop(self.output.drain(..n)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return State::Open,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                    self.deafen();
                    return State::Ended;
                }
                Err(_) => return State::Gone,
            }
        }
    }

    /// Input that the session has not taken yet.
    pub fn has_input(&self) -> bool {
        !self.input.is_empty()
    }

    /// More is not read before the session has taken some of it.
    pub fn is_full(&self) -> bool {
        self.input.len() >= READ_AHEAD
    }

    /// Output that the other side has not taken yet.
    pub fn has_output(&self) -> bool {
        !self.output.is_empty()
    }

    /// Nobody reads any more: output is dropped from now on.
    pub fn deafen(&mut self) {
        self.deaf = true;
        self.output.clear();
    }

    /// As new: forgets both buffers.
    pub fn clear(&mut self) {
        self.deaf = false;
        self.input.clear();
        self.output.clear();
    }

    /// The stream itself.
    pub fn get_mut(&mut self) -> &mut S {
        &mut self.stream
    }
}
