//! The status model of IEEE 488.2 and SCPI-99 for one link.
//!
//! Conditions are shared and handed in as plain words; events, enables, filters and the error queue belong to the link.

use crate::error::{Error, ErrorNumber};
use heapless::Deque;

/// Errors that the queue keeps.
pub const QUEUE_LENGTH: usize = 16;
/// Bits that a SCPI register has: bit 15 is always 0.
const ALL: u16 = 0x7fff;
/// Bit of OPERation and QUEStionable that sums up their INSTrument register.
pub const INSTRUMENT_SUMMARY: u16 = 1 << 13;

/// Bits of the status byte.
#[allow(missing_docs)]
pub mod stb {
    pub const ERROR_QUEUE: u8 = 1 << 2;
    pub const QUESTIONABLE: u8 = 1 << 3;
    pub const MESSAGE_AVAILABLE: u8 = 1 << 4;
    pub const STANDARD_EVENT: u8 = 1 << 5;
    pub const MASTER_SUMMARY: u8 = 1 << 6;
    pub const OPERATION: u8 = 1 << 7;
}

/// Bits of the standard event status register.
#[allow(missing_docs)]
pub mod esr {
    pub const OPERATION_COMPLETE: u8 = 1 << 0;
    pub const QUERY_ERROR: u8 = 1 << 2;
    pub const DEVICE_ERROR: u8 = 1 << 3;
    pub const EXECUTION_ERROR: u8 = 1 << 4;
    pub const COMMAND_ERROR: u8 = 1 << 5;
    pub const POWER_ON: u8 = 1 << 7;
}

/// The condition words, shared by all links. Bit 13 of OPERation and QUEStionable is the link's own and ignored here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Conditions {
    /// STATus:OPERation.
    pub operation: u16,
    /// STATus:QUEStionable.
    pub questionable: u16,
    /// STATus:OPERation:INSTrument, bits 1..6: axis moving.
    pub operation_instrument: u16,
    /// STATus:QUEStionable:INSTrument, bits 1..6: axis not homed, uncertain or in fault.
    pub questionable_instrument: u16,
}

/// Which of the four registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Bank {
    Operation,
    Questionable,
    OperationInstrument,
    QuestionableInstrument,
}

/// One SCPI register: condition -> transition filters -> event -> enable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Register {
    /// As last seen.
    pub condition: u16,
    /// Latched changes.
    pub event: u16,
    /// Which events sum up.
    pub enable: u16,
    /// Which rising bits latch.
    pub positive: u16,
    /// Which falling bits latch.
    pub negative: u16,
}

impl Register {
    const fn preset(enable: u16) -> Self {
        Register { condition: 0, event: 0, enable, positive: ALL, negative: 0 }
    }

    fn observe(&mut self, condition: u16) {
        let condition = condition & ALL;
        let (rising, falling) = (condition & !self.condition, self.condition & !condition);
        self.event |= rising & self.positive | falling & self.negative;
        self.condition = condition;
    }

    /// True when an enabled event is latched.
    pub const fn summary(&self) -> bool {
        self.event & self.enable != 0
    }

    /// Reads and clears the events.
    pub fn take_event(&mut self) -> u16 {
        core::mem::take(&mut self.event)
    }
}

/// Status of one link.
#[derive(Clone, Debug)]
pub struct LinkStatus {
    banks: [Register; 4],
    esr: u8,
    /// Standard event status enable, *ESE.
    pub ese: u8,
    sre: u8,
    operation_complete_pending: bool,
    errors: Deque<Error, QUEUE_LENGTH>,
}

impl Default for LinkStatus {
    fn default() -> Self {
        Self::new()
    }
}

impl LinkStatus {
    /// As after power-up: enables clear, filters preset, the power-on bit set.
    pub const fn new() -> Self {
        LinkStatus {
            banks: [Register::preset(0), Register::preset(0), Register::preset(ALL), Register::preset(ALL)],
            esr: esr::POWER_ON,
            ese: 0,
            sre: 0,
            operation_complete_pending: false,
            errors: Deque::new(),
        }
    }

    /// One register.
    pub const fn bank(&self, bank: Bank) -> &Register {
        &self.banks[bank as usize]
    }

    /// One register, to be written.
    pub const fn bank_mut(&mut self, bank: Bank) -> &mut Register {
        &mut self.banks[bank as usize]
    }

    /// Latches what changed in the conditions. Call it at every change that must not be missed.
    pub fn observe(&mut self, conditions: &Conditions) {
        let [operation, questionable, operation_axes, questionable_axes] = &mut self.banks;
        operation_axes.observe(conditions.operation_instrument);
        questionable_axes.observe(conditions.questionable_instrument);
        operation.observe(with_summary(conditions.operation, operation_axes));
        questionable.observe(with_summary(conditions.questionable, questionable_axes));
    }

    /// Queues an error and sets the bit of its class. The oldest are kept; the last place tells of the loss (-350).
    pub fn report(&mut self, error: Error) {
        self.esr |= class_bit(error.number);
        if self.errors.push_back(error).is_err() {
            self.errors.pop_back();
            let _ = self.errors.push_back(ErrorNumber::QueueOverflow.into());
            self.esr |= class_bit(ErrorNumber::QueueOverflow);
        }
    }

    /// Takes the oldest error.
    pub fn next_error(&mut self) -> Option<Error> {
        self.errors.pop_front()
    }

    /// Errors in the queue.
    pub fn error_count(&self) -> usize {
        self.errors.len()
    }

    /// Reads and clears the standard events, *ESR?.
    pub fn take_esr(&mut self) -> u8 {
        core::mem::take(&mut self.esr)
    }

    /// Service request enable, *SRE?.
    pub const fn sre(&self) -> u8 {
        self.sre
    }

    /// Bit 6 cannot be set (IEEE 488.2, 11.3.2.3).
    pub fn set_sre(&mut self, mask: u8) {
        self.sre = mask & !stb::MASTER_SUMMARY;
    }

    /// The status byte; `message_available` is MAV.
    pub fn status_byte(&self, message_available: bool) -> u8 {
        let bit = |set, bit| if set { bit } else { 0 };
        let summary = bit(!self.errors.is_empty(), stb::ERROR_QUEUE)
            | bit(self.bank(Bank::Questionable).summary(), stb::QUESTIONABLE)
            | bit(message_available, stb::MESSAGE_AVAILABLE)
            | bit(self.esr & self.ese != 0, stb::STANDARD_EVENT)
            | bit(self.bank(Bank::Operation).summary(), stb::OPERATION);
        summary | bit(summary & self.sre != 0, stb::MASTER_SUMMARY)
    }

    /// *CLS: events, errors and a pending *OPC; enables and filters stay.
    pub fn clear(&mut self) {
        self.esr = 0;
        self.errors.clear();
        self.operation_complete_pending = false;
        for bank in &mut self.banks {
            bank.event = 0;
        }
        // Bit 13 is a condition of its own: without events it has fallen.
        for bank in &mut self.banks[..2] {
            bank.condition &= !INSTRUMENT_SUMMARY;
        }
    }

    /// STATus:PRESet: enables and filters as after power-up; events stay.
    pub fn preset(&mut self) {
        for (bank, enable) in self.banks.iter_mut().zip([0, 0, ALL, ALL]) {
            *bank = Register { condition: bank.condition, event: bank.event, ..Register::preset(enable) };
        }
    }

    /// *OPC: bit 0 follows when everything has ended.
    pub fn await_operation_complete(&mut self) {
        self.operation_complete_pending = true;
    }

    /// Forgets a pending *OPC (*RST, device clear).
    pub fn forget_operation_complete(&mut self) {
        self.operation_complete_pending = false;
    }

    /// Everything has ended: a pending *OPC sets its bit.
    pub fn operation_ended(&mut self) {
        if core::mem::take(&mut self.operation_complete_pending) {
            self.esr |= esr::OPERATION_COMPLETE;
        }
    }
}

fn with_summary(condition: u16, axes: &Register) -> u16 {
    condition & !INSTRUMENT_SUMMARY | if axes.summary() { INSTRUMENT_SUMMARY } else { 0 }
}

/// The standard event of an error's class (SCPI-99 volume 2, 21.8).
const fn class_bit(number: ErrorNumber) -> u8 {
    match number.code() {
        -199..=-100 => esr::COMMAND_ERROR,
        -299..=-200 => esr::EXECUTION_ERROR,
        -499..=-400 => esr::QUERY_ERROR,
        _ => esr::DEVICE_ERROR,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_queue_keeps_the_oldest_and_its_last_place_tells_of_the_loss() {
        let mut status = LinkStatus::new();
        status.take_esr();
        for _ in 0..20 {
            status.report(ErrorNumber::UndefinedHeader.into());
        }
        assert_eq!(status.error_count(), 16);
        for _ in 0..15 {
            assert_eq!(status.next_error().map(|error| error.number), Some(ErrorNumber::UndefinedHeader));
        }
        assert_eq!(status.next_error().map(|error| error.number), Some(ErrorNumber::QueueOverflow));
        assert_eq!(status.take_esr(), esr::COMMAND_ERROR | esr::DEVICE_ERROR);
    }

    #[test]
    fn an_axis_that_starts_sets_bit_13_of_operation() {
        let mut status = LinkStatus::new();
        status.bank_mut(Bank::Operation).enable = INSTRUMENT_SUMMARY;
        status.observe(&Conditions { operation_instrument: 1 << 2, ..Conditions::default() });
        assert_eq!(status.bank(Bank::Operation).event, INSTRUMENT_SUMMARY);
        assert_eq!(status.status_byte(false), stb::OPERATION);
        status.bank_mut(Bank::OperationInstrument).take_event();
        status.observe(&Conditions { operation_instrument: 1 << 2, ..Conditions::default() });
        assert_eq!(status.bank(Bank::Operation).condition, 0);
    }

    #[test]
    fn filters_choose_the_edge() {
        let mut status = LinkStatus::new();
        *status.bank_mut(Bank::Operation) = Register { positive: 0, negative: 1 << 8, ..*status.bank(Bank::Operation) };
        status.observe(&Conditions { operation: 1 << 8, ..Conditions::default() });
        assert_eq!(status.bank(Bank::Operation).event, 0);
        status.observe(&Conditions::default());
        assert_eq!(status.bank_mut(Bank::Operation).take_event(), 1 << 8);
    }

    #[test]
    fn the_master_summary_follows_the_enabled_bits_and_never_itself() {
        let mut status = LinkStatus::new();
        status.set_sre(0xff);
        assert_eq!(status.sre(), 0xbf);
        assert_eq!(status.status_byte(false), 0);
        assert_eq!(status.status_byte(true), stb::MESSAGE_AVAILABLE | stb::MASTER_SUMMARY);
        status.ese = esr::POWER_ON;
        assert_eq!(status.status_byte(false), stb::STANDARD_EVENT | stb::MASTER_SUMMARY);
    }

    #[test]
    fn clear_keeps_enables_and_preset_keeps_events() {
        let mut status = LinkStatus::new();
        status.ese = 4;
        status.bank_mut(Bank::Questionable).enable = 8;
        status.observe(&Conditions { questionable: 8, ..Conditions::default() });
        status.preset();
        assert_eq!((status.bank(Bank::Questionable).event, status.bank(Bank::Questionable).enable), (8, 0));
        status.bank_mut(Bank::Questionable).enable = 8;
        status.clear();
        assert_eq!((status.bank(Bank::Questionable).event, status.bank(Bank::Questionable).enable), (0, 8));
        assert_eq!((status.take_esr(), status.ese), (0, 4));
    }

    #[test]
    fn operation_complete_is_set_once_and_only_when_asked_for() {
        let mut status = LinkStatus::new();
        status.take_esr();
        status.operation_ended();
        assert_eq!(status.take_esr(), 0);
        status.await_operation_complete();
        status.operation_ended();
        status.operation_ended();
        assert_eq!(status.take_esr(), esr::OPERATION_COMPLETE);
    }
}
