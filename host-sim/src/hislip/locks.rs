//! Who may use an instrument (IVI-6.1, 6.5): one client exclusively, or those who know a name.

use std::collections::BTreeSet;

/// What became of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lock {
    /// Not now.
    Refused,
    /// Alone.
    Exclusive,
    /// With those who know the name.
    Shared,
    /// The client has such a lock, or has none to give back.
    Mistaken,
}

impl Lock {
    /// As the protocol tells it.
    pub const fn code(self) -> u8 {
        match self {
            Lock::Refused => 0,
            Lock::Exclusive => 1,
            Lock::Shared => 2,
            Lock::Mistaken => 3,
        }
    }
}

/// The locks of one instrument; clients are numbers.
#[derive(Clone, Debug, Default)]
pub struct Locks {
    exclusive: Option<usize>,
    name: Vec<u8>,
    shared: BTreeSet<usize>,
}

impl Locks {
    /// A client wants a lock: exclusive without a name, else shared.
    pub fn request(&mut self, client: usize, name: &[u8]) -> Lock {
        let others = self.exclusive.is_some_and(|owner| owner != client);
        match name.is_empty() {
            true if self.exclusive == Some(client) => Lock::Mistaken,
            // who shares it may have it alone for a while
            true if others || !self.shared.is_empty() && !self.shared.contains(&client) => Lock::Refused,
            true => {
                self.exclusive = Some(client);
                Lock::Exclusive
            }
            false if self.shared.contains(&client) => Lock::Mistaken,
            false if others || !self.shared.is_empty() && self.name != name => Lock::Refused,
            false => {
                self.name = name.to_vec();
                self.shared.insert(client);
                Lock::Shared
            }
        }
    }

    /// A client gives a lock back, the exclusive one first.
    pub fn release(&mut self, client: usize) -> Lock {
        if self.exclusive == Some(client) {
            self.exclusive = None;
            Lock::Exclusive
        } else if self.shared.remove(&client) {
            Lock::Shared
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
        assert_eq!(locks.request(1, b""), Lock::Exclusive);
        assert_eq!(
            (locks.request(1, b""), locks.request(2, b""), locks.request(2, b"x")),
            (Lock::Mistaken, Lock::Refused, Lock::Refused)
        );
        assert!(locks.admits(1) && !locks.admits(2));
        assert_eq!(
            (locks.release(2), locks.release(1), locks.release(1)),
            (Lock::Mistaken, Lock::Exclusive, Lock::Mistaken)
        );
        assert_eq!(
            (locks.request(1, b"x"), locks.request(2, b"x"), locks.request(3, b"y")),
            (Lock::Shared, Lock::Shared, Lock::Refused)
        );
        assert!(locks.admits(2) && !locks.admits(3));
        assert_eq!(locks.request(3, b""), Lock::Refused);
        assert_eq!((locks.request(2, b""), locks.admits(1), locks.holders()), (Lock::Exclusive, false, (true, 2)));
        locks.forget(2);
        assert_eq!((locks.admits(1), locks.holders()), (true, (false, 1)));
        locks.forget(1);
        assert!(locks.admits(3));
    }
}
