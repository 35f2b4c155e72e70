//! What is served, with the clients of a HiSLIP server.

use super::Served;
use super::link::{State, Stream};
use super::socket::Socket;
use super::station::TOKEN;
use crate::control::Hand;
use crate::gpib::{Panel, Ports};
use crate::hislip::{Client, Frame, Frames, Kind, Locks, VENDOR, VERSION, place};
use mio::net::TcpListener;
use mio::{Interest, Poll, Registry};
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

/// Sessions at a time.
const SESSIONS: usize = 16;
/// Messages of one connection in one turn.
const MESSAGES: usize = 64;

/// Codes of fatal errors.
mod fatal {
    pub const BAD_HEADER: u8 = 1;
    pub const NOT_BOTH_CHANNELS: u8 = 2;
    pub const BAD_INITIALIZATION: u8 = 3;
    pub const TOO_MANY: u8 = 4;
}

/// A connection and its messages.
struct Channel {
    stream: Stream<Socket>,
    frames: Frames,
    ended: bool,
}

impl Channel {
    /// The next message. An error: the connection is of no use any more.
    fn next(&mut self) -> Result<Option<Frame>, u8> {
        let mut found = Ok(None);
        let frames = &mut self.frames;
        self.stream.offer(|bytes| match frames.take(bytes) {
            Ok((taken, frame)) => {
                found = Ok(frame);
                taken
            }
            Err(_) => {
                found = Err(fatal::BAD_HEADER);
                bytes.len()
            }
        });
        found
    }

    /// Reads what has come; false when the other side has gone.
    fn fill(&mut self) -> bool {
        match self.stream.fill() {
            State::Open => {}
            State::Ended => self.ended = true,
            State::Gone => return false,
        }
        !self.ended || self.stream.has_input()
    }

    /// Sends what waits; false when the other side has gone.
    fn send(&mut self, output: &mut Vec<u8>) -> bool {
        let state = self.stream.drain(|to| {
            let count = to.len().min(output.len());
            to[..count].copy_from_slice(&output[..count]);
            output.drain(..count);
            count
        });
        state == State::Open
    }

    /// Says why it is closed, as far as that is still heard.
    fn refuse(&mut self, code: u8) {
        let text = match code {
            fatal::BAD_HEADER => "Poorly formed message header",
            fatal::NOT_BOTH_CHANNELS => "Attempt to use connection without both channels established",
            fatal::BAD_INITIALIZATION => "Invalid initialization sequence",
            fatal::TOO_MANY => "Server refused connection due to maximum number of clients exceeded",
            _ => "Unidentified error",
        };
        self.send(&mut Frame::bytes(Kind::FatalError, code, 0, text.as_bytes()));
    }
}

/// A client's link to an instrument.
struct Session {
    place: usize,
    port: usize,
    client: Client,
    synchronous: Channel,
    asynchronous: Option<Channel>,
}

/// What is served, with the clients of a HiSLIP server.
pub struct OnHislip<S> {
    served: S,
    listener: TcpListener,
    registry: Registry,
    /// Connections that have not said what they are.
    strangers: Vec<Channel>,
    sessions: BTreeMap<u16, Session>,
    locks: BTreeMap<usize, Locks>,
    next: u16,
}

impl<S: Served + Ports> OnHislip<S> {
    /// Listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn new(served: S, address: SocketAddr, poll: &Poll) -> io::Result<Self> {
        let mut listener = TcpListener::bind(address)?;
        poll.registry().register(&mut listener, TOKEN, Interest::READABLE)?;
        let registry = poll.registry().try_clone()?;
        let (sessions, locks) = (BTreeMap::new(), BTreeMap::new());
        Ok(OnHislip { served, listener, registry, strangers: Vec::new(), sessions, locks, next: 1 })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    fn accept(&mut self, wall: Duration) {
        while let Ok((stream, _)) = self.listener.accept() {
            let stream = Stream::new(Socket::accepted(stream, &self.registry));
            let mut channel = Channel { stream, frames: Frames::default(), ended: false };
            if self.strangers.len() < SESSIONS {
                self.strangers.push(channel);
            } else {
                channel.refuse(fatal::TOO_MANY);
            }
        }
        for mut channel in std::mem::take(&mut self.strangers) {
            if !channel.fill() {
                continue;
            }
            match channel.next() {
                Ok(None) => self.strangers.push(channel),
                Ok(Some(frame)) => self.introduce(channel, &frame, wall),
                Err(code) => channel.refuse(code),
            }
        }
    }

    /// The first message of a connection says which of the two it is.
    fn introduce(&mut self, mut channel: Channel, frame: &Frame, wall: Duration) {
        match (frame.kind, frame.payload.as_deref()) {
            (Some(Kind::Initialize), Some(name)) => {
                let Some(place) = place(name) else { return channel.refuse(fatal::BAD_INITIALIZATION) };
                let room = self.sessions.len() < SESSIONS;
                let Some(port) = room.then(|| self.served.open(place, wall)).flatten() else {
                    return channel.refuse(fatal::TOO_MANY);
                };
                if let Some(mut instrument) = self.served.port(place, port, wall) {
                    // a client of the network controls it as long as it does not say otherwise
                    instrument.panel(Panel::Enable(true));
                }
                let id = self.free_id();
                let versions = u32::from(VERSION) << 16 | u32::from(id);
                channel.send(&mut Frame::bytes(Kind::InitializeResponse, 0, versions, b""));
                let client = Client::new(id.into());
                self.sessions.insert(id, Session { place, port, client, synchronous: channel, asynchronous: None });
            }
            (Some(Kind::AsyncInitialize), _) => {
                let session = u16::try_from(frame.parameter).ok().and_then(|id| self.sessions.get_mut(&id));
                match session.filter(|session| session.asynchronous.is_none()) {
                    Some(session) => {
                        channel.send(&mut Frame::bytes(Kind::AsyncInitializeResponse, 0, VENDOR.into(), b""));
                        session.asynchronous = Some(channel);
                    }
                    None => channel.refuse(fatal::BAD_INITIALIZATION),
                }
            }
            _ => channel.refuse(fatal::BAD_INITIALIZATION),
        }
    }

    fn free_id(&mut self) -> u16 {
        while self.next == 0 || self.sessions.contains_key(&self.next) {
            self.next = self.next.wrapping_add(1);
        }
        self.next
    }

    /// One round of all sessions; true while one of them waits.
    fn round(&mut self, wall: Duration) -> bool {
        self.accept(wall);
        let OnHislip { served, sessions, locks, .. } = self;
        sessions.retain(|id, session| {
            let locks = locks.entry(session.place).or_default();
            let kept = session.round(served, locks, wall);
            if !kept {
                locks.forget((*id).into());
                served.close(session.place, session.port);
            }
            kept
        });
        let waits = |session: &Session| session.client.is_busy() || session.synchronous.stream.has_input();
        !self.strangers.is_empty() || self.sessions.values().any(waits)
    }
}

impl Session {
    /// Takes messages and answers them; false when the session is over.
    fn round(&mut self, served: &mut impl Ports, locks: &mut Locks, wall: Duration) -> bool {
        let Session { place, port, client, synchronous, asynchronous } = self;
        let Some(mut instrument) = served.port(*place, *port, wall) else { return false };
        let mut open = synchronous.fill();
        let Some(asynchronous) = asynchronous else {
            if synchronous.stream.has_input() {
                synchronous.refuse(fatal::NOT_BOTH_CHANNELS);
                return false;
            }
            return open;
        };
        open &= asynchronous.fill();
        client.turn(&mut *instrument, locks, wall);
        // what was sent before a status query is done before it
        for _ in 0..MESSAGES {
            if !client.is_ready(&mut *instrument, locks) {
                break;
            }
            match synchronous.next() {
                Ok(None) => break,
                Ok(Some(frame)) => client.hear(frame, &mut *instrument),
                Err(code) => {
                    synchronous.refuse(code);
                    return false;
                }
            }
        }
        for _ in 0..MESSAGES {
            match asynchronous.next() {
                Ok(None) => break,
                Ok(Some(frame)) => client.hear_aside(frame, &mut *instrument, locks, wall),
                Err(code) => {
                    asynchronous.refuse(code);
                    return false;
                }
            }
        }
        client.turn(&mut *instrument, locks, wall);
        let [answers, asides] = client.output();
        open & synchronous.send(answers) & asynchronous.send(asides)
    }
}

impl<S: Served + Ports> Served for OnHislip<S> {
    fn turn(&mut self, wall: Duration, budget: Duration) -> bool {
        self.round(wall);
        let busy = self.served.turn(wall, budget);
        self.round(wall) || busy
    }

    fn hand(&mut self, hand: Hand) {
        self.served.hand(hand);
    }

    fn is_flat_out(&self) -> bool {
        self.served.is_flat_out()
    }

    fn status(&self) -> String {
        self.served.status()
    }
}
