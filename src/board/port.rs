//! What a task that serves a port tells the controller.

use core::cell::Cell;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use stage_controller::hal::PortEvent;

/// Wakes the controller when a port has something for it.
pub static ARRIVED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Events of a port that the controller has not heard of.
pub struct Events {
    closed: Cell<bool>,
    opened: Cell<bool>,
    asleep: Cell<bool>,
}

impl Events {
    /// None.
    pub const fn new() -> Self {
        Events { closed: Cell::new(false), opened: Cell::new(false), asleep: Cell::new(false) }
    }

    /// Who was there is not any more.
    pub fn close(&self) {
        self.closed.set(true);
        ARRIVED.signal(());
    }

    /// Somebody is there.
    pub fn open(&self) {
        self.opened.set(true);
        ARRIVED.signal(());
    }

    /// Who was there is not any more; somebody may have come, who alone counts.
    pub fn begin(&self, opened: bool) {
        self.opened.set(opened);
        self.close();
    }

    /// Who was there sleeps.
    pub fn sleep(&self) {
        self.asleep.set(true);
        ARRIVED.signal(());
    }

    /// The controller does not know yet that the last one has left.
    pub fn is_closed(&self) -> bool {
        self.closed.get()
    }

    /// The next one for the controller.
    pub fn take(&self) -> Option<PortEvent> {
        let events =
            [(&self.asleep, PortEvent::Asleep), (&self.closed, PortEvent::Closed), (&self.opened, PortEvent::Opened)];
        events.into_iter().find(|(happened, _)| happened.take()).map(|(_, event)| event)
    }
}
