//! The board: STM32F407G-DISC1 with six step/direction drivers. A second board is another folder like this one.

pub mod adc;
pub mod backup;
pub mod clock;
pub mod critical;
mod division;
pub mod faults;
pub mod flash;
pub mod gpio;
mod mailbox;
mod memory;
pub mod pins;
pub mod port;
pub mod refill;
mod ring;
pub mod step_dma;
pub mod supervision;
pub mod usart;
pub mod usb;

use backup::Backup;
use clock::ResetCause;
use embassy_stm32::Peripherals;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::pac;
use refill::Border;
use stage_controller::hal::{Hal, Signs};
use stage_controller::refill::border::{Order, Report, Sample};
use stage_controller::refill::safety::{Halt, Watch};
use stage_controller::store::Standstill;
use stage_controller::store::standstill::Keeper;

/// What was found out while starting.
#[derive(Clone, Copy)]
pub struct Start {
    /// The crystal is dead: the clock is the internal oscillator's.
    pub internal_oscillator: bool,
    /// Why the chip started.
    pub cause: ResetCause,
}

/// Clocks, pins and the HAL. Drivers are disabled from the first moment on.
pub fn start() -> (Peripherals, Start) {
    gpio::power_up();
    gpio::write(pac::GPIOC, pins::enable_word(0x3f));
    gpio::set_up();
    let cause = clock::reset_cause();
    let crystal = clock::probe_crystal();
    let mut config = embassy_stm32::Config::default();
    config.rcc = clock::configuration(crystal);
    config.dma_interrupt_priority = Priority::P6;
    below_the_refill();
    let peripherals = embassy_stm32::init(config);
    flash::accelerate();
    if crystal {
        clock::guard_crystal();
    }
    (peripherals, Start { internal_oscillator: !crystal, cause })
}

/// Every interrupt begins at the most urgent priority after a reset: all go below the critical sections' ceiling, and
/// the refill and the stops take theirs later.
fn below_the_refill() {
    /// Interrupts of the chip (RM0090, table 62).
    const INTERRUPTS: usize = 82;
    const USUAL: u8 = 0x60;
    // SAFETY: nothing is unmasked yet.
    let nvic = unsafe { cortex_m::Peripherals::steal() }.NVIC;
    for register in nvic.ipr.iter().take(INTERRUPTS) {
        // SAFETY: a priority of the four upper bits.
        unsafe { register.write(USUAL) };
    }
}

/// The thread's side of the board.
pub struct Board {
    border: Border,
    backup: Backup,
    keeper: Keeper,
    enables: Option<(u8, u8)>,
    signs: Option<Signs>,
}

impl Board {
    /// With the border to the refill, and the memory that outlives a reset.
    pub fn new(border: Border, backup: Backup, keeper: Keeper) -> Self {
        Board { border, backup, keeper, enables: None, signs: None }
    }
}

impl Hal for Board {
    fn report(&mut self) -> Option<Report> {
        self.border.report()
    }

    fn sample(&mut self) -> Option<Sample> {
        self.border.sample()
    }

    fn can_order(&self) -> bool {
        self.border.orders.ready()
    }

    fn order(&mut self, order: Order) {
        let waits = order.segment.is_some();
        let taken = self.border.orders.enqueue(order).is_ok();
        debug_assert!(taken, "only when there is room");
        if waits {
            refill::attend_if_standing();
        } else {
            refill::attend();
        }
    }

    fn halt(&mut self, halt: Halt) {
        refill::halt(halt);
    }

    fn rearm(&mut self) {
        refill::rearm();
    }

    fn set_watch(&mut self, watch: Watch) {
        refill::set_watch(watch);
    }

    fn set_enables(&mut self, levels: u8, disabled: u8) {
        if self.enables.replace((levels, disabled)) != Some((levels, disabled)) {
            faults::set_disabled_levels(disabled);
            gpio::write(pac::GPIOC, pins::enable_word(levels));
        }
    }

    fn keep(&mut self, standstill: Standstill) {
        if let Some((copy, bytes)) = self.keeper.update(standstill) {
            self.backup.write(copy, &bytes);
        }
    }

    fn show(&mut self, signs: Signs) {
        if self.signs.replace(signs) != Some(signs) {
            let lights = [true, signs.moving, signs.fault, signs.traffic];
            for (pin, on) in pins::LIGHTS.iter().zip(lights) {
                gpio::write(pac::GPIOD, if on { pin.bit() } else { pin.bit() << 16 });
            }
        }
    }
}
