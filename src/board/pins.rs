//! Every pin of the board, in one table: STM32F407G-DISC1 (MB997).
//!
//! | signal | pin | note |
//! |---|---|---|
//! | STEP 1..6 | PE6, PE14, PE5, PE13, PE7, PE15 | active high |
//! | DIR 1..6 | PE4, PE8, PE9, PE10, PE11, PE12 | high = upwards |
//! | trigger output | PE2 | position compare |
//! | emergency stop | PA0 | TIM8_ETR; contact to 3.3 V closed = run (on the board: the blue button) |
//! | serial TX, RX | PA2, PA3 | USART2, 3.3 V levels |
//! | limit switch lower 1..6 | PD1, PD3, PD7, PD9, PD11, PB14 | pulled up |
//! | limit switch upper 1..6 | PD2, PD6, PD8, PD10, PB13, PB15 | pulled up |
//! | driver fault 1..6 | PB4, PB5, PB7, PB8, PB11, PB12 | pulled up |
//! | driver enable 1..6 | PC1, PC2, PC5, PC6, PC8, PC9 | push-pull |
//! | optical power 1, 2 | PB0, PB1 | ADC1_IN8, ADC2_IN9; full scale is VDDA, 3 V on this board |
//! | USB | PA11, PA12 | the micro-AB socket |
//! | lights | PD12 green, PD13 orange, PD14 red, PD15 blue | runs, moves, stopped for a fault, serial or USB traffic |
//!
//! The twelve limit switches lie on twelve different EXTI lines, line 0 is the emergency stop's. Taken by the board:
//! PA4..PA7, PA9, PA10, PA13, PA14, PB3, PB6, PB9, PB10, PC0, PC3, PC7, PC10, PC12, PC14, PC15, PD4, PD5, PE0, PE1,
//! PE3, PH0, PH1 (UM1472, table 7).

use stage_controller::refill::border::POWER_INPUTS;
use stage_controller::refill::safety::Inputs;
use stage_controller::units::AXES;

/// A port; its number is that of EXTI's multiplexer (RM0090, 9.2.3).
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Port {
    A,
    B,
    C,
    D,
}

/// A pin of a port.
#[derive(Clone, Copy)]
pub struct Pin(pub Port, pub u8);

impl Pin {
    /// Its bit in a register of the port.
    pub const fn bit(self) -> u32 {
        1 << self.1
    }
}

use Port::{A, B, C, D};

/// Contact of the emergency stop: TIM8_ETR.
pub const STOP: Pin = Pin(A, 0);
/// Lower limit switch of each motor.
pub const LOWER: [Pin; AXES] = [Pin(D, 1), Pin(D, 3), Pin(D, 7), Pin(D, 9), Pin(D, 11), Pin(B, 14)];
/// Upper limit switch of each motor.
pub const UPPER: [Pin; AXES] = [Pin(D, 2), Pin(D, 6), Pin(D, 8), Pin(D, 10), Pin(B, 13), Pin(B, 15)];
/// Fault output of each driver.
pub const FAULT: [Pin; AXES] = [Pin(B, 4), Pin(B, 5), Pin(B, 7), Pin(B, 8), Pin(B, 11), Pin(B, 12)];
/// Enable input of each driver: one port, so that one word switches all.
pub const ENABLE: [Pin; AXES] = [Pin(C, 1), Pin(C, 2), Pin(C, 5), Pin(C, 6), Pin(C, 8), Pin(C, 9)];
/// Outputs of the power meter.
pub const POWER: [Pin; POWER_INPUTS] = [Pin(B, 0), Pin(B, 1)];
/// Lights, all on port D: runs, moves, stopped for a fault, traffic.
pub const LIGHTS: [Pin; 4] = [Pin(D, 12), Pin(D, 13), Pin(D, 14), Pin(D, 15)];

/// Bits of a port's register that carry inputs.
const fn carried(port: Port) -> u32 {
    let (mut mask, mut n) = (0, 0);
    while n < AXES {
        let mut k = 0;
        while k < 3 {
            let pin = [LOWER[n], UPPER[n], FAULT[n]][k];
            if pin.0 as u8 == port as u8 {
                mask |= pin.bit();
            }
            k += 1;
        }
        n += 1;
    }
    if STOP.0 as u8 == port as u8 { mask | STOP.bit() } else { mask }
}

/// Inputs by their meaning; it is found out anew only when a level has changed.
pub struct Known {
    levels: [u32; 3],
    inputs: Inputs,
}

impl Known {
    /// From levels.
    pub fn new(levels: Levels) -> Self {
        Known { levels: levels.carried(), inputs: levels.inputs() }
    }

    /// The inputs at these levels.
    #[inline(always)]
    pub fn at(&mut self, levels: Levels) -> Inputs {
        let [a, b, d] = levels.carried();
        if (a ^ self.levels[0]) | (b ^ self.levels[1]) | (d ^ self.levels[2]) != 0 {
            *self = Known::new(levels);
        }
        self.inputs
    }
}

/// Input registers of the ports that carry inputs.
#[derive(Clone, Copy)]
pub struct Levels {
    pub a: u32,
    pub b: u32,
    pub d: u32,
}

impl Levels {
    fn of(&self, pins: &[Pin; AXES]) -> u8 {
        pins.iter().enumerate().fold(0, |mask, (n, pin)| mask | u8::from(self.is_high(*pin)) << n)
    }

    fn is_high(&self, pin: Pin) -> bool {
        let port = match pin.0 {
            A => self.a,
            B => self.b,
            C => 0,
            D => self.d,
        };
        port & pin.bit() != 0
    }

    /// The bits that carry inputs.
    #[inline(always)]
    fn carried(&self) -> [u32; 3] {
        const MASKS: [u32; 3] = [carried(A), carried(B), carried(D)];
        [self.a & MASKS[0], self.b & MASKS[1], self.d & MASKS[2]]
    }

    /// The inputs by their meaning.
    #[inline(never)]
    pub fn inputs(&self) -> Inputs {
        Inputs { lower: self.of(&LOWER), upper: self.of(&UPPER), fault: self.of(&FAULT), stop: !self.is_high(STOP) }
    }
}

/// The word for the set/reset register of the enable lines' port; bit n of `levels`: line n is high.
pub const fn enable_word(levels: u8) -> u32 {
    let (mut word, mut n) = (0, 0);
    while n < AXES {
        let bit = ENABLE[n].bit();
        word |= if levels >> n & 1 != 0 { bit } else { bit << 16 };
        n += 1;
    }
    word
}

const _: () = {
    let (mut lines, mut n) = (1 << STOP.1, 0);
    while n < AXES {
        assert!(lines & (LOWER[n].bit() | UPPER[n].bit()) == 0, "two inputs on one EXTI line");
        lines |= LOWER[n].bit() | UPPER[n].bit();
        assert!(matches!(ENABLE[n].0, C), "the enable lines share a port");
        n += 1;
    }
};
