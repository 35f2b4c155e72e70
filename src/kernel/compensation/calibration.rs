//! The calibration block: everything the controller knows of its stage, in fixed point.
//!
//! The host tool computes it in f64 from a machine description; the controller only checks and applies it.
//! Layout: magic `SCAL`, version (u16), payload length (u16), payload (postcard), CRC-32 (ISO-HDLC) of all before.

use crate::error::{Error, ErrorNumber};
use crate::units::{ANGLE_LIMIT, AXES, Axis, COORDINATE_LIMIT, wide};
use crate::wire::Wire;
use serde::{Deserialize, Serialize};

/// Version of the block's payload. Raised when a field changes; older blocks are then refused with -221.
pub const BLOCK_VERSION: u16 = 1;
/// Largest block in bytes: one whose numbers are all at their longest has 733.
pub const BLOCK_CAPACITY: usize = 768;
const MAGIC: [u8; 4] = *b"SCAL";
/// Smallest step, Q32: 2 nm or nrad. Below, whole nanometres no longer reach every step.
pub const STEP_MIN: u64 = 2 << 32;
/// Steps are smaller than this, Q32: 65.536 um or urad.
pub const STEP_END: u64 = 1 << 48;
const HEADER: usize = 8;
const CRC: crc::Crc<u32, crc::NoTable> = crc::Crc::<u32, crc::NoTable>::new(&crc::CRC_32_ISO_HDLC);

/// One motor and the stage that it drives. Lengths in nm or, for a rotary stage, nrad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MotorData {
    /// Size of one step, Q32 nm or nrad.
    pub step_q32: u64,
    /// Fractional bits of the motor's coupling row: 30 + floor(log2 step).
    pub row_bits: u8,
    /// Width of the play in whole steps.
    pub backlash_steps: u32,
    /// Lower end of the travel, nm or nrad.
    pub travel_lower: i32,
    /// Upper end of the travel, nm or nrad.
    pub travel_upper: i32,
    /// Largest velocity, nm/s or nrad/s.
    pub velocity: u64,
    /// Largest acceleration, nm/s^2 or nrad/s^2.
    pub acceleration: u64,
    /// Largest jerk, nm/s^3 or nrad/s^3.
    pub jerk: u64,
}

/// The line about which a rotary stage turns, with the stage at home.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScrewAxis {
    /// Which rotary stage.
    pub axis: Axis,
    /// Unit direction in chip axes, Q30.
    pub direction: [i32; 3],
    /// A point of the line in chip axes, 1/16 nm.
    pub point: [i32; 3],
}

/// Everything that the controller knows of its stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Calibration {
    /// Name of the machine, ASCII, padded with zeros.
    pub name: [u8; 16],
    /// The stages from the base to the fibre array.
    pub order: [Axis; AXES],
    /// The motors in axis order.
    pub motors: [MotorData; AXES],
    /// D^-1 with the step size folded in: row i = motor i (X, Y, Z), C = round(D^-1 / step * 2^row_bits).
    pub inverse_slides: [[i32; 3]; 3],
    /// Rotary motors (alpha, beta, gamma): C = round(2^row_bits / step).
    pub rotary_gain: [i32; 3],
    /// W^-1 - I in Q32, rows and columns alpha, beta, gamma.
    pub tilt: [[i32; 3]; 3],
    /// Second-order term of the actuator angles in alpha^2, beta^2, gamma^2, alpha beta, alpha gamma, beta gamma;
    /// per radian times 2^60 / 10^9. Rows alpha, beta, gamma.
    pub second_order: [[i32; 6]; 3],
    /// The three screw axes from the tip (fibre array) to the base.
    pub screws: [ScrewAxis; 3],
    /// Orientation of the fibre array frame at home in chip axes, Q30, row-major.
    pub home_rotation: [[i32; 3]; 3],
    /// Origin of the fibre array frame at home in chip axes, 1/16 nm.
    pub home_origin: [i32; 3],
    /// The fibre point F in the fibre array frame, 1/16 nm.
    pub fibre_point: [i32; 3],
}

impl Calibration {
    /// What a block is read into.
    const BLANK: Self = {
        let motor = MotorData {
            step_q32: 0,
            row_bits: 0,
            backlash_steps: 0,
            travel_lower: 0,
            travel_upper: 0,
            velocity: 0,
            acceleration: 0,
            jerk: 0,
        };
        Calibration {
            name: [0; 16],
            order: [Axis::X; AXES],
            motors: [motor; AXES],
            inverse_slides: [[0; 3]; 3],
            rotary_gain: [0; 3],
            tilt: [[0; 3]; 3],
            second_order: [[0; 6]; 3],
            screws: [ScrewAxis { axis: Axis::X, direction: [0; 3], point: [0; 3] }; 3],
            home_rotation: [[0; 3]; 3],
            home_origin: [0; 3],
            fibre_point: [0; 3],
        }
    };

    /// Reads every field: the bytes that [`Calibration::encode`] writes.
    fn wire(&mut self, wire: &mut Wire<'_>) {
        self.name.iter_mut().for_each(|byte| wire.byte(byte));
        self.order.iter_mut().for_each(|axis| wire.axis(axis));
        for motor in &mut self.motors {
            wire.long(&mut motor.step_q32);
            wire.byte(&mut motor.row_bits);
            wire.word(&mut motor.backlash_steps);
            wire.signed(&mut motor.travel_lower);
            wire.signed(&mut motor.travel_upper);
            wire.long(&mut motor.velocity);
            wire.long(&mut motor.acceleration);
            wire.long(&mut motor.jerk);
        }
        wire.all_signed(self.inverse_slides.as_flattened_mut());
        wire.all_signed(&mut self.rotary_gain);
        wire.all_signed(self.tilt.as_flattened_mut());
        wire.all_signed(self.second_order.as_flattened_mut());
        for screw in &mut self.screws {
            wire.axis(&mut screw.axis);
            wire.all_signed(&mut screw.direction);
            wire.all_signed(&mut screw.point);
        }
        wire.all_signed(self.home_rotation.as_flattened_mut());
        wire.all_signed(&mut self.home_origin);
        wire.all_signed(&mut self.fibre_point);
    }

    /// Writes the block; returns its length.
    ///
    /// # Errors
    /// None when the buffer is shorter than the block ([`BLOCK_CAPACITY`] is always enough).
    pub fn encode(&self, block: &mut [u8]) -> Option<usize> {
        let (header, rest) = block.split_at_mut_checked(HEADER)?;
        let payload = postcard::to_slice(self, rest).ok()?.len();
        header[..4].copy_from_slice(&MAGIC);
        header[4..6].copy_from_slice(&BLOCK_VERSION.to_le_bytes());
        header[6..8].copy_from_slice(&u16::try_from(payload).ok()?.to_le_bytes());
        let end = HEADER + payload;
        let crc = CRC.checksum(block.get(..end)?);
        block.get_mut(end..end + 4)?.copy_from_slice(&crc.to_le_bytes());
        Some(end + 4)
    }

    /// Reads and checks a block.
    ///
    /// # Errors
    /// -230 when the CRC does not match, -221 when magic, version, length or a value's range is wrong.
    pub fn decode(block: &[u8]) -> Result<Self, Error> {
        let shape = |what| Error::text(ErrorNumber::SettingsConflict, what);
        if block.len() < HEADER + 4 || block[..4] != MAGIC {
            return Err(shape("not a calibration block"));
        }
        let (body, crc) = block.split_at(block.len() - 4);
        if CRC.checksum(body).to_le_bytes() != *crc {
            return Err(Error::text(ErrorNumber::DataCorrupt, "calibration CRC"));
        }
        if u16::from_le_bytes([body[4], body[5]]) != BLOCK_VERSION {
            return Err(shape("calibration block version"));
        }
        if usize::from(u16::from_le_bytes([body[6], body[7]])) != body.len() - HEADER {
            return Err(shape("calibration block length"));
        }
        let mut calibration = Calibration::BLANK;
        let mut wire = Wire::read(&body[HEADER..]);
        calibration.wire(&mut wire);
        wire.end().ok_or(shape("calibration payload"))?;
        calibration.check()?;
        Ok(calibration)
    }

    /// CRC-32 of the block's bytes before the CRC itself: what `COMP:CRC?` answers.
    pub fn crc(block: &[u8]) -> u32 {
        CRC.checksum(&block[..block.len().saturating_sub(4)])
    }

    /// The values that the arithmetic relies on.
    #[inline(never)]
    fn check(&self) -> Result<(), Error> {
        let shape = |what| Err(Error::text(ErrorNumber::SettingsConflict, what));
        let mut seen = [false; AXES];
        for axis in self.order {
            seen[axis.index()] = true;
        }
        if seen != [true; AXES] || self.order[..3].iter().any(|axis| axis.is_rotary()) {
            return shape("calibration axis order");
        }
        let mut rotary = [self.order[5], self.order[4], self.order[3]].into_iter();
        if self.screws.iter().any(|screw| Some(screw.axis) != rotary.next()) {
            return shape("calibration screw order");
        }
        for motor in &self.motors {
            let step_ok = (STEP_MIN..STEP_END).contains(&motor.step_q32) && motor.row_bits == row_bits(motor.step_q32);
            let travel_ok = motor.travel_lower < motor.travel_upper
                && motor.travel_lower >= -COORDINATE_LIMIT
                && motor.travel_upper <= COORDINATE_LIMIT;
            let rates_ok = (1..=1 << 36).contains(&motor.velocity)
                && (1..=1 << 42).contains(&motor.acceleration)
                && (1..=1 << 50).contains(&motor.jerk);
            if !step_ok || !travel_ok || !rates_ok || motor.backlash_steps > 1 << 20 {
                return shape("calibration motor data");
            }
        }
        if !self.is_near_the_ideal() {
            return shape("calibration matrix, axes or gain far from a stage's");
        }
        let small = |values: &[i32], limit: i32| values.iter().all(|v| (-limit..=limit).contains(v));
        let rows_ok = self.tilt.iter().all(|row| small(row, 1 << 28))
            && self.second_order.iter().all(|row| small(row, 1 << 28))
            && self.screws.iter().all(|s| small(&s.direction, 1 << 30) && small(&s.point, 1 << 30))
            && self.home_rotation.iter().all(|row| small(row, 1 << 30))
            && small(&self.home_origin, 1 << 30)
            && small(&self.fibre_point, 1 << 30);
        if !rows_ok {
            return shape("calibration coefficients");
        }
        Ok(())
    }
}

impl Calibration {
    /// A stage is built square and straight to a few percent: what is farther off is no calibration, and the law's
    /// inverse need not converge.
    fn is_near_the_ideal(&self) -> bool {
        let unit = |i: usize| {
            let motor = &self.motors[i];
            wide::div(1u128 << (u32::from(motor.row_bits) + 32), u128::from(motor.step_q32)) as i64
        };
        let slides = self.inverse_slides.iter().enumerate().all(|(i, row)| {
            row.iter().enumerate().all(|(j, c)| {
                let ideal = if i == j { unit(i) } else { 0 };
                (i64::from(*c) - ideal).abs() <= unit(i) / 10
            })
        });
        let gains = self.rotary_gain.iter().zip(3..);
        let gains = gains.into_iter().all(|(gain, i)| (i64::from(*gain) - unit(i)).abs() <= (unit(i) >> 20) + 2);
        // squares in Q56: within a thousandth of one
        let one = |v: &[i32; 3]| {
            let square: i64 = v.iter().map(|x| i64::from(*x).pow(2) >> 4).sum();
            (square - (1 << 56)).abs() <= 1 << 46
        };
        let along = |axis: Axis, v: &[i32; 3]| v[axis.index() % 3] > 1_000_000_000;
        let screws = self.screws.iter().all(|s| one(&s.direction) && along(s.axis, &s.direction));
        let turns = self.motors[3..].iter().all(|m| m.travel_lower < ANGLE_LIMIT && m.travel_upper > -ANGLE_LIMIT);
        slides && gains && screws && turns && self.home_rotation.iter().all(one)
    }
}

/// Fractional bits of a coupling row: 30 + floor(log2 step), so that 2^bits / step fits 31 bits (docs/LAW.md 3).
pub const fn row_bits(step_q32: u64) -> u8 {
    (30 + step_q32.ilog2() - 32) as u8
}
