//! What the class needs of the message exchange behind it.

/// What a host finds that begins to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// Bytes of an answer.
    Answer,
    /// Nothing yet: a message is still executed, which may answer.
    NotYet,
    /// Nothing, and nothing will come: the host has not asked. The instrument notes that.
    NothingAsked,
}

/// Remote and local (USB488, 4.3.2 to 4.3.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Panel {
    /// REN false.
    Disable,
    /// REN true.
    Enable,
    /// Go to local.
    Local,
    /// Local lockout.
    LockOut,
}

/// What takes messages and makes answers, one side speaking at a time.
pub trait Instrument {
    /// Takes bytes, `end`: with END on the last. Says how many; the others are offered again. Interrupts an answer that
    /// waits.
    fn write(&mut self, bytes: &[u8], end: bool) -> usize;
    /// Bytes of an answer that can be read at once.
    fn available(&self) -> usize;
    /// The answer ends with the last of them.
    fn is_whole(&self) -> bool;
    /// The host begins to read.
    fn look(&mut self) -> Found;
    /// Hands bytes of an answer out; says how many.
    fn read(&mut self, to: &mut [u8]) -> usize;
    /// The link has bytes of an answer that its host has not.
    fn hold(&mut self, held: bool);
    /// The status byte with RQS in bit 6, which this clears.
    fn serial_poll(&mut self) -> u8;
    /// RQS.
    fn requests_service(&self) -> bool;
    /// Device clear.
    fn clear(&mut self);
    /// Trigger. False: to be said again.
    fn trigger(&mut self) -> bool;
    /// Forgets a message that has begun, whatever is executed: those before it stay.
    fn abandon(&mut self);
    /// Remote and local.
    fn panel(&mut self, panel: Panel);
}
