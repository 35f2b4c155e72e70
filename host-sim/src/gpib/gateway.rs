//! One client's gateway: its lines become operations on a bus, one after the other.
//!
//! It understands what a Prologix GPIB-ETHERNET controller does, with these differences:
//! - A `++read` whose time-out has passed while the instrument is still at work on the answer ends only when the client
//!   sends something else. A client that does not wait sees what it would see; one that does gets its answer.
//! - A `++read` right behind a `++spoll` of an instrument that has nothing to say does not ask it: pyvisa-py reads so,
//!   and would cause -420 with every status byte.
//! - A line that an instrument does not take is held, as the handshake of a bus holds it, until the instrument goes on
//!   or `++clr`, `++ifc` or `++rst` comes; then, and when the client goes, that instrument is cleared: half a message
//!   never waits for the next client.

use super::command::{Address, Command, HELP, Setting, Until};
use super::lines::{Line, Lines};
use super::{Bus, Instrument, Panel};
use stage_controller::scpi::exchange::Read;
use std::time::Duration;

/// Answers that the client has not taken yet, beyond which no more is read, bytes.
const OUTPUT: usize = 16_384;
/// What ends an answer of the gateway itself.
const NEWLINE: &str = "\r\n";

/// What the commands set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Settings {
    address: Address,
    auto: bool,
    eoi: bool,
    eos: u8,
    eot_enable: bool,
    eot_char: u8,
    read_timeout: Duration,
    save: bool,
}

impl Settings {
    fn new(primary: u8) -> Self {
        Settings {
            address: Address { primary, secondary: None },
            auto: false,
            eoi: true,
            eos: 0,
            eot_enable: false,
            eot_char: 0,
            read_timeout: Duration::from_millis(1000),
            save: true,
        }
    }

    fn set(&mut self, setting: Setting, value: u16) {
        match setting {
            Setting::Auto => self.auto = value == 1,
            Setting::Eoi => self.eoi = value == 1,
            Setting::Eos => self.eos = value as u8,
            Setting::EotEnable => self.eot_enable = value == 1,
            Setting::EotChar => self.eot_char = value as u8,
            Setting::Mode => {}
            Setting::ReadTimeout => self.read_timeout = Duration::from_millis(value.into()),
            Setting::SaveConfig => self.save = value == 1,
        }
    }

    fn get(&self, setting: Setting) -> u128 {
        match setting {
            Setting::Auto => self.auto.into(),
            Setting::Eoi => self.eoi.into(),
            Setting::Eos => self.eos.into(),
            Setting::EotEnable => self.eot_enable.into(),
            Setting::EotChar => self.eot_char.into(),
            Setting::Mode => 1,
            Setting::ReadTimeout => self.read_timeout.as_millis(),
            Setting::SaveConfig => self.save.into(),
        }
    }
}

/// What takes longer than a moment.
#[derive(Clone, Debug, Default)]
enum Doing {
    #[default]
    Nothing,
    /// `tried`: the instrument has seen some of it.
    Writing { bytes: Vec<u8>, sent: usize, end: bool, auto: bool, tried: bool },
    /// `since`: the last byte, wall time; `polite`: asks only for what is there.
    Reading { until: Until, since: Duration, polite: bool },
    /// What is still to be triggered, the last one first.
    Triggering(Vec<Address>),
}

/// The gateway as one client sees it.
#[derive(Clone, Debug)]
pub struct Gateway {
    first: u8,
    settings: Settings,
    lines: Lines,
    doing: Doing,
    /// The last line was a serial poll.
    polled: bool,
    output: Vec<u8>,
}

impl Gateway {
    /// With the settings of the start; `first` is the address then.
    pub fn new(first: u8) -> Self {
        Gateway {
            first,
            settings: Settings::new(first),
            lines: Lines::default(),
            doing: Doing::Nothing,
            polled: false,
            output: Vec::new(),
        }
    }

    /// Takes bytes of the client, at this `wall` time since the start, and does what they say; says how many. The
    /// others are to be offered again, first.
    pub fn receive(&mut self, bytes: &[u8], bus: &mut impl Bus, wall: Duration) -> usize {
        let mut taken = self.make_way(bytes, bus, wall);
        while taken < bytes.len() && matches!(self.doing, Doing::Nothing) && self.output.len() < OUTPUT {
            let line = self.lines.push(bytes[taken]);
            taken += 1;
            if let Some(line) = line {
                self.begin(line, bus, wall);
                self.go_on(bus, wall);
            }
        }
        taken
    }

    /// Ends what new bytes put an end to; says how many of them are done with.
    fn make_way(&mut self, bytes: &[u8], bus: &mut impl Bus, wall: Duration) -> usize {
        match self.doing {
            Doing::Reading { since, .. } if !bytes.is_empty() && wall >= since + self.settings.read_timeout => {
                self.doing = Doing::Nothing;
                0
            }
            Doing::Writing { .. } | Doing::Triggering(_) => {
                // in data every `+` is escaped: this is a command
                let at = ["++clr", "++ifc", "++rst"].iter().filter_map(|command| find_line(bytes, command)).min();
                if at.is_some() {
                    self.give_up(bus, wall);
                    self.lines = Lines::default();
                }
                at.unwrap_or(0)
            }
            _ => 0,
        }
    }

    /// Ends what is under way. An instrument that has seen a part of a line is cleared.
    fn give_up(&mut self, bus: &mut impl Bus, wall: Duration) {
        if let Doing::Writing { tried: true, .. } = std::mem::take(&mut self.doing) {
            with(bus, self.settings.address, wall, |instrument| instrument.clear());
        }
    }

    /// The client has gone.
    pub fn hang_up(&mut self, bus: &mut impl Bus, wall: Duration) {
        self.give_up(bus, wall);
        bus.release();
    }

    /// A line: a command is done, data is begun to be sent.
    fn begin(&mut self, line: Line, bus: &mut impl Bus, wall: Duration) {
        let polled = std::mem::take(&mut self.polled);
        match line {
            Line::Data { mut bytes, whole } => {
                if whole {
                    let end: &[u8] = match self.settings.eos {
                        0 => b"\r\n",
                        1 => b"\r",
                        2 => b"\n",
                        _ => b"",
                    };
                    bytes.extend_from_slice(end);
                }
                let (end, auto) = (whole && self.settings.eoi, whole && self.settings.auto);
                self.doing = Doing::Writing { bytes, sent: 0, end, auto, tried: false };
            }
            Line::Command(text) => match Command::parse(&text) {
                Some(Command::Read(until)) => self.doing = Doing::Reading { until, since: wall, polite: polled },
                Some(command) => self.execute(command, bus, wall),
                None => self.say("Unrecognized command"),
            },
        }
    }

    fn execute(&mut self, command: Command, bus: &mut impl Bus, wall: Duration) {
        let here = self.settings.address;
        match command {
            Command::Address(Some(address)) => self.settings.address = address,
            Command::Address(None) => match here.secondary {
                None => self.say(here.primary),
                Some(secondary) => self.say(format!("{} {secondary}", here.primary)),
            },
            Command::Set(setting, value) => self.settings.set(setting, value),
            Command::Ask(setting) => self.say(self.settings.get(setting)),
            // begun elsewhere
            Command::Read(_) => {}
            Command::SerialPoll(address) => {
                self.polled = address.is_none();
                let status = with(bus, address.unwrap_or(here), wall, |instrument| instrument.serial_poll());
                self.say(status.unwrap_or(0));
            }
            Command::ServiceRequest => {
                let addresses = bus.addresses();
                let mut requests = |at: &u8| bus.instrument(*at, wall).is_some_and(|mut one| one.requests_service());
                self.say(u8::from(addresses.iter().any(&mut requests)));
            }
            Command::Clear => {
                with(bus, here, wall, |instrument| instrument.clear());
            }
            Command::Trigger(mut addresses) => {
                if addresses.is_empty() {
                    addresses.push(here);
                }
                addresses.reverse();
                self.doing = Doing::Triggering(addresses);
            }
            Command::Local => {
                with(bus, here, wall, |instrument| instrument.panel(Panel::Local));
            }
            Command::LockOut => {
                with(bus, here, wall, |instrument| instrument.panel(Panel::LockOut));
            }
            // nobody talks or listens between two operations
            Command::InterfaceClear => {}
            Command::Version => self.say(concat!(
                "Stage Controller GPIB-LAN gateway, as Prologix GPIB-ETHERNET, version ",
                env!("CARGO_PKG_VERSION")
            )),
            Command::Reset => self.settings = Settings::new(self.first),
            Command::Help => self.say(HELP.trim_end().replace('\n', NEWLINE)),
        }
    }

    fn say(&mut self, text: impl ToString) {
        self.output.extend(text.to_string().bytes());
        self.output.extend(NEWLINE.bytes());
    }

    /// Goes on with what is under way, at this `wall` time since the start.
    pub fn go_on(&mut self, bus: &mut impl Bus, wall: Duration) {
        let here = self.settings.address;
        match &mut self.doing {
            Doing::Nothing => {}
            Doing::Writing { bytes, sent, end, auto, tried } => {
                let done = with(bus, here, wall, |instrument| {
                    *tried = true;
                    while *sent < bytes.len() {
                        match instrument.write(&bytes[*sent..], *end) {
                            0 => return false,
                            taken => *sent += taken,
                        }
                    }
                    true
                });
                // where nobody is, nobody listens
                if done != Some(false) {
                    let then = Doing::Reading { until: Until::End, since: wall, polite: false };
                    self.doing = if *auto { then } else { Doing::Nothing };
                    self.go_on(bus, wall);
                }
            }
            Doing::Reading { until, since, polite } => {
                let (until, polite, before) = (*until, *polite, self.output.len());
                let done = with(bus, here, wall, |instrument| read(instrument, until, polite, &mut self.output));
                if self.output.len() > before {
                    *since = wall;
                }
                match done {
                    Some(Ended::Later) => return,
                    Some(Ended::WithEnd) if self.settings.eot_enable => self.output.push(self.settings.eot_char),
                    _ => {}
                }
                self.doing = Doing::Nothing;
            }
            Doing::Triggering(addresses) => {
                while let Some(address) = addresses.last() {
                    if with(bus, *address, wall, |instrument| instrument.trigger()) == Some(false) {
                        return;
                    }
                    addresses.pop();
                }
                self.doing = Doing::Nothing;
            }
        }
    }

    /// Something is under way.
    pub fn is_busy(&self) -> bool {
        !matches!(self.doing, Doing::Nothing)
    }

    /// A read has brought nothing for longer than its time-out, at this `wall` time since the start.
    pub fn has_timed_out(&self, wall: Duration) -> bool {
        matches!(self.doing, Doing::Reading { since, .. } if wall >= since + self.settings.read_timeout)
    }

    /// Hands out what the client is to read; says how many bytes.
    pub fn transmit(&mut self, to: &mut [u8]) -> usize {
        let count = to.len().min(self.output.len());
        to[..count].copy_from_slice(&self.output[..count]);
        self.output.drain(..count);
        count
    }
}

/// How a read has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ended {
    /// It has not: more may come.
    Later,
    WithEnd,
    /// At its byte, or with nothing to be read.
    Otherwise,
}

fn read(instrument: &mut dyn Instrument, until: Until, polite: bool, output: &mut Vec<u8>) -> Ended {
    if polite && instrument.is_idle() {
        return Ended::Otherwise;
    }
    let mut chunk = [0; 1024];
    let most = if until == Until::End { chunk.len() } else { 1 };
    while output.len() < OUTPUT {
        match instrument.read(&mut chunk[..most]) {
            Read::Bytes(count, end) => {
                output.extend_from_slice(&chunk[..count]);
                if end {
                    return Ended::WithEnd;
                }
                if matches!(until, Until::Byte(byte) if output.ends_with(&[byte])) {
                    return Ended::Otherwise;
                }
            }
            Read::NotYet => return Ended::Later,
            Read::NothingAsked => return Ended::Otherwise,
        }
    }
    Ended::Later
}

/// Does something with the instrument at an address; none where there is none.
fn with<R>(
    bus: &mut impl Bus,
    address: Address,
    wall: Duration,
    act: impl FnOnce(&mut dyn Instrument) -> R,
) -> Option<R> {
    let nobody = address.secondary.is_some();
    let mut instrument = bus.instrument(address.primary, wall).filter(|_| !nobody)?;
    Some(act(&mut *instrument))
}

/// Where a line begins with this text.
fn find_line(bytes: &[u8], text: &str) -> Option<usize> {
    (0..bytes.len())
        .find(|at| bytes[*at..].starts_with(text.as_bytes()) && (*at == 0 || matches!(bytes[at - 1], b'\r' | b'\n')))
}
