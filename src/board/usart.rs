//! The serial port: USART2 on PA2 and PA3, 8N1, received and sent by DMA (RM0090, 30).
//!
//! # Design
//! Reception runs for ever into a ring of [`RING`] bytes; the controller reads it where it lies. The line going idle
//! wakes the controller, and it looks around once a millisecond anyhow. Idle is told a byte after the last one, which
//! is 87 us at 115200 baud: while a message is coming its LF is looked for more often ([`Serial::line_end`]). A damaged
//! byte stops nothing: the interrupt notes where it lies in the ring, and what came up to it is dropped. A break is a
//! damaged byte after which the line is still low.
//!
//! The driver of the HAL is not used: after an error it restarts the stream without setting its address and count anew,
//! so that ring and stream disagree from then on.
//!
//! # Limitations
//! Whoever stalls the processor for longer than the ring lasts (178 ms at 115200 baud, 20 ms at 1 Mbaud) calls
//! [`Serial::after_a_stall`].

use super::gpio;
use super::port::ARRIVED;
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt;
use embassy_stm32::pac;
use embassy_stm32::pac::Interrupt;
use embassy_stm32::pac::dma::vals::{Dir, Pl, Size};
use embassy_time::Timer;
use stage_controller::hal::{Port, PortEvent};
use static_cell::ConstStaticCell;

/// Bytes that may come while nobody looks.
const RING: usize = 2048;
/// Bytes that may wait to be sent.
const OUTPUT: usize = 512;
/// How often the end of a message that is coming is looked for, us.
const LOOK_US: u32 = 20;
/// Its sender seems to rest when for this long, in bits, and as many looks beside nothing has come.
const PATIENCE_BITS: u32 = 20;
const LOOKS: u32 = 10;
/// Clock of USART2, Hz: that of APB1.
const CLOCK_HZ: u32 = 42_000_000;
/// Streams of DMA1, both on channel 4 (RM0090, table 42).
const RECEIVE: usize = 5;
const SEND: usize = 6;
const CHANNEL: u8 = 4;

/// Memory that DMA writes beside the processor.
struct Shared(UnsafeCell<[u8; RING]>);
// SAFETY: written by DMA alone; the one Serial reads what DMA has left behind.
unsafe impl Sync for Shared {}
static INPUT: Shared = Shared(UnsafeCell::new([0; RING]));

/// TC in the status register.
const TRANSMISSION_COMPLETE: u32 = 1 << 6;

/// What the interrupt has seen: bits of [`EVENTS`], and in the upper half the place in the ring behind the last damaged
/// byte.
static SEEN: AtomicU32 = AtomicU32::new(0);
/// Events in the order in which they are handed on; a bit each.
const EVENTS: [PortEvent; 4] = [PortEvent::Opened, PortEvent::Overrun, PortEvent::Framing, PortEvent::Break];

/// The serial port.
pub struct Serial {
    baud: u32,
    /// Bytes taken over so far.
    read: u64,
    /// Bytes of the whole rounds that the stream has gone.
    rounds: u64,
    /// Bytes that were offered last.
    offered: usize,
    /// All of them were taken over, and end within a message.
    within: bool,
    output: &'static mut [u8; OUTPUT],
    /// Bytes of the output from `sent`, `waiting` of them, the first `sending` of which the stream has.
    sent: usize,
    waiting: usize,
    sending: usize,
}

impl Serial {
    /// Sets the port up; it is open from the start.
    ///
    /// # Panics
    /// When called a second time.
    pub fn open(baud: u32) -> Self {
        static BUFFER: ConstStaticCell<[u8; OUTPUT]> = ConstStaticCell::new([0; OUTPUT]);
        let output = BUFFER.take();
        pac::RCC.ahb1enr().modify(|w| w.set_dma1en(true));
        pac::RCC.apb1enr().modify(|w| w.set_usart2en(true));
        gpio::serial();
        let usart = pac::USART2;
        usart.cr3().write(|w| {
            w.set_dmar(true);
            w.set_dmat(true);
            w.set_eie(true);
        });
        set_rate(baud);
        usart.cr1().write(|w| {
            w.set_ue(true);
            w.set_te(true);
            w.set_re(true);
            w.set_idleie(true);
        });
        start_reception();
        note(PortEvent::Opened);
        for interrupt in [Interrupt::USART2, Interrupt::DMA1_STREAM6] {
            // SAFETY: the handlers share atomics with the thread.
            unsafe { NVIC::unmask(interrupt) };
        }
        Serial { baud, read: 0, rounds: 0, offered: 0, within: false, output, sent: 0, waiting: 0, sending: 0 }
    }

    /// Nothing waits to be sent, and the last bit is out.
    pub fn is_drained(&self) -> bool {
        self.waiting == 0 && pac::USART2.sr().read().tc()
    }

    /// Another rate, bits per second; once the port is drained. True when it was another one.
    pub fn follow(&mut self, baud: u32) -> bool {
        let changes = baud != self.baud && self.is_drained();
        if changes {
            self.baud = baud;
            set_rate(baud);
        }
        changes
    }

    /// Waits for an LF, if a message is coming; else, and once its sender rests, for ever.
    pub async fn line_end(&mut self) {
        let (mut seen, mut quiet) = (self.read, 0);
        let patience = LOOKS + PATIENCE_BITS * 1_000_000 / self.baud / LOOK_US;
        while self.within && quiet < patience {
            let written = self.written();
            if (seen..written).any(|at| received(at) == b'\n') {
                return;
            }
            quiet = if written == seen { quiet + 1 } else { 0 };
            seen = written;
            Timer::after_micros(LOOK_US.into()).await;
        }
        self.within = false;
        core::future::pending().await
    }

    /// The processor stood still: if the ring went round meanwhile, nobody knows how often.
    pub fn after_a_stall(&mut self) {
        if pac::DMA1.isr(RECEIVE / 4).read().tcif(RECEIVE % 4) {
            self.read = self.written();
            note(PortEvent::Overrun);
        }
    }

    /// Bytes that have come so far. To be asked at least once a round.
    fn written(&mut self) -> u64 {
        loop {
            if pac::DMA1.isr(RECEIVE / 4).read().tcif(RECEIVE % 4) {
                clear_round();
                self.rounds += RING as u64;
            }
            let place = written();
            // a round that ended in between counts before the place does
            if !pac::DMA1.isr(RECEIVE / 4).read().tcif(RECEIVE % 4) {
                return self.rounds + place as u64;
            }
        }
    }

    /// Hands the stream what waits, if it has done with what it had.
    fn kick(&mut self) {
        let stream = pac::DMA1.st(SEND);
        if stream.cr().read().en() {
            return;
        }
        self.sent = (self.sent + self.sending) % OUTPUT;
        self.waiting -= self.sending;
        self.sending = self.waiting.min(OUTPUT - self.sent);
        if self.sending == 0 {
            return;
        }
        pac::DMA1.ifcr(SEND / 4).write(|w| {
            w.set_tcif(SEND % 4, true);
            w.set_htif(SEND % 4, true);
            w.set_teif(SEND % 4, true);
            w.set_dmeif(SEND % 4, true);
            w.set_feif(SEND % 4, true);
        });
        // the end of transmission is that of these bytes; ones elsewhere: a zero would also clear a byte that has just
        // come (RM0090, 30.6.1)
        pac::USART2.sr().write_value(pac::usart::regs::Sr(!TRANSMISSION_COMPLETE));
        cortex_m::asm::dmb();
        stream.par().write_value(pac::USART2.dr().as_ptr() as u32);
        stream.m0ar().write_value(self.output.as_ptr() as u32 + self.sent as u32);
        stream.ndtr().write(|w| w.set_ndt(self.sending as u16));
        stream.cr().write(|w| {
            w.set_chsel(CHANNEL);
            w.set_dir(Dir::MEMORY_TO_PERIPHERAL);
            w.set_minc(true);
            w.set_msize(Size::BITS8);
            w.set_psize(Size::BITS8);
            w.set_tcie(true);
            w.set_en(true);
        });
    }
}

impl Port for Serial {
    fn event(&mut self) -> Option<PortEvent> {
        let seen = SEEN.load(Ordering::Relaxed);
        let first = (seen & 0xffff).trailing_zeros() as usize;
        let event = *EVENTS.get(first)?;
        SEEN.fetch_and(!(1 << first), Ordering::Relaxed);
        if matches!(event, PortEvent::Framing | PortEvent::Break) {
            // everything up to there
            let place = (seen >> 16) as u64 % RING as u64;
            let written = self.written();
            self.read = written - (written.wrapping_sub(place)) % RING as u64;
        }
        Some(event)
    }

    fn received(&mut self) -> &[u8] {
        let written = self.written();
        if written - self.read > RING as u64 {
            // it has gone over what was not read yet
            self.read = written;
            note(PortEvent::Overrun);
        }
        let (from, count) = ((self.read % RING as u64) as usize, (written - self.read) as usize);
        let end = (from + count).min(RING);
        self.offered = end - from;
        // SAFETY: the stream writes behind `written`; it takes a whole round, and then an overrun, to come here again.
        let input = unsafe { &*INPUT.0.get() };
        input.get(from..end).unwrap_or(&[])
    }

    fn consume(&mut self, count: usize) {
        self.read += count as u64;
        if self.offered > 0 {
            // what is not taken now waits for something else than bytes
            self.within = count == self.offered && received(self.read - 1) != b'\n';
        }
    }

    fn room(&self) -> usize {
        OUTPUT - self.waiting
    }

    fn send(&mut self, bytes: &[u8]) {
        for byte in bytes.iter().take(OUTPUT - self.waiting) {
            self.output[(self.sent + self.waiting) % OUTPUT] = *byte;
            self.waiting += 1;
        }
        self.kick();
    }

    fn attend(&mut self) {
        self.kick();
        // a transfer error switches the stream off (RM0090, 10.3.18)
        if !pac::DMA1.st(RECEIVE).cr().read().en() {
            start_reception();
            (self.read, self.rounds) = (0, 0);
            note(PortEvent::Overrun);
        }
    }
}

/// A byte that has come, by its number.
fn received(number: u64) -> u8 {
    let place = (number % RING as u64) as usize;
    // SAFETY: inside the ring; the stream writes elsewhere, or over a byte that counts as lost.
    unsafe { INPUT.0.get().cast::<u8>().add(place).read_volatile() }
}

/// The ring from its first place.
fn start_reception() {
    pac::DMA1.ifcr(RECEIVE / 4).write(|w| {
        w.set_tcif(RECEIVE % 4, true);
        w.set_htif(RECEIVE % 4, true);
        w.set_teif(RECEIVE % 4, true);
        w.set_dmeif(RECEIVE % 4, true);
        w.set_feif(RECEIVE % 4, true);
    });
    let stream = pac::DMA1.st(RECEIVE);
    stream.par().write_value(pac::USART2.dr().as_ptr() as u32);
    stream.m0ar().write_value(INPUT.0.get() as u32);
    stream.ndtr().write(|w| w.set_ndt(RING as u16));
    stream.cr().write(|w| {
        w.set_chsel(CHANNEL);
        w.set_dir(Dir::PERIPHERAL_TO_MEMORY);
        w.set_minc(true);
        w.set_circ(true);
        w.set_msize(Size::BITS8);
        w.set_psize(Size::BITS8);
        w.set_pl(Pl::HIGH);
        w.set_en(true);
    });
}

/// Place in the ring that the stream writes next.
fn written() -> usize {
    (RING - usize::from(pac::DMA1.st(RECEIVE).ndtr().read().ndt())) % RING
}

fn clear_round() {
    pac::DMA1.ifcr(RECEIVE / 4).write(|w| w.set_tcif(RECEIVE % 4, true));
}

/// Sixteen samples a bit: the divisor is the clock by the rate, rounded (RM0090, 30.3.4).
fn set_rate(baud: u32) {
    pac::USART2.brr().write_value(pac::usart::regs::Brr((CLOCK_HZ + baud / 2) / baud));
}

fn note(event: PortEvent) {
    let bit = EVENTS.iter().position(|e| *e == event).map_or(0, |n| 1 << n);
    SEEN.fetch_or(bit, Ordering::Relaxed);
    ARRIVED.signal(());
}

#[interrupt]
fn USART2() {
    let usart = pac::USART2;
    // reading the status and then the data clears what is handled here; the stream has taken the byte long since
    let status = usart.sr().read();
    // a stream that an error has switched off reads nothing, and an overrun would ask for ever
    if !status.rxne() || !pac::DMA1.st(RECEIVE).cr().read().en() {
        // otherwise the stream is about to read it, and must
        let _ = usart.dr().read();
    }
    if status.fe() {
        let place = (written() as u32) << 16;
        let _ = SEEN.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |seen| Some(seen & 0xffff | place));
        note(if gpio::serial_is_low() { PortEvent::Break } else { PortEvent::Framing });
    }
    if status.ore() {
        note(PortEvent::Overrun);
    }
    ARRIVED.signal(());
}

/// The stream has sent what it had.
#[interrupt]
fn DMA1_STREAM6() {
    pac::DMA1.ifcr(SEND / 4).write(|w| w.set_tcif(SEND % 4, true));
    ARRIVED.signal(());
}
