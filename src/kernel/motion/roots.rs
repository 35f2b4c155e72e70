//! Integer roots, rounded up: a duration rounded up keeps every limit.

use crate::units::wide;

/// Smallest `r` with `r² >= x`.
#[inline(never)]
pub fn sqrt_up(x: u128) -> u128 {
    let root = u128::from(wide::isqrt(x));
    if root * root < x { root + 1 } else { root }
}

/// Smallest `r` with `r³ >= x`, for `x <= 2^96`; larger arguments count as 2^96.
#[inline(never)]
pub fn cbrt_up(x: u128) -> u64 {
    let root = wide::cube_root(x).min((1 << 33) - 1);
    let short = u128::from(root) * u128::from(root) * u128::from(root) < x;
    (root + u64::from(short)).min((1 << 33) - 1)
}
