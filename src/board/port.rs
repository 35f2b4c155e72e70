//! Ports of the board: a pipe each way between a driver's tasks and the controller's turn.

use core::sync::atomic::{AtomicU8, Ordering};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embassy_sync::signal::Signal;
use stage_controller::hal::{Port, PortEvent};

/// Bytes that wait in either direction.
const ROOM: usize = 512;
/// Bytes that the controller looks at together.
const TOGETHER: usize = 64;

/// Wakes the controller when a port has something for it.
pub static ARRIVED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Events in the order in which they are handed on; a bit each.
const EVENTS: [PortEvent; 2] = [PortEvent::Closed, PortEvent::Opened];

/// What lies between a driver and the controller.
pub struct Plug {
    input: Pipe<CriticalSectionRawMutex, ROOM>,
    output: Pipe<CriticalSectionRawMutex, ROOM>,
    events: AtomicU8,
    closed: Signal<CriticalSectionRawMutex, ()>,
}

impl Plug {
    /// Nothing in it.
    pub const fn new() -> Self {
        Plug { input: Pipe::new(), output: Pipe::new(), events: AtomicU8::new(0), closed: Signal::new() }
    }

    /// The driver tells of an event.
    pub fn ring(&self, event: PortEvent) {
        let bit = EVENTS.iter().position(|e| *e == event).map_or(0, |n| 1 << n);
        self.events.fetch_or(bit, Ordering::Relaxed);
        if event == PortEvent::Closed {
            self.closed.signal(());
        }
        ARRIVED.signal(());
    }

    /// The driver hands on what came; waits while there is no room.
    pub async fn take_in(&self, bytes: &[u8]) {
        let mut left = bytes;
        while !left.is_empty() {
            let written = self.input.write(left).await;
            left = &left[written..];
            ARRIVED.signal(());
        }
    }

    /// The driver fetches what is to be sent; waits until there is something.
    pub async fn fetch(&self, bytes: &mut [u8]) -> usize {
        loop {
            let count = self.output.read(bytes).await;
            // there is room again
            ARRIVED.signal(());
            self.closed.reset();
            // answers to one who has left, as long as the controller has not heard of that
            if self.events.load(Ordering::Relaxed) & 1 == 0 {
                return count;
            }
        }
    }

    /// Waits until the port is closed: what was fetched last is for nobody then.
    pub async fn until_closed(&self) {
        self.closed.wait().await;
    }
}

/// The controller's side of a plug.
pub struct Socket {
    plug: &'static Plug,
    bytes: [u8; TOGETHER],
    from: usize,
    to: usize,
}

impl Socket {
    /// One for each plug.
    pub fn new(plug: &'static Plug) -> Self {
        Socket { plug, bytes: [0; TOGETHER], from: 0, to: 0 }
    }
}

impl Port for Socket {
    fn event(&mut self) -> Option<PortEvent> {
        let first = self.plug.events.load(Ordering::Relaxed).trailing_zeros();
        let event = EVENTS.get(first as usize)?;
        if *event == PortEvent::Closed {
            // the answers of the one who left are nobody else's
            self.plug.output.clear();
        }
        self.plug.events.fetch_and(!(1 << first), Ordering::Relaxed);
        Some(*event)
    }

    fn received(&mut self) -> &[u8] {
        if self.from == self.to {
            (self.from, self.to) = (0, self.plug.input.try_read(&mut self.bytes).unwrap_or(0));
        }
        self.bytes.get(self.from..self.to).unwrap_or(&[])
    }

    fn consume(&mut self, count: usize) {
        self.from = (self.from + count).min(self.to);
    }

    fn room(&self) -> usize {
        self.plug.output.free_capacity()
    }

    fn send(&mut self, bytes: &[u8]) {
        let mut left = bytes;
        // the pipe takes what lies together up to its end: two pieces at most
        while let (false, Ok(written)) = (left.is_empty(), self.plug.output.try_write(left)) {
            left = &left[written..];
        }
    }
}
