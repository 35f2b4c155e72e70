//! Who sent what, who took what: no byte is lost, doubled or taken twice.

/// A byte and whether EOI stood beside it.
pub type Mark = (u8, bool);

/// What one receiver should have and has.
#[derive(Default, Debug)]
pub struct Account {
    /// Sent to it, in order; `true`: cut by ATN or IFC, so that it may be missing.
    pub owed: Vec<(Mark, bool)>,
    pub got: Vec<Mark>,
}

impl Account {
    /// # Panics
    ///
    /// If a byte was lost, doubled, altered or out of order.
    pub fn balance(&self, who: &str) {
        let mut got = self.got.iter();
        let mut next = got.next();
        for (at, (mark, cut)) in self.owed.iter().enumerate() {
            if next == Some(mark) {
                next = got.next();
            } else {
                assert!(*cut, "{who} lost byte {at}, {mark:?}; has {next:?}\nowed {:?}\ngot {:?}", self.owed, self.got);
            }
        }
        assert_eq!(next, None, "{who} took what nobody sent\nowed {:?}\ngot {:?}", self.owed, self.got);
    }
}

/// Accounts of all receivers.
#[derive(Default, Debug)]
pub struct Ledger {
    pub device: Account,
    pub instrument: Account,
    pub controller: Account,
    /// Who listened when DAV became true: device, instrument, controller.
    pub listened: [bool; 3],
}

impl Ledger {
    /// A source is through with a byte.
    pub fn sent(&mut self, mark: Mark, cut: bool) {
        for (account, listens) in
            [&mut self.device, &mut self.instrument, &mut self.controller].into_iter().zip(self.listened)
        {
            if listens {
                account.owed.push((mark, cut));
            }
        }
    }

    pub fn balance(&self) {
        self.device.balance("device");
        self.instrument.balance("instrument");
        self.controller.balance("controller");
    }
}
