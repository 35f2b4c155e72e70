//! 128-bit integers on a 32-bit processor: quotients, checked products and roots, exact.
//!
//! # Design
//! A compiler for a Cortex-M4 expands every division of 128 bits in place, bit by bit: near 1 KB of code and 3,000
//! instructions each. Here each operation exists once, in digits of 32 bits, for about 100 to 200 instructions (Knuth,
//! The Art of Computer Programming 2, 4.3.1, algorithm D, whose half digits the processor's own division finds).
//! Nothing here panics: a division by zero saturates.

/// `(high, low) / by`, quotient and remainder, where `high < by` and the top bit of `by` is set: two half digits by the
/// processor's division.
#[inline(never)]
pub(crate) const fn two_by_one(high: u32, low: u32, by: u32) -> (u32, u32) {
    let (first, rest) = half_digit(high, low >> 16, by);
    let (second, rest) = half_digit(rest, low & 0xffff, by);
    (first << 16 | second, rest)
}

/// One half digit of [`two_by_one`], and the rest.
#[inline(always)]
const fn half_digit(rest: u32, next: u32, by: u32) -> (u32, u32) {
    // its top bit is set: said once more, so that the compiler sees no division by zero
    let upper = by >> 16 | 1 << 15;
    let mut quotient = rest / upper;
    if quotient > 0xffff {
        quotient = 0xffff;
    }
    let mut left = ((rest as i64) << 16 | next as i64) - quotient as i64 * by as i64;
    // at most twice too large
    while left < 0 {
        quotient = quotient.wrapping_sub(1);
        left += by as i64;
    }
    (quotient, left as u32)
}

/// `(high, low) / by`, quotient and remainder, where `high < by` and the top bit of `by` is set.
#[inline(never)]
fn four_by_two(high: u64, low: u64, by: u64) -> (u64, u64) {
    let (upper, lower) = ((by >> 32) as u32, by as u32);
    let digit = |rest: u64, next: u32| -> (u32, u64) {
        let top = (rest >> 32) as u32;
        let (mut quotient, above) = if top >= upper {
            (u32::MAX, rest - u64::from(u32::MAX) * u64::from(upper))
        } else {
            let (quotient, above) = two_by_one(top, rest as u32, upper);
            (quotient, u64::from(above))
        };
        let mut rest = above << 32 | u64::from(next);
        let mut product = u64::from(quotient) * u64::from(lower);
        let mut above = above >> 32;
        while above == 0 && rest < product {
            quotient -= 1;
            product -= u64::from(lower);
            let (sum, carry) = rest.overflowing_add(u64::from(upper) << 32);
            (rest, above) = (sum, u64::from(carry));
        }
        (quotient, rest.wrapping_sub(product))
    };
    let (first, rest) = digit(high, (low >> 32) as u32);
    let (second, rest) = digit(rest, low as u32);
    (u64::from(first) << 32 | u64::from(second), rest)
}

/// Quotient, rounded down, and remainder. By zero: the largest number, and the dividend.
#[inline(never)]
pub fn div_rem(dividend: u128, divisor: u128) -> (u128, u128) {
    if dividend < divisor {
        return (0, dividend);
    }
    let ((high, low), (upper, lower)) = (halves(dividend), halves(divisor));
    if upper == 0 {
        if lower == 0 {
            return (u128::MAX, dividend);
        }
        // both to the left, until the divisor's top bit is set
        let up = lower.leading_zeros();
        let by = lower << up;
        let middle = high << up | (low >> 1) >> (63 - up);
        let (first, rest) = if high < lower { (0, middle) } else { four_by_two((high >> 1) >> (63 - up), middle, by) };
        let (second, rest) = four_by_two(rest, low << up, by);
        return (u128::from(first) << 64 | u128::from(second), u128::from(rest >> up));
    }
    // the quotient by the divisor's first 64 bits is right or one too large (Warren, Hacker's Delight, 9-5)
    let up = upper.leading_zeros();
    let (estimate, _) = four_by_two(high >> 1, high << 63 | low >> 1, upper << up | (lower >> 1) >> (63 - up));
    let mut quotient = (estimate >> (63 - up)).saturating_sub(1);
    let product = u128::from(quotient) * u128::from(lower);
    let mut rest = dividend.wrapping_sub(product).wrapping_sub(u128::from(quotient.wrapping_mul(upper)) << 64);
    if rest >= divisor {
        rest -= divisor;
        quotient += 1;
    }
    (u128::from(quotient), rest)
}

#[inline(always)]
fn halves(x: u128) -> (u64, u64) {
    ((x >> 64) as u64, x as u64)
}

/// Quotient of 64 bits by 32, rounded down: fast enough for the refill. By zero: the largest number.
#[inline(never)]
pub fn over_word(dividend: u64, divisor: u32) -> u64 {
    let (high, low) = ((dividend >> 32) as u32, dividend as u32);
    let (Some(first), Some(rest)) = (high.checked_div(divisor), high.checked_rem(divisor)) else { return u64::MAX };
    // both to the left, until the divisor's top bit is set
    let up = divisor.leading_zeros();
    let (second, _) = two_by_one(rest << up | (low >> 1) >> (31 - up), low << up, divisor << up);
    u64::from(first) << 32 | u64::from(second)
}

/// Quotient, rounded down.
pub fn div(dividend: u128, divisor: u128) -> u128 {
    div_rem(dividend, divisor).0
}

/// Quotient, rounded up.
#[inline(never)]
pub fn div_up(dividend: u128, divisor: u128) -> u128 {
    let (quotient, remainder) = div_rem(dividend, divisor);
    quotient.saturating_add(u128::from(remainder != 0))
}

/// Signed quotient, rounded towards zero, and the remainder, which has the sign of the dividend.
#[inline(never)]
pub fn signed_div_rem(dividend: i128, divisor: i128) -> (i128, i128) {
    let (quotient, remainder) = div_rem(dividend.unsigned_abs(), divisor.unsigned_abs());
    (turned(quotient as i128, (dividend < 0) != (divisor < 0)), turned(remainder as i128, dividend < 0))
}

/// Signed quotient, rounded towards zero.
#[inline(never)]
pub fn signed_div(dividend: i128, divisor: i128) -> i128 {
    signed_div_rem(dividend, divisor).0
}

/// Quotient by a small number, rounded towards zero. By zero: zero.
#[inline(never)]
pub fn over_small(dividend: i128, divisor: u32) -> i128 {
    if divisor == 0 {
        return 0;
    }
    let size = dividend.unsigned_abs();
    // both to the left, until the divisor's top bit is set
    let up = divisor.leading_zeros();
    let by = divisor << up;
    let digits = [(size >> 96) as u32, (size >> 64) as u32, (size >> 32) as u32, size as u32, 0];
    let mut rest = (digits[0] >> 1) >> (31 - up);
    let mut quotient = 0;
    for pair in digits.windows(2) {
        let next = pair[0] << up | (pair[1] >> 1) >> (31 - up);
        let digit;
        (digit, rest) = if rest == 0 && next < by { (0, next) } else { two_by_one(rest, next, by) };
        quotient = quotient << 32 | u128::from(digit);
    }
    turned(quotient as i128, dividend < 0)
}

/// A sixth, rounded towards zero.
#[inline(never)]
pub fn sixth(x: i128) -> i128 {
    let size = x.unsigned_abs();
    let mut sixth = 0;
    let mut rest = 0;
    for digit in [(size >> 96) as u32, (size >> 64) as u32, (size >> 32) as u32, size as u32] {
        // 2^32 is four more than 6 * 0x2aaa_aaaa
        let low = u64::from(digit) + u64::from(4 * rest);
        let part = if low >> 32 == 0 { low as u32 / 6 } else { ((low >> 1) as u32) / 3 };
        let digit = rest * 0x2aaa_aaaa + part;
        rest = (low as u32).wrapping_sub(part.wrapping_mul(6));
        sixth = sixth << 32 | u128::from(digit);
    }
    turned(sixth as i128, x < 0)
}

/// Signed quotient, rounded upwards; the divisor is positive.
#[inline(never)]
pub fn signed_div_up(dividend: i128, divisor: i128) -> i128 {
    let (quotient, remainder) = signed_div_rem(dividend, divisor);
    if remainder > 0 { quotient + 1 } else { quotient }
}

/// `floor(a * b / 2^down)` for `down < 128`; the largest number where that is more.
#[inline(never)]
pub fn mul_shift(a: u64, b: u64, down: u32) -> u64 {
    narrow((u128::from(a) * u128::from(b)) >> (down & 127))
}

/// The lower 64 bits of `floor(x / 2^by)`.
#[inline(never)]
pub fn shifted_down(x: u128, by: u32) -> u64 {
    let (high, low) = halves(x);
    match by {
        0..64 => low >> by | (high << 1) << (63 - by),
        64..128 => high >> (by - 64),
        _ => 0,
    }
}

/// As 64 bits; the largest number where it is more.
#[inline(always)]
pub fn narrow(x: u128) -> u64 {
    if (x >> 64) as u64 == 0 { x as u64 } else { u64::MAX }
}

/// `x`, or its negative: where a product with a sign would be one of 128 bits.
#[inline(always)]
pub fn turned(x: i128, back: bool) -> i128 {
    if back { x.wrapping_neg() } else { x }
}

/// The number nearest to `x` that is not below `least` nor above `most`: [`Ord::clamp`] without its panic, which would
/// bring the decimal text of 128 bits into the firmware.
pub fn within(x: i128, least: i128, most: i128) -> i128 {
    if x < least {
        least
    } else if x > most {
        most
    } else {
        x
    }
}

/// Product with a small number; none beyond 128 bits.
#[inline(never)]
pub fn times(x: i128, n: u32) -> Option<i128> {
    let digit = |at: u32| u64::from((x >> at) as u32) * u64::from(n);
    // three digits without a sign, and the upper one with it: each sum has room for the carry from below
    let first = digit(0);
    let second = digit(32) + (first >> 32);
    let third = digit(64) + (second >> 32);
    let top = (x >> 96) as i64 * i64::from(n) + (third >> 32) as i64;
    let low = u128::from(first as u32) | u128::from(second as u32) << 32 | u128::from(third as u32) << 64;
    (top == i64::from(top as i32)).then_some(i128::from(top) << 96 | low as i128)
}

/// The largest `r` with `r * r <= x`; the top two bits of `x` are not both zero.
#[inline(never)]
pub(crate) fn isqrt_64(x: u64) -> u32 {
    // Zimmermann's: half of the digits first, by Newton's steps from above in 32 bits
    let (high, low) = ((x >> 32) as u32, x as u32);
    let mut upper = 0xffff;
    while let better = (upper + high / upper.max(1)) / 2
        && better < upper
    {
        upper = better;
    }
    let rest = high - upper * upper;
    let dividend = u64::from(rest) << 16 | u64::from(low >> 16);
    // by half of both: below 2^32
    let quotient = u64::from((dividend >> 1) as u32 / upper.max(1));
    let rest = dividend - 2 * quotient * u64::from(upper);
    let root = (u64::from(upper) << 16) + quotient;
    let too_large = (rest << 16 | u64::from(low & 0xffff)) < quotient * quotient;
    (root - u64::from(too_large)).min(u64::from(u32::MAX)) as u32
}

/// An `r` with `r * r * r <= x` that is by two too small at most, for `2^56 <= x < 2^63`.
#[inline(never)]
pub(crate) fn cube_root_64(x: u64) -> u64 {
    // half of the digits first, by Newton's steps from above in 32 bits
    let high = (x >> 33) as u32;
    let mut upper = 1024u32;
    while let better = (2 * upper + high / (upper * upper).max(1)) / 3
        && better < upper
    {
        upper = better;
    }
    let upper = u64::from(upper) << 11;
    let square = upper * upper;
    // a step of Newton's in 32 bits: of 20 of them are 11 wanted
    let (rest, slope) = (((x - square * upper) >> 23) as u32, ((3 * square) >> 23) as u32 + 1);
    let mut root = upper + u64::from(rest / slope);
    while root * root * root > x {
        root -= 1;
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    impl Random {
        /// Any length, and often digits of all ones or zeros, where carries run far.
        fn wide(&mut self) -> u128 {
            let mut x = 0;
            for _ in 0..4 {
                let digit = match self.bits() >> 61 {
                    0 => 0,
                    1 => u32::MAX,
                    2 => 1 << 31,
                    3 => 1,
                    _ => (self.bits() >> 32) as u32,
                };
                x = x << 32 | u128::from(digit);
            }
            x >> (self.bits() >> 57)
        }
    }

    #[test]
    fn quotients_and_remainders_are_those_of_the_compiler() {
        let mut random = Random(1);
        for _ in 0..2_000_000 {
            let (n, d) = (random.wide(), random.wide());
            if d == 0 {
                assert_eq!(div_rem(n, d), (u128::MAX, n));
                continue;
            }
            assert_eq!(div_rem(n, d), (n / d, n % d), "{n:#x} / {d:#x}");
            assert_eq!(div_up(n, d), n.div_ceil(d));
            let (n, d) = (n as i128, d as i128);
            if d != -1 {
                assert_eq!(signed_div_rem(n, d), (n / d, n % d), "{n} / {d}");
                assert_eq!(signed_div(n, d), n / d);
                assert_eq!(sixth(n), n / 6, "{n} / 6");
                let small = (d as u32).max(1);
                assert_eq!(over_small(n, small), n / i128::from(small), "{n} / {small}");
                assert_eq!(over_word(n as u64, small), n as u64 / u64::from(small), "{} / {small}", n as u64);
            }
            if d > 0 {
                assert_eq!(signed_div_up(n, d), n / d + i128::from(n % d > 0));
            }
        }
    }

    #[test]
    fn products_are_those_of_the_compiler_or_none() {
        let mut random = Random(2);
        let mut none = 0;
        for _ in 0..1_000_000 {
            let (x, n) = (random.wide() as i128, random.wide() as u32);
            assert_eq!(times(x, n), x.checked_mul(i128::from(n)), "{x} * {n}");
            none += u32::from(times(x, n).is_none());
            let (a, b, k) = (random.wide() as u64, random.wide() as u64, (random.bits() >> 57) as u32);
            assert_eq!(mul_shift(a, b, k), u64::try_from((u128::from(a) * u128::from(b)) >> k).unwrap_or(u64::MAX));
        }
        assert!(none > 10_000);
        assert_eq!(times(i128::MIN / 2, 2), Some(i128::MIN));
        assert_eq!(times(i128::MIN, 2), None);
    }

    #[test]
    fn roots_are_those_of_the_compiler() {
        let mut random = Random(3);
        for _ in 0..1_000_000 {
            let x = random.wide() as u64;
            let x = x << (x.leading_zeros() & 62);
            if x != 0 {
                assert_eq!(u64::from(isqrt_64(x)), x.isqrt(), "{x:#x}");
            }
        }
    }

    #[test]
    fn cube_roots_are_never_too_large_and_hardly_too_small() {
        let mut random = Random(4);
        let cube = |r: u64| u128::from(r) * u128::from(r) * u128::from(r);
        for _ in 0..1_000_000 {
            let x = (random.bits() >> (1 + (random.bits() >> 61) % 6)).max(1 << 56);
            let root = cube_root_64(x);
            assert!(cube(root) <= x.into() && cube(root + 3) > x.into(), "{x:#x}");
        }
    }
}
