//! The rotation centre: where the fibre point goes when the rotary stages turn, c(q), and the actuator angles q.
//!
//! Three screw axes one after the other from the tip to the base (docs/LAW.md 2), each with sin q and
//! 2 sin^2(q/2), so that nothing cancels near zero.
//!
//! # Accuracy
//! Better than 1 nm at levers to 60 mm and angles to 5 degrees; rounding noise below 0.02 nm.
//! Angles are clamped to 7.69 degrees (a sixteenth of a nanoradian in 32 bits).

/// Fractional bits of positions in here: 2^-20 nm in 64 bits.
const POSITION_BITS: u32 = 20;

/// High half of a 32 x 32 bit product (SMMUL).
#[inline(always)]
fn mul_high(a: i32, b: i32) -> i32 {
    ((i64::from(a) * i64::from(b)) >> 32) as i32
}

/// Q32 nrad to 1/16 nrad, clamped.
#[inline(always)]
fn sixteenths(angle: i64) -> i32 {
    (angle >> 28).clamp(-(i32::MAX as i64), i32::MAX as i64) as i32
}

/// sin q in Q33 and 2 sin^2(q/2) in Q35 from q in 1/16 nrad.
///
/// Taylor terms to q^5 and q^6: the first one left out is below 2e-11 at 7.69 degrees.
#[inline(always)]
fn sine_versine(q: i32) -> (i32, i32) {
    // Q33 rad: q * 2^33 / 16e9 = q * 0.536870912, as q minus q * 0.463129088.
    let x = q - mul_high(q, 1_989_124_287);
    let square = mul_high(x, x); // x^2, Q34
    let fourth = mul_high(square, square); // x^4, Q36
    let sixth = mul_high(fourth, square); // x^6, Q38
    let third = mul_high(square, 715_827_883) - (mul_high(fourth, 35_791_394) >> 2); // x^2/6 - x^4/120, Q34
    let sine = x - (mul_high(x, third) >> 2);
    let versine = square - mul_high(fourth, 89_478_485) + mul_high(sixth, 745_654); // x^2/2 is `square` read as Q35
    (sine, versine)
}

/// A rotary stage's line at home.
#[derive(Clone, Copy, Debug, Default)]
pub struct Screw {
    /// Which of alpha, beta, gamma (0, 1, 2) turns about it.
    pub angle: u8,
    /// Unit direction in chip axes, Q30.
    pub direction: [i32; 3],
    /// A point of the line, 2^-20 nm.
    pub point: [i64; 3],
}

/// w x r, w in Q30, in the unit of r.
#[inline(always)]
fn cross(w: &[i32; 3], r: &[i32; 3]) -> [i32; 3] {
    let minor =
        |a: i32, b: i32, c: i32, d: i32| ((i64::from(a) * i64::from(b) - i64::from(c) * i64::from(d)) >> 30) as i32;
    [minor(w[1], r[2], w[2], r[1]), minor(w[2], r[0], w[0], r[2]), minor(w[0], r[1], w[1], r[0])]
}

impl Screw {
    /// Turns a point (2^-20 nm) about the line by an angle in 1/16 nrad.
    #[inline(never)]
    fn turn(&self, q: i32, p: &mut [i64; 3]) {
        let (sine, versine) = sine_versine(q);
        let mut lever = [0i32; 3]; // 1/16 nm
        for (r, (p, c)) in lever.iter_mut().zip(p.iter().zip(&self.point)) {
            *r = ((p - c) >> (POSITION_BITS - 4)) as i32;
        }
        let a = cross(&self.direction, &lever);
        let b = cross(&self.direction, &a);
        for (p, (a, b)) in p.iter_mut().zip(a.iter().zip(&b)) {
            // Q33 * 1/16 nm and Q35 * 1/16 nm, to 2^-20 nm
            *p += ((i64::from(sine) * i64::from(*a)) >> (33 + 4 - POSITION_BITS))
                + ((i64::from(versine) * i64::from(*b)) >> (35 + 4 - POSITION_BITS));
        }
    }
}

/// What the rotary stages do to orientation and to the fibre point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rotation {
    /// W^-1 - I, Q32.
    pub tilt: [[i32; 3]; 3],
    /// Second-order term, per radian times 2^60 / 10^9 (see the calibration block).
    pub second_order: [[i32; 6]; 3],
    /// From the tip to the base.
    pub screws: [Screw; 3],
    /// The point that stays put: the fibre point or another pivot, at home, 2^-20 nm.
    pub pivot: [i64; 3],
    /// False: c = 0.
    pub held: bool,
}

/// Actuator angles and displacement of the pivot for one orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Turned {
    /// q_a: angles of the rotary stages, nrad in Q32, order alpha, beta, gamma.
    pub actuator: [i64; 3],
    /// c(q_a): displacement of the pivot by those angles, nm in Q32, chip axes.
    pub displacement: [i64; 3],
}

impl Rotation {
    /// q_a and c(q_a) of logical angles (nrad in Q32).
    #[inline(never)]
    pub fn turn(&self, angles: &[i64; 3]) -> Turned {
        let actuator = self.actuator_angles(angles);
        let mut displacement = [0; 3];
        if self.held {
            let mut p = self.pivot;
            for screw in &self.screws {
                screw.turn(sixteenths(actuator[usize::from(screw.angle) % 3]), &mut p);
            }
            for (c, (p, home)) in displacement.iter_mut().zip(p.iter().zip(&self.pivot)) {
                *c = (p - home) << (32 - POSITION_BITS);
            }
        }
        Turned { actuator, displacement }
    }

    /// q_a = W^-1 a + second-order term.
    #[inline(always)]
    fn actuator_angles(&self, angles: &[i64; 3]) -> [i64; 3] {
        let a = angles.map(sixteenths);
        let products = [
            mul_high(a[0], a[0]),
            mul_high(a[1], a[1]),
            mul_high(a[2], a[2]),
            mul_high(a[0], a[1]),
            mul_high(a[0], a[2]),
            mul_high(a[1], a[2]),
        ];
        let mut actuator = *angles;
        for (q, (tilt, second)) in actuator.iter_mut().zip(self.tilt.iter().zip(&self.second_order)) {
            let mut sum = 0i64; // 2^-36 nrad
            for (t, a) in tilt.iter().zip(&a) {
                sum += i64::from(*t) * i64::from(*a);
            }
            for (s, p) in second.iter().zip(&products) {
                sum += i64::from(*s) * i64::from(*p);
            }
            *q += sum >> 4;
        }
        actuator
    }
}

/// 1/16 nm to the unit of positions in here.
pub const fn from_sixteenths(value: i32) -> i64 {
    (value as i64) << (POSITION_BITS - 4)
}

/// Whole nm of a position in here, rounded up in magnitude.
pub const fn to_nanometres(value: i64) -> u64 {
    (value.unsigned_abs() >> POSITION_BITS) + 1
}
