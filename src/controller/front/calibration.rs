//! Calibration, switches and pivots: changes of the law at standstill, which move no motor.

use super::orders::Waiting;
use super::{Front, LEVER_LIMIT_NM, PIVOTS, check_step_rates, refuse};
use crate::compensation::calibration::Calibration;
use crate::compensation::law::{Law, Switches, largest_lever_nm};
use crate::error::{Error, ErrorNumber};
use crate::settings::Settings;
use crate::units::{Axis, MotorSteps};

impl Front {
    /// Loads a calibration block: never moves a motor; backlash, travel and rates are taken from it.
    ///
    /// # Errors
    /// 104 while moving, -230 bad CRC, -221 bad version or shape, -222 a lever beyond 60 mm: the old one stays.
    pub fn load(&mut self, block: &[u8]) -> Result<(), Error> {
        self.standstill()?;
        let calibration = Calibration::decode(block)?;
        if largest_lever_nm(&calibration, calibration.fibre_point) > LEVER_LIMIT_NM {
            return Err(Error::text(ErrorNumber::DataOutOfRange, "fibre point beyond 60 mm from a rotary axis"));
        }
        check_step_rates(&self.timing, &calibration.motors)?;
        self.check_standing(&Law::new(&calibration, self.settings.switches, calibration.fibre_point))?;
        let bytes = heapless::Vec::from_slice(block)
            .map_err(|_| Error::text(ErrorNumber::SettingsConflict, "calibration block length"))?;
        let fresh = Settings::defaults(Some(&calibration));
        for (own, new) in self.settings.axes.iter_mut().zip(&fresh.axes) {
            let (inverted, timing, wiring, home) = (own.inverted, own.timing, own.wiring, own.home);
            *own = *new;
            (own.inverted, own.timing, own.wiring) = (inverted, timing, wiring);
            (own.home.side, own.home.offset) = (home.side, home.offset);
        }
        self.pivots = [None; PIVOTS];
        self.pivot = 0;
        self.block = bytes;
        self.calibration = Some(calibration);
        self.change_law()
    }

    /// The block as loaded.
    ///
    /// # Errors
    /// 107 with nothing loaded.
    pub fn block(&self) -> Result<&[u8], Error> {
        self.calibration().map(|_| self.block.as_slice())
    }

    /// The calibration in force.
    ///
    /// # Errors
    /// 107 with nothing loaded.
    pub fn calibration(&self) -> Result<&Calibration, Error> {
        self.calibration.as_ref().ok_or(refuse(ErrorNumber::NoCalibration))
    }

    /// Switches parts of the compensation; no motor moves.
    ///
    /// # Errors
    /// 104 when coupling or pivot change while moving, 107 when a part is turned on with nothing loaded.
    pub fn set_switches(&mut self, switches: Switches) -> Result<(), Error> {
        let old = self.settings.switches;
        let linear = |s: Switches| (s.compensation && s.coupling, s.compensation && s.pivot);
        let law_changes = self.calibration.is_some() && linear(old) != linear(switches);
        if let Some(calibration) = self.calibration.as_ref().filter(|_| law_changes) {
            self.standstill()?;
            self.check_standing(&Law::new(calibration, switches, self.pivot_point(calibration)))?;
        }
        self.settings.switches = switches;
        if law_changes { self.change_law() } else { self.refresh_plays() }
    }

    /// Defines a pivot in the fibre array frame, 1/16 nm.
    ///
    /// # Errors
    /// 107 with no calibration, -222 beyond 60 mm from a rotary axis, -221 for number 0, 104 while the pivot is in
    /// use and the stage moves.
    pub fn define_pivot(&mut self, number: u8, point: [i32; 3]) -> Result<(), Error> {
        let calibration = self.calibration()?;
        if number == 0 {
            return Err(Error::text(ErrorNumber::SettingsConflict, "pivot 0 is the calibration's own"));
        }
        if largest_lever_nm(calibration, point) > LEVER_LIMIT_NM {
            return Err(Error::text(ErrorNumber::DataOutOfRange, "pivot beyond 60 mm from a rotary axis"));
        }
        let in_use = self.pivot == number;
        if in_use {
            self.standstill()?;
            self.check_standing(&Law::new(calibration, self.settings.switches, point))?;
        }
        if let Some(place) = self.pivots.get_mut(usize::from(number)) {
            *place = Some(point);
        }
        if in_use { self.change_law() } else { Ok(()) }
    }

    /// Selects a pivot; nothing moves, the logical position is recomputed.
    ///
    /// # Errors
    /// 104 while moving, 107 with no calibration, -221 for a pivot that is not defined.
    pub fn select_pivot(&mut self, number: u8) -> Result<(), Error> {
        let point = self.defined_pivot(number)?;
        self.standstill()?;
        self.check_standing(&Law::new(self.calibration()?, self.settings.switches, point))?;
        self.pivot = number;
        self.change_law()
    }

    /// The selected pivot and its point in the fibre array frame, 1/16 nm.
    ///
    /// # Errors
    /// 107 with no calibration.
    pub fn pivot(&self) -> Result<(u8, [i32; 3]), Error> {
        Ok((self.pivot, self.pivot_point(self.calibration()?)))
    }

    /// A pivot, whether selected or not, in the fibre array frame, 1/16 nm.
    ///
    /// # Errors
    /// 107 with no calibration, -221 for a pivot that is not defined.
    pub fn defined_pivot(&self, number: u8) -> Result<[i32; 3], Error> {
        let calibration = self.calibration()?;
        match self.pivots.get(usize::from(number)) {
            Some(Some(point)) if number != 0 => Ok(*point),
            _ if number == 0 => Ok(calibration.fibre_point),
            _ => Err(Error::text(ErrorNumber::SettingsConflict, "pivot not defined")),
        }
    }

    /// CRC-32 of the block as loaded.
    ///
    /// # Errors
    /// 107 with nothing loaded.
    pub fn block_crc(&self) -> Result<u32, Error> {
        self.block().map(Calibration::crc)
    }

    /// Step size that the calibration gives, Q32 nm or nrad.
    pub fn default_step_q32(&self, axis: Axis) -> Option<u64> {
        self.calibration.map(|c| c.motors[axis.index()].step_q32)
    }

    fn pivot_point(&self, calibration: &Calibration) -> [i32; 3] {
        match self.pivots.get(usize::from(self.pivot)) {
            Some(Some(point)) if self.pivot != 0 => *point,
            _ => calibration.fibre_point,
        }
    }

    /// Under another law the counts at which the motors stand must still be a pose.
    ///
    /// # Errors
    /// -222 when it lies beyond the range of coordinates.
    pub(super) fn check_standing(&self, law: &Law) -> Result<(), Error> {
        let steps = self.report.final_steps;
        if law.names(steps) {
            return Ok(());
        }
        Err(Error::text(ErrorNumber::DataOutOfRange, "the stage would stand beyond the range of coordinates"))
    }

    /// The law that calibration, switches and pivot ask for.
    pub(super) fn real_law(&self) -> Law {
        match &self.calibration {
            Some(calibration) => Law::new(calibration, self.settings.switches, self.pivot_point(calibration)),
            None => Law::identity(&self.motors()),
        }
    }

    /// Puts the law in force that calibration, switches and pivot ask for.
    pub(super) fn change_law(&mut self) -> Result<(), Error> {
        self.put_law(self.real_law(), self.report.final_steps)
    }

    /// Puts a law in force, under which the motors stand at these counts.
    pub(super) fn put_law(&mut self, law: Law, steps: MotorSteps) -> Result<(), Error> {
        self.capability.law = law;
        self.order(Waiting::Law)?;
        self.refresh_plays()?;
        self.stand_at(steps);
        Ok(())
    }
}
