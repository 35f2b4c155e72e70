//! A device with its exchange, as what stands behind an interface of class USB488.

use super::{Device, Exchange, Read};
use stage_usb488::{Found, Instrument, Panel};

/// A device with its exchange. What it can execute is executed before [`stage_usb488::Interface::turn`].
pub struct Attached<'a, D> {
    /// The exchange of the link.
    pub exchange: &'a mut Exchange,
    /// What takes its messages.
    pub device: &'a mut D,
}

impl<D: Device> Instrument for Attached<'_, D> {
    fn write(&mut self, bytes: &[u8], end: bool) -> usize {
        self.exchange.write(self.device, bytes, end)
    }

    fn available(&self) -> usize {
        self.device.available()
    }

    fn is_whole(&self) -> bool {
        !self.device.asks()
    }

    fn look(&mut self) -> Found {
        match self.exchange.look(self.device) {
            Read::Bytes(..) => Found::Answer,
            Read::NotYet => Found::NotYet,
            Read::NothingAsked => Found::NothingAsked,
        }
    }

    fn read(&mut self, to: &mut [u8]) -> usize {
        // its caller tells the exchange what it holds then
        self.device.give(to)
    }

    fn hold(&mut self, held: bool) {
        self.exchange.hold(self.device, held);
    }

    fn serial_poll(&mut self) -> u8 {
        self.exchange.serial_poll(self.device)
    }

    fn requests_service(&self) -> bool {
        self.exchange.requests_service()
    }

    fn clear(&mut self) {
        self.exchange.clear(self.device);
    }

    fn trigger(&mut self) -> bool {
        self.exchange.trigger(self.device)
    }

    fn abandon(&mut self) {
        self.exchange.abandon(self.device);
    }

    fn panel(&mut self, panel: Panel) {
        let control = self.exchange.control();
        match panel {
            Panel::Disable => control.enable(false),
            Panel::Enable => control.enable(true),
            Panel::Local => control.go_to_local(),
            Panel::LockOut => control.lock_out(),
        }
    }
}
