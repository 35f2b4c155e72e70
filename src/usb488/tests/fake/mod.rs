//! An instrument of few words: what it was told, and answers as long as one likes.
#![allow(dead_code)]

use super::host::{Bench, Usb};
use stage_usb488::{Found, Instrument, Interface, Panel};
use std::collections::VecDeque;

/// `send N` is answered by N bytes, anything else with `?` by itself; `work` takes until [`Fake::work`] is done.
#[derive(Default)]
pub struct Fake {
    input: Vec<u8>,
    pub messages: Vec<String>,
    pub answer: VecDeque<u8>,
    /// Turns that the message which is executed takes.
    pub work: usize,
    /// The answer has not ended.
    pub more: bool,
    /// Bytes that it takes at once.
    pub appetite: Option<usize>,
    pub interrupted: usize,
    pub unasked: usize,
    pub abandoned: usize,
    pub clears: usize,
    pub triggers: usize,
    pub panels: Vec<Panel>,
    pub status: u8,
    pub requests: bool,
    pub held: bool,
}

/// What `send` sends.
pub fn pattern(size: usize) -> Vec<u8> {
    (0..size).map(|n| (n * 7 + n / 64) as u8).collect()
}

impl Fake {
    fn execute(&mut self) {
        let message = String::from_utf8_lossy(&self.input).into_owned();
        self.input.clear();
        if let Some(size) = message.strip_prefix("send ") {
            self.answer = pattern(size.parse().unwrap()).into();
        } else if message.ends_with('?') {
            self.answer = message.bytes().collect();
        }
        self.messages.push(message);
    }
}

impl Instrument for Fake {
    fn write(&mut self, bytes: &[u8], end: bool) -> usize {
        if self.held || !self.answer.is_empty() || self.more {
            (self.held, self.more) = (false, false);
            self.answer.clear();
            self.interrupted += 1;
        }
        if self.work > 0 {
            return 0;
        }
        let taken = self.appetite.unwrap_or(bytes.len()).min(bytes.len());
        self.input.extend(&bytes[..taken]);
        if end && taken == bytes.len() {
            self.execute();
        }
        taken
    }

    fn available(&self) -> usize {
        self.answer.len()
    }

    fn is_whole(&self) -> bool {
        !self.more
    }

    fn look(&mut self) -> Found {
        if !self.answer.is_empty() {
            return Found::Answer;
        }
        if self.work > 0 || self.more {
            return Found::NotYet;
        }
        self.unasked += 1;
        Found::NothingAsked
    }

    fn read(&mut self, to: &mut [u8]) -> usize {
        let count = to.len().min(self.answer.len());
        to.iter_mut().zip(self.answer.drain(..count)).for_each(|(to, from)| *to = from);
        count
    }

    fn hold(&mut self, held: bool) {
        self.held = held;
    }

    fn serial_poll(&mut self) -> u8 {
        self.status | if std::mem::take(&mut self.requests) { 0x40 } else { 0 }
    }

    fn requests_service(&self) -> bool {
        self.requests
    }

    fn clear(&mut self) {
        self.input.clear();
        self.answer.clear();
        (self.work, self.more, self.held) = (0, false, false);
        self.clears += 1;
    }

    fn trigger(&mut self) -> bool {
        if self.held || !self.answer.is_empty() {
            self.held = false;
            self.answer.clear();
            self.interrupted += 1;
        }
        self.triggers += usize::from(self.work == 0);
        self.work == 0
    }

    fn abandon(&mut self) {
        if !self.input.is_empty() {
            self.input.clear();
            self.abandoned += 1;
        }
    }

    fn panel(&mut self, panel: Panel) {
        self.panels.push(panel);
    }
}

impl Bench for Fake {
    fn turn(&mut self, interface: &mut Interface) -> bool {
        interface.turn(self)
    }

    fn pass(&mut self) -> bool {
        let works = self.work > 0;
        self.work = self.work.saturating_sub(1);
        works
    }
}

pub fn usb() -> Usb<Fake> {
    Usb::new(Fake::default())
}
