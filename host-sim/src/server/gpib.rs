//! What is served, on a bus with its gateway.

use super::link::{State, Stream};
use super::socket::Socket;
use super::station::TOKEN;
use super::{Served, Station};
use crate::control::Hand;
use crate::gpib::{Bus, Claims, Gateway, Instrument, Panel, Ports};
use mio::net::TcpListener;
use mio::{Interest, Poll, Registry};
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

/// Address of the first board; the next ones follow, and the meter of a bench.
pub const FIRST_ADDRESS: u8 = 5;
/// Clients at a time.
const CLIENTS: usize = 8;

/// Boards, each for itself, on one bus.
pub struct Boards {
    stations: Vec<(Station, usize)>,
    claims: Claims,
}

impl Boards {
    /// Puts boards on a bus; none when one has no link left.
    pub fn new(stations: Vec<Station>) -> Option<Self> {
        let attach = |mut station: Station| station.attach(0).map(|link| (station, link));
        stations
            .into_iter()
            .map(attach)
            .collect::<Option<_>>()
            .map(|stations| Boards { stations, claims: Claims::default() })
    }
}

impl Bus for Boards {
    fn addresses(&self) -> Vec<u8> {
        (FIRST_ADDRESS..).take(self.stations.len()).collect()
    }

    fn instrument(&mut self, address: u8, _: Duration) -> Option<Box<dyn Instrument + '_>> {
        let (station, link) = self.stations.get_mut(usize::from(address.checked_sub(FIRST_ADDRESS)?))?;
        station.instrument(*link)
    }

    fn release(&mut self, address: u8) {
        let place = address.checked_sub(FIRST_ADDRESS).map(usize::from);
        if let Some((station, link)) = place.and_then(|place| self.stations.get_mut(place)) {
            station.release(*link);
        }
    }

    fn claims(&mut self) -> &mut Claims {
        &mut self.claims
    }
}

impl Ports for Boards {
    fn places(&self) -> usize {
        self.stations.len()
    }

    fn open(&mut self, place: usize, wall: Duration) -> Option<usize> {
        self.stations.get_mut(place)?.0.attach(wall.as_millis() as u64)
    }

    fn close(&mut self, place: usize, port: usize) {
        if let Some((station, _)) = self.stations.get_mut(place) {
            station.detach(port);
        }
    }

    fn port(&mut self, place: usize, port: usize, _: Duration) -> Option<Box<dyn Instrument + '_>> {
        self.stations.get_mut(place)?.0.instrument(port)
    }
}

impl Served for Boards {
    fn turn(&mut self, wall: Duration, budget: Duration) -> bool {
        let budget = budget / self.stations.len().max(1) as u32;
        // every one of them, whatever the others say
        self.stations.iter_mut().fold(false, |busy, (station, _)| station.turn(wall, budget) || busy)
    }

    fn hand(&mut self, hand: Hand) {
        self.stations.iter_mut().for_each(|(station, _)| station.hand(hand));
    }

    fn is_flat_out(&self) -> bool {
        self.stations.iter().any(|(station, _)| station.is_flat_out())
    }

    fn status(&self) -> String {
        self.stations.iter().map(|(station, _)| station.status()).collect::<Vec<_>>().join("   ")
    }
}

struct Client {
    stream: Stream<Socket>,
    gateway: Gateway,
    /// It sends no more.
    leaving: bool,
    /// It has sent something.
    spoke: bool,
}

impl Client {
    /// Takes what has come, does it, and hands the answers out.
    fn exchange(&mut self, bus: &mut impl Bus, wall: Duration) -> State {
        let Client { stream, gateway, spoke, .. } = self;
        gateway.go_on(bus, wall);
        loop {
            let mut taken = 0;
            stream.offer(|bytes| {
                *spoke = true;
                taken = gateway.receive(bytes, bus, wall);
                taken
            });
            let state = stream.drain(|to| gateway.transmit(to));
            if state != State::Open || taken == 0 {
                return state;
            }
        }
    }

    /// Reads what has come. That the other side has gone is seen behind what is not read yet, too.
    fn fill(&mut self) -> State {
        match self.stream.fill() {
            State::Open if self.stream.has_input() => self.stream.get_mut().other_side(),
            state => state,
        }
    }

    /// It sends no more, and all it has sent is done, or is held up for longer than it would wait for a read.
    fn is_done(&self, wall: Duration) -> bool {
        let all = !self.stream.has_input() && !self.gateway.is_busy() && !self.stream.has_output();
        self.leaving && (all || self.gateway.has_stalled(wall))
    }
}

/// What is served, on a bus, with the clients of its gateway.
pub struct OnBus<S> {
    served: S,
    listener: TcpListener,
    registry: Registry,
    clients: Vec<Client>,
}

impl<S: Served + Bus> OnBus<S> {
    /// Listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn new(served: S, address: SocketAddr, poll: &Poll) -> io::Result<Self> {
        let mut listener = TcpListener::bind(address)?;
        poll.registry().register(&mut listener, TOKEN, Interest::READABLE)?;
        Ok(OnBus { served, listener, registry: poll.registry().try_clone()?, clients: Vec::new() })
    }

    /// Where the gateway listens.
    ///
    /// # Errors
    /// Those of the socket.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    fn accept(&mut self, wall: Duration) {
        while let Ok((stream, _)) = self.listener.accept() {
            if self.clients.len() == CLIENTS {
                // who has gone before this one came is seen first
                self.hear(wall);
            }
            if self.clients.len() == CLIENTS
                && let Some(silent) = self.clients.iter().position(|client| !client.spoke)
            {
                self.clients.remove(silent).gateway.hang_up(&mut self.served, wall);
            }
            if self.clients.len() < CLIENTS {
                let stream = Stream::new(Socket::accepted(stream, &self.registry));
                if self.clients.is_empty() {
                    self.enable(true, wall);
                }
                let gateway = Gateway::new(FIRST_ADDRESS);
                self.clients.push(Client { stream, gateway, leaving: false, spoke: false });
            }
        }
    }

    /// The line REN: true while somebody controls the bus.
    fn enable(&mut self, enabled: bool, wall: Duration) {
        for address in self.served.addresses() {
            if let Some(mut instrument) = self.served.instrument(address, wall) {
                instrument.panel(Panel::Enable(enabled));
            }
        }
    }

    /// Ends reads whose time is over, once the instruments have had theirs.
    fn expire(&mut self, wall: Duration) {
        let OnBus { served, clients, .. } = self;
        clients.iter_mut().for_each(|client| client.gateway.expire(served, wall));
    }

    /// Takes what the clients have sent, and does and answers it; those who have gone are gone.
    fn hear(&mut self, wall: Duration) {
        let OnBus { served, clients, .. } = self;
        let before = clients.len();
        clients.retain_mut(|client| {
            let read = client.fill();
            client.leaving |= read == State::Ended;
            let state = client.exchange(served, wall);
            if client.leaving {
                client.gateway.end_jogs(served);
            }
            let gone = read == State::Gone || state == State::Gone || client.is_done(wall);
            if gone {
                client.gateway.hang_up(served, wall);
            }
            !gone
        });
        if before > 0 && self.clients.is_empty() {
            self.enable(false, wall);
        }
    }

    /// One round of all clients; true while one of them waits.
    fn round(&mut self, wall: Duration) -> bool {
        self.accept(wall);
        self.hear(wall);
        self.served.end_late_jogs(wall);
        self.clients.iter().any(|client| client.gateway.is_busy() || client.stream.has_input() || client.leaving)
    }
}

impl<S: Ports> Ports for OnBus<S> {
    fn places(&self) -> usize {
        self.served.places()
    }

    fn open(&mut self, place: usize, wall: Duration) -> Option<usize> {
        self.served.open(place, wall)
    }

    fn close(&mut self, place: usize, port: usize) {
        self.served.close(place, port);
    }

    fn port(&mut self, place: usize, port: usize, wall: Duration) -> Option<Box<dyn Instrument + '_>> {
        self.served.port(place, port, wall)
    }
}

impl<S: Served + Bus> Served for OnBus<S> {
    fn turn(&mut self, wall: Duration, budget: Duration) -> bool {
        self.round(wall);
        let busy = self.served.turn(wall, budget);
        let waits = self.round(wall);
        self.expire(wall);
        waits || busy
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
