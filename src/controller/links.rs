//! All links of a controller: their sessions, device events to all of them, and jogs that need traffic.

use super::front::Front;
use crate::error::Error;
use crate::scpi::session::{Instrument, Session};

/// Block data may pause for this long, ms.
const BLOCK_TIMEOUT_MS: u64 = 2000;

/// One link and what time says of it.
#[derive(Clone, Debug)]
struct Link {
    session: Session,
    /// Time of the last byte, ms.
    last_traffic_ms: u64,
    open: bool,
    /// It has been told why the controller started, and what was lost.
    told: bool,
}

/// `N` links, numbered from 0.
#[derive(Clone, Debug)]
pub struct Links<const N: usize> {
    links: [Link; N],
}

impl<const N: usize> Default for Links<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Links<N> {
    /// All closed.
    pub fn new() -> Self {
        let link = |n| Link { session: Session::new(n as u8), last_traffic_ms: 0, open: false, told: false };
        Links { links: core::array::from_fn(link) }
    }

    /// A link opens as after power-up; a free number, none when all are taken. The errors of the start
    /// ([`Front::health`]) are told once on each number, whenever it is open for the first time.
    pub fn open(&mut self, now_ms: u64) -> Option<usize> {
        let n = self.links.iter().position(|link| !link.open)?;
        let told = self.links[n].told;
        self.links[n] = Link { session: Session::new(n as u8), last_traffic_ms: now_ms, open: true, told };
        Some(n)
    }

    /// A link closes: its input and a pending *OPC? are dropped, its jogs end; positioning moves finish.
    pub fn close(&mut self, n: usize, front: &mut Front) {
        if let Some(link) = self.links.get_mut(n) {
            link.session.device_clear();
            link.open = false;
            front.end_jogs(n as u8);
        }
    }

    /// BREAK on a link.
    pub fn clear(&mut self, n: usize) {
        if let Some(link) = self.links.get_mut(n) {
            link.session.device_clear();
        }
    }

    /// Takes bytes; says how many. The others are to be offered again, first and unchanged.
    pub fn receive(&mut self, n: usize, bytes: &[u8], now_ms: u64) -> usize {
        let Some(link) = self.links.get_mut(n) else { return bytes.len() };
        if !bytes.is_empty() {
            link.last_traffic_ms = now_ms;
        }
        link.session.receive(bytes)
    }

    /// Hands answers to a link; says how many bytes.
    pub fn transmit(&mut self, n: usize, to: &mut [u8]) -> usize {
        self.links.get_mut(n).map_or(0, |link| link.session.transmit(to))
    }

    /// The link has nothing to send.
    pub fn is_quiet(&self, n: usize) -> bool {
        self.links.get(n).is_none_or(|link| !link.session.has_output())
    }

    /// A message on some link is held up: by motion, or by a reading that is not there yet.
    pub fn is_waiting(&self) -> bool {
        self.links.iter().any(|link| link.open && link.session.is_waiting())
    }

    /// The session of a link that is open.
    pub fn session(&mut self, n: usize) -> Option<&mut Session> {
        self.links.get_mut(n).filter(|link| link.open).map(|link| &mut link.session)
    }

    /// There was traffic on a link whose bytes go straight to its session.
    pub fn heard(&mut self, n: usize, now_ms: u64) {
        if let Some(link) = self.links.get_mut(n) {
            link.last_traffic_ms = now_ms;
        }
    }

    /// Executes what can be executed on every link, and ends jogs without traffic. True when something was executed:
    /// [`Front::plan`] is then due, with the latest report.
    pub fn poll(&mut self, front: &mut Front, now_ms: u64) -> bool {
        self.poll_each(front, now_ms, |_, session, front| session.poll(front))
    }

    /// As [`Links::poll`]; `poll` executes on one link, by its number.
    #[inline(always)]
    pub fn poll_each(
        &mut self,
        front: &mut Front,
        now_ms: u64,
        mut poll: impl FnMut(usize, &mut Session, &mut Front) -> bool,
    ) -> bool {
        while let Some(error) = front.take_late_error() {
            self.report(error);
        }
        for link in self.links.iter_mut().filter(|link| link.open && !link.told) {
            link.told = true;
            front.health().errors().chain(front.settings_lost()).for_each(|error| link.session.report(error));
        }
        let timeout = u64::from(front.settings().jog_timeout_ms);
        let mut progress = false;
        for (n, link) in self.links.iter_mut().enumerate().filter(|(_, link)| link.open) {
            let quiet_ms = now_ms.saturating_sub(link.last_traffic_ms);
            if quiet_ms > timeout && front.has_jog(n as u8) {
                front.end_jogs(n as u8);
            }
            if quiet_ms > BLOCK_TIMEOUT_MS && link.session.awaits_block() {
                link.session.timeout();
            }
            progress |= poll(n, &mut link.session, front);
        }
        progress
    }

    /// Latches conditions on every link between two polls.
    pub fn observe(&mut self, front: &Front) {
        let conditions = front.conditions();
        self.links.iter_mut().filter(|link| link.open).for_each(|link| link.session.observe(&conditions));
    }

    /// Queues an error on one link.
    pub fn report_to(&mut self, n: usize, error: Error) {
        if let Some(link) = self.links.get_mut(n).filter(|link| link.open) {
            link.session.report(error);
        }
    }

    /// Queues a device event on every link.
    pub fn report(&mut self, error: Error) {
        self.links.iter_mut().filter(|link| link.open).for_each(|link| link.session.report(error));
    }
}
