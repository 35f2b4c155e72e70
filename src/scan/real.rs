//! Signed numbers of 31 significant bits with an exponent of their own, for sums and quotients whose size nobody knows
//! beforehand: a fit. Each operation is off by less than 2^-29 of its result, on a board as on a desktop.

use crate::units::rough::Rough;

/// `mantissa * 2^exponent`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Real {
    /// At least 2^30 in size, or zero.
    mantissa: i32,
    exponent: i32,
}

impl Real {
    /// 0.
    pub const ZERO: Real = Real { mantissa: 0, exponent: 0 };

    /// `x * 2^exponent`.
    #[inline(never)]
    pub fn new(x: i64, exponent: i32) -> Real {
        if x == 0 {
            return Real::ZERO;
        }
        // 31 bits and a sign
        let down = 33 - x.unsigned_abs().leading_zeros() as i32;
        let mantissa = if down > 0 { x >> down } else { x << -down };
        Real { mantissa: mantissa as i32, exponent: exponent + down }
    }

    /// A whole number.
    pub fn whole(x: i64) -> Real {
        Real::new(x, 0)
    }

    /// True below zero.
    pub fn is_negative(self) -> bool {
        self.mantissa < 0
    }

    /// The sum.
    #[inline(never)]
    pub fn plus(self, other: Real) -> Real {
        let (large, small) = if self.exponent < other.exponent && other.mantissa != 0 || self.mantissa == 0 {
            (other, self)
        } else {
            (self, other)
        };
        let apart = large.exponent.wrapping_sub(small.exponent).clamp(0, 63);
        let low = (i64::from(small.mantissa) << 30) >> apart;
        Real::new((i64::from(large.mantissa) << 30) + low, large.exponent - 30)
    }

    /// The difference.
    #[inline(never)]
    pub fn minus(self, other: Real) -> Real {
        self.plus(Real { mantissa: -other.mantissa, ..other })
    }

    /// The product.
    #[inline(never)]
    pub fn times(self, other: Real) -> Real {
        Real::new(i64::from(self.mantissa) * i64::from(other.mantissa), self.exponent + other.exponent)
    }

    /// The quotient; by zero: zero.
    #[inline(never)]
    pub fn over(self, other: Real) -> Real {
        let quotient = (i64::from(self.mantissa) << 31).checked_div(other.mantissa.into()).unwrap_or(0);
        Real::new(quotient, self.exponent - other.exponent - 31)
    }

    /// The root of its size.
    #[inline(never)]
    pub fn root(self) -> Real {
        let root = Rough::down(self.mantissa.unsigned_abs().into(), -self.exponent).root_down();
        // as many digits as a mantissa has
        let up = 30 - root.magnitude();
        Real::new(root.floor(up) as i64, -up)
    }

    /// The nearest whole number within 32 bits.
    #[inline(never)]
    pub fn rounded(self) -> i32 {
        let (mantissa, exponent) = (i64::from(self.mantissa), self.exponent);
        let value = match exponent {
            32.. => mantissa << 32,
            0.. => mantissa << exponent,
            -62.. => (mantissa + (1 << (-exponent - 1))) >> -exponent,
            _ => 0,
        };
        value.clamp(i32::MIN.into(), i32::MAX.into()) as i32
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    fn value(x: Real) -> f64 {
        f64::from(x.mantissa) * 2f64.powi(x.exponent)
    }

    #[test]
    fn operations_are_right_to_30_bits() {
        let mut state = 1u64;
        let mut any = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            Real::new((state as i64) >> (state % 60), (state >> 40) as i32 % 40 - 20)
        };
        for _ in 0..100_000 {
            let (a, b) = (any(), any());
            let (x, y) = (value(a), value(b));
            let near = |have: Real, want: f64, size: f64| {
                assert!((value(have) - want).abs() <= size.abs() * 2f64.powi(-28), "{x} {y}: {} {want}", value(have));
            };
            near(a.plus(b), x + y, x.abs() + y.abs());
            near(a.minus(b), x - y, x.abs() + y.abs());
            near(a.times(b), x * y, x * y);
            if y != 0.0 {
                near(a.over(b), x / y, x / y);
            }
            near(a.root(), x.abs().sqrt(), x.abs().sqrt() * 2.0);
            if x.abs() < 1e9 {
                assert!((f64::from(a.rounded()) - x).abs() <= 0.5 + x.abs() * 1e-9, "{x}");
            }
        }
        assert_eq!(Real::whole(5).over(Real::ZERO), Real::ZERO);
    }
}
