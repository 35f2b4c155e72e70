//! The refill: the one interrupt that makes words, and what stops it.
//!
//! Above the executor and above every critical section; it shares nothing with the thread but atomics, the latest
//! report, and queues of one writer and one reader.

use super::critical::{REFILL, STOPS, WAKE};
use super::mailbox::Mailbox;
use super::pins::{LOWER, Port, STOP, UPPER};
use super::ring::Ring;
use super::step_dma::{self, StepDma};
use super::{gpio, supervision};
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt;
use embassy_stm32::pac;
use embassy_stm32::pac::Interrupt;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Timer;
use heapless::spsc::{Consumer, Producer, Queue};
use stage_controller::refill::border::{Order, Report, Sample};
use stage_controller::refill::generator::Generator;
use stage_controller::refill::safety::{Cause, Halt, Watch};
use stage_controller::refill::stream::{Stream, Wishes};
use static_cell::StaticCell;

/// Orders on their way down; one place of a queue stays empty.
const ORDERS: usize = 5;

/// Samples of light on their way up, 256 us each.
const SAMPLES: usize = 16;

/// The thread is woken by what changes, and after this many refills anyhow.
const CALM: u8 = 4;

/// Lines of EXTI that carry limit switches.
const SWITCH_LINES: u32 = {
    let (mut lines, mut n) = (0, 0);
    while n < LOWER.len() {
        lines |= LOWER[n].bit() | UPPER[n].bit();
        n += 1;
    }
    lines
};

/// What the refill owns.
#[repr(C)] // the large part last, so that the rest lies within the reach of one load
struct Owned {
    sink: StepDma,
    orders: Consumer<'static, Order>,
    /// [`Report::marks`] of the last report.
    marks: [u32; 4],
    /// Refills until the thread is woken although nothing has changed.
    calm: u8,
    stream: Stream,
}

/// Memory of the refill alone.
struct Private(UnsafeCell<MaybeUninit<Owned>>);
// SAFETY: written once before the interrupt is unmasked, afterwards used in the interrupt alone.
unsafe impl Sync for Private {}
// not an Option, whose None is not all zero and would take as much flash
static OWNED: Private = Private(UnsafeCell::new(MaybeUninit::uninit()));
/// What the refill owns is there.
static STARTED: AtomicBool = AtomicBool::new(false);

/// The thread's side of the border.
pub struct Border {
    /// Orders down.
    pub orders: Producer<'static, Order>,
    /// Reports that were read, see [`Border::report`].
    seen: u32,
}

impl Border {
    /// The latest report, if it was not taken yet.
    pub fn report(&mut self) -> Option<Report> {
        REPORT.take(&mut self.seen)
    }

    /// The oldest sample that was not taken yet.
    pub fn sample(&mut self) -> Option<Sample> {
        LIGHT.take()
    }
}

/// The latest report; each stands alone, so that one that is not read costs nothing.
static REPORT: Mailbox<Report> = Mailbox::new();
/// What was sampled and not yet looked at.
static LIGHT: Ring<Sample, SAMPLES> = Ring::new();
static WATCH: AtomicU32 = AtomicU32::new(0);
static PAUSE: AtomicBool = AtomicBool::new(false);
static REARM: AtomicBool = AtomicBool::new(false);
/// Motors that may be stepping up and, eight bits higher, down.
static STEPPING: AtomicU32 = AtomicU32::new(0);
/// Why the output was stopped: [`code`], 0 for nothing.
static HALT: AtomicU32 = AtomicU32::new(0);
/// The stream stands: no segment ends, so orders are attended to when they come.
static STANDING: AtomicBool = AtomicBool::new(false);
/// Wakes the thread after a refill.
pub static REFILLED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Sets the interrupts up and starts the stream, once. `generator` as after power-up.
///
/// # Panics
/// When called a second time.
pub fn start(generator: Generator) -> Border {
    static DOWN: StaticCell<Queue<Order, ORDERS>> = StaticCell::new();
    let (orders_in, orders) = DOWN.init(Queue::new()).split();
    // SAFETY: the interrupt that uses it is still masked; the cells above allow one call only.
    unsafe {
        REPORT.prepare(Report::default());
        (*OWNED.0.get()).write(Owned {
            stream: Stream::new(generator),
            sink: StepDma::new(),
            orders,
            marks: Report::default().marks(),
            calm: 0,
        });
    }
    STARTED.store(true, Ordering::Release);
    watch_switches();
    for (interrupt, priority) in [
        (Interrupt::TIM2, REFILL),
        (Interrupt::DMA2_STREAM1, STOPS),
        (Interrupt::DMA2_STREAM2, STOPS),
        (Interrupt::EXTI0, STOPS),
        (Interrupt::EXTI1, STOPS),
        (Interrupt::EXTI2, STOPS),
        (Interrupt::EXTI3, STOPS),
        (Interrupt::EXTI9_5, STOPS),
        (Interrupt::EXTI15_10, STOPS),
        (WAKER, WAKE),
    ] {
        // SAFETY: what the handlers share with the thread is atomic or a single-producer queue.
        unsafe {
            cortex_m::Peripherals::steal().NVIC.set_priority(interrupt, priority);
            NVIC::unmask(interrupt);
        }
    }
    NVIC::pend(Interrupt::TIM2);
    Border { orders: orders_in, seen: 0 }
}

/// Both edges of every limit switch, and the opening of the emergency stop's contact.
fn watch_switches() {
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    for pin in LOWER.into_iter().chain(UPPER).chain([STOP]) {
        let line = usize::from(pin.1);
        let port = match pin.0 {
            Port::A => 0,
            Port::B => 1,
            Port::C => 2,
            Port::D => 3,
        };
        pac::SYSCFG.exticr(line / 4).modify(|w| w.set_exti(line % 4, port));
    }
    pac::EXTI.rtsr(0).modify(|w| w.0 |= SWITCH_LINES);
    pac::EXTI.ftsr(0).modify(|w| w.0 |= SWITCH_LINES | STOP.bit());
    pac::EXTI.pr(0).write(|w| w.0 = SWITCH_LINES | STOP.bit());
    pac::EXTI.imr(0).modify(|w| w.0 |= SWITCH_LINES | STOP.bit());
}

/// What the inputs are judged by from now on.
pub fn set_watch(watch: Watch) {
    WATCH.store(watch.to_bits(), Ordering::Relaxed);
}

/// Stops all motors at once; the next report says where.
pub fn halt(halt: Halt) {
    step_dma::stop();
    // the first cause is the one that counts, but nothing hides an emergency stop
    if halt.cause == Cause::EmergencyStop {
        HALT.store(code(halt), Ordering::Relaxed);
    } else {
        let _ = HALT.compare_exchange(0, code(halt), Ordering::Relaxed, Ordering::Relaxed);
    }
    NVIC::pend(Interrupt::TIM2);
}

/// Lets the stream stand, at standstill, and waits until it does.
pub async fn pause() {
    PAUSE.store(true, Ordering::Relaxed);
    attend();
    while !STANDING.load(Ordering::Relaxed) {
        Timer::after_micros(100).await;
    }
}

/// Lets the stream go on after a pause.
pub fn resume() {
    PAUSE.store(false, Ordering::Relaxed);
    attend();
}

/// Arms the stream after an emergency stop, if the contact is closed.
pub fn rearm() {
    REARM.store(true, Ordering::Relaxed);
    attend();
}

/// Runs the refill although no segment has ended: while the stream stands, orders still want answers.
pub fn attend() {
    NVIC::pend(Interrupt::TIM2);
}

/// The same, if no segment will end by itself.
pub fn attend_if_standing() {
    if STANDING.load(Ordering::Relaxed) {
        attend();
    }
}

const fn code(halt: Halt) -> u32 {
    (halt.cause as u32 + 1) << 24 | (halt.fault as u32) << 16 | (halt.upper as u32) << 8 | halt.lower as u32
}

fn decode(code: u32) -> Option<Halt> {
    let [lower, upper, fault, cause] = code.to_le_bytes();
    let cause = match cause {
        0 => return None,
        1 => Cause::Requested,
        2 => Cause::Limit,
        3 => Cause::EmergencyStop,
        4 => Cause::DriverFault,
        5 => Cause::Deadline,
        _ => Cause::Output,
    };
    Some(Halt { cause, lower, upper, fault })
}

/// Takes a wish.
#[inline(always)]
fn taken(wish: &AtomicBool) -> bool {
    wish.load(Ordering::Relaxed) && wish.swap(false, Ordering::Relaxed)
}

#[interrupt]
fn TIM2() {
    if !STARTED.load(Ordering::Acquire) {
        return;
    }
    // SAFETY: written before STARTED was; this interrupt alone, which does not nest.
    let Owned { stream, sink, orders, marks, calm } = unsafe { (*OWNED.0.get()).assume_init_mut() };
    let light = sink.begin_refill();
    let wishes = Wishes { pause: PAUSE.load(Ordering::Relaxed), rearm: taken(&REARM) };
    let watch = Watch::from_bits(WATCH.load(Ordering::Relaxed));
    // looked at first: an exchange costs more, and there is hardly ever anything
    let halt = if HALT.load(Ordering::Relaxed) == 0 {
        None
    } else {
        forget_steps();
        decode(HALT.swap(0, Ordering::Relaxed))
    };
    // SAFETY: this interrupt alone; the thread cannot interrupt it.
    let (stepping, now) = unsafe {
        REPORT.update(|report| {
            if let Some(sums) = light {
                // of its border the last report tells
                let Report { played, counts, steps, taking_up, moving, .. } = *report;
                let power = [sums as u16, (sums >> 16) as u16];
                LIGHT.write(|| Sample { played, counts, steps, taking_up, moving, power });
            }
            stream.service(sink, orders, watch, halt, wishes, report);
            (u32::from(report.stepping_down) << 8 | u32::from(report.stepping_up), report.marks())
        })
    };
    STEPPING.store(stepping, Ordering::Relaxed);
    let running = stream.is_running();
    STANDING.store(!running, Ordering::Relaxed);
    sink.end_refill(running);
    supervision::refill_ran();
    *calm = calm.saturating_sub(1);
    // not `!=`, which is a call
    let [a, b, c, d] = *marks;
    if (now[0] ^ a) | (now[1] ^ b) | (now[2] ^ c) | (now[3] ^ d) != 0 || *calm == 0 {
        *marks = now;
        *calm = CALM;
        NVIC::pend(WAKER);
    }
}

/// Nothing steps any more: a contact that bounces while the stream is set up anew stops nothing a second time.
pub fn forget_steps() {
    STEPPING.store(0, Ordering::Relaxed);
}

/// Judges the limit switches on an edge of one.
#[inline(always)]
fn judge() {
    pac::EXTI.pr(0).write(|w| w.0 = SWITCH_LINES);
    let stepping = STEPPING.load(Ordering::Relaxed);
    let watch = Watch::from_bits(WATCH.load(Ordering::Relaxed));
    if let Some(reason) = watch.halt(gpio::levels().inputs(), stepping as u8, (stepping >> 8) as u8) {
        halt(reason);
    }
}

#[interrupt]
fn EXTI1() {
    judge();
}

#[interrupt]
fn EXTI2() {
    judge();
}

#[interrupt]
fn EXTI3() {
    judge();
}

#[interrupt]
fn EXTI9_5() {
    judge();
}

#[interrupt]
fn EXTI15_10() {
    judge();
}

/// The contact of the emergency stop has opened: the gate has stopped the steps already, this makes it last. By the
/// edge, which the line remembers, and not by the timer's trigger flag, which also tells of every start (RM0090,
/// 17.4.5).
#[interrupt]
fn EXTI0() {
    pac::EXTI.pr(0).write(|w| w.0 = STOP.bit());
    halt(Halt { cause: Cause::EmergencyStop, ..Halt::default() });
}

#[interrupt]
fn DMA2_STREAM1() {
    output_failed();
}

#[interrupt]
fn DMA2_STREAM2() {
    output_failed();
}

fn output_failed() {
    step_dma::clear_failure();
    halt(Halt { cause: Cause::Output, ..Halt::default() });
}

/// An interrupt that no peripheral of ours uses: the refill may not touch the executor, this one may.
const WAKER: Interrupt = Interrupt::CAN1_TX;

#[interrupt]
fn CAN1_TX() {
    REFILLED.signal(());
}
