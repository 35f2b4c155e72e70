//! One board with its links.

use super::Served;
use super::link::{State, Stream};
use super::pace::{Pace, Speed, Turn};
use super::pty::Pty;
use super::socket::Socket;
use crate::board::{Board, Interleaving};
use crate::control::Hand;
use crate::flash::Flash;
use crate::gpib::{Instrument, Wired};
use crate::machine::Machine;
use mio::net::TcpListener;
use mio::unix::SourceFd;
use mio::{Interest, Poll, Registry, Token};
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use stage_controller::refill::safety::Inputs;
use stage_controller::scpi::exchange::Exchange;
use stage_controller::scpi::session::Session;
use stage_controller::store::Store;
use stage_controller::units::decimal::{Formatted, Unit};
use stage_controller::units::{Axis, SEGMENT_NS};
use std::io::{self, Read, Write};
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd};
use std::time::Duration;

/// Links of a board: sockets, the serial port, the bus, and clients of HiSLIP.
const LINKS: usize = 18;
/// Rounds of one turn for a client that leaves.
const LAST_ROUNDS: usize = 64;
/// Of everything that wakes the server: it looks at all links then.
pub(super) const TOKEN: Token = Token(0);

/// How a board is set up.
#[derive(Clone, Debug)]
pub struct Options {
    /// Address to listen on.
    pub address: SocketAddr,
    /// Open a pseudo terminal too.
    pub pty: bool,
    /// Virtual time.
    pub speed: Speed,
    /// Seed of the interleaving of the two halves.
    pub seed: u64,
}

struct Client {
    link: usize,
    stream: Stream<Socket>,
    /// It sends no more.
    leaving: bool,
    /// It has gone, behind more input than is read ahead.
    gone: bool,
}

impl Client {
    /// It is not there to hear anything more.
    fn deafen(&mut self) {
        self.leaving = true;
        self.stream.deafen();
    }
}

struct Terminal {
    stream: Stream<Pty>,
    /// Its link while somebody has it open.
    link: Option<usize>,
    /// It was hung up.
    leaving: bool,
}

/// Links that are a bus, by their numbers.
type Buses = Vec<(usize, Exchange)>;

/// What conditions follow, of the latest report.
#[derive(Clone, Copy, Default, PartialEq)]
struct Seen {
    moving: u8,
    taking_up: u8,
    settled: bool,
    aborts: u16,
    inputs: Inputs,
    latched: bool,
}

/// One board with its links.
pub struct Station {
    board: Board,
    links: Links<LINKS>,
    listener: TcpListener,
    registry: Registry,
    clients: Vec<Client>,
    pty: Option<Terminal>,
    pace: Pace,
    seen: Seen,
    buses: Buses,
}

impl Station {
    /// Sets a board up and listens; `front` as after power-up, `store` where it keeps its settings.
    ///
    /// # Errors
    /// Those of the sockets.
    pub fn new(
        machine: &Machine,
        front: Front,
        store: Store<Flash>,
        options: &Options,
        poll: &Poll,
    ) -> io::Result<Self> {
        let mut board = Board::new(machine, front, Interleaving::Jittered(2), options.seed);
        board.store = store;
        board.settle();
        let mut listener = TcpListener::bind(options.address)?;
        poll.registry().register(&mut listener, TOKEN, Interest::READABLE)?;
        let pty = match options.pty {
            true => {
                let pty = Pty::new()?;
                poll.registry().register(&mut SourceFd(&pty.as_fd().as_raw_fd()), TOKEN, Interest::READABLE)?;
                Some(Terminal { stream: Stream::new(pty), link: None, leaving: false })
            }
            false => None,
        };
        Ok(Station {
            board,
            links: Links::new(),
            listener,
            registry: poll.registry().try_clone()?,
            clients: Vec::new(),
            pty,
            pace: Pace::new(options.speed),
            seen: Seen::default(),
            buses: Vec::new(),
        })
    }

    /// Opens a link that is a bus. None when all links are taken.
    pub(super) fn attach(&mut self, now_ms: u64) -> Option<usize> {
        let link = self.links.open(now_ms)?;
        self.buses.push((link, Exchange::new()));
        Some(link)
    }

    /// Closes a link that is a bus.
    pub(super) fn detach(&mut self, link: usize) {
        self.buses.retain(|(n, _)| *n != link);
        self.links.close(link, &mut self.board.front);
    }

    /// The board as an instrument on a link that is a bus.
    pub(super) fn instrument(&mut self, link: usize) -> Option<Box<dyn Instrument + '_>> {
        let Station { board, links, buses, .. } = self;
        let (_, exchange) = buses.iter_mut().find(|(n, _)| *n == link)?;
        let poll = |session: &mut Session, see: &mut dyn FnMut(u8)| session.poll_message(&mut board.front, see);
        Some(Box::new(Wired { exchange, device: links.session(link)?, poll }))
    }

    /// Who has begun a jog on a link that is a bus has gone: it ends.
    pub(super) fn release(&mut self, link: usize) {
        self.board.front.end_jogs(link as u8);
    }

    /// Executes what can be executed; true when something was.
    fn execute(&mut self, now_ms: u64) -> bool {
        execute(&mut self.links, &mut self.buses, &mut self.board.front, now_ms)
    }

    /// Where it listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Path of its pseudo terminal.
    pub fn terminal(&mut self) -> Option<std::path::PathBuf> {
        self.pty.as_mut().map(|pty| pty.stream.get_mut().path().to_owned())
    }

    /// The board.
    pub(super) fn board(&mut self) -> &mut Board {
        &mut self.board
    }

    /// Takes what the links have sent and executes it; true when something was.
    pub(super) fn hear(&mut self, now_ms: u64) -> bool {
        self.accept(now_ms);
        self.read(now_ms);
        let executed = self.execute(now_ms);
        self.part(now_ms);
        self.write();
        executed
    }

    /// Answers after time has passed.
    pub(super) fn tell(&mut self, now_ms: u64) {
        self.observe();
        self.execute(now_ms);
        self.write();
    }

    /// Something moves or is saved, something has happened at the stage, or a client waits for a reading.
    pub(super) fn wants_time(&self) -> bool {
        self.board.front.operation_pending() || self.board.has_news() || self.links.is_waiting()
    }

    pub(super) fn is_busy(&self) -> bool {
        self.wants_time()
            || self.clients.iter().any(|c| c.stream.has_input() || c.leaving && !c.stream.has_output())
            || self.pty.as_ref().is_some_and(|pty| pty.leaving)
    }

    fn accept(&mut self, now_ms: u64) {
        while let Ok((stream, _)) = self.listener.accept() {
            // without a link number left the socket is closed at once
            if let Some(link) = self.links.open(now_ms) {
                let stream = Stream::new(Socket::accepted(stream, &self.registry));
                self.clients.push(Client { link, stream, leaving: false, gone: false });
            }
        }
    }

    fn read(&mut self, now_ms: u64) {
        let Station { board, links, clients, pty, .. } = self;
        for client in clients {
            let state = client.stream.fill();
            client.stream.offer(|bytes| links.receive(client.link, bytes, now_ms));
            match state {
                State::Open if client.stream.is_full() => {
                    client.gone = client.stream.get_mut().other_side() != State::Open;
                    if client.gone {
                        board.front.end_jogs(client.link as u8);
                    }
                }
                State::Open => {}
                State::Ended => client.leaving = true,
                // also by our answers to somebody who has sent all and closed: what has come is still executed
                State::Gone => client.deafen(),
            }
        }
        if let Some(Terminal { stream, link, leaving }) = pty {
            // what the next one writes waits in the kernel until the link is free
            let state = if *leaving { State::Open } else { stream.fill() };
            if link.is_none() && (state == State::Open || stream.has_input()) {
                *link = links.open(now_ms);
            }
            if let Some(n) = *link {
                stream.offer(|bytes| links.receive(n, bytes, now_ms));
            }
            if state != State::Open {
                stream.deafen();
                *leaving = true;
            }
        }
    }

    /// Closes the links of those who send no more, once what they have sent is executed or waits for motion.
    fn part(&mut self, now_ms: u64) {
        let Station { board, links, clients, pty, buses, .. } = self;
        let front = &mut board.front;
        clients.retain_mut(|client| {
            // of one that has gone behind more than is read ahead, nothing more is done once nothing of that can be done
            let last = client.leaving || client.gone && client.stream.is_full();
            let done = last
                && finish(client.link, &mut client.stream, links, buses, front, now_ms)
                && (client.leaving || client.stream.is_full());
            if done {
                links.close(client.link, front);
            }
            !done
        });
        if let Some(Terminal { stream, link, leaving }) = pty
            && *leaving
            && link.is_none_or(|n| finish(n, stream, links, buses, front, now_ms))
        {
            if let Some(n) = link.take() {
                links.close(n, front);
            }
            stream.clear();
            *leaving = false;
        }
    }

    fn write(&mut self) {
        let Station { links, clients, pty, .. } = self;
        for client in clients {
            // an end is seen by the read that has taken everything in front of it
            if client.stream.drain(|to| links.transmit(client.link, to)) == State::Gone {
                client.deafen();
            }
        }
        if let Some(Terminal { stream, link: Some(n), .. }) = pty {
            // a hang-up is seen by the next read
            let _ = stream.drain(|to| links.transmit(*n, to));
        }
    }

    /// One segment of virtual time. A message that has waited for it goes on in it.
    pub(super) fn step(&mut self, now_ms: u64) {
        self.board.step(|_| ());
        self.observe();
        if self.links.is_waiting() {
            self.execute(now_ms);
        }
    }

    /// Short conditions are latched when they change, not only when a client asks.
    fn observe(&mut self) {
        let report = self.board.front.report();
        let now = Seen {
            moving: report.moving,
            taking_up: report.taking_up,
            settled: report.settled,
            aborts: report.aborts,
            inputs: report.inputs,
            latched: report.latched,
        };
        if now != self.seen {
            self.seen = now;
            self.links.observe(&self.board.front);
            for (link, exchange) in &mut self.buses {
                if let Some(session) = self.links.session(*link) {
                    exchange.observe(session);
                }
            }
        }
    }

    /// Pose, what moves, who is there.
    pub(super) fn line(&self) -> String {
        let front = &self.board.front;
        let pose = front.position();
        let unit = |axis: Axis| if axis.is_rotary() { Unit::ANGLE } else { Unit::LENGTH };
        let text = |axis: Axis| {
            let digits = Formatted { value: pose.0[axis.index()].into(), unit: unit(axis) }.to_string();
            // a live line wants 0.1 urad, not 0.2 nrad
            let keep = if axis.is_rotary() { digits.len().saturating_sub(3) } else { digits.len() };
            digits[..keep].to_owned()
        };
        let pose: Vec<_> = Axis::ALL.into_iter().map(text).collect();
        let state = if front.operation_pending() { "moving" } else { "at rest" };
        let clients = self.clients.len() + usize::from(self.pty.as_ref().is_some_and(|pty| pty.link.is_some()));
        let seconds = self.board.played() as f64 * SEGMENT_NS as f64 * 1e-9;
        format!("{seconds:9.1} s  {}  {state}  {clients} client(s)", pose.join(" "))
    }
}

impl Served for Station {
    fn turn(&mut self, wall: Duration, budget: Duration) -> bool {
        let now_ms = wall.as_millis() as u64;
        let executed = self.hear(now_ms);
        let mut turn = Turn::new(wall, budget);
        while self.pace.takes(&mut turn, self.wants_time()) {
            self.step(now_ms);
        }
        self.tell(now_ms);
        executed || self.is_busy()
    }

    fn hand(&mut self, hand: Hand) {
        if let Hand::Stage(control) = hand {
            control.apply(&mut self.board);
        }
    }

    fn is_flat_out(&self) -> bool {
        self.pace.is_flat_out()
    }

    fn status(&self) -> String {
        self.line()
    }
}

/// Executes what can be executed on all links; true when something was.
fn execute(links: &mut Links<LINKS>, buses: &mut Buses, front: &mut Front, now_ms: u64) -> bool {
    // bytes are traffic, a look at the link is none
    for (link, exchange) in buses.iter_mut() {
        if exchange.take_heard() {
            links.heard(*link, now_ms);
        }
    }
    links.poll_each(front, now_ms, |n, session, front| match buses.iter_mut().find(|(link, _)| *link == n) {
        Some((_, exchange)) => exchange.poll(session, |session, see| session.poll_message(front, see)),
        None => session.poll(front),
    })
}

/// Executes what a client has left behind; true when nothing is left that can be executed without waiting for motion,
/// and its answers are out. Its jogs end at once.
fn finish<S: Read + Write>(
    link: usize,
    stream: &mut Stream<S>,
    links: &mut Links<LINKS>,
    buses: &mut Buses,
    front: &mut Front,
    now_ms: u64,
) -> bool {
    for _ in 0..LAST_ROUNDS {
        stream.offer(|bytes| links.receive(link, bytes, now_ms));
        let busy = front.is_busy_at_the_border();
        let progress = execute(links, buses, front, now_ms);
        front.end_jogs(link as u8);
        if stream.drain(|to| links.transmit(link, to)) != State::Open {
            stream.deafen();
            continue;
        }
        if !progress {
            // orders on their way are a matter of a few segments
            let short = busy || front.is_busy_at_the_border() || front.operation_pending() && !front.is_moving();
            return !short && !stream.has_output() && links.is_quiet(link);
        }
    }
    false
}
