//! The power meter of a bench with its links.

use super::link::{State, Stream};
use super::socket::Socket;
use super::station::TOKEN;
use crate::gpib::{Instrument, Wired};
use crate::power_meter::Session;
use crate::rig::Rig;
use mio::net::TcpListener;
use mio::{Interest, Poll, Registry};
use stage_controller::scpi::exchange::Exchange;
use std::io;
use std::net::SocketAddr;

/// Links at a time.
const LINKS: usize = 9;

struct Client {
    stream: Stream<Socket>,
    session: Session,
    /// It sends no more.
    leaving: bool,
}

impl Client {
    /// Executes what can be executed without time, and hands the answers out.
    fn exchange(&mut self, rig: &mut Rig) -> State {
        let tick = rig.tick();
        loop {
            self.stream.offer(|bytes| self.session.receive(bytes));
            let progress = self.session.poll(&mut rig.bench, tick);
            let state = self.stream.drain(|to| self.session.transmit(to));
            if state != State::Open || !progress {
                return state;
            }
        }
    }

    fn is_done(&self) -> bool {
        self.leaving && !self.stream.has_input() && !self.session.is_busy() && !self.stream.has_output()
    }
}

/// The meter and who talks to it.
pub struct MeterStation {
    listener: TcpListener,
    registry: Registry,
    clients: Vec<Client>,
    /// Links that are a bus.
    buses: [Option<(Session, Exchange)>; LINKS],
}

impl MeterStation {
    /// Listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn new(address: SocketAddr, poll: &Poll) -> io::Result<Self> {
        let mut listener = TcpListener::bind(address)?;
        poll.registry().register(&mut listener, TOKEN, Interest::READABLE)?;
        Ok(MeterStation {
            listener,
            registry: poll.registry().try_clone()?,
            clients: Vec::new(),
            buses: std::array::from_fn(|_| None),
        })
    }

    /// Opens a link that is a bus. None when all are taken.
    pub(super) fn attach(&mut self) -> Option<usize> {
        let port = self.buses.iter().position(Option::is_none)?;
        self.buses[port] = Some((Session::new(), Exchange::new()));
        Some(port)
    }

    /// Closes a link that is a bus.
    pub(super) fn detach(&mut self, port: usize) {
        self.buses[port] = None;
    }

    /// The meter as an instrument on a link that is a bus.
    pub(super) fn instrument<'a>(&'a mut self, port: usize, rig: &'a mut Rig) -> Option<Box<dyn Instrument + 'a>> {
        let tick = rig.tick();
        let (device, exchange) = self.buses.get_mut(port)?.as_mut()?;
        let poll =
            move |session: &mut Session, see: &mut dyn FnMut(u8)| session.poll_message(&mut rig.bench, tick, see);
        Some(Box::new(Wired { exchange, device, poll }))
    }

    fn poll_buses(&mut self, rig: &mut Rig) {
        let tick = rig.tick();
        for (session, exchange) in self.buses.iter_mut().flatten() {
            exchange.poll(session, |session, see| session.poll_message(&mut rig.bench, tick, see));
        }
    }

    /// Where it listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Takes what the links have sent, executes it and answers; true while something waits.
    pub(super) fn hear(&mut self, rig: &mut Rig) -> bool {
        while let Ok((stream, _)) = self.listener.accept() {
            if self.clients.len() < LINKS {
                let stream = Stream::new(Socket::accepted(stream, &self.registry));
                self.clients.push(Client { stream, session: Session::new(), leaving: false });
            }
        }
        self.clients.retain_mut(|client| {
            match client.stream.fill() {
                State::Open => {}
                State::Ended => client.leaving = true,
                State::Gone => return false,
            }
            let state = client.exchange(rig);
            state == State::Open && !client.is_done()
        });
        self.poll_buses(rig);
        self.wants_time() || self.clients.iter().any(|client| client.stream.has_input())
    }

    /// The bench has gone on by a segment.
    pub(super) fn see(&mut self, rig: &mut Rig) {
        let tick = rig.tick();
        for client in &mut self.clients {
            client.session.see(&rig.bench, tick);
            if client.session.wants_time() {
                client.session.poll(&mut rig.bench, tick);
            }
        }
        let mut waits = false;
        for (session, exchange) in self.buses.iter_mut().flatten() {
            session.see(&rig.bench, tick);
            exchange.observe(session);
            waits |= session.wants_time();
        }
        if waits {
            self.poll_buses(rig);
        }
    }

    /// A client waits for the switch or for a reading.
    pub(super) fn wants_time(&self) -> bool {
        self.clients
            .iter()
            .map(|client| &client.session)
            .chain(self.buses.iter().flatten().map(|(session, _)| session))
            .any(Session::wants_time)
    }
}
