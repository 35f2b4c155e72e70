//! Integer roots, rounded up: a duration rounded up keeps every limit.

/// Smallest `r` with `r² >= x`.
pub fn sqrt_up(x: u128) -> u128 {
    let root = x.isqrt();
    if root * root < x { root + 1 } else { root }
}

/// Smallest `r` with `r³ >= x`, for `x <= 2^96`; larger arguments count as 2^96.
///
/// Digit by digit: 33 rounds of two 64-bit products are cheaper on a Cortex-M4 than the
/// divisions of a Newton iteration.
pub fn cbrt_up(x: u128) -> u64 {
    let mut root = 0u64;
    let mut bit = 1u64 << 32;
    while bit > 0 {
        let trial = root | bit;
        let cube = u128::from(trial) * u128::from(trial) * u128::from(trial);
        if cube < x {
            root = trial;
        }
        bit >>= 1;
    }
    if x == 0 || root == (1 << 33) - 1 { root } else { root + 1 }
}
