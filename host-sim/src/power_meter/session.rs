//! One link of the instrument.

use super::command::{Command, Path};
use super::error::{COLLISION, Entry, Queue};
use super::{READINGS, SETTLE_TICKS, SWITCH_TICKS};
use crate::bench_twin::{Bench, Sees};
use crate::optics::{dbm, milliwatts};
use stage_controller::scpi::lexer::{CLEAR, Event, Lexer};
use std::collections::VecDeque;

/// Output that the link has not taken yet, beyond which no more is executed, bytes.
const OUTPUT: usize = 4096;
/// Bits of the status byte (IEEE 488.2, 11.2; SCPI-99 volume 1, 9).
const STATUS_ERRORS: u8 = 4;
const STATUS_MESSAGE: u8 = 16;
const STATUS_EVENTS: u8 = 32;
const STATUS_MASTER: u8 = 64;
/// *OPC has come true.
const OPERATION_COMPLETE: u8 = 1;
/// After power-up (IEEE 488.2, 11.5.1.1.1).
const POWER_ON: u8 = 128;

/// What the message waits for.
#[derive(Clone, Debug)]
pub(super) enum Wait {
    /// The switch settles until this tick.
    Switch(u64),
    /// Readings of a mean, from this tick on.
    Reading { channels: Vec<usize>, from: u64, count: u32, sums_mw: [f64; 2], saturated: [bool; 2] },
}

/// One link: its message, its queue and registers.
#[derive(Clone, Debug)]
pub struct Session {
    pub(super) lexer: Lexer,
    /// The message that is executed, and where its next unit begins.
    pub(super) message: Option<(String, usize)>,
    path: Path,
    pub(super) answers: Vec<String>,
    pub(super) wait: Option<Wait>,
    pub(super) output: VecDeque<u8>,
    pub(super) queue: Queue,
    event_enable: u8,
    service_enable: u8,
    /// The collision is in the queue, or was.
    told: bool,
    /// The message has asked for an answer that nothing may follow on a bus.
    pub(super) indefinite: bool,
}

impl Default for Session {
    fn default() -> Self {
        Self::new()
    }
}

impl Session {
    /// A link as after power-up.
    pub fn new() -> Self {
        Session {
            lexer: Lexer::new(),
            message: None,
            path: Path::new(),
            answers: Vec::new(),
            wait: None,
            output: VecDeque::new(),
            queue: Queue::new(POWER_ON),
            event_enable: 0,
            service_enable: 0,
            told: false,
            indefinite: false,
        }
    }

    /// Takes bytes, up to the end of a message; says how many. The others are to be offered again, first.
    pub fn receive(&mut self, bytes: &[u8]) -> usize {
        for (n, byte) in bytes.iter().enumerate() {
            if self.message.is_some() {
                // a clear is seen behind what waits, too
                let Some(clear) = bytes[n..].iter().position(|byte| *byte == CLEAR) else { return n };
                self.device_clear();
                return n + clear + 1;
            }
            let event = self.lexer.push(*byte);
            self.framed(event);
        }
        bytes.len()
    }

    pub(super) fn framed(&mut self, event: Event) {
        match event {
            Event::Message => {
                let text = String::from_utf8_lossy(self.lexer.message()).into_owned();
                self.lexer.release();
                (self.message, self.path, self.indefinite) = (Some((text, 0)), Path::new(), false);
            }
            Event::TooLong => self.queue.push(Entry::new(-363, "message longer than 512 bytes")),
            Event::Clear => self.device_clear(),
            Event::Abort | Event::None => {}
        }
    }

    /// 0x18, device clear: drops input, output and a reading; the switch goes where it was sent.
    pub fn device_clear(&mut self) {
        self.lexer.clear();
        self.output.clear();
        self.give_up();
    }

    /// Drops the message that is executed, and what it has answered so far.
    pub(super) fn give_up(&mut self) {
        self.message = None;
        self.answers.clear();
        if matches!(self.wait, Some(Wait::Reading { .. })) {
            self.wait = None;
        }
    }

    /// Executes what can be executed at this tick of the bench; true when something was.
    pub fn poll(&mut self, bench: &mut Bench, tick: u64) -> bool {
        self.advance(bench, tick, |_| true)
    }

    /// Executes what can be executed, for as long as `goes_on` says so; it is asked in front of every unit.
    pub(super) fn advance(&mut self, bench: &mut Bench, tick: u64, mut goes_on: impl FnMut(&mut Self) -> bool) -> bool {
        self.look_at(bench);
        let mut progress = false;
        while self.output.len() < OUTPUT && !self.waits(tick) && goes_on(self) {
            let Some((text, at)) = self.message.take() else { break };
            progress = true;
            if at > text.len() {
                self.end_message();
                continue;
            }
            let (unit, end) = unit_at(&text, at);
            let result = match unit.is_empty() {
                true => Ok(()),
                false => Command::parse(unit, &mut self.path).and_then(|command| self.execute(&command, bench, tick)),
            };
            match result {
                Err(entry) if entry.is_command_error() => {
                    self.queue.push(entry);
                    self.end_message();
                    continue;
                }
                Err(entry) => self.queue.push(entry),
                Ok(()) => {}
            }
            self.message = Some((text, end + 1));
        }
        progress
    }

    /// A collision is told once on each link.
    fn look_at(&mut self, bench: &Bench) {
        if let Some(collision) = bench.collision().filter(|_| !self.told) {
            self.told = true;
            self.queue.push(Entry::new(COLLISION, collision.to_string()));
        }
    }

    /// The next unit has to wait; ends what is over.
    fn waits(&mut self, tick: u64) -> bool {
        match &self.wait {
            None => return false,
            Some(Wait::Switch(until)) if tick < *until => return true,
            Some(Wait::Switch(_)) => {}
            Some(Wait::Reading { count, .. }) if *count < READINGS => return true,
            Some(Wait::Reading { channels, count, sums_mw, saturated, .. }) => {
                let level = |channel: &usize| match saturated[*channel] {
                    true => "9.9E37".to_owned(),
                    false => format!("{:.3}", dbm(sums_mw[*channel] / f64::from(*count))),
                };
                self.answers.push(channels.iter().map(level).collect::<Vec<_>>().join(","));
            }
        }
        self.wait = None;
        false
    }

    pub(super) fn end_message(&mut self) {
        if !self.answers.is_empty() {
            self.output.extend(std::mem::take(&mut self.answers).join(";").bytes());
            self.output.push_back(b'\n');
        }
    }

    fn execute(&mut self, command: &Command, bench: &mut Bench, tick: u64) -> Result<(), Entry> {
        let answer = match command {
            Command::Identify => {
                self.indefinite = true;
                concat!("Stage Controller,Power meter and switch,0,", env!("CARGO_PKG_VERSION")).to_owned()
            }
            Command::SelfTest => "0".to_owned(),
            // everything is done in its turn: when this is reached, what stands before it has ended
            Command::Complete => "1".to_owned(),
            Command::EventStatus => std::mem::take(&mut self.queue.events).to_string(),
            Command::EventEnable => self.event_enable.to_string(),
            Command::ServiceEnable => self.service_enable.to_string(),
            Command::StatusByte => self.status_byte().to_string(),
            Command::NextError => self.queue.pop().to_string(),
            Command::ErrorCount => self.queue.len().to_string(),
            Command::Version => "1999.0".to_owned(),
            Command::Routed(channel) => match bench.sees()[*channel] {
                Sees::Fibre(fibre) => (fibre + 1).to_string(),
                Sees::Detector => "DET".to_owned(),
                Sees::Nothing => "OPEN".to_owned(),
            },
            Command::Read(channels) => {
                if let Some(collision) = bench.collision() {
                    self.answers.push(vec!["9.91E37"; channels.len()].join(","));
                    return Err(Entry::new(COLLISION, collision.to_string()));
                }
                self.wait = Some(Wait::Reading {
                    channels: channels.clone(),
                    from: tick + SETTLE_TICKS,
                    count: 0,
                    sums_mw: [0.0; 2],
                    saturated: [false; 2],
                });
                return Ok(());
            }
            _ => return self.act(command, bench, tick),
        };
        self.answers.push(answer);
        Ok(())
    }

    /// What has no answer.
    fn act(&mut self, command: &Command, bench: &mut Bench, tick: u64) -> Result<(), Entry> {
        match command {
            Command::Clear => self.queue.clear(),
            Command::SetComplete => self.queue.events |= OPERATION_COMPLETE,
            Command::SetEventEnable(mask) => self.event_enable = *mask,
            // bit 6 is never one (IEEE 488.2, 11.3.2)
            Command::SetServiceEnable(mask) => self.service_enable = mask & !STATUS_MASTER,
            Command::Reset => {
                let sees = bench.options().sees;
                for (channel, sees) in sees.into_iter().enumerate() {
                    bench.connect(channel, sees);
                }
                self.wait = Some(Wait::Switch(tick + SWITCH_TICKS));
            }
            Command::Route(channel, sees) => {
                bench.connect(*channel, *sees);
                self.wait = Some(Wait::Switch(tick + SWITCH_TICKS));
            }
            _ => {}
        }
        Ok(())
    }

    /// The unit that comes next is a query.
    pub(super) fn is_at_query(&self) -> bool {
        let Some((text, at)) = self.message.as_ref().filter(|(text, at)| *at <= text.len()) else { return false };
        let (unit, _) = unit_at(text, *at);
        unit.split_ascii_whitespace().next().is_some_and(|header| header.ends_with('?'))
    }

    /// The status byte (IEEE 488.2, 11.2), MSS in bit 6.
    pub fn status_byte(&self) -> u8 {
        self.status_byte_with(!self.output.is_empty())
    }

    pub(super) fn status_byte_with(&self, message_available: bool) -> u8 {
        let mut status = 0;
        status |= if self.queue.len() > 0 { STATUS_ERRORS } else { 0 };
        status |= if message_available { STATUS_MESSAGE } else { 0 };
        status |= if self.queue.events & self.event_enable != 0 { STATUS_EVENTS } else { 0 };
        status | if status & self.service_enable != 0 { STATUS_MASTER } else { 0 }
    }

    /// The bench has come to a tick: what the meter shows there belongs to a mean that is taken.
    pub fn see(&mut self, bench: &Bench, tick: u64) {
        self.look_at(bench);
        if let Some(Wait::Reading { from, count, sums_mw, saturated, .. }) = &mut self.wait
            && tick > *from
            && *count < READINGS
        {
            let levels = bench.readings();
            for channel in 0..2 {
                sums_mw[channel] += milliwatts(levels[channel]);
                saturated[channel] |= bench.is_saturated(channel);
            }
            *count += 1;
        }
    }

    /// The message waits for time to pass.
    pub fn wants_time(&self) -> bool {
        self.wait.is_some()
    }

    /// A message is being executed.
    pub fn is_busy(&self) -> bool {
        self.message.is_some()
    }

    /// Hands out answers; says how many bytes.
    pub fn transmit(&mut self, to: &mut [u8]) -> usize {
        let count = to.len().min(self.output.len());
        for (to, byte) in to.iter_mut().zip(self.output.drain(..count)) {
            *to = byte;
        }
        count
    }
}

/// The unit of a message that begins at a place, and where it ends.
fn unit_at(text: &str, at: usize) -> (&str, usize) {
    let end = text[at..].find(';').map_or(text.len(), |end| at + end);
    (text[at..end].trim(), end)
}
