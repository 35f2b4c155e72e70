//! Who may use an instrument (IVI-6.1, 6.5): one client exclusively, or those who know a name.

use std::collections::BTreeSet;

/// What became of a request, or of a release; the numbers are those of the protocol (tables 19 and 20).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Lock {
    /// Not now.
    Refused = 0,
    /// The client has it; or the exclusive one is given back.
    Done = 1,
    /// The shared one is given back.
    SharedReleased = 2,
    /// The client has such a lock, or has none to give back: waiting would not help.
    Mistaken = 3,
}

/// The locks of one instrument; clients are numbers.
#[derive(Clone, Debug, Default)]
pub struct Locks {
    exclusive: Option<usize>,
    name: Vec<u8>,
    shared: BTreeSet<usize>,
}

impl Locks {
    /// A client wants a lock: exclusive without a name, else shared (table 22).
    pub fn request(&mut self, client: usize, name: &[u8]) -> Lock {
        let shares = self.shared.contains(&client);
        match (name.is_empty(), self.exclusive) {
            (true, Some(owner)) => {
                if owner == client {
                    Lock::Mistaken
                } else {
                    Lock::Refused
                }
            }
            // who shares it may have it alone for a while
            (true, None) if !self.shared.is_empty() && !shares => Lock::Refused,
            (true, None) => {
                self.exclusive = Some(client);
                Lock::Done
            }
            (false, _) if shares => Lock::Mistaken,
            (false, Some(owner)) if owner == client => Lock::Mistaken,
            (false, Some(_)) if self.shared.is_empty() => Lock::Refused,
            (false, _) if !self.shared.is_empty() && self.name != name => Lock::Refused,
            (false, _) => {
                self.name = name.to_vec();
                self.shared.insert(client);
                Lock::Done
            }
        }
    }

    /// A client has a lock.
    pub fn has(&self, client: usize) -> bool {
        self.exclusive == Some(client) || self.shared.contains(&client)
    }

    /// A client gives a lock back, the exclusive one first.
    pub fn release(&mut self, client: usize) -> Lock {
        if self.exclusive == Some(client) {
            self.exclusive = None;
            Lock::Done
        } else if self.shared.remove(&client) {
            Lock::SharedReleased
        } else {
            Lock::Mistaken
        }
    }

    /// A client has gone.
    pub fn forget(&mut self, client: usize) {
        while self.release(client) != Lock::Mistaken {}
    }

    /// A client may use the instrument.
    pub fn admits(&self, client: usize) -> bool {
        match self.exclusive {
            Some(owner) => owner == client,
            None => self.shared.is_empty() || self.shared.contains(&client),
        }
    }

    /// Somebody has it alone; how many have a lock.
    pub fn holders(&self) -> (bool, usize) {
        let alone = self.exclusive.filter(|owner| !self.shared.contains(owner));
        (self.exclusive.is_some(), self.shared.len() + usize::from(alone.is_some()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_has_it_alone_or_those_who_know_the_name_share_it() {
        let mut locks = Locks::default();
        assert_eq!(locks.request(1, b""), Lock::Done);
        assert_eq!(
            (locks.request(1, b""), locks.request(1, b"x"), locks.request(2, b""), locks.request(2, b"x")),
            (Lock::Mistaken, Lock::Mistaken, Lock::Refused, Lock::Refused)
        );
        assert!(locks.admits(1) && !locks.admits(2));
        assert_eq!(
            (locks.release(2), locks.release(1), locks.release(1)),
            (Lock::Mistaken, Lock::Done, Lock::Mistaken)
        );
        assert_eq!(
            (locks.request(1, b"x"), locks.request(2, b"x"), locks.request(3, b"y"), locks.request(1, b"x")),
            (Lock::Done, Lock::Done, Lock::Refused, Lock::Mistaken)
        );
        assert!(locks.admits(2) && !locks.admits(3));
        assert_eq!(locks.request(3, b""), Lock::Refused);
        assert_eq!((locks.request(2, b""), locks.admits(1), locks.holders()), (Lock::Done, false, (true, 2)));
        // a third may share it, and waits with the others until it is free
        assert_eq!(
            (locks.request(3, b"x"), locks.admits(3), locks.release(3)),
            (Lock::Done, false, Lock::SharedReleased)
        );
        locks.forget(2);
        assert_eq!((locks.admits(1), locks.holders()), (true, (false, 1)));
        assert_eq!(locks.release(1), Lock::SharedReleased);
        assert!(locks.admits(3));
    }

    #[test]
    fn the_answers_have_the_numbers_of_the_protocol() {
        let numbers = [Lock::Refused, Lock::Done, Lock::SharedReleased, Lock::Mistaken].map(|lock| lock as u8);
        assert_eq!(numbers, [0, 1, 2, 3]);
    }
}
