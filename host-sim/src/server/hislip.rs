//! What is served, with the clients of a HiSLIP server.

use super::Served;
use super::link::{State, Stream};
use super::socket::Socket;
use super::station::TOKEN;
use crate::control::Hand;
use crate::gpib::{Panel, Ports};
use crate::hislip::{Channel, Fatal, Frame, Frames, Kind, Link, Locks, Over, VENDOR, VERSION, place};
use mio::net::TcpListener;
use mio::{Interest, Poll, Registry};
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

/// Sessions at a time.
const SESSIONS: usize = 16;
/// Connections at a time that have not said what they are. A further one takes the place of the oldest.
const STRANGERS: usize = 16;
/// A client that is not there with both connections after this time is sent away.
const INITIALIZATION: Duration = Duration::from_secs(10);
/// ... and after this time, when another client needs its place.
const HALF: Duration = Duration::from_secs(1);
/// Reads of one connection in one turn.
const READS: usize = 64;

/// A connection.
struct Connection {
    stream: Stream<Socket>,
    ended: bool,
}

impl Connection {
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
    fn refuse(&mut self, fatal: Fatal) {
        self.send(&mut Frame::bytes(Kind::FatalError, fatal as u8, 0, fatal.text().as_bytes()));
    }
}

/// A connection that has not said what it is.
struct Stranger {
    connection: Connection,
    frames: Frames,
    since: Duration,
}

impl Stranger {
    /// Its first message. An error: it is no client.
    fn first(&mut self) -> Result<Option<Frame>, Fatal> {
        let mut found = Ok(None);
        let frames = &mut self.frames;
        self.connection.stream.offer(|bytes| match frames.take(bytes) {
            Ok((taken, frame)) => {
                found = Ok(frame);
                taken
            }
            Err(_) => {
                found = Err(Fatal::BadHeader);
                bytes.len()
            }
        });
        found
    }
}

/// A client's link to an instrument.
struct Session {
    place: usize,
    port: usize,
    link: Link,
    synchronous: Connection,
    asynchronous: Option<Connection>,
    since: Duration,
}

/// What is served, with the clients of a HiSLIP server.
pub struct OnHislip<S> {
    served: S,
    listener: TcpListener,
    registry: Registry,
    strangers: Vec<Stranger>,
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
            if self.strangers.len() == STRANGERS {
                self.strangers.remove(0).connection.refuse(Fatal::TooMany);
            }
            let stream = Stream::new(Socket::accepted(stream, &self.registry));
            let connection = Connection { stream, ended: false };
            self.strangers.push(Stranger { connection, frames: Frames::default(), since: wall });
        }
        for mut stranger in std::mem::take(&mut self.strangers) {
            if !stranger.connection.fill() {
                continue;
            }
            match stranger.first() {
                Ok(None) if wall >= stranger.since + INITIALIZATION => {
                    stranger.connection.refuse(Fatal::BadInitialization);
                }
                Ok(None) => self.strangers.push(stranger),
                Ok(Some(frame)) => self.introduce(stranger.connection, &frame, wall),
                Err(fatal) => stranger.connection.refuse(fatal),
            }
        }
    }

    /// The first message of a connection says which of the two it is.
    fn introduce(&mut self, mut connection: Connection, frame: &Frame, wall: Duration) {
        match (frame.kind, frame.payload.as_deref()) {
            (Some(Kind::Initialize), Some(name)) => {
                let Some(place) = place(name).filter(|place| *place < self.served.places()) else {
                    return connection.refuse(Fatal::BadInitialization);
                };
                let Some(port) = self.open(place, wall) else { return connection.refuse(Fatal::TooMany) };
                if let Some(mut instrument) = self.served.port(place, port, wall) {
                    // a client of the network controls it as long as it does not say otherwise
                    instrument.panel(Panel::Enable(true));
                }
                let id = self.free_id();
                let versions = u32::from(VERSION) << 16 | u32::from(id);
                connection.send(&mut Frame::bytes(Kind::InitializeResponse, 0, versions, b""));
                let link = Link::new(id.into());
                let session = Session { place, port, link, synchronous: connection, asynchronous: None, since: wall };
                self.sessions.insert(id, session);
            }
            (Some(Kind::AsyncInitialize), _) => {
                let session = u16::try_from(frame.parameter).ok().and_then(|id| self.sessions.get_mut(&id));
                match session.filter(|session| session.asynchronous.is_none()) {
                    Some(session) => {
                        connection.send(&mut Frame::bytes(Kind::AsyncInitializeResponse, 0, VENDOR.into(), b""));
                        session.asynchronous = Some(connection);
                    }
                    None => connection.refuse(Fatal::BadInitialization),
                }
            }
            _ => connection.refuse(Fatal::BadInitialization),
        }
    }

    /// A link to an instrument. Who has begun and not gone on must make room.
    fn open(&mut self, place: usize, wall: Duration) -> Option<usize> {
        loop {
            let room = self.sessions.len() < SESSIONS;
            if let Some(port) = room.then(|| self.served.open(place, wall)).flatten() {
                return Some(port);
            }
            let half = |session: &Session| session.asynchronous.is_none() && wall >= session.since + HALF;
            let oldest = self.sessions.iter().filter(|(_, session)| half(session)).min_by_key(|(_, s)| s.since);
            let id = oldest.map(|(id, _)| *id)?;
            let mut session = self.sessions.remove(&id)?;
            session.synchronous.refuse(Fatal::BadInitialization);
            self.served.close(session.place, session.port);
        }
    }

    fn free_id(&mut self) -> u16 {
        while self.next == 0 || self.sessions.contains_key(&self.next) {
            self.next = self.next.wrapping_add(1);
        }
        self.next
    }

    /// One round of all sessions; true while one of them is at work.
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
        // who waits for a lock, or says nothing, waits without work
        self.sessions.values().any(|session| session.link.is_busy())
    }
}

impl Session {
    /// Takes messages and answers them; false when the session is over.
    fn round(&mut self, served: &mut impl Ports, locks: &mut Locks, wall: Duration) -> bool {
        let Session { place, port, link, synchronous, asynchronous, since } = self;
        let Some(mut instrument) = served.port(*place, *port, wall) else { return false };
        // first: what was sent on the other connection before what is read here is there too, then
        let heard_aside = asynchronous.as_mut().is_none_or(Connection::fill);
        let mut open = synchronous.fill();
        let Some(asynchronous) = asynchronous else {
            let refused = match synchronous.stream.has_input() {
                true => Some(Fatal::NotBothChannels),
                false => (wall >= *since + INITIALIZATION).then_some(Fatal::BadInitialization),
            };
            if let Some(fatal) = refused {
                synchronous.refuse(fatal);
            }
            return open && refused.is_none();
        };
        link.turn(&mut *instrument, locks, wall);
        // what was sent before a status query is done before it
        let mut told = |channel: Channel, connection: &mut Connection| {
            for _ in 0..READS {
                let mut taken = Ok(0);
                connection.stream.offer(|bytes| {
                    taken = link.receive(channel, bytes, &mut *instrument, locks, wall);
                    taken.unwrap_or(bytes.len())
                });
                if taken? == 0 {
                    break;
                }
                // one read does not bring all that has come
                if channel == Channel::Synchronous {
                    open = connection.fill();
                }
            }
            Ok(())
        };
        let told = [told(Channel::Synchronous, synchronous), told(Channel::Asynchronous, asynchronous)];
        link.turn(&mut *instrument, locks, wall);
        open |= synchronous.ended && (synchronous.stream.has_input() || link.has_work());
        let sent =
            synchronous.send(link.output(Channel::Synchronous)) & asynchronous.send(link.output(Channel::Asynchronous));
        for (told, connection) in told.into_iter().zip([synchronous, asynchronous]) {
            if let Err(Over::Refused(fatal)) = told {
                connection.refuse(fatal);
            }
        }
        heard_aside && open && sent && told == [Ok(()); 2]
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
