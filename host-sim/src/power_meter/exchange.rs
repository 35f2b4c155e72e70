//! The meter as the device behind a message exchange.

use super::error::Entry;
use super::session::{Session, Wait};
use crate::bench_twin::Bench;
use stage_controller::error::ErrorNumber;
use stage_controller::scpi::exchange::Device;

impl Session {
    /// As [`Session::poll`], but a query behind `*IDN?` is refused (-440). `see` is shown the status byte in front of
    /// every unit.
    pub fn poll_message(&mut self, bench: &mut Bench, tick: u64, mut see: impl FnMut(u8)) -> bool {
        self.advance(bench, tick, |session| {
            see(session.status_byte());
            if session.indefinite && session.is_at_query() {
                session.queue.push(Entry::new(ErrorNumber::QueryAfterIndefinite.code(), ""));
                session.message = None;
                session.end_message();
            }
            true
        })
    }
}

impl Device for Session {
    fn take(&mut self, bytes: &[u8]) -> usize {
        self.receive(bytes)
    }

    fn end(&mut self) -> bool {
        if !self.lexer.is_at_start() {
            let event = if self.lexer.in_block() { self.lexer.timeout() } else { self.lexer.push(b'\n') };
            self.framed(event);
        }
        true
    }

    fn is_partial(&self) -> bool {
        !self.lexer.is_at_start()
    }

    fn drop_partial(&mut self) {
        self.lexer.clear();
    }

    fn is_busy(&self) -> bool {
        Session::is_busy(self)
    }

    /// It takes one message at a time: what stands behind it has not been taken.
    fn has_more(&self) -> bool {
        false
    }

    fn asks(&self) -> bool {
        self.message.is_some()
            && (!self.answers.is_empty() || matches!(self.wait, Some(Wait::Reading { .. })) || self.is_at_query())
    }

    fn available(&self) -> usize {
        self.output.len()
    }

    fn give(&mut self, to: &mut [u8]) -> usize {
        self.transmit(to)
    }

    fn drop_answer(&mut self) {
        if self.asks() {
            self.give_up();
        }
        self.output.clear();
    }

    fn clear(&mut self) {
        self.device_clear();
    }

    /// There is nothing in it to be triggered (DT0 of IEEE 488.1).
    fn trigger(&mut self) -> bool {
        true
    }

    fn report(&mut self, error: ErrorNumber) {
        self.queue.push(Entry::new(error.code(), ""));
    }

    fn status_byte(&self, held: bool) -> u8 {
        self.status_byte_with(held || !self.output.is_empty())
    }
}
