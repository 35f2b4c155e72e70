//! What a scan concludes from its samples, and where it ends.

use super::{Next, Phase};
use crate::controller::front::light::LinePeak;
use crate::controller::front::{Front, LightMemory};
use crate::error::{Error, ErrorNumber};
use crate::scan::peak::{self, Peak};
use crate::scan::{End, Kind, SCAN_AXES, status};
use crate::sense::DARK;
use crate::units::wide;

impl Front {
    /// All samples of a leg are there.
    pub(super) fn leg_done(&mut self) {
        let Some(scan) = &mut self.scan else { return };
        let definition = scan.definition;
        match definition.kind {
            Kind::Line => return self.line_found(),
            Kind::Raster => {
                let peak = self.line_peak();
                let (Some(scan), Some(memory)) = (&mut self.scan, self.light.get_mut()) else { return };
                if let Some(peak) = peak.filter(|peak| !peak.edge) {
                    let n = usize::from(scan.lines);
                    if let (Some(line), Some(place)) = (memory.lines.get_mut(n), memory.peaks.get_mut(n)) {
                        *line = (scan.leg.beside as i32, peak.level);
                        *place = LinePeak { x: peak.x, sigma: peak.sigma.unwrap_or(0) };
                        scan.lines += 1;
                    }
                }
            }
            _ => {}
        }
        let Some(scan) = &mut self.scan else { return };
        scan.index += 1;
        if scan.index < definition.legs() {
            return self.begin_part();
        }
        match definition.kind {
            Kind::Raster => self.raster_found(),
            _ => {
                // the greatest sample: no better than the turns lie apart
                let half = scan.definition.step.unsigned_abs() / 2;
                let (level, place) = scan.best;
                self.found(place, level, [half; SCAN_AXES]);
            }
        }
    }

    /// The peak of the line in memory, where the stage was when the light was seen.
    fn line_peak(&self) -> Option<Peak> {
        let scan = self.scan.as_ref()?;
        let mut peak = peak::find(self.light.get()?.samples.points())?;
        if scan.leg.lag != 0 && scan.definition.kind != Kind::Parabola {
            // as fast as it really was
            let delay = self.sense_settings(scan.definition.channel.into()).delay_ns;
            let way = scan.block.way_in(delay).unwrap_or(scan.leg.lag);
            peak.x = peak.x.saturating_add((scan.leg.lag - way) as i32);
        }
        Some(peak)
    }

    /// A line or a parabola has been sampled.
    pub(super) fn line_found(&mut self) {
        match self.line_peak() {
            None => self.fail_scan("fewer than three samples"),
            Some(peak) => self.peak_found([peak.x, 0, 0], &peak, [peak.sigma.unwrap_or(0); SCAN_AXES]),
        }
    }

    fn peak_found(&mut self, place: [i32; SCAN_AXES], peak: &Peak, sigma: [u32; SCAN_AXES]) {
        let Some(scan) = &mut self.scan else { return };
        if peak.strays {
            scan.outcome.status |= status::OUTLIERS;
        }
        let dark = scan.best.0 <= DARK || scan.outcome.status & status::LIGHT == 0;
        if peak.edge && !dark && scan.outcome.status & status::SATURATED == 0 {
            scan.outcome.status |= status::EDGE;
            (scan.outcome.level, scan.fails) = (scan.best.0, None);
            return self.fail_scan("no maximum within the range");
        }
        self.found(place, peak.level, sigma);
    }

    /// All lines of a raster have been sampled: a parabola over their peaks, and a straight line through their places.
    fn raster_found(&mut self) {
        let (Some(scan), Some(memory)) = (&self.scan, self.light.get()) else { return };
        let count = usize::from(scan.lines);
        let lines = memory.lines.get(..count).unwrap_or(&[]);
        let Some(across) = peak::find(lines) else {
            let dark = scan.outcome.status & status::LIGHT == 0;
            return self.fail_scan(if dark { NO_LIGHT } else { "fewer than three lines with a maximum" });
        };
        let (x, sigma) = along(memory, count, across.x);
        self.peak_found([x, across.x, 0], &across, [sigma, across.sigma.unwrap_or(0), 0]);
    }

    /// A climb has ended.
    pub(super) fn climbed(&mut self) {
        let Some(scan) = &self.scan else { return };
        let (climb, step) = (scan.climb, scan.climb.step.unsigned_abs());
        self.found(climb.best, climb.level, [step; SCAN_AXES]);
    }

    /// The threshold was reached, and the scan ends there.
    pub(super) fn found_light(&mut self) {
        let Some(scan) = &mut self.scan else { return };
        let place = scan.first.unwrap_or_default();
        let level = scan.best.0;
        scan.outcome.status &= !status::SATURATED;
        self.found(place, level, [0; SCAN_AXES]);
    }

    /// Something was found; whether it is light is still to be seen.
    fn found(&mut self, place: [i32; SCAN_AXES], level: i32, sigma: [u32; SCAN_AXES]) {
        let Some(scan) = &mut self.scan else { return };
        let light = scan.outcome.status & status::LIGHT != 0;
        if scan.outcome.status & status::SATURATED != 0 {
            return self.fail_scan("power saturated");
        }
        if !light || level <= DARK || scan.definition.end == End::First && scan.first.is_none() {
            return self.fail_scan(NO_LIGHT);
        }
        if scan.definition.end != End::First {
            scan.outcome.status |= status::PEAK;
        }
        (scan.outcome.level, scan.outcome.sigma) = (level, sigma);
        scan.set_position(place);
        self.conclude();
    }

    /// A scan that has found nothing goes back to where it began.
    pub(super) fn fail_scan(&mut self, why: &'static str) {
        let Some(scan) = &mut self.scan else { return };
        scan.fails = Some(Error::text(ErrorNumber::ScanFailed, why));
        if scan.best.0 > i32::MIN {
            // the greatest sample, for whoever wants to look there again
            let (level, place) = scan.best;
            scan.outcome.level = level;
            scan.set_position(place);
        }
        self.conclude();
    }

    /// Goes to where the scan ends.
    pub(super) fn conclude(&mut self) {
        let Some(scan) = &mut self.scan else { return };
        scan.over = true;
        scan.phase = Phase::Going(Next::Over);
        scan.ways = Default::default();
        let scan = *scan;
        let definition = &scan.definition;
        let mut offsets = [0; SCAN_AXES];
        let mut downwards = Self::sides(definition);
        match (scan.fails, definition.end) {
            (Some(_), _) | (None, End::Start) => {}
            (None, End::Stay) => {
                self.refresh();
                return;
            }
            (None, End::Peak | End::First) => {
                for (axis, offset) in definition.axes().zip(&mut offsets) {
                    let i = axis.index();
                    *offset = i64::from(scan.outcome.position[i]) - i64::from(scan.start.0[i]);
                }
                if definition.kind == Kind::Hill {
                    downwards = scan.climb.downwards;
                }
            }
        }
        let before = Self::offset_pose(&scan, self.before(definition, offsets, downwards));
        if let Some(running) = &mut self.scan {
            running.ways = [Some(before), Some(Self::offset_pose(&scan, offsets)), None];
        }
        self.refresh();
    }
}

impl super::Scan {
    /// Position of the result by offsets.
    fn set_position(&mut self, place: [i32; SCAN_AXES]) {
        for (axis, offset) in self.definition.axes().zip(place) {
            self.outcome.position[axis.index()] = self.start.0[axis.index()].saturating_add(offset);
        }
    }
}

const NO_LIGHT: &str = "no light above the threshold";

/// Where the peaks of lines lie on them at a place across: a straight line by least squares, with the uncertainty of the
/// peak of the nearest line.
fn along(memory: &LightMemory, count: usize, across: i32) -> (i32, u32) {
    let pairs = || memory.lines.iter().zip(&memory.peaks).take(count).map(|(line, peak)| (line.0, peak));
    let n = count.max(1) as i64;
    let (mut sum_y, mut sum_x) = (0i64, 0i64);
    for (y, peak) in pairs() {
        (sum_y, sum_x) = (sum_y + i64::from(y), sum_x + i64::from(peak.x));
    }
    let (mean_y, mean_x) = (sum_y.wrapping_div(n), sum_x.wrapping_div(n));
    let (mut squares, mut products) = (0i128, 0i128);
    let mut nearest = (u32::MAX, 0);
    for (y, peak) in pairs() {
        let dy = i128::from(i64::from(y) - mean_y);
        squares += dy * dy;
        products += dy * i128::from(i64::from(peak.x) - mean_x);
        nearest = nearest.min((y.abs_diff(across), peak.sigma));
    }
    let slope = wide::signed_div(products * i128::from(i64::from(across) - mean_y), squares.max(1));
    ((mean_x + slope as i64).clamp(i32::MIN.into(), i32::MAX.into()) as i32, nearest.1)
}
