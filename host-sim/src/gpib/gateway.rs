//! One client's gateway: its lines become operations on a bus, one after the other.
//!
//! It understands what a Prologix GPIB-ETHERNET controller does, with these differences:
//! - A `++read` right behind a `++spoll` of an instrument that has nothing to say does not ask it: pyvisa-py reads so,
//!   and would cause -420 with every status byte.
//! - A line that an instrument does not take is held, as the handshake of a bus holds it, until the instrument goes on.
//!   `++clr` of that instrument, `++ifc` or `++rst` end it wherever they stand in what waits: the instrument is cleared,
//!   and what waits for it in front of them is dropped. All else is done in its order.
//! - A `!` as the first byte of a line is told to its instrument when it arrives, whatever waits in front of it.
//! - Several clients control the bus one after the other: `Claims`. When one goes, what it has begun to say and not
//!   ended is cleared; and where it may have begun a jog, all jogs over the gateway end.

use super::claims::Id;
use super::command::{Address, Command, HELP, Until};
use super::lines::Lines;
use super::queue::{Queue, What};
use super::settings::Settings;
use super::{Bus, Instrument, Panel};
use stage_controller::scpi::exchange::Read;
use std::time::Duration;

/// Answers that the client has not taken yet, beyond which no more is read, bytes.
const OUTPUT: usize = 16_384;
/// What ends an answer of the gateway itself.
const NEWLINE: &str = "\r\n";

/// What takes longer than a moment. `begun`: how often its instrument had been cleared when it began there; once more,
/// and it is over.
#[derive(Clone, Debug, Default)]
enum Doing {
    #[default]
    Nothing,
    Writing(Writing),
    Reading(Reading),
    /// What is still to be triggered, the last one first.
    Triggering(Vec<Address>),
}

#[derive(Clone, Debug)]
struct Writing {
    bytes: Vec<u8>,
    sent: usize,
    /// With EOI on the last byte.
    end: bool,
    /// The line ends here.
    whole: bool,
    begun: Option<u64>,
    aborts: bool,
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    until: Until,
    /// The last byte, wall time.
    since: Duration,
    /// Asks only for what is there.
    polite: bool,
    begun: Option<u64>,
}

/// The gateway as one client sees it.
#[derive(Clone, Debug)]
pub struct Gateway {
    first: u8,
    /// On the bus; none before it has done anything there.
    id: Option<Id>,
    settings: Settings,
    lines: Lines,
    /// The line that comes in begins with `!`.
    aborts: bool,
    queue: Queue,
    doing: Doing,
    /// A line that is sent in parts, and `begun` of its first one.
    parts: Option<u64>,
    /// The last line was a serial poll.
    polled: bool,
    /// When something last went on, wall time.
    moved: Duration,
    output: Vec<u8>,
}

impl Gateway {
    /// With the settings of the start; `first` is the address then.
    pub fn new(first: u8) -> Self {
        let settings = Settings::new(first);
        Gateway {
            first,
            id: None,
            settings,
            lines: Lines::default(),
            aborts: false,
            queue: Queue::new(settings.address),
            doing: Doing::Nothing,
            parts: None,
            polled: false,
            moved: Duration::ZERO,
            output: Vec::new(),
        }
    }

    fn id(&mut self, bus: &mut impl Bus) -> Id {
        *self.id.get_or_insert_with(|| bus.claims().newcomer())
    }

    /// Takes bytes of the client, at this `wall` time since the start, and does what they say; says how many. The
    /// others are to be offered again, first.
    pub fn receive(&mut self, bytes: &[u8], bus: &mut impl Bus, wall: Duration) -> usize {
        let mut taken = 0;
        while taken < bytes.len() && !self.queue.is_full() {
            let begins = self.lines.is_at_start();
            let line = self.lines.push(bytes[taken]);
            taken += 1;
            if begins && self.lines.is_abort() {
                self.aborts = true;
                with(bus, self.queue.address(), wall, |instrument| instrument.foresee_abort(true));
            }
            if let Some(line) = line {
                self.queue.push(line, std::mem::take(&mut self.aborts));
            }
        }
        self.go_on(bus, wall);
        taken
    }

    /// Goes on with what is under way and what waits behind it, at this `wall` time since the start.
    pub fn go_on(&mut self, bus: &mut impl Bus, wall: Duration) {
        loop {
            self.doing = match std::mem::take(&mut self.doing) {
                Doing::Nothing => Doing::Nothing,
                Doing::Writing(line) => self.write(line, bus, wall),
                Doing::Reading(reading) => self.read(reading, bus, wall),
                Doing::Triggering(addresses) => self.trigger(addresses, bus, wall),
            };
            if self.is_at_work() {
                if !self.break_off(bus, wall) {
                    return;
                }
            } else if self.output.len() >= OUTPUT {
                return;
            } else {
                let Some(line) = self.queue.pop() else { return };
                self.moved = wall;
                self.begin(line, bus, wall);
            }
        }
    }

    /// Ends a read that has brought nothing for longer than its time-out. What it has not brought waits for the next.
    pub fn expire(&mut self, bus: &mut impl Bus, wall: Duration) {
        let room = self.output.len() < OUTPUT;
        if let Doing::Reading(reading) = &mut self.doing
            && !room
        {
            reading.since = wall;
        }
        if self.has_timed_out(wall) {
            self.doing = Doing::Nothing;
            let who = self.id(bus);
            bus.claims().leave(self.settings.address.primary, who, None);
            self.go_on(bus, wall);
        }
    }

    /// What an instrument does not take is given up when a clear of it waits. False: it goes on.
    fn break_off(&mut self, bus: &mut impl Bus, wall: Duration) -> bool {
        let at = match &self.doing {
            Doing::Writing(_) => self.settings.address,
            Doing::Triggering(addresses) => match addresses.last() {
                Some(address) => *address,
                None => return false,
            },
            _ => return false,
        };
        if !self.queue.take_clear(at) {
            return false;
        }
        match std::mem::take(&mut self.doing) {
            Doing::Writing(line) => {
                self.parts = None;
                if line.begun.is_some() {
                    self.clear(at, bus, wall);
                }
            }
            Doing::Triggering(mut addresses) => {
                addresses.pop();
                self.doing = Doing::Triggering(addresses);
            }
            _ => {}
        }
        true
    }

    /// Device clear, for all clients.
    fn clear(&mut self, at: Address, bus: &mut impl Bus, wall: Duration) {
        let coming = self.foresees(at);
        let there = with(bus, at, wall, |instrument| {
            instrument.clear();
            if coming {
                instrument.foresee_abort(true);
            }
        });
        if there.is_some() {
            bus.claims().cleared(at.primary);
        }
    }

    /// A `!` is on its way to an instrument.
    fn foresees(&self, at: Address) -> bool {
        let under_way = matches!(&self.doing, Doing::Writing(line) if line.aborts) && self.settings.address == at;
        under_way || self.aborts && self.queue.address() == at || self.queue.aborts(at)
    }

    /// The client sends no more: where it has begun jogs they end, also those it still begins, and those of others.
    pub fn end_jogs(&mut self, bus: &mut impl Bus) {
        if let Some(id) = self.id {
            bus.claims().jogs(id).into_iter().for_each(|address| bus.release(address));
        }
    }

    /// The client has gone.
    pub fn hang_up(&mut self, bus: &mut impl Bus, wall: Duration) {
        for address in bus.addresses() {
            if self.foresees(Address { primary: address, secondary: None })
                && let Some(mut instrument) = bus.instrument(address, wall)
            {
                instrument.foresee_abort(false);
            }
        }
        let here = self.settings.address;
        if let Doing::Writing(Writing { begun: Some(begun), .. }) = std::mem::take(&mut self.doing)
            && begun == bus.claims().clears(here.primary)
        {
            (self.aborts, self.queue) = (false, Queue::new(here));
            self.clear(here, bus, wall);
        }
        self.end_jogs(bus);
        let Some(id) = self.id else { return };
        for address in bus.claims().forget(id) {
            let partial = bus.instrument(address, wall).is_some_and(|mut instrument| instrument.is_partial());
            if partial {
                (self.aborts, self.queue) = (false, Queue::new(here));
                self.clear(Address { primary: address, secondary: None }, bus, wall);
            }
        }
    }

    /// A line: a command is done, data is begun to be sent.
    fn begin(&mut self, line: What, bus: &mut impl Bus, wall: Duration) {
        let polled = std::mem::take(&mut self.polled);
        match line {
            What::Data { mut bytes, whole, aborts } => {
                let clears = bus.claims().clears(self.settings.address.primary);
                if self.parts.is_some_and(|begun| begun != clears) {
                    // what was in front of this part in its line is no more
                    self.parts = self.parts.filter(|_| !whole);
                    return;
                }
                if whole {
                    bytes.extend_from_slice(self.settings.end());
                }
                let end = whole && self.settings.eoi;
                self.doing = Doing::Writing(Writing { bytes, sent: 0, end, whole, begun: None, aborts });
            }
            What::Command(Some(Command::Read(until))) => {
                self.doing = Doing::Reading(Reading { until, since: wall, polite: polled, begun: None });
            }
            What::Command(Some(command)) => self.execute(command, bus, wall),
            What::Command(None) => self.say("Unrecognized command"),
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
            Command::Clear => self.clear(here, bus, wall),
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

    fn write(&mut self, mut line: Writing, bus: &mut impl Bus, wall: Duration) -> Doing {
        let (here, who) = (self.settings.address, self.id(bus));
        let claims = bus.claims();
        let clears = claims.clears(here.primary);
        if let Some(begun) = line.begun.filter(|begun| *begun != clears) {
            self.parts = (!line.whole).then_some(begun);
            return Doing::Nothing;
        }
        // where nobody is, nobody listens
        let nobody = here.secondary.is_some();
        if !nobody && !claims.take(here.primary, who, wall) {
            return Doing::Writing(line);
        }
        if !nobody && line.begun.is_none() {
            line.begun = Some(clears);
            // the name of every command that begins a jog has it; what goes on in the next part or line may cut a name
            let jogs = line.bytes.windows(3).any(|word| word.eq_ignore_ascii_case(b"JOG"));
            let goes_on = !line.end && (!line.whole || self.settings.end().is_empty());
            claims.wrote(here.primary, who, jogs || goes_on);
        }
        let before = line.sent;
        let done = with(bus, here, wall, |instrument| {
            while line.sent < line.bytes.len() {
                match instrument.write(&line.bytes[line.sent..], line.end) {
                    0 => return false,
                    taken => line.sent += taken,
                }
            }
            true
        });
        if line.sent > before {
            self.moved = wall;
        }
        if done == Some(false) {
            return Doing::Writing(line);
        }
        if line.aborts && !self.foresees(here) {
            with(bus, here, wall, |instrument| instrument.foresee_abort(false));
        }
        self.parts = (!line.whole).then_some(clears);
        if line.whole {
            self.leave(bus, wall);
        }
        if line.whole && self.settings.auto {
            return self.read(Reading { until: Until::End, since: wall, polite: false, begun: None }, bus, wall);
        }
        Doing::Nothing
    }

    /// What was under way here has ended. Who has asked is expected to read.
    fn leave(&mut self, bus: &mut impl Bus, wall: Duration) {
        let (here, who) = (self.settings.address, self.id(bus));
        let asked = with(bus, here, wall, |instrument| instrument.awaits_reader()) == Some(true);
        bus.claims().leave(here.primary, who, asked.then(|| wall + self.settings.read_timeout));
    }

    fn read(&mut self, mut reading: Reading, bus: &mut impl Bus, wall: Duration) -> Doing {
        let (here, who) = (self.settings.address, self.id(bus));
        let claims = bus.claims();
        let clears = claims.clears(here.primary);
        if reading.begun.is_some_and(|begun| begun != clears) {
            return Doing::Nothing;
        }
        if here.secondary.is_none() && !claims.take(here.primary, who, wall) {
            return Doing::Reading(reading);
        }
        reading.begun = Some(clears);
        let of_another = claims.was_asked_by_another(here.primary, who);
        let (Reading { until, polite, .. }, before) = (reading, self.output.len());
        let done = with(bus, here, wall, |instrument| match of_another && !instrument.is_idle() {
            true => Ended::Later,
            false => read(instrument, until, polite, &mut self.output),
        });
        if self.output.len() > before {
            (reading.since, self.moved) = (wall, wall);
        }
        match done {
            Some(Ended::Later) => return Doing::Reading(reading),
            Some(Ended::WithEnd) if self.settings.eot_enable => self.output.push(self.settings.eot_char),
            _ => {}
        }
        self.leave(bus, wall);
        Doing::Nothing
    }

    fn trigger(&mut self, mut addresses: Vec<Address>, bus: &mut impl Bus, wall: Duration) -> Doing {
        let who = self.id(bus);
        while let Some(address) = addresses.last().copied() {
            if address.secondary.is_none() {
                if !bus.claims().take(address.primary, who, wall) {
                    return Doing::Triggering(addresses);
                }
                let done = with(bus, address, wall, |instrument| instrument.trigger());
                // it is not part of a line: others may go on meanwhile
                bus.claims().leave(address.primary, who, None);
                if done == Some(false) {
                    return Doing::Triggering(addresses);
                }
                self.moved = wall;
            }
            addresses.pop();
        }
        Doing::Nothing
    }

    /// Something takes longer than a moment.
    fn is_at_work(&self) -> bool {
        !matches!(self.doing, Doing::Nothing)
    }

    /// Something is under way, or waits.
    pub fn is_busy(&self) -> bool {
        self.is_at_work() || !self.queue.is_empty()
    }

    /// A read has brought nothing for longer than its time-out, at this `wall` time since the start.
    pub fn has_timed_out(&self, wall: Duration) -> bool {
        matches!(&self.doing, Doing::Reading(reading) if wall >= reading.since + self.settings.read_timeout)
    }

    /// Nothing has gone on for longer than a read may take, at this `wall` time since the start.
    pub fn has_stalled(&self, wall: Duration) -> bool {
        self.is_at_work() && wall >= self.moved + self.settings.read_timeout
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
