//! What a scan concludes from its samples, and where it ends.

use super::{Next, Phase};
use crate::controller::front::light::LinePeak;
use crate::controller::front::{Front, LightMemory};
use crate::scan::peak::{self, Peak};
use crate::scan::real::Real;
use crate::scan::{END, Kind, RANGE, SCAN_AXES, STEP, end, status};
use crate::sense::DARK;

impl Front {
    /// All samples of a leg are there.
    #[inline(never)]
    pub(super) fn leg_done(&mut self) {
        let Some(kind) = self.light.scan().map(|scan| scan.definition.kind) else { return };
        let peak = if kind == Kind::Raster { self.line_peak() } else { None };
        let Some(memory) = self.light.get_mut() else { return };
        let scan = &mut memory.scan;
        if let Some(peak) = peak.filter(|peak| !peak.edge) {
            let n = usize::from(scan.lines);
            if let (Some(line), Some(place)) = (memory.lines.get_mut(n), memory.peaks.get_mut(n)) {
                *line = (scan.leg.beside, peak.level);
                *place = LinePeak { x: peak.x, sigma: peak.sigma.unwrap_or(0) };
                scan.lines += 1;
            }
        }
        scan.index += 1;
        if scan.index < scan.definition.legs() {
            return self.begin_part();
        }
        match kind {
            Kind::Line => self.line_found(),
            Kind::Raster => self.raster_found(),
            _ => {
                // the greatest sample: no better than the turns lie apart
                (scan.outcome.level, scan.place) = scan.best;
                let half = scan.definition.values[STEP].unsigned_abs() / 2;
                let reach = scan.definition.reach();
                self.best_found(half, reach);
            }
        }
    }

    /// The peak of the line in memory, where the stage was when the light was seen.
    fn line_peak(&mut self) -> Option<Peak> {
        let memory = self.light.get_mut()?;
        let scan = &memory.scan;
        let mut peak = peak::find(memory.samples.points_mut())?;
        if scan.leg.lag != 0 && scan.definition.kind != Kind::Parabola {
            // as fast as it really was
            let delay = self.settings.sense[scan.definition.channel()].delay_ns;
            let way = scan.block.way_in(delay).unwrap_or(scan.leg.lag);
            peak.x = peak.x.saturating_add(scan.leg.lag - way);
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

    #[inline(never)]
    fn peak_found(&mut self, place: [i32; SCAN_AXES], peak: &Peak, sigma: [u32; SCAN_AXES]) {
        let Some(scan) = self.light.scan_mut() else { return };
        if peak.strays {
            scan.outcome.status |= status::OUTLIERS;
        }
        (scan.place, scan.outcome.level, scan.outcome.sigma) = (place, peak.level, sigma);
        self.found(peak.edge);
    }

    /// All lines of a raster have been sampled: a parabola over their peaks, and a straight line through their places.
    fn raster_found(&mut self) {
        let Some(memory) = self.light.get_mut() else { return };
        let count = usize::from(memory.scan.lines);
        let Some(across) = peak::find(memory.lines.get_mut(..count).unwrap_or(&mut [])) else {
            let told = memory.scan.outcome.status;
            return self.fail_scan(match told & (status::LIGHT | status::SATURATED) {
                0 => NO_LIGHT,
                status::LIGHT => "fewer than three lines with a maximum",
                _ => TOO_MUCH,
            });
        };
        let (x, sigma) = along(memory, count, across.x);
        self.peak_found([x, across.x, 0], &across, [sigma, across.sigma.unwrap_or(0), 0]);
    }

    /// A climb has ended.
    pub(super) fn climbed(&mut self) {
        let Some(scan) = self.light.scan_mut() else { return };
        let climb = &scan.climb;
        if climb.is_cut_off() {
            return self.fail_scan("2000 points, no end");
        }
        // where it was sent, not where the nearest step is
        (scan.outcome.level, scan.place) = (climb.level, climb.best);
        let (step, reach) = (climb.step.unsigned_abs(), scan.definition.values[RANGE] / 2);
        self.best_found(step, reach);
    }

    /// The best of single places, each as good as `sigma`: what lies further out than the reach was not looked at.
    #[inline(never)]
    fn best_found(&mut self, sigma: u32, reach: i32) {
        let Some(scan) = self.light.scan_mut() else { return };
        scan.outcome.sigma = [sigma; SCAN_AXES];
        let edge = scan.place.iter().any(|x| x.unsigned_abs() + sigma > reach.unsigned_abs());
        self.found(edge);
    }

    /// The threshold was reached, and the scan ends there.
    pub(super) fn found_light(&mut self) {
        let Some(scan) = self.light.scan_mut() else { return };
        (scan.place, scan.outcome.level) = (scan.first, scan.best.0);
        scan.outcome.status &= !status::SATURATED;
        self.found(false);
    }

    /// Something was found, at the edge or within; whether it is light is still to be seen.
    #[inline(never)]
    fn found(&mut self, edge: bool) {
        let Some(scan) = self.light.scan_mut() else { return };
        let told = &mut scan.outcome.status;
        if *told & status::SATURATED != 0 {
            return self.fail_scan(TOO_MUCH);
        }
        if *told & status::LIGHT == 0 || scan.outcome.level <= DARK {
            return self.fail_scan(NO_LIGHT);
        }
        if edge {
            *told |= status::EDGE;
            return self.fail_scan("no maximum within the range");
        }
        if scan.definition.values[END] != end::FIRST {
            *told |= status::PEAK;
        }
        scan.tell_position();
        self.conclude();
    }

    /// A scan that has found nothing goes back to where it began.
    #[inline(never)]
    pub(super) fn fail_scan(&mut self, why: &'static str) {
        let Some(scan) = self.light.scan_mut() else { return };
        (scan.fails, scan.outcome.sigma) = (Some(why), [0; SCAN_AXES]);
        if scan.best.0 > i32::MIN {
            // the greatest sample, for whoever wants to look there again
            (scan.outcome.level, scan.place) = scan.best;
            scan.tell_position();
        } else {
            scan.fails = Some(NO_SAMPLES);
        }
        self.conclude();
    }

    /// Goes to where the scan ends.
    #[inline(never)]
    pub(super) fn conclude(&mut self) {
        let Some(scan) = self.light.scan_mut() else { return };
        scan.over = true;
        (scan.phase, scan.next) = (Phase::Going, Next::Over);
        scan.ways = [None; super::WAYS];
        let Some(scan) = self.light.scan() else { return };
        let definition = &scan.definition;
        let mut offsets = [0; SCAN_AXES];
        let mut downwards = u8::from(definition.is_negative());
        match (scan.fails, definition.values[END]) {
            (Some(_), _) | (None, end::START) => {}
            (None, end::STAY) => return self.refresh(),
            _ => {
                offsets = scan.place;
                if definition.kind == Kind::Hill {
                    downwards = scan.climb.downwards;
                }
            }
        }
        let ways = [Some(self.before(scan, offsets, downwards)), Some(Self::offset_pose(scan, offsets))];
        if let Some(running) = self.light.scan_mut() {
            running.ways = ways;
        }
        self.refresh();
    }
}

impl super::Scan {
    /// Position of the result by its offsets.
    fn tell_position(&mut self) {
        self.outcome.position = Front::offset_pose(self, self.place).0;
    }
}

pub(super) const NO_SAMPLES: &str = "no samples of the power inputs";
const NO_LIGHT: &str = "no light above the threshold";
const TOO_MUCH: &str = "power saturated";

/// Where the peaks of lines lie on them at a place across: a straight line by least squares, with the uncertainty of the
/// peak of the nearest line.
#[inline(never)]
fn along(memory: &LightMemory, count: usize, across: i32) -> (i32, u32) {
    let whole = |x: i32| Real::whole(x.into());
    let pairs = || memory.lines.iter().zip(&memory.peaks).take(count).map(|(line, peak)| (line.0, peak));
    let mean = |sum: i64| Real::whole(sum).over(Real::whole(count as i64));
    let mean_y = mean(pairs().map(|(y, _)| i64::from(y)).sum());
    let mean_x = mean(pairs().map(|(_, peak)| i64::from(peak.x)).sum());
    let (mut squares, mut products) = (Real::ZERO, Real::ZERO);
    let mut nearest = (u32::MAX, 0);
    for (y, peak) in pairs() {
        let dy = whole(y).minus(mean_y);
        squares = squares.plus(dy.times(dy));
        products = products.plus(dy.times(whole(peak.x)));
        nearest = nearest.min((y.abs_diff(across), peak.sigma));
    }
    let slope = products.over(squares);
    (mean_x.plus(slope.times(whole(across).minus(mean_y))).rounded(), nearest.1)
}
