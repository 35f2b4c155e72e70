//! A session as the device behind a message exchange.

use super::{Framer, Instrument, Session};
use crate::error::{Error, ErrorNumber};
use crate::scpi::exchange::Device;
use crate::scpi::parser;

impl Session {
    /// As [`Session::poll`], but no message is begun while the answer of the one before it waits for its reader, and
    /// a query behind an indefinite answer is refused (-440). `see` is shown the status byte in front of every unit.
    pub fn poll_message(&mut self, instrument: &mut impl Instrument, mut see: impl FnMut(u8)) -> bool {
        self.one_answer = true;
        self.advance(instrument, &mut |session| {
            see(session.status_byte());
            session.busy || !session.has_output()
        })
    }

    /// The unit that comes next, or waits, is a query.
    fn is_at_query(&self) -> bool {
        let unit = parser::next_unit(self.lexer.message(), self.at, &self.path);
        unit.is_some_and(|unit| unit.call.is_ok_and(|call| call.query))
    }
}

impl Device for Session {
    fn take(&mut self, bytes: &[u8]) -> usize {
        self.receive(bytes)
    }

    fn end(&mut self) -> bool {
        if self.watch.is_at_start() {
            return true;
        }
        if self.watch.in_block() {
            let mine = self.awaits_block();
            self.timeout();
            return mine;
        }
        let full = self.busy && self.backlog.is_full();
        !full && self.receive(b"\n") == 1
    }

    fn is_partial(&self) -> bool {
        !self.watch.is_at_start()
    }

    #[inline(never)] // called in three places
    fn drop_partial(&mut self) {
        // it stands last: behind the whole messages of the backlog, which begins with one, or alone in the lexer
        if !self.busy && self.backlog.is_empty() {
            self.lexer.clear();
        }
        (self.watch, self.ahead) = (Framer::new(), 0);
        let mut whole = 0;
        for (n, byte) in self.backlog.iter().enumerate() {
            self.watch.step(*byte);
            if self.watch.is_at_start() {
                whole = n + 1;
            }
        }
        while self.backlog.len() > whole {
            self.backlog.pop_back();
        }
        self.watch = Framer::new();
    }

    fn foresee_abort(&mut self, coming: bool) {
        if coming {
            self.abort_now = true;
            self.aborts_ahead += 1;
            self.foreseen += 1;
        } else {
            self.aborts_ahead = self.aborts_ahead.saturating_sub(self.foreseen);
            self.foreseen = 0;
        }
    }

    fn is_busy(&self) -> bool {
        self.busy || !self.backlog.is_empty() || self.ahead > 0
    }

    fn has_more(&self) -> bool {
        self.ahead > 0 || !self.backlog.iter().all(u8::is_ascii_whitespace)
    }

    fn asks(&self) -> bool {
        self.busy && (self.out.is_open() || self.is_at_query())
    }

    fn available(&self) -> usize {
        self.out.available()
    }

    fn give(&mut self, to: &mut [u8]) -> usize {
        self.transmit(to)
    }

    fn drop_answer(&mut self) {
        if self.asks() {
            self.end_message();
        }
        self.out.clear();
    }

    fn clear(&mut self) {
        self.device_clear();
    }

    fn trigger(&mut self) -> bool {
        const TRIGGER: &[u8] = b"*TRG\n";
        let room = !self.is_busy() || self.backlog.capacity() - self.backlog.len() >= TRIGGER.len() && self.ahead == 0;
        room && self.receive(TRIGGER) == TRIGGER.len()
    }

    fn report(&mut self, error: ErrorNumber) {
        Session::report(self, Error::from(error));
    }

    fn status_byte(&self, held: bool) -> u8 {
        self.status.status_byte(held || self.has_output())
    }
}
