//! The controller's thread: ports, front and border, one turn after the other.

use crate::controller::front::Front;
use crate::controller::links::Links;
use crate::error::{Error, ErrorNumber};
use crate::hal::{Hal, Port, PortEvent, Signs};
use crate::refill::safety::Halt;
#[cfg(feature = "bus")]
use crate::scpi::exchange::{Attached, Exchange};

/// Bytes that are handed to a port at once.
const CHUNK: usize = 64;
/// A message with bytes missing has ended when nothing came for this long, ms.
const BROKEN_MS: u64 = 20;
/// Rounds of a turn in which bytes and answers go to and fro.
const ROUNDS: usize = 4;

/// The front with the links of `N` ports.
///
/// Both are large and stay where they are: a board has no stack to move them about.
pub struct Controller<'a, const N: usize> {
    /// The front half.
    pub front: &'a mut Front,
    links: &'a mut Links<N>,
    /// Link of each port while it is open.
    open: [Option<usize>; N],
    /// Bytes of a port were lost: until its next LF, or this time, what comes is the rest of a broken message, ms.
    broken_until: [u64; N],
    /// The exchange of each port that is a bus, while it is open.
    #[cfg(feature = "bus")]
    exchanges: [Option<Exchange>; N],
}

impl<'a, const N: usize> Controller<'a, N> {
    /// All ports closed.
    pub fn new(front: &'a mut Front, links: &'a mut Links<N>) -> Self {
        Controller {
            front,
            links,
            open: [None; N],
            broken_until: [0; N],
            #[cfg(feature = "bus")]
            exchanges: [None; N],
        }
    }

    /// True when every answer to what came through a port has been handed to it.
    pub fn has_answered(&self, n: usize) -> bool {
        self.open[n].is_none_or(|link| self.links.is_quiet(link))
    }

    /// One turn: reports up, bytes in, commands, orders down, answers out. Never waits. `now_ms`: time since the start.
    #[inline(never)] // its stack is not the task's
    pub fn turn(&mut self, hal: &mut impl Hal, ports: &mut [&mut dyn Port; N], now_ms: u64) {
        let mut traffic = false;
        ports.iter_mut().for_each(|port| port.attend());
        self.take_reports(hal);
        for _ in 0..ROUNDS {
            let mut progress = false;
            for (n, port) in ports.iter_mut().enumerate() {
                progress |= self.take_bytes(n, *port, now_ms);
            }
            progress |= self.execute(now_ms);
            // a check may have taken several segments: what is planned begins behind what has been made meanwhile
            self.take_reports(hal);
            self.give_orders(hal);
            for (n, port) in ports.iter_mut().enumerate() {
                progress |= self.give_answers(n, *port);
            }
            traffic |= progress;
            if !progress {
                break;
            }
        }
        hal.set_watch(self.front.watch());
        hal.set_enables(self.front.enable_lines(), self.front.disabled_lines());
        let report = self.front.report();
        hal.show(Signs { moving: self.front.is_moving(), fault: report.latched, traffic });
    }

    fn take_reports(&mut self, hal: &mut impl Hal) {
        while let Some(report) = hal.report() {
            let changed = report.differs(self.front.report());
            self.front.receive_report(report);
            if changed {
                // before the next report: a driver in fault stops the output again and again until it is disabled
                hal.set_watch(self.front.watch());
                hal.set_enables(self.front.enable_lines(), self.front.disabled_lines());
                // short conditions are latched when they change, not only when a client asks
                self.links.observe(self.front);
            }
        }
        // after the reports: one that tells of an abort comes before what is sampled behind it
        while let Some(sample) = hal.sample() {
            self.front.receive_sample(sample);
        }
        self.front.plan();
    }

    fn give_orders(&mut self, hal: &mut impl Hal) {
        if self.front.take_abort() {
            hal.halt(Halt::default());
        }
        if self.front.take_rearm() {
            hal.rearm();
        }
        // before the orders: what is to move is marked before it moves
        hal.keep(self.front.standstill_record());
        while hal.can_order() {
            let Some(order) = self.front.next_order() else { break };
            hal.order(order);
        }
    }

    /// Executes what can be executed on all links; true when something was.
    #[cfg(not(feature = "bus"))]
    fn execute(&mut self, now_ms: u64) -> bool {
        self.links.poll(self.front, now_ms)
    }

    /// Executes what can be executed on all links; true when something was.
    #[cfg(feature = "bus")]
    fn execute(&mut self, now_ms: u64) -> bool {
        let Controller { front, links, open, exchanges, .. } = self;
        links.poll_each(front, now_ms, |link, session, front| {
            let ports = open.iter().zip(exchanges.iter_mut());
            match ports.filter(|(open, _)| **open == Some(link)).find_map(|(_, exchange)| exchange.as_mut()) {
                Some(exchange) => exchange.poll(session, |session, see| session.poll_message(front, see)),
                None => session.poll(front),
            }
        })
    }

    /// Events and bytes of a port; true when there were any.
    fn take_bytes(&mut self, n: usize, port: &mut dyn Port, now_ms: u64) -> bool {
        let mut any = false;
        while let Some(event) = port.event() {
            any = true;
            self.happened(n, event, now_ms);
            #[cfg(feature = "bus")]
            if event != PortEvent::Asleep {
                self.exchanges[n] = self.open[n].and_then(|_| port.bus()).map(|_| Exchange::new());
            }
        }
        let Some(link) = self.open[n] else {
            // nobody is there: what is left of the last one is nobody's
            let left = port.received().len();
            port.consume(left);
            return any || left != 0;
        };
        #[cfg(feature = "bus")]
        if let (Some(exchange), Some(device), Some(bus)) =
            (&mut self.exchanges[n], self.links.session(link), port.bus())
        {
            let changed = bus.turn(&mut Attached { exchange, device });
            if exchange.take_heard() {
                self.links.heard(link, now_ms);
            }
            return any | changed;
        }
        let bytes = port.received();
        let broken = now_ms < self.broken_until[n];
        let taken = if broken && !bytes.is_empty() {
            let end = bytes.iter().position(|byte| *byte == b'\n');
            self.broken_until[n] = if end.is_some() { 0 } else { now_ms + BROKEN_MS };
            end.map_or(bytes.len(), |end| end + 1)
        } else {
            self.links.receive(link, bytes, now_ms)
        };
        port.consume(taken);
        any || taken != 0
    }

    fn happened(&mut self, n: usize, event: PortEvent, now_ms: u64) {
        match (event, self.open[n]) {
            (PortEvent::Opened, None) => self.open[n] = self.links.open(now_ms),
            (PortEvent::Closed, Some(link)) => {
                self.links.close(link, self.front);
                self.open[n] = None;
            }
            (PortEvent::Asleep, Some(link)) => self.front.end_jogs(link as u8),
            (PortEvent::Break, Some(link)) => self.links.clear(link),
            (PortEvent::Overrun, Some(link)) => {
                self.lost(n, link, Error::text(ErrorNumber::InputBufferOverrun, "bytes were lost"), now_ms);
            }
            (PortEvent::Framing, Some(link)) => {
                self.lost(n, link, Error::text(ErrorNumber::FramingError, "check the baud rate"), now_ms);
            }
            _ => {}
        }
    }

    fn lost(&mut self, n: usize, link: usize, error: Error, now_ms: u64) {
        self.links.clear(link);
        self.links.report_to(link, error);
        self.broken_until[n] = now_ms + BROKEN_MS;
    }

    fn give_answers(&mut self, n: usize, port: &mut dyn Port) -> bool {
        let Some(link) = self.open[n] else { return false };
        let mut any = false;
        loop {
            let mut chunk = [0; CHUNK];
            let room = port.room().min(CHUNK);
            let count = self.links.transmit(link, &mut chunk[..room]);
            if count == 0 {
                return any;
            }
            port.send(&chunk[..count]);
            any = true;
        }
    }
}
