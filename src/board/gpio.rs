//! Ports by their registers: the step output and the stops cannot wait for a driver.

use super::pins::{ENABLE, FAULT, LIGHTS, LOWER, Levels, Pin, Port, STOP, UPPER};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::vals::{Moder, Ospeedr, Ot, Pupdr};
use embassy_stm32::pac::gpio::{Gpio, regs::Bsrr};

/// The port's registers.
pub fn port(port: Port) -> Gpio {
    match port {
        Port::A => pac::GPIOA,
        Port::B => pac::GPIOB,
        Port::C => pac::GPIOC,
        Port::D => pac::GPIOD,
    }
}

/// Clocks all ports that are used.
pub fn power_up() {
    pac::RCC.ahb1enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_gpioden(true);
        w.set_gpioeen(true);
    });
    // a clock needs two cycles to arrive (RM0090, 7.3.10)
    let _ = pac::RCC.ahb1enr().read();
}

/// Writes the set/reset register: set bits win over reset bits.
#[inline(always)]
pub fn write(gpio: Gpio, word: u32) {
    gpio.bsrr().write_value(Bsrr(word));
}

/// A push-pull output.
pub fn output(gpio: Gpio, pin: u8) {
    let n = usize::from(pin);
    gpio.otyper().modify(|w| w.set_ot(n, Ot::PUSH_PULL));
    gpio.ospeedr().modify(|w| w.set_ospeedr(n, Ospeedr::HIGH_SPEED));
    gpio.pupdr().modify(|w| w.set_pupdr(n, Pupdr::FLOATING));
    gpio.moder().modify(|w| w.set_moder(n, Moder::OUTPUT));
}

fn input(pin: Pin, pull: Pupdr) {
    let (gpio, n) = (port(pin.0), usize::from(pin.1));
    gpio.pupdr().modify(|w| w.set_pupdr(n, pull));
    gpio.moder().modify(|w| w.set_moder(n, Moder::INPUT));
}

/// An input of a converter.
pub fn analog(pin: Pin) {
    let (gpio, n) = (port(pin.0), usize::from(pin.1));
    gpio.pupdr().modify(|w| w.set_pupdr(n, Pupdr::FLOATING));
    gpio.moder().modify(|w| w.set_moder(n, Moder::ANALOG));
}

/// Enable lines, lights, switches, faults and the emergency stop.
pub fn set_up() {
    for pin in ENABLE.into_iter().chain(LIGHTS) {
        output(port(pin.0), pin.1);
    }
    for pin in LOWER.into_iter().chain(UPPER).chain(FAULT) {
        input(pin, Pupdr::PULL_UP);
    }
    // the contact pulls it up to 3.3 V: an open or broken wire reads as a stop
    let (gpio, n) = (port(STOP.0), usize::from(STOP.1));
    gpio.pupdr().modify(|w| w.set_pupdr(n, Pupdr::PULL_DOWN));
    // alternate function 3: TIM8_ETR (data sheet, table 9); the input register reads the pin all the same
    gpio.afr(0).modify(|w| w.set_afr(n, 3));
    gpio.moder().modify(|w| w.set_moder(n, Moder::ALTERNATE));
}

/// TX and RX of USART2: alternate function 7 on PA2 and PA3 (data sheet, table 9).
pub fn serial() {
    let gpio = pac::GPIOA;
    for n in [2, 3] {
        gpio.afr(0).modify(|w| w.set_afr(n, 7));
        gpio.moder().modify(|w| w.set_moder(n, Moder::ALTERNATE));
    }
    // an open line idles high
    gpio.pupdr().modify(|w| w.set_pupdr(3, Pupdr::PULL_UP));
}

/// The line to the receiver is low.
pub fn serial_is_low() -> bool {
    pac::GPIOA.idr().read().0 & 1 << 3 == 0
}

/// The input registers.
#[inline(always)]
pub fn levels() -> Levels {
    Levels { a: pac::GPIOA.idr().read().0, b: pac::GPIOB.idr().read().0, d: pac::GPIOD.idr().read().0 }
}

/// Mode register of the enable lines' port with these as outputs and everything else as after a reset.
const ENABLE_MODES: u32 = {
    let (mut modes, mut n) = (0, 0);
    while n < ENABLE.len() {
        modes |= 1 << (2 * ENABLE[n].1);
        n += 1;
    }
    modes
};

// Disables the drivers before memory is set up, which takes milliseconds at the speed of a reset: the lines float until
// then. Clock of port C, its set/reset register, its modes (RM0090, 7.3.10 and 8.4). It touches registers alone.
core::arch::global_asm!(
    ".section .text.__pre_init, \"ax\"",
    ".global __pre_init",
    ".type __pre_init, %function",
    ".thumb_func",
    "__pre_init:",
    "ldr r0, =0x40023830",
    "ldr r1, [r0]",
    "orr r1, r1, #4",
    "str r1, [r0]",
    "ldr r1, [r0]",
    "ldr r0, =0x40020800",
    "ldr r1, ={levels}",
    "str r1, [r0, #0x18]",
    "ldr r1, ={modes}",
    "str r1, [r0]",
    "bx lr",
    ".ltorg",
    levels = const super::pins::enable_word(0x3f),
    modes = const ENABLE_MODES,
);
