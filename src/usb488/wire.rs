//! What the class needs of the hardware: three endpoints, each of which holds a packet.

use crate::PACKET;
use crate::notify;

/// The endpoints. Nothing here waits.
pub trait Wire {
    /// A packet that has come on bulk OUT: how long it is. Another one may then come.
    fn receive(&mut self, packet: &mut [u8; PACKET]) -> Option<usize>;
    /// Halts bulk OUT: packets are answered by STALL until the host clears that.
    fn halt(&mut self);
    /// Puts a packet at bulk IN, which is empty. False: not now.
    fn send(&mut self, packet: &[u8]) -> bool;
    /// The host has fetched the packet at bulk IN.
    fn is_fetched(&mut self) -> bool;
    /// Empties bulk IN; true when the host has fetched the packet before.
    fn recall(&mut self) -> bool;
    /// Puts a packet at interrupt IN, which is empty. False: not now.
    fn notify(&mut self, notice: &[u8; notify::SIZE]) -> bool;
    /// The host has fetched the packet at interrupt IN.
    fn is_notice_fetched(&mut self) -> bool;
}
