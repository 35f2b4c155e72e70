//! One row of the coupling: a motor's target from coordinates, step size folded in.

/// One half in Q32, added once so that the floor of a target is the nearest step.
pub const HALF: i64 = 1 << 31;

/// The motor's target in Q32.32 steps with one half added: sum of `coefficients` (steps per unit in
/// Q`bits`, |C| < 2^31) times `coordinates` (nm or nrad in Q32, |u| <= 2^29).
///
/// The whole parts are summed exactly (six products stay below 2^63), of the fractions the upper 16 bits
/// count: 2^-16 nm. At whole coordinates the floor of the result equals `(A + 2^(bits-1)) >> bits`
/// bit for bit (docs/LAW.md 3). `bits` is 31 to 46.
#[inline(always)]
pub fn row<const N: usize>(coefficients: &[i32; N], coordinates: &[i64; N], bits: u8) -> i64 {
    let mut whole = 0i64;
    let mut part = 0i64;
    for (c, u) in coefficients.iter().zip(coordinates) {
        whole = whole.wrapping_add(i64::from(*c) * i64::from((u >> 32) as i32));
        part += i64::from(*c) * i64::from(*u as u32 >> 16);
    }
    let sum = whole.wrapping_add(part >> 16);
    let fine = if bits >= 32 { sum >> (bits - 32) } else { sum << (32 - bits) };
    fine.wrapping_add(HALF)
}
