//! Step output: TIM8 clocks words out of a ring in memory to port E, one a microsecond (RM0090, 10 and 17).
//!
//! # Design
//! - TIM8 counts [`CORE_HZ`] down to the tick. Its update requests DMA2 stream 1, channel 7: one word of the ring to
//!   GPIOE's set/reset register, circular. Only DMA2 reaches the port, and the ring may not lie in core-coupled memory.
//! - In the middle of each tick its compare event requests stream 2, channel 7: the word that lowers all STEP lines
//!   goes into the ring, one segment behind. What has played is cleared by hardware, whatever the processor does.
//! - TIM2 counts TIM8's updates: the words played since the start. Its compare interrupt, once a segment, is the refill.
//! - The same match triggers the converters of the [power inputs](super::adc).
//! - TIM8 is gated by its external trigger: while the emergency stop's contact is open it does not count.
//!
//! # Note
//! Direct mode reads one word ahead: what is written less than a tick before it plays is not seen any more. Disabling
//! the stream drops that word.

use super::adc::{Adc, NONE};
use super::clock::CORE_HZ;
use super::gpio;
use super::pins::Known;
use core::cell::UnsafeCell;
use core::ptr::addr_of;
use embassy_stm32::pac;
use embassy_stm32::pac::dma::St;
use embassy_stm32::pac::dma::regs::Ixr;
use embassy_stm32::pac::dma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::timer::vals::{Mms, Sms, Ts};
use stage_controller::refill::safety::Inputs;
use stage_controller::refill::stream::{RING, StepSink};
use stage_controller::stepgen::pins::{DIR_PINS, RESET_STEPS, STEP_PINS, TRIGGER_PIN};
use stage_controller::stepgen::segment::Words;
use stage_controller::stepgen::timing::MAX_GRID;
use stage_controller::units::{SEGMENT_TICKS, TICKS_PER_SECOND};

/// Words in the ring.
const LENGTH: usize = RING * SEGMENT_TICKS;
/// Core clocks in a tick.
const TICK_CLOCKS: u32 = CORE_HZ / TICKS_PER_SECOND;
const _: () = assert!(CORE_HZ.is_multiple_of(TICKS_PER_SECOND) && LENGTH <= u16::MAX as usize);

/// Looks at whether a transfer is done; it takes some ten clocks.
const LOOKS: u32 = 64;

/// Stream that plays, stream that clears.
const PLAY: usize = 1;
const CLEAR: usize = 2;
/// Channel of TIM8's requests on both (RM0090, table 43).
const CHANNEL: u8 = 7;

/// Memory that DMA reads and writes beside the processor.
pub(super) struct Shared<T>(pub(super) UnsafeCell<T>);
// SAFETY: the processor side is owned by the one StepDma; the DMA side keeps to the part that protocol leaves it.
unsafe impl<T> Sync for Shared<T> {}

// all zero, so that it takes no flash: `prepare` fills it before anything plays
static RING_WORDS: Shared<[Words; RING]> = Shared(UnsafeCell::new([[0; SEGMENT_TICKS]; RING]));
/// What stream 2 writes; in memory that its peripheral port is sure to reach.
#[unsafe(link_section = ".data.silence")]
static SILENCE: u32 = RESET_STEPS;

/// The step output; owned by the refill.
pub struct StepDma {
    /// Words counted when TIM2 last wrapped.
    wraps: u64,
    last: u32,
    /// The border whose match asks for the refill, [`NONE`] if it was no match.
    awaited: u32,
    known: Known,
    light: Adc,
}

/// Stops the step output from anywhere, at once: no word plays after this.
#[inline(always)]
pub fn stop() {
    pac::TIM8.cr1().modify(|w| w.set_cen(false));
}

/// All flags of a stream in the interrupt registers, and where those of streams 0 to 3 begin (RM0090, 10.5.3).
const FLAGS: u32 = 0b11_1101;
const fn flags_at(stream: usize) -> usize {
    [0, 6, 16, 22][stream]
}

/// Clears the flags of both streams.
pub fn clear_failure() {
    pac::DMA2.ifcr(0).write_value(Ixr(FLAGS << flags_at(PLAY) | FLAGS << flags_at(CLEAR)));
}

impl StepDma {
    /// Sets timers and streams up; nothing plays yet.
    ///
    /// # Safety
    /// Once only: it owns TIM8, TIM2, DMA2 streams 1, 2 and 4, both rings and what [`Adc`] owns.
    pub unsafe fn new() -> Self {
        pac::RCC.ahb1enr().modify(|w| w.set_dma2en(true));
        pac::RCC.apb2enr().modify(|w| w.set_tim8en(true));
        pac::RCC.apb1enr().modify(|w| w.set_tim2en(true));
        for pin in STEP_PINS.into_iter().chain(DIR_PINS).chain([TRIGGER_PIN]) {
            gpio::output(pac::GPIOE, pin);
        }
        // a debugger that halts the core halts the steps and the watchdog with it
        pac::DBGMCU.apb2fzr().modify(|w| w.set_tim8(true));
        pac::DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));

        let timer = pac::TIM8;
        timer.psc().write_value(0);
        timer.arr().write(|w| w.set_arr((TICK_CLOCKS - 1) as u16));
        timer.ccr(0).write(|w| w.set_ccr((TICK_CLOCKS / 2) as u16));
        timer.cr2().write(|w| w.set_mms(Mms::UPDATE));
        timer.smcr().write(|w| {
            w.set_ts(Ts::ETRF);
            w.set_sms(Sms::GATED_MODE);
        });
        timer.egr().write(|w| w.set_ug(true));
        timer.sr().write_value(Default::default());
        timer.dier().write(|w| {
            w.set_ude(true);
            w.set_ccde(0, true);
        });

        let counter = pac::TIM2;
        counter.psc().write_value(0);
        counter.arr().write_value(u32::MAX);
        counter.smcr().write(|w| {
            w.set_ts(Ts::ITR1);
            w.set_sms(Sms::EXT_CLOCK_MODE);
        });
        counter.egr().write(|w| w.set_ug(true));
        counter.sr().write_value(Default::default());
        counter.dier().write(|w| w.set_ccie(0, true));
        counter.cr2().write(|w| w.set_mms(Mms::COMPARE_PULSE));
        counter.cr1().modify(|w| w.set_cen(true));
        // SAFETY: as this one, once only.
        let light = unsafe { Adc::new() };
        StepDma { wraps: 0, last: 0, awaited: NONE, known: Known::new(gpio::levels()), light }
    }

    /// Awaits the next border and answers the light at the one before the last, see [`Adc::collect`]; call first in
    /// the refill.
    #[inline(always)]
    pub fn begin_refill(&mut self) -> Option<u32> {
        let count = self.await_border();
        self.light.collect(count)
    }

    /// What the refill has left is made ready for the next border; call last in the refill.
    #[inline(always)]
    pub fn end_refill(&mut self, running: bool) {
        self.light.settle(self.awaited, pac::TIM2.cnt().read(), running);
    }

    /// Asks for the refill when the segment that plays now has ended; answers the words played in it and before.
    #[inline(always)]
    fn await_border(&mut self) -> u32 {
        let counter = pac::TIM2;
        let count = counter.cnt().read();
        let border = (count & !(SEGMENT_TICKS as u32 - 1)).wrapping_add(SEGMENT_TICKS as u32);
        counter.ccr(0).write_value(border);
        counter.sr().modify(|w| w.set_ccif(0, false));
        self.awaited = border;
        if counter.cnt().read().wrapping_sub(border) as i32 >= 0 {
            // it passed between the two: ask at once
            self.awaited = NONE;
            counter.egr().write(|w| w.set_ccg(0, true));
        }
        count
    }

    fn disable() {
        // one after the other and not by a loop: the compiler is to see that both exist
        for stream in [pac::DMA2.st(PLAY), pac::DMA2.st(CLEAR)] {
            stream.cr().modify(|w| w.set_en(false));
            while stream.cr().read().en() {}
        }
        clear_failure();
    }

    fn enable(stream: St, peripheral: u32, direction: Dir) {
        stream.par().write_value(peripheral);
        stream.m0ar().write_value(RING_WORDS.0.get() as u32);
        stream.ndtr().write(|w| w.set_ndt(LENGTH as u16));
        stream.fcr().write(|w| w.set_dmdis(pac::dma::vals::Dmdis::ENABLED));
        stream.cr().write(|w| {
            w.set_chsel(CHANNEL);
            w.set_dir(direction);
            w.set_minc(true);
            w.set_circ(true);
            w.set_msize(Size::BITS32);
            w.set_psize(Size::BITS32);
            w.set_pl(Pl::VERY_HIGH);
            w.set_teie(true);
            w.set_en(true);
        });
    }
}

impl StepSink for StepDma {
    #[inline(always)]
    fn played(&mut self) -> u64 {
        let count = pac::TIM2.cnt().read();
        if count < self.last {
            self.wraps += 1 << 32;
        }
        self.last = count;
        self.wraps + u64::from(count)
    }

    #[inline(always)]
    fn slot(&mut self, slot: usize) -> &mut Words {
        // SAFETY: `&mut self` is the only way to the ring for the processor; the stream asks for a segment that neither
        // plays nor is being cleared, or for one that no longer plays.
        let ring = unsafe { &mut *RING_WORDS.0.get() };
        &mut ring[slot % RING]
    }

    fn prepare(&mut self) {
        Self::disable();
        // lowers what a stop left high, after the longest pulse
        cortex_m::asm::delay(MAX_GRID * TICK_CLOCKS);
        gpio::write(pac::GPIOE, RESET_STEPS);
        for slot in 0..RING {
            self.slot(slot).fill(RESET_STEPS);
        }
        cortex_m::asm::dmb();
        // All is silent: stream 2 is brought to where it belongs, one segment behind the first word.
        Self::enable(pac::DMA2.st(CLEAR), addr_of!(SILENCE) as u32, Dir::PERIPHERAL_TO_MEMORY);
        for left in (SEGMENT_TICKS..LENGTH).rev() {
            pac::TIM8.egr().write(|w| w.set_ccg(0, true));
            // each is served before the next one is asked for
            let _ = (0..LOOKS).any(|_| usize::from(pac::DMA2.st(CLEAR).ndtr().read().ndt()) == left);
        }
    }

    fn start(&mut self) {
        pac::TIM2.cnt().write_value(0);
        (self.wraps, self.last) = (0, 0);
        self.light.lose();
        // the border that was awaited belongs to the count before
        self.await_border();
        pac::TIM8.cnt().write_value(Default::default());
        pac::TIM8.sr().write_value(Default::default());
        // what the processor has written is in memory before the stream reads it
        cortex_m::asm::dmb();
        Self::enable(pac::DMA2.st(PLAY), pac::GPIOE.bsrr().as_ptr() as u32, Dir::MEMORY_TO_PERIPHERAL);
        pac::TIM8.cr1().modify(|w| w.set_cen(true));
    }

    fn stop(&mut self) {
        stop();
        self.light.lose();
        super::refill::forget_steps();
        // the transfer of the last update is over long before this
        cortex_m::asm::delay(TICK_CLOCKS);
    }

    #[inline(always)]
    fn inputs(&mut self) -> Inputs {
        self.known.at(gpio::levels())
    }
}
