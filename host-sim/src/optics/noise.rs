//! Noise that is a function of seed and time: the same however often and in whatever order it is asked for.

use std::f64::consts::TAU;

/// Mixes 64 bits so that every bit of the result hangs on all (the finaliser of SplitMix64, Steele et al. 2014).
#[inline]
pub fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Random bits of a source at a tick.
#[inline]
pub fn bits(source: u64, tick: u64) -> u64 {
    mixed(mixed(source).wrapping_add(tick.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

/// Two independent normal numbers of standard deviation 1 (Box and Muller).
pub fn normal_pair(source: u64, tick: u64) -> [f64; 2] {
    let first = bits(source, tick);
    let unit = |bits: u64| ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let radius = (-2.0 * unit(first).ln()).sqrt();
    let (sin, cos) = (TAU * unit(mixed(first ^ 0xd1b5_4a32_d192_ed03))).sin_cos();
    [radius * cos, radius * sin]
}

/// Nearly normal numbers of standard deviation 1 from random bits: the sum of four 16-bit ones. None is beyond 3.46.
#[inline]
pub fn nearly_normal(bits: u64) -> f64 {
    let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
    // variance of the sum: 4 (2^32 - 1) / 12
    (sum as f64 - 131_070.0) / 37_837.227
}
