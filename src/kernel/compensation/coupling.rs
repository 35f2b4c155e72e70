//! One row of the coupling: a motor's target from coordinates, step size folded in.

use crate::units::AXES;

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
    let dot = |u: [i32; N]| {
        let products = coefficients.iter().zip(u).map(|(c, u)| i64::from(*c) * i64::from(u));
        products.fold(0i64, i64::wrapping_add)
    };
    target(dot(coordinates.map(whole)), dot(coordinates.map(part)), factor(bits))
}

/// What brings a sum from Q`bits` to Q29 when the upper half of the product is taken. A law keeps it, because a power
/// of two that the compiler knows would become slower shifts.
pub fn factor(bits: u8) -> i32 {
    1 << (61u32.wrapping_sub(bits.into()) & 31)
}

/// [`row`] for three motors at once; a leaf of its own, lest it make its caller run out of registers.
#[inline(never)]
pub fn rows(coefficients: &[[i32; 3]; 3], factors: &[i32; AXES], coordinates: &[i64; 3], motors: &mut [i64; AXES]) {
    let [x, y, z] = *coordinates;
    let (wholes, parts) = ([whole(x), whole(y), whole(z)], [part(x), part(y), part(z)]);
    let [first, second, third] = coefficients;
    motors[0] = target(dot(first, &wholes), dot(first, &parts), factors[0]);
    motors[1] = target(dot(second, &wholes), dot(second, &parts), factors[1]);
    motors[2] = target(dot(third, &wholes), dot(third, &parts), factors[2]);
}

/// Written out, because a loop over three products costs more than they do.
#[inline(always)]
fn dot([a, b, c]: &[i32; 3], [x, y, z]: &[i32; 3]) -> i64 {
    let (x, y, z) = (i64::from(*x), i64::from(*y), i64::from(*z));
    (i64::from(*a) * x).wrapping_add(i64::from(*b) * y).wrapping_add(i64::from(*c) * z)
}

/// [`row`] of one coordinate, with the [`factor`] of its bits.
#[inline(always)]
pub fn lone(coefficient: i32, coordinate: i64, factor: i32) -> i64 {
    let times = |u: i32| i64::from(coefficient) * i64::from(u);
    target(times(whole(coordinate)), times(part(coordinate)), factor)
}

#[inline(always)]
fn whole(coordinate: i64) -> i32 {
    (coordinate >> 32) as i32
}

#[inline(always)]
fn part(coordinate: i64) -> i32 {
    (coordinate as u32 >> 16) as i32
}

/// The target from the sums of products of the whole parts and of the fractions.
#[inline(always)]
fn target(wholes: i64, parts: i64, factor: i32) -> i64 {
    shifted(wholes.wrapping_add(parts >> 16), factor).wrapping_add(HALF)
}

/// `sum` from Q`bits` times Q32 to Q29 and from there to Q32: a shift by a variable, as two products. What it drops is
/// below the half that is added, so that the floor stays exact.
#[inline(always)]
fn shifted(sum: i64, factor: i32) -> i64 {
    let low = (u64::from(sum as u32) * u64::from(factor as u32)) >> 32;
    (low as i64).wrapping_add(i64::from((sum >> 32) as i32) * i64::from(factor)) << 3
}
