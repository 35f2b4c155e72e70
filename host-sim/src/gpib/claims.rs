//! Who has an instrument to itself: the clients of a gateway control one bus, one after the other.
//!
//! - A line that is written, and a read, have their instrument until they end.
//! - Who has asked keeps it for as long as a read may take ([`Claims::leave`]), so that questions of several clients do
//!   not interrupt each other.
//! - A device clear, whoever sends it, ends all that.

use std::collections::BTreeMap;
use std::time::Duration;

/// A client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Id(u64);

/// Of one instrument.
#[derive(Clone, Debug, Default)]
struct Claim {
    /// Who has it, and until when; none: until that ends.
    owner: Option<(Id, Option<Duration>)>,
    /// Who has sent to it last.
    writer: Option<Id>,
    /// Who has sent what may have begun a jog. The instrument cannot tell their jogs apart: all are of one link.
    joggers: Vec<Id>,
    /// One of them has gone, and what it has sent may not be done.
    late_jogs: bool,
    clears: u64,
}

/// Who has which instrument of a bus.
#[derive(Clone, Debug, Default)]
pub struct Claims {
    clients: u64,
    at: BTreeMap<u8, Claim>,
}

impl Claims {
    pub(super) fn newcomer(&mut self) -> Id {
        self.clients += 1;
        Id(self.clients)
    }

    fn claim(&mut self, address: u8) -> &mut Claim {
        self.at.entry(address).or_default()
    }

    /// False while another client has it.
    pub(super) fn take(&mut self, address: u8, who: Id, wall: Duration) -> bool {
        let claim = self.claim(address);
        let another = |(owner, until): (Id, Option<Duration>)| owner != who && until.is_none_or(|until| wall < until);
        let free = !claim.owner.is_some_and(another);
        if free {
            claim.owner = Some((who, None));
        }
        free
    }

    /// What was under way has ended; `until`: it has asked, and is expected to read until then.
    pub(super) fn leave(&mut self, address: u8, who: Id, until: Option<Duration>) {
        let claim = self.claim(address);
        if claim.owner.is_some_and(|(owner, _)| owner == who) {
            claim.owner = until.map(|until| (who, Some(until)));
        }
    }

    /// A client sends something; `jogs`: which may begin a jog.
    pub(super) fn wrote(&mut self, address: u8, who: Id, jogs: bool) {
        let claim = self.claim(address);
        claim.writer = Some(who);
        if jogs && !claim.joggers.contains(&who) {
            claim.joggers.push(who);
        }
    }

    /// What it answers was asked by another client, who is still there.
    pub(super) fn was_asked_by_another(&self, address: u8, who: Id) -> bool {
        self.at.get(&address).and_then(|claim| claim.writer).is_some_and(|writer| writer != who)
    }

    /// It was cleared.
    pub(super) fn cleared(&mut self, address: u8) {
        let claim = self.claim(address);
        (claim.owner, claim.writer) = (None, None);
        claim.clears += 1;
    }

    /// How often it was cleared: what was begun before is over.
    pub(super) fn clears(&self, address: u8) -> u64 {
        self.at.get(&address).map_or(0, |claim| claim.clears)
    }

    /// Where a client may have begun a jog.
    pub(super) fn jogs(&self, who: Id) -> Vec<u8> {
        self.at.iter().filter(|(_, claim)| claim.joggers.contains(&who)).map(|(address, _)| *address).collect()
    }

    /// Where a jog may begin whose client has gone.
    pub(super) fn late_jogs(&self) -> Vec<u8> {
        self.at.iter().filter(|(_, claim)| claim.late_jogs).map(|(address, _)| *address).collect()
    }

    /// All is done there that was sent by who has gone.
    pub(super) fn no_late_jogs(&mut self, address: u8) {
        self.claim(address).late_jogs = false;
    }

    /// A client has gone; where it has sent last.
    pub(super) fn forget(&mut self, who: Id) -> Vec<u8> {
        let mut wrote = Vec::new();
        for (address, claim) in &mut self.at {
            claim.owner = claim.owner.filter(|(owner, _)| *owner != who);
            claim.late_jogs |= claim.joggers.contains(&who);
            claim.joggers.retain(|jogger| *jogger != who);
            if claim.writer == Some(who) {
                claim.writer = None;
                wrote.push(*address);
            }
        }
        wrote
    }
}
