//! One board with its links.

use super::link::{State, Stream};
use super::pty::Pty;
use crate::board::{Board, Interleaving};
use crate::control::Control;
use crate::flash::Flash;
use crate::machine::Machine;
use mio::net::{TcpListener, TcpStream};
use mio::unix::SourceFd;
use mio::{Interest, Poll, Token};
use stage_controller::controller::front::Front;
use stage_controller::controller::links::Links;
use stage_controller::refill::safety::Inputs;
use stage_controller::store::Store;
use stage_controller::units::decimal::{Formatted, Unit};
use stage_controller::units::{Axis, SEGMENT_NS};
use std::io::{self, Read, Write};
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd};
use std::time::{Duration, Instant};

/// Links of a board: sockets and the serial port.
const LINKS: usize = 9;
/// Most segments in one turn at full speed.
const FLAT_OUT_SEGMENTS: u64 = 2000;
/// Virtual time that a late turn makes up for; beyond, it is given up.
const CATCH_UP: Duration = Duration::from_millis(250);
/// Segments between two looks at the clock.
const SEGMENTS_PER_LOOK: u64 = 8;
/// Rounds of one turn for a client that leaves.
const LAST_ROUNDS: usize = 64;
const IDLE_TOKEN: Token = Token(0);

/// How virtual time runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as the machine can, and only while something moves.
    Max,
    /// This many times wall time.
    Factor(f64),
}

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
    stream: Stream<TcpStream>,
    /// It sends no more.
    leaving: bool,
}

struct Terminal {
    stream: Stream<Pty>,
    /// Its link while somebody has it open.
    link: Option<usize>,
    /// It was hung up.
    leaving: bool,
}

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
    clients: Vec<Client>,
    pty: Option<Terminal>,
    speed: Speed,
    /// Wall time up to which virtual time has run.
    reached: Duration,
    /// The last turn did not catch up with wall time.
    late: bool,
    seen: Seen,
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
        poll.registry().register(&mut listener, IDLE_TOKEN, Interest::READABLE)?;
        let pty = match options.pty {
            true => {
                let pty = Pty::new()?;
                poll.registry().register(&mut SourceFd(&pty.as_fd().as_raw_fd()), IDLE_TOKEN, Interest::READABLE)?;
                Some(Terminal { stream: Stream::new(pty), link: None, leaving: false })
            }
            false => None,
        };
        Ok(Station {
            board,
            links: Links::new(),
            listener,
            clients: Vec::new(),
            pty,
            speed: options.speed,
            reached: Duration::ZERO,
            late: false,
            seen: Seen::default(),
        })
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

    /// A hand does something at the stage.
    pub fn control(&mut self, control: Control) {
        control.apply(&mut self.board);
    }

    /// True when virtual time runs as fast as it can, or lags behind.
    pub fn is_flat_out(&self) -> bool {
        self.speed == Speed::Max || self.late
    }

    /// One turn of the loop at this wall time, of which virtual time may take `budget`; true while something moves or
    /// waits.
    pub fn turn(&mut self, wall: Duration, budget: Duration) -> bool {
        let now_ms = wall.as_millis() as u64;
        self.accept(now_ms);
        self.read(now_ms);
        let executed = self.links.poll(&mut self.board.front, now_ms);
        self.part(now_ms);
        self.write();
        self.advance(wall, budget);
        self.observe();
        self.links.poll(&mut self.board.front, now_ms);
        self.write();
        executed || self.is_busy()
    }

    fn is_busy(&self) -> bool {
        self.board.front.operation_pending()
            || self.board.has_news()
            || self.clients.iter().any(|c| c.stream.has_input() || c.leaving && !c.stream.has_output())
            || self.pty.as_ref().is_some_and(|pty| pty.leaving)
    }

    fn accept(&mut self, now_ms: u64) {
        while let Ok((stream, _)) = self.listener.accept() {
            // without a link number left the socket is closed at once
            if let Some(link) = self.links.open(now_ms) {
                let _ = stream.set_nodelay(true);
                self.clients.push(Client { link, stream: Stream::new(stream), leaving: false });
            }
        }
    }

    fn read(&mut self, now_ms: u64) {
        let Station { board, links, clients, pty, .. } = self;
        clients.retain_mut(|client| {
            let state = client.stream.fill();
            client.stream.offer(|bytes| links.receive(client.link, bytes, now_ms));
            match state {
                State::Open => {}
                State::Ended => client.leaving = true,
                // a reset by our answers to somebody who has sent all and closed
                State::Gone if client.leaving => client.stream.deafen(),
                State::Gone => {
                    // what came before the reset is still executed, if it can be without waiting
                    links.poll(&mut board.front, now_ms);
                    links.close(client.link, &mut board.front);
                    return false;
                }
            }
            true
        });
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
        let Station { board, links, clients, pty, .. } = self;
        clients.retain_mut(|client| {
            let done = client.leaving && finish(client.link, &mut client.stream, links, &mut board.front, now_ms);
            if done {
                links.close(client.link, &mut board.front);
            }
            !done
        });
        if let Some(Terminal { stream, link, leaving }) = pty
            && *leaving
            && link.is_none_or(|n| finish(n, stream, links, &mut board.front, now_ms))
        {
            if let Some(n) = link.take() {
                links.close(n, &mut board.front);
            }
            stream.clear();
            *leaving = false;
        }
    }

    fn write(&mut self) {
        let Station { board, links, clients, pty, .. } = self;
        clients.retain_mut(|client| {
            let state = client.stream.drain(|to| links.transmit(client.link, to));
            // an end is seen by the read that has taken everything in front of it
            let gone = state == State::Gone && !client.leaving;
            if gone {
                links.close(client.link, &mut board.front);
            }
            !gone
        });
        if let Some(Terminal { stream, link: Some(n), .. }) = pty {
            // a hang-up is seen by the next read
            let _ = stream.drain(|to| links.transmit(*n, to));
        }
    }

    fn advance(&mut self, wall: Duration, budget: Duration) {
        let start = Instant::now();
        let is_over = |n: u64| n % SEGMENTS_PER_LOOK == SEGMENTS_PER_LOOK - 1 && start.elapsed() >= budget;
        match self.speed {
            Speed::Max => {
                for n in 0..FLAT_OUT_SEGMENTS {
                    if !(self.board.front.operation_pending() || self.board.has_news()) || is_over(n) {
                        break;
                    }
                    self.step();
                }
            }
            Speed::Factor(factor) => {
                if wall - self.reached > CATCH_UP {
                    self.reached = wall - CATCH_UP;
                }
                let segment = Duration::from_nanos((SEGMENT_NS as f64 / factor) as u64).max(Duration::from_nanos(1));
                let mut n = 0;
                while self.reached + segment <= wall && !is_over(n) {
                    self.reached += segment;
                    self.step();
                    n += 1;
                }
                self.late = self.reached + segment <= wall;
            }
        }
    }

    fn step(&mut self) {
        self.board.step(|_| ());
        self.observe();
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
        }
    }

    /// The live line: pose, what moves, who is there.
    pub fn status(&self) -> String {
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

/// Executes what a client has left behind; true when nothing is left that can be executed without waiting for motion,
/// and its answers are out. Its jogs end at once.
fn finish<S: Read + Write>(
    link: usize,
    stream: &mut Stream<S>,
    links: &mut Links<LINKS>,
    front: &mut Front,
    now_ms: u64,
) -> bool {
    for _ in 0..LAST_ROUNDS {
        stream.offer(|bytes| links.receive(link, bytes, now_ms));
        let busy = front.is_busy_at_the_border();
        let progress = links.poll(front, now_ms);
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
