//! The rotation centre: where the fibre point goes when the rotary stages turn, c(q), and the actuator angles q.
//!
//! Three screw axes one after the other from the tip to the base (docs/LAW.md 2), each with sin q and
//! 2 sin^2(q/2), so that nothing cancels near zero.
//!
//! # Accuracy
//! Better than 1 nm at levers to 60 mm and angles to 5 degrees; rounding noise below 0.02 nm.
//! Angles are clamped to 7.69 degrees (a sixteenth of a nanoradian in 32 bits).
//!
//! # Cost
//! What a Cortex-M4 multiplies in one instruction: 32 by 32 bits, the whole product added up or its upper half.

/// Fractional bits of positions that are given: 2^-20 nm in 64 bits.
const POSITION_BITS: u32 = 20;

/// Fractional bits of a displacement while it is summed: what a sine in Q33 times an eighth of a nanometre has.
const SUM_BITS: u32 = 36;

/// High half of a 32 x 32 bit product (SMMUL).
#[inline(always)]
fn mul_high(a: i32, b: i32) -> i32 {
    ((i64::from(a) * i64::from(b)) >> 32) as i32
}

/// Q32 nrad to 1/16 nrad, clamped to whole nanoradians of 28 bits.
#[inline(always)]
fn sixteenths(angle: i64) -> i32 {
    const MOST: i32 = 1 << 27;
    ((angle >> 32) as i32).clamp(-MOST, MOST - 1) << 4 | (angle as u32 >> 28) as i32
}

/// sin q in Q33 and 2 sin^2(q/2) in Q34 from q in 1/16 nrad.
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
    let versine = square - mul_high(fourth, 89_478_485) + mul_high(sixth, 745_654); // Q35: x^2/2 is `square` read so
    (sine, versine >> 1)
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

/// A screw as the refill needs it.
#[derive(Clone, Copy, Debug, Default)]
struct Link {
    /// Which of alpha, beta, gamma (0, 1, 2) turns about it.
    angle: usize,
    /// Unit direction in chip axes, Q31; one is the largest number below it.
    direction: [i32; 3],
    /// From the line's point to the pivot at home, 1/16 nm.
    lever: [i32; 3],
}

impl Link {
    /// direction x lever in 1/8 nm, and direction x that in 1/4 nm, which a versine of less than 2^-6 makes small.
    #[inline(always)]
    fn arms(&self, lever: [i32; 3]) -> [[i32; 3]; 2] {
        let first = cross(self.direction, lever);
        [first, cross(self.direction, first)]
    }

    /// Adds to the displacement of the pivot (Q36 nm) what a turn about the line by an angle in 1/16 nrad makes.
    #[inline(never)]
    fn turn(&self, q: i32, displacement: &mut [i64; 3]) {
        let [x, y, z] = self.lever;
        let [a, b, c] = displacement;
        let moved = |r: i32, way: &i64| r.wrapping_add((*way >> 32) as i32); // Q36 to 1/16 nm
        swing(q, &self.arms([moved(x, a), moved(y, b), moved(z, c)]), displacement);
    }
}

/// The product of a direction in Q31 and an arm, halved.
#[inline(always)]
fn cross([x, y, z]: [i32; 3], [u, v, w]: [i32; 3]) -> [i32; 3] {
    let [xv, xw, yu] = [mul_high(x, v), mul_high(x, w), mul_high(y, u)];
    let [yw, zu, zv] = [mul_high(y, w), mul_high(z, u), mul_high(z, v)];
    [yw - zv, zu - xw, xv - yu]
}

/// Adds a column times a term. Without a loop, which costs more than what is in it when the compiler is to be short.
#[inline(always)]
fn add_column(sums: &mut [i64; 3], [x, y, z]: &[i32; 3], term: i32) {
    let [a, b, c] = sums;
    *a += i64::from(*x) * i64::from(term);
    *b += i64::from(*y) * i64::from(term);
    *c += i64::from(*z) * i64::from(term);
}

/// Adds what a turn by an angle in 1/16 nrad makes of the [arms](Link::arms).
#[inline(always)]
fn swing(q: i32, [first, second]: &[[i32; 3]; 2], displacement: &mut [i64; 3]) {
    let (sine, versine) = sine_versine(q);
    // Q33 * 1/8 nm and Q34 * 1/4 nm
    add_column(displacement, first, sine);
    add_column(displacement, second, versine);
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
    /// The same for the refill.
    pub fn prepared(&self) -> Rotary {
        let link = |screw: &Screw| {
            let mut lever = [0; 3];
            for (r, (p, c)) in lever.iter_mut().zip(self.pivot.iter().zip(&screw.point)) {
                *r = ((p - c) >> (POSITION_BITS - 4)) as i32;
            }
            let direction = screw.direction.map(|w| w.saturating_mul(2));
            Link { angle: usize::from(screw.angle % 3), direction, lever }
        };
        let mut columns = [[0; 3]; 9];
        for (row, (tilt, second)) in self.tilt.iter().zip(&self.second_order).enumerate() {
            for (k, (column, given)) in columns.iter_mut().zip(tilt.iter().chain(second)).enumerate() {
                // the squares are taken negative
                column[row] = if (3..6).contains(&k) { -given } else { *given };
            }
        }
        let [tip, links @ ..] = [0, 1, 2].map(|i: usize| link(&self.screws[i]));
        Rotary { columns, tip: tip.angle, arms: tip.arms(tip.lever), links, held: self.held }
    }

    /// q_a and c(q_a) of logical angles (nrad in Q32).
    pub fn turn(&self, angles: &[i64; 3]) -> Turned {
        let mut turned = Turned::default();
        self.prepared().turn(angles, &mut turned);
        turned
    }
}

/// [`Rotation`] in the form in which the refill evaluates it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rotary {
    /// W^-1 - I and the second-order term, as in [`Rotation`], by columns; those of the squares negative.
    columns: [[i32; 3]; 9],
    /// The angle about the axis next to the tip, and what it swings: no other turn changes that.
    tip: usize,
    arms: [[i32; 3]; 2],
    /// The other two, to the base.
    links: [Link; 2],
    held: bool,
}

impl Rotary {
    /// q_a and c(q_a) of logical angles (nrad in Q32).
    #[inline(never)]
    pub fn turn(&self, angles: &[i64; 3], turned: &mut Turned) {
        self.actuator_angles(angles, &mut turned.actuator);
        let mut displacement = [0; 3];
        if self.held {
            let angle = |which: usize| sixteenths(turned.actuator.get(which).copied().unwrap_or(0));
            let [middle, base] = &self.links;
            swing(angle(self.tip), &self.arms, &mut displacement);
            middle.turn(angle(middle.angle), &mut displacement);
            base.turn(angle(base.angle), &mut displacement);
        }
        let [x, y, z] = displacement;
        turned.displacement = [x >> (SUM_BITS - 32), y >> (SUM_BITS - 32), z >> (SUM_BITS - 32)];
    }

    /// q_a = W^-1 a + second-order term.
    #[inline(never)]
    fn actuator_angles(&self, angles: &[i64; 3], actuator: &mut [i64; 3]) {
        let [a, b, c] = [sixteenths(angles[0]), sixteenths(angles[1]), sixteenths(angles[2])];
        // A square taken negative is not known to be positive: the compiler would make it unsigned, and its product
        // with a signed number two instructions longer.
        let negative_square = |x: i32| mul_high(x, x.wrapping_neg());
        let [tilt @ .., xx, yy, zz, xy, xz, yz] = &self.columns;
        let mut sums = [0i64; 3]; // 2^-36 nrad
        add_column(&mut sums, &tilt[0], a);
        add_column(&mut sums, &tilt[1], b);
        add_column(&mut sums, &tilt[2], c);
        add_column(&mut sums, xx, negative_square(a));
        add_column(&mut sums, yy, negative_square(b));
        add_column(&mut sums, zz, negative_square(c));
        add_column(&mut sums, xy, mul_high(a, b));
        add_column(&mut sums, xz, mul_high(a, c));
        add_column(&mut sums, yz, mul_high(b, c));
        actuator[0] = angles[0] + (sums[0] >> 4);
        actuator[1] = angles[1] + (sums[1] >> 4);
        actuator[2] = angles[2] + (sums[2] >> 4);
    }

    /// The second-order term by its six products, per radian times 2^60 / 10^9 but for signs.
    pub fn second_order(&self) -> &[[i32; 3]] {
        &self.columns[3..]
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
