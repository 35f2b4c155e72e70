//! Numbers of 32 significant bits for bounds: each operation is rounded to the side that its name says.
//!
//! # Design
//! What limits a motion need not be exact, only never too large (or too small). A mantissa of 32 bits and an exponent
//! of its own are what a Cortex-M4 multiplies in one instruction and divides in two, for 20 to 50 instructions each,
//! where exact numbers of 128 bits take hundreds. One operation is off by less than 2^-30 of its result, a cube root by
//! less than 2^-17. No width can be too small: exponents have 32 bits.

use super::wide::{cube_root_64, isqrt_64, two_by_one};

/// A number that is not negative: `mantissa * 2^exponent`. By its order of fields it is ordered as numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rough {
    exponent: i32,
    /// Its top bit is set, or it is zero.
    mantissa: u32,
}

/// Exponent of zero, and of what has no bound with the other sign: no sum of real exponents comes near.
const LEAST_EXPONENT: i32 = -(1 << 24);

impl Default for Rough {
    fn default() -> Self {
        Rough::ZERO
    }
}

impl Rough {
    /// 0.
    pub const ZERO: Rough = Rough { exponent: LEAST_EXPONENT, mantissa: 0 };
    /// 1.
    pub const ONE: Rough = Rough { exponent: -31, mantissa: 1 << 31 };
    /// Larger than every number.
    pub const INFINITE: Rough = Rough { exponent: -LEAST_EXPONENT, mantissa: 1 << 31 };

    /// `x / 2^bits`, not above it.
    #[inline(never)]
    pub const fn down(x: u64, bits: i32) -> Rough {
        Rough::normal(x, bits).0
    }

    /// `x / 2^bits`, not below it.
    #[inline(never)]
    pub const fn up(x: u64, bits: i32) -> Rough {
        let (below, exact) = Rough::normal(x, bits);
        if exact { below } else { below.next() }
    }

    /// Not above, and whether it is exact.
    #[inline(always)]
    const fn normal(x: u64, bits: i32) -> (Rough, bool) {
        if x == 0 {
            return (Rough::ZERO, true);
        }
        let up = x.leading_zeros();
        let x = x << up;
        (Rough { exponent: 32 - up as i32 - bits, mantissa: (x >> 32) as u32 }, x as u32 == 0)
    }

    /// A number in 128 bits, not above it.
    pub const fn wide_down(x: u128) -> Rough {
        Rough::wide(x).0
    }

    /// A number in 128 bits, not below it.
    pub const fn wide_up(x: u128) -> Rough {
        let (below, exact) = Rough::wide(x);
        if exact { below } else { below.next() }
    }

    /// Not above, and whether it is exact.
    #[inline(never)]
    const fn wide(x: u128) -> (Rough, bool) {
        // the digits that are there: a shift of 128 bits is long
        let (high, low) = ((x >> 64) as u64, x as u64);
        let (first, bits, rest) = if high >> 32 != 0 {
            (high, -64, low)
        } else if high != 0 {
            (high << 32 | low >> 32, -32, low << 32)
        } else {
            (low, 0, 0)
        };
        let (below, exact) = Rough::normal(first, bits);
        (below, exact && rest == 0)
    }

    /// The next larger number.
    #[inline(always)]
    const fn next(self) -> Rough {
        match self.mantissa.checked_add(1) {
            Some(mantissa) => Rough { mantissa, ..self },
            None => Rough { exponent: self.exponent + 1, mantissa: 1 << 31 },
        }
    }

    /// Times `2^by`.
    #[inline(always)]
    pub const fn shifted(self, by: i32) -> Rough {
        if self.mantissa == 0 { self } else { Rough { exponent: self.exponent + by, ..self } }
    }

    /// The product, not below it.
    #[inline(never)]
    pub const fn times_up(self, by: Rough) -> Rough {
        let (below, exact) = self.product(by);
        if exact { below } else { below.next() }
    }

    /// The product, not above it.
    #[inline(always)]
    pub const fn times_down(self, by: Rough) -> Rough {
        self.product(by).0
    }

    /// Not above, and whether it is exact.
    #[inline(always)]
    const fn product(self, by: Rough) -> (Rough, bool) {
        let product = self.mantissa as u64 * by.mantissa as u64;
        let (mut high, mut low, mut exponent) =
            ((product >> 32) as u32, product as u32, self.exponent + by.exponent + 32);
        if high == 0 {
            return (Rough::ZERO, true);
        }
        if high >> 31 == 0 {
            (high, low, exponent) = (high << 1 | low >> 31, low << 1, exponent - 1);
        }
        (Rough { exponent, mantissa: high }, low == 0)
    }

    /// The sum, not below it.
    #[inline(never)]
    pub fn plus_up(self, other: Rough) -> Rough {
        // of two with the same exponent either may be the larger one
        let (large, small) = if self.exponent < other.exponent { (other, self) } else { (self, other) };
        if small.mantissa == 0 {
            return large;
        }
        let apart = (large.exponent - small.exponent) as u32;
        // what is shifted out counts as one
        let add = if apart < 32 { (small.mantissa >> apart) + u32::from(apart != 0) } else { 1 };
        match large.mantissa.overflowing_add(add) {
            (mantissa, false) => Rough { mantissa, ..large },
            (rest, true) => Rough { exponent: large.exponent + 1, mantissa: (rest >> 1 | 1 << 31) + (rest & 1) },
        }
    }

    /// The difference, not above it; 0 where it would be negative.
    #[inline(never)]
    pub fn minus_down(self, other: Rough) -> Rough {
        if self <= other {
            return Rough::ZERO;
        }
        if other.mantissa == 0 {
            return self;
        }
        let apart = (self.exponent - other.exponent) as u32;
        let less = if apart < 32 { (other.mantissa >> apart) + u32::from(apart != 0) } else { 1 };
        let left = self.mantissa.saturating_sub(less);
        Rough::down(left.into(), -self.exponent)
    }

    /// The quotient, not above it; by zero it is infinite.
    #[inline(never)]
    pub const fn over_down(self, by: Rough) -> Rough {
        self.quotient(by).0
    }

    /// The quotient, not below it; by zero it is infinite.
    #[inline(never)]
    pub const fn over_up(self, by: Rough) -> Rough {
        let (below, exact) = self.quotient(by);
        if exact { below } else { below.next() }
    }

    /// Not above, and whether it is exact.
    #[inline(never)]
    const fn quotient(self, by: Rough) -> (Rough, bool) {
        if by.mantissa == 0 {
            return (Rough::INFINITE, true);
        }
        if self.mantissa == 0 {
            return (self, true);
        }
        // the mantissa of the quotient has its top bit set
        let up = (self.mantissa < by.mantissa) as u32;
        let (high, low) = ((self.mantissa >> 1) << up, (self.mantissa & 1) << 31 << up);
        let high = high | self.mantissa & up;
        let (mantissa, rest) = two_by_one(high, low, by.mantissa);
        (Rough { exponent: self.exponent - by.exponent - 31 - up as i32, mantissa }, rest == 0)
    }

    /// The smaller of this and of a quotient that is not above the exact one.
    #[inline(never)]
    pub fn least(self, dividend: Rough, divisor: Rough) -> Rough {
        // most quotients are larger than the smallest one: half a product says so for less than a division
        let up = dividend.exponent - divisor.exponent - self.exponent;
        let product = ((u64::from(self.mantissa) * u64::from(divisor.mantissa)) >> 32) as u32;
        if up > 32 || up > 30 && dividend.mantissa >> (32 - up) > product {
            return self;
        }
        self.min(dividend.over_down(divisor))
    }

    /// The square root, not above it.
    #[inline(never)]
    pub fn root_down(self) -> Rough {
        if self.mantissa == 0 {
            return self;
        }
        // 63 or 64 bits, their exponent even
        let odd = self.exponent & 1;
        let root = isqrt_64(u64::from(self.mantissa) << (32 - odd));
        Rough { exponent: (self.exponent + odd - 32) / 2, mantissa: root }
    }

    /// The square root, not below it.
    pub fn root_up(self) -> Rough {
        let below = self.root_down();
        if below.times_down(below) == self { below } else { below.next() }
    }

    /// The cube root, not above it, to 2^-17.
    #[inline(never)]
    pub fn cube_root_down(self) -> Rough {
        if self.mantissa == 0 {
            return self;
        }
        // 60 to 62 bits, their exponent a multiple of three
        let up = 28 + (self.exponent - 28).rem_euclid(3);
        let root = cube_root_64(u64::from(self.mantissa) << up);
        Rough::down(root, (up - self.exponent) / 3)
    }

    /// The cube root, not below it, to 2^-17.
    pub fn cube_root_up(self) -> Rough {
        let below = self.cube_root_down();
        // three of its 20 or 21 bits: it is too small by two at most
        if below.mantissa == 0 { below } else { below.plus_up(Rough::down(3, -below.exponent - 12)) }
    }

    /// Bits of its whole part, or minus the zeros behind its point; of zero: 0.
    pub const fn magnitude(self) -> i32 {
        if self.mantissa == 0 { 0 } else { self.exponent + 32 }
    }

    /// Rounded down, in 128 bits; none where it has more than `most`, at least 32.
    pub const fn wide_floor(self, most: u32) -> Option<u128> {
        match self.exponent {
            0.. if self.exponent as u32 + 32 > most => None,
            0.. => Some((self.mantissa as u128) << self.exponent),
            -31.. => Some((self.mantissa >> -self.exponent) as u128),
            _ => Some(0),
        }
    }

    /// Times `2^bits`, rounded down; the largest number where it is more.
    #[inline(never)]
    pub const fn floor(self, bits: i32) -> u64 {
        let up = self.exponent + bits;
        match up {
            _ if self.mantissa == 0 || up <= -32 => 0,
            _ if up > 32 => u64::MAX,
            0.. => (self.mantissa as u64) << up,
            _ => (self.mantissa >> -up) as u64,
        }
    }

    /// Times `2^bits`, rounded up; the largest number where it is more.
    #[inline(never)]
    pub const fn ceil(self, bits: i32) -> u64 {
        let up = self.exponent + bits;
        if up > 32 {
            u64::MAX
        } else if up > 0 {
            (self.mantissa as u64) << up
        } else if up > -32 && self.mantissa != 0 {
            ((self.mantissa - 1) >> -up) as u64 + 1
        } else {
            (self.mantissa != 0) as u64
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::random::Random;

    fn value(x: Rough) -> f64 {
        f64::from(x.mantissa) * 2f64.powi(x.exponent)
    }

    /// Any number of up to 32 bits, often with digits of ones or zeros, at any place.
    fn any(random: &mut Random) -> Rough {
        let bits = random.bits();
        let mantissa = match bits >> 61 {
            0 => u32::MAX,
            1 => 1 << 31,
            2 => return Rough::ZERO,
            3 => (1 << 31) + 1,
            _ => bits as u32 | 1 << 31,
        };
        Rough { exponent: ((bits >> 32) % 80) as i32 - 60, mantissa }
    }

    /// Whether `x` is `exact`, or next to it on the right side; `exact` may be off by 2^-52 itself.
    #[track_caller]
    fn near(x: Rough, exact: f64, above: bool, most: f64) {
        let off = (value(x) - exact) / exact.max(1e-300);
        let off = if above { off } else { -off };
        assert!(off >= -1e-15 && off <= most, "{x:?} for {exact}: off by {off}");
        assert!(x.mantissa == 0 || x.mantissa >> 31 == 1, "{x:?}");
    }

    #[test]
    fn every_operation_is_near_and_on_its_side() {
        let mut random = Random(11);
        let ulp = 1.0 / f64::from(1u32 << 30);
        for _ in 0..1_000_000 {
            let (a, b) = (any(&mut random), any(&mut random));
            let (x, y) = (value(a), value(b));
            near(a.times_up(b), x * y, true, ulp);
            near(a.times_down(b), x * y, false, ulp);
            near(a.plus_up(b), x + y, true, ulp);
            if x > y {
                // near zero what is lost is small against what it came from
                near(a.minus_down(b), x - y, false, ulp * x / (x - y));
            } else {
                assert_eq!(a.minus_down(b).mantissa, 0);
            }
            if b.mantissa != 0 {
                near(a.over_down(b), x / y, false, ulp);
                near(a.over_up(b), x / y, true, ulp);
                near(Rough::INFINITE.least(a, b), x / y, false, ulp);
                let (c, least) = (any(&mut random), |c: Rough| c.least(a, b));
                assert_eq!(least(c), c.min(a.over_down(b)));
            }
            near(a.root_down(), x.sqrt(), false, ulp);
            near(a.root_up(), x.sqrt(), true, ulp);
            near(a.cube_root_down(), x.cbrt(), false, 2.0f64.powi(-17));
            near(a.cube_root_up(), x.cbrt(), true, 2.0f64.powi(-17));
            assert_eq!(a < b, x < y, "{a:?} {b:?}");
        }
        assert_eq!(Rough::ONE.over_down(Rough::ZERO), Rough::INFINITE);
        assert!(Rough::INFINITE > any(&mut random));
    }

    #[test]
    fn whole_numbers_come_in_and_go_out_on_the_side_that_is_asked_for() {
        let mut random = Random(12);
        for _ in 0..1_000_000 {
            let x = random.bits() >> (random.bits() >> 58);
            let (below, above) = (Rough::down(x, 5), Rough::up(x, 5));
            near(below, x as f64 / 32.0, false, 1e-9);
            near(above, x as f64 / 32.0, true, 1e-9);
            assert!(below.floor(5) <= x && above.ceil(5) >= x);
            if x >> 32 == 0 {
                assert_eq!((below.floor(5), above.ceil(5)), (x, x));
            }
            let wide = u128::from(x) << (random.bits() >> 58);
            near(Rough::wide_down(wide), wide as f64, false, 1e-9);
            near(Rough::wide_up(wide), wide as f64, true, 1e-9);
            let most = 32 + (random.bits() >> 58) as u32;
            let floor = Rough::wide_down(wide).wide_floor(most);
            assert_eq!(floor.is_none(), 128 - wide.leading_zeros() > most, "{wide:#x} {most}");
            if let Some(floor) = floor {
                assert!(floor <= wide && wide - floor <= wide >> 31, "{wide:#x}");
            }
            let bits = (random.bits() >> 58) as i32 - 40;
            let exact = value(below) * 2f64.powi(bits);
            let (floor, ceil) = (below.floor(bits), below.ceil(bits));
            if exact < 2f64.powi(62) {
                assert_eq!((floor, ceil), (exact.floor() as u64, exact.ceil() as u64), "{below:?} {bits}");
            }
        }
    }
}
