//! What is saved and recalled, and the request for it on its way to whoever owns the flash.

use super::orders::Waiting;
use super::{Abort, Front, LEVER_LIMIT_NM, check_step_rates};
use crate::compensation::backlash::Flank;
use crate::compensation::calibration::Calibration;
use crate::compensation::law::{Law, largest_lever_nm};
use crate::error::{Error, ErrorNumber};
use crate::settings::{self, Settings};
use crate::stepgen::timing::Timing;
use crate::store::{Record, Standstill};
use crate::units::{AXES, MotorSteps};

/// Farthest coordinate of a pivot, 1/16 nm: what the arithmetic of the law takes.
const PIVOT_LIMIT: i32 = 1 << 30;

/// What the owner of the flash is to do at standstill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StorageRequest {
    /// `*SAV`: settings, calibration, and where the motors stand.
    Save,
    /// `*RCL`: the saved settings and calibration.
    Recall,
    /// `SYSTem:PARK`: where the motors stand.
    Park,
}

/// Why the controller starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Power came back: nobody knows what has happened to the motors meanwhile.
    PowerOn,
    /// Watchdog, software, reset pin: power was there all the time.
    Reset,
}

/// Requests and what became of them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Storage {
    request: Option<StorageRequest>,
    /// Taken by the owner of the flash.
    underway: bool,
    /// Number of the latest request.
    ticket: u32,
    /// How the last two ended; a link asks before there can be a third.
    failed: [Option<Error>; 2],
    /// Why defaults are in use.
    lost: Option<Error>,
    /// Where the motors were said to stand at start, and the order after which the reports say so too.
    restored: Option<(u16, Standstill)>,
}

impl Storage {
    pub(super) fn is_pending(&self) -> bool {
        self.request.is_some()
    }

    pub(super) fn answered(&mut self, answered: impl Fn(u16) -> bool) {
        self.restored = self.restored.filter(|(sequence, _)| !answered(*sequence));
    }
}

impl Front {
    /// Everything that `*SAV` keeps, but where the motors stand.
    pub fn record(&self) -> Record<'_> {
        let block = self.calibration.map_or(&[][..], |_| self.block.as_slice());
        Record { settings: self.settings, pivots: self.pivots, pivot: self.pivot, block }
    }

    /// Puts a record in force; no motor moves, the logical position is recomputed.
    ///
    /// # Errors
    /// 104 while moving; what a command with such a value would say, -221, -222, -230: nothing has changed then.
    pub fn apply_record(&mut self, record: &Record<'_>) -> Result<(), Error> {
        self.standstill()?;
        let calibration = if record.block.is_empty() { None } else { Some(Calibration::decode(record.block)?) };
        let motors = settings::motors(calibration.as_ref(), Some(&record.settings));
        record.settings.check(&motors)?;
        let timing = timing(&record.settings)?;
        check_step_rates(&timing, &motors)?;
        let law = match &calibration {
            Some(calibration) => Law::new(calibration, record.settings.switches, checked_pivot(record, calibration)?),
            None if record.pivot != 0 || record.pivots.iter().any(Option::is_some) => {
                return Err(Error::text(ErrorNumber::SettingsConflict, "pivots without a calibration"));
            }
            None => Law::identity(&motors),
        };
        self.check_standing(&law)?;
        let block = heapless::Vec::from_slice(record.block)
            .map_err(|_| Error::text(ErrorNumber::SettingsConflict, "calibration block length"))?;
        self.timing = timing;
        self.order(Waiting::Pulses)?;
        self.settings = record.settings;
        (self.calibration, self.block) = (calibration, block);
        (self.pivots, self.pivot) = (record.pivots, record.pivot);
        self.change_law()
    }

    /// Speed of the serial port, bits per second. A change takes effect once the answers of its message have left.
    pub fn baud(&self) -> u32 {
        self.settings.baud
    }

    /// Another speed of the serial port, bits per second, within [`settings::BAUD_MIN`] and [`settings::BAUD_MAX`].
    pub fn set_baud(&mut self, baud: u32) {
        self.settings.baud = baud.clamp(settings::BAUD_MIN, settings::BAUD_MAX);
    }

    /// Where the motors stand, for memory that outlives a reset. To be kept before the orders of
    /// [`Front::next_order`] are handed on: what moves is marked before it moves.
    pub fn standstill_record(&self) -> Standstill {
        let mask = |flags: &[bool; AXES]| flags.iter().enumerate().fold(0, |mask, (i, set)| mask | u8::from(*set) << i);
        let report = &self.report;
        let mut standstill = Standstill {
            counts: report.counts,
            overlay: report.overlay,
            known: report.known,
            negative: report.negative,
            ..Standstill::default()
        };
        if let Some((_, restored)) = &self.storage.restored {
            standstill = *restored;
        }
        Standstill {
            homed: mask(&self.homed),
            uncertain: mask(&self.uncertain),
            moving: self.is_moving() || self.abort != Abort::None || self.preload.is_some(),
            ..standstill
        }
    }

    /// Says at start where the motors stand. After a reset at standstill everything is as before, but the drivers are
    /// off; after a power cut the counts and flanks are the last known ones and no axis is homed; after a reset in
    /// motion the counts are a guess: no axis is homed, all are uncertain (109).
    pub fn restore(&mut self, standstill: &Standstill, cause: Start) {
        let mut steps = standstill.counts;
        for (steps, overlay) in steps.0.iter_mut().zip(&standstill.overlay) {
            *steps = steps.wrapping_sub(*overlay);
        }
        let law = &self.capability.law;
        let is_a_pose = law.names(steps);
        let bit = |mask: u8| core::array::from_fn(|i| mask >> i & 1 != 0);
        let certain = is_a_pose && !standstill.moving;
        self.homed = if certain && cause == Start::Reset { bit(standstill.homed) } else { [false; AXES] };
        self.uncertain = if certain { bit(standstill.uncertain) } else { [true; AXES] };
        if is_a_pose && self.place(steps, standstill, certain).is_err() {
            self.homed = [false; AXES];
            self.uncertain = [true; AXES];
        }
        self.refresh();
    }

    /// Orders the generator to stand at counts, with overlays and flanks.
    fn place(&mut self, steps: MotorSteps, standstill: &Standstill, certain: bool) -> Result<(), Error> {
        let mut standstill = *standstill;
        if !certain {
            (standstill.known, standstill.negative) = (0, 0);
        }
        for (i, overlay) in standstill.overlay.into_iter().enumerate() {
            let negative = standstill.negative >> i & 1 != 0;
            let flank = if negative { Flank::Negative } else { Flank::Positive };
            let flank = (standstill.known >> i & 1 != 0).then_some(flank);
            self.order(Waiting::Rest { motor: i as u8, flank, overlay })?;
        }
        self.report.overlay = standstill.overlay;
        (self.report.known, self.report.negative) = (standstill.known, standstill.negative);
        self.refresh_plays()?;
        self.stand_at(steps);
        self.storage.restored = Some((self.sequence, standstill));
        Ok(())
    }

    /// Settings were saved and cannot be read: `error` tells every link once, QUEStionable bit 8 stays until they are
    /// saved anew or recalled.
    pub fn lose_settings(&mut self, error: Error) {
        self.storage.lost = Some(error);
    }

    /// Why defaults are in use although settings were saved.
    pub fn settings_lost(&self) -> Option<Error> {
        self.storage.lost
    }

    /// Asks for storage at standstill; answers the number of the request.
    ///
    /// # Errors
    /// 104 while moving or while another request is pending.
    pub fn request_storage(&mut self, request: StorageRequest) -> Result<u32, Error> {
        self.standstill()?;
        if self.storage.is_pending() {
            return Err(ErrorNumber::Moving.into());
        }
        self.storage.request = Some(request);
        self.storage.ticket = self.storage.ticket.wrapping_add(1).max(1);
        Ok(self.storage.ticket)
    }

    /// True while a request is pending.
    pub fn storage_pending(&self) -> bool {
        self.storage.is_pending()
    }

    /// How a request ended; none while it has not.
    pub fn storage_result(&self, ticket: u32) -> Option<Result<(), Error>> {
        let done = ticket != self.storage.ticket || !self.storage.is_pending();
        done.then(|| self.storage.failed[(ticket & 1) as usize].map_or(Ok(()), Err))
    }

    /// True when [`Front::take_storage_request`] would give something: time to stop the stream.
    pub fn storage_due(&self) -> bool {
        self.storage.is_pending() && !self.storage.underway && !self.motion_pending()
    }

    /// What the owner of the flash is to do, once it may: everything stands and no order is on its way. It answers with
    /// [`Front::storage_done`]; until then nothing else is begun. [`crate::store::service::serve`] does both.
    pub fn take_storage_request(&mut self) -> Option<StorageRequest> {
        let due = self.storage_due();
        self.storage.underway |= due;
        self.storage.request.filter(|_| due)
    }

    /// The request is done, or has failed.
    pub fn storage_done(&mut self, request: StorageRequest, result: Result<(), Error>) {
        // what is saved now, or in force as it was saved, is no longer lost
        if result.is_ok() && request != StorageRequest::Park {
            self.storage.lost = None;
        }
        self.storage.failed[(self.storage.ticket & 1) as usize] = result.err();
        (self.storage.request, self.storage.underway) = (None, false);
    }
}

/// Pulse timing that settings ask for.
///
/// # Errors
/// -222 when the times are too long.
pub(super) fn timing(settings: &Settings) -> Result<Timing, Error> {
    let timing = Timing::new(settings.axes.map(|a| a.timing))
        .ok_or(Error::text(ErrorNumber::DataOutOfRange, "pulse times above 32 us, or set-up or hold above 128 us"))?;
    Ok(timing.with_inverted(settings.axes.map(|a| a.inverted)))
}

/// The pivot in use; all of them must be within reach.
fn checked_pivot(record: &Record<'_>, calibration: &Calibration) -> Result<[i32; 3], Error> {
    let bounded = |point: &[i32; 3]| point.iter().all(|x| (-PIVOT_LIMIT..=PIVOT_LIMIT).contains(x));
    let reached = |point: &[i32; 3]| bounded(point) && largest_lever_nm(calibration, *point) <= LEVER_LIMIT_NM;
    if !record.pivots.iter().flatten().chain([&calibration.fibre_point]).all(reached) {
        return Err(Error::text(ErrorNumber::DataOutOfRange, "pivot beyond 60 mm from a rotary axis"));
    }
    match record.pivots.get(usize::from(record.pivot)) {
        Some(Some(point)) if record.pivot != 0 => Ok(*point),
        Some(_) if record.pivot == 0 => Ok(calibration.fibre_point),
        _ => Err(Error::text(ErrorNumber::SettingsConflict, "pivot not defined")),
    }
}
