//! Light: the two power inputs, converted from every border between segments on (RM0090, 13).
//!
//! # Design
//! - The match of TIM2 with the border, the one that asks for the refill, triggers ADC1 and with it ADC2: no processor
//!   comes between. Each converts its own input [`CONVERSIONS`] times, both at the same moment, so that neither
//!   disturbs the other: 27 clocks of 21 MHz each, 10.3 us in all, of which 15 are for sampling (a source below 10
//!   kilohm settles to half a count: data sheet, 5.3.21).
//! - DMA2 stream 4 carries both codes in one word into a ring, a part of it for every border.
//! - The refill at the next border sums the part that is complete. Where the motors stood at that border is what the
//!   last report says, which is not yet written over.
//!
//! # What may go wrong
//! The position of the DMA says how many conversions came. If one trigger was lost or came late, if the processor was
//! so late that it let a border pass, or after an overrun, it is not where it belongs: there is no sample, and ring and
//! converters begin anew in front of the next border. So they do after every stop of the stream.

use super::gpio;
use super::pins::POWER;
use super::step_dma::Shared;
use core::cell::UnsafeCell;
use embassy_stm32::pac;
use embassy_stm32::pac::adc::vals::{Dds as One, Exten, SampleTime};
use embassy_stm32::pac::adccommon::vals::{Adcpre, Dds, Dma, Multi};
use embassy_stm32::pac::dma::regs::Ixr;
use embassy_stm32::pac::dma::vals::{Pl, Size};
use stage_controller::refill::border::{CONVERSIONS, POWER_INPUTS};
use stage_controller::units::SEGMENT_TICKS;

/// Words of a part.
const PART: usize = CONVERSIONS as usize;
/// Parts of the ring: one is filled, one is read. With four the place of the DMA is beyond doubt until three triggers in
/// a row are lost, and the first one shows.
const PARTS: usize = 4;
const RING: u32 = (PARTS * PART) as u32;
/// Channels of the pins: PB0, PB1 (data sheet, table 7).
const CHANNELS: [u8; POWER_INPUTS] = [8, 9];
/// TIM2_TRGO (RM0090, table 69).
const TRIGGER: u8 = 0b0110;
/// Stream and channel of ADC1's requests (RM0090, table 43).
const STREAM: usize = 4;
const CHANNEL: u8 = 0;
/// Ticks that converters need to wake up, with a reserve (data sheet: 3 us).
const WAKING: u32 = 16;
/// Ticks after a trigger by which the first conversion is there and the last one is not yet: 1.4 and 10.3 us.
const AMID: u32 = 6;
/// Ticks after a trigger by which all are there.
const DONE: u32 = 14;
const SEGMENT: u32 = SEGMENT_TICKS as u32;
/// No border: those are multiples of a segment.
pub const NONE: u32 = 1;

static CODES: Shared<[[u32; PART]; PARTS]> = Shared(UnsafeCell::new([[0; PART]; PARTS]));

/// The converters; owned by the step output, whose timer triggers them.
pub struct Adc {
    /// The border, counted by TIM2, that triggers next; [`NONE`] after anything unusual.
    due: u32,
    /// The part into which that goes.
    part: usize,
    /// The border of which the last report tells and whose conversions, in the part before, are not yet summed;
    /// [`NONE`] if there is none.
    open: u32,
}

impl Adc {
    /// Sets converters and stream up; they begin with the first [`Adc::settle`].
    ///
    /// # Safety
    /// Once only: it owns ADC1, ADC2 and DMA2 stream 4.
    pub unsafe fn new() -> Self {
        pac::RCC.apb2enr().modify(|w| {
            w.set_adc1en(true);
            w.set_adc2en(true);
        });
        for pin in POWER {
            gpio::analog(pin);
        }
        for (converter, channel) in [pac::ADC1, pac::ADC2].into_iter().zip(CHANNELS) {
            converter.cr1().write(|w| w.set_scan(true));
            converter.smpr2().write(|w| w.set_smp(usize::from(channel), SampleTime::CYCLES15));
            converter.sqr1().write(|w| w.set_l(CONVERSIONS as u8 - 1));
            // five bits a place, six places a register
            let all = u32::from(channel) * 0b00001_00001_00001_00001_00001_00001;
            converter.sqr2().write(|w| w.0 = all);
            converter.sqr3().write(|w| w.0 = all);
        }
        Adc { due: NONE, part: 0, open: NONE }
    }

    /// Whatever is being converted belongs to no border that counts.
    #[inline(always)]
    pub fn lose(&mut self) {
        (self.due, self.open) = (NONE, NONE);
    }

    /// The sums of both inputs, input 1 in the lower half, at the border of which the last report tells: once, and only
    /// if all is as it should be. `count`: what TIM2 says; call first of all in the refill.
    #[inline(always)]
    pub fn collect(&mut self, count: u32) -> Option<u32> {
        let (since, part, open) = (count.wrapping_sub(self.due), self.part, self.open);
        if self.due == NONE {
            return None;
        }
        if since >= SEGMENT {
            return self.collect_early(count);
        }
        self.open = self.due;
        self.due = self.due.wrapping_add(SEGMENT);
        self.part = part.wrapping_add(1) % PARTS;
        if open == NONE {
            return None;
        }
        // none or some right behind the trigger, at least one and at most all later
        if beyond(part).wrapping_sub(u32::from(since >= AMID)) % RING >= PART as u32 {
            self.lose();
            return None;
        }
        Some(sum(part.wrapping_sub(1)))
    }

    /// The refill runs between two borders, because somebody wanted it to.
    #[cold]
    #[inline(never)]
    fn collect_early(&mut self, count: u32) -> Option<u32> {
        if self.open == NONE || count.wrapping_sub(self.open) < DONE {
            return None;
        }
        self.open = NONE;
        if !beyond(self.part).is_multiple_of(RING) {
            self.lose();
            return None;
        }
        Some(sum(self.part.wrapping_sub(1)))
    }

    /// The refill is done: `awaited` is the border that triggers next, [`NONE`] if that is not sure, and `count` what
    /// TIM2 says now. Begins anew if things do not follow on each other.
    #[inline(always)]
    pub fn settle(&mut self, awaited: u32, count: u32, running: bool) {
        if count.wrapping_sub(self.open) >= SEGMENT {
            // a border has passed meanwhile: the report may tell of this one or of that one
            self.open = NONE;
        }
        if self.due != awaited {
            self.lose();
            if running && awaited != NONE && (WAKING..=SEGMENT).contains(&awaited.wrapping_sub(count)) {
                begin();
                (self.due, self.part) = (awaited, 0);
            }
        }
    }
}

/// Conversions since the begin of a part, modulo the ring.
#[inline(always)]
fn beyond(part: usize) -> u32 {
    RING.wrapping_sub(pac::DMA2.st(STREAM).ndtr().read().ndt().into()).wrapping_sub((part * PART) as u32)
}

/// The sums of a part that no conversion reaches now.
#[inline(always)]
fn sum(part: usize) -> u32 {
    // SAFETY: the place is fixed; the stream writes to other parts.
    let at = unsafe { CODES.0.get().cast::<u32>().add(part % PARTS * PART) };
    let word = |n: usize| {
        // SAFETY: within the part; read as it lies in memory, because the stream has written it.
        unsafe { at.add(n).read_volatile() }
    };
    // eight codes of 12 bit: the sums of both inputs keep to their 16 bits; written out, lest it become a loop
    let mut sum = word(0);
    sum = sum.wrapping_add(word(1));
    sum = sum.wrapping_add(word(2));
    sum = sum.wrapping_add(word(3));
    sum = sum.wrapping_add(word(4));
    sum = sum.wrapping_add(word(5));
    sum = sum.wrapping_add(word(6));
    sum.wrapping_add(word(7))
}
const _: () = assert!(PART == 8);

/// Converters and stream from the start: the next trigger goes into the first part.
#[cold]
#[inline(never)]
fn begin() {
    for converter in [pac::ADC1, pac::ADC2] {
        converter.cr2().write(|_| ());
        converter.sr().write(|_| ());
    }
    // takes an overrun's block from the requests (RM0090, 13.8.1)
    pac::ADC123_COMMON.ccr().write(|w| w.set_adcpre(Adcpre::DIV4));
    let stream = pac::DMA2.st(STREAM);
    stream.cr().modify(|w| w.set_en(false));
    while stream.cr().read().en() {}
    // all flags of the first stream in the upper register
    pac::DMA2.ifcr(1).write_value(Ixr(0b11_1101));
    stream.par().write_value(pac::ADC123_COMMON.cdr().as_ptr() as u32);
    stream.m0ar().write_value(CODES.0.get() as u32);
    stream.ndtr().write(|w| w.set_ndt(RING as u16));
    stream.cr().write(|w| {
        w.set_chsel(CHANNEL);
        w.set_minc(true);
        w.set_circ(true);
        w.set_msize(Size::BITS32);
        w.set_psize(Size::BITS32);
        w.set_pl(Pl::LOW);
        w.set_en(true);
    });
    pac::ADC123_COMMON.ccr().write(|w| {
        w.set_adcpre(Adcpre::DIV4);
        w.set_multi(Multi::DUAL_R);
        w.set_dma(Dma::MODE2);
        w.set_dds(Dds::CONTINUOUS);
    });
    pac::ADC2.cr2().write(|w| w.set_adon(true));
    // the master alone is triggered, the slave follows (RM0090, 13.9)
    pac::ADC1.cr2().write(|w| {
        w.set_adon(true);
        w.set_dds(One::SINGLE);
        w.set_extsel(TRIGGER);
        w.set_exten(Exten::RISING_EDGE);
    });
}
