//! The samples of a scan: means, and where they were taken.

use super::{Phase, Scan};
use crate::controller::front::Front;
use crate::refill::border::Sample;
use crate::scan::{END, Kind, NUMBER, SCAN_AXES, THRESHOLD, end, status};
use crate::sense::{FULL_SCALE, Reading};
use crate::units::Pose;

/// Samples on their way to a mean.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    count: u16,
    sum: u32,
    /// Counts of the leg's motor.
    steps: i64,
    saturated: bool,
    /// Offset and segment of the first and of the last sample of the leg.
    ends: Option<[(i32, u64); 2]>,
}

impl Block {
    /// None.
    pub const NONE: Block = Block { count: 0, sum: 0, steps: 0, saturated: false, ends: None };

    /// Samples so far.
    pub fn count(&self) -> u16 {
        self.count
    }

    fn add(&mut self, code: u16, steps: i32) {
        self.count += 1;
        self.sum += u32::from(code);
        self.steps += i64::from(steps);
        self.saturated |= code >= FULL_SCALE;
    }

    /// Begins a new mean.
    fn clear(&mut self) {
        *self = Block { ends: self.ends, ..Block::NONE };
    }

    /// How far the leg went in a time, by its own samples; nm or nrad.
    pub fn way_in(&self, ns: u32) -> Option<i32> {
        let [(from, first), (to, last)] = self.ends?;
        let time = (last - first) as i64 * crate::units::SEGMENT_NS as i64;
        // at most 2^31 nm by a tenth of a second: far below 2^63
        (i64::from(to) - i64::from(from)).checked_mul(ns.into())?.checked_div(time).map(|way| way as i32)
    }
}

impl Front {
    /// A sample; true when a scan uses it.
    pub(in crate::controller::front) fn scan_sample(&mut self, sample: &Sample, lost: bool) -> bool {
        let Some(scan) = self.light.scan_mut() else { return false };
        let channel = scan.definition.channel();
        let code = sample.power.get(channel).copied().unwrap_or(0);
        let steps = sample.steps.0.get(usize::from(scan.leg.motor)).copied().unwrap_or(0);
        let settings = &self.settings.sense[channel];
        match scan.phase {
            Phase::Settling => {
                let used = sample.played >= scan.since && sample.taking_up == 0 && scan.block.count < settings.average;
                if used {
                    scan.block.add(code, steps);
                }
                used
            }
            Phase::Sampling | Phase::Draining => {
                let leg = &scan.leg;
                let offset = leg.offset(i64::from(steps) << 32) - leg.lag;
                // how long it rests before and behind is a matter of when the thread hears of it; what is late may still
                // be of the way before
                let late = scan.phase == Phase::Sampling && sample.played < scan.since;
                let moves = sample.moving | sample.taking_up != 0 && !late;
                let within = moves && leg.sign() * (offset - leg.from) >= 0 && leg.sign() * (leg.to - offset) >= 0;
                if lost && within {
                    scan.outcome.status |= status::LOST;
                }
                // where the stage is, its own motor says but while it takes up play: other motors that reverse meanwhile
                // leave their part of the stage where it was; of a spiral the place is known to its step alone
                let unsure = sample.taking_up >> leg.motor & 1 != 0 && scan.definition.kind != Kind::Spiral;
                if lost || !within || unsure {
                    scan.block.clear();
                }
                if !within || unsure {
                    return false;
                }
                scan.block.add(code, steps);
                let here = (offset, sample.played);
                scan.block.ends = Some([scan.block.ends.map_or(here, |ends| ends[0]), here]);
                if scan.block.count >= settings.average {
                    let (mean, block) = (scan.block, &mut scan.block);
                    block.clear();
                    let steps_q32 = crate::units::wide::signed_div(i128::from(mean.steps) << 32, mean.count.into());
                    let offset = scan.leg.offset(steps_q32 as i64) - scan.leg.lag;
                    let reading = settings.reading(mean.sum, mean.count, mean.saturated);
                    self.leg_sample(offset, reading);
                }
                true
            }
            _ => false,
        }
    }

    /// A mean of a leg.
    #[inline(never)]
    fn leg_sample(&mut self, offset: i32, reading: Reading) {
        let Some(memory) = self.light.get_mut() else { return };
        let scan = &mut memory.scan;
        let (along, beside) = (offset, scan.leg.beside);
        scan.note(reading, if scan.leg.along == 0 { [along, beside, 0] } else { [beside, along, 0] });
        memory.samples.push((along, reading.level()));
        // the light of the end of a leg may come when it is over
        if scan.definition.values[END] == end::FIRST && scan.outcome.status & status::LIGHT != 0 {
            scan.phase = Phase::Crossing;
            self.planner.stop_coordinated();
        }
    }

    /// The mean at a point at rest is complete.
    #[inline(never)]
    pub(super) fn measured(&mut self) {
        let at = self.position();
        let Some(memory) = self.light.get_mut() else { return };
        let scan = &mut memory.scan;
        let definition = &scan.definition;
        let block = &scan.block;
        let reading = self.settings.sense[definition.channel()].reading(block.sum, block.count, block.saturated);
        let mut place = [0; SCAN_AXES];
        for (axis, place) in definition.axes().iter().zip(&mut place) {
            let of = |pose: &Pose| pose.0.get(usize::from(*axis)).copied().unwrap_or(0);
            *place = of(&at).wrapping_sub(of(&scan.start));
        }
        scan.note(reading, place);
        memory.samples.push((place[0], reading.level()));
        scan.index += 1;
        let definition = &scan.definition;
        let climbs = definition.kind == Kind::Hill;
        // by where it was sent, not by where the nearest step is: nothing may add up
        let goes_on = if climbs {
            scan.climb.measured(definition, reading.level())
        } else {
            scan.index < definition.values[NUMBER]
        };
        if definition.values[END] == end::FIRST && scan.outcome.status & status::LIGHT != 0 {
            self.found_light();
        } else if goes_on && !(climbs && reading == Reading::High) {
            self.begin_part();
        } else if climbs {
            self.climbed();
        } else {
            self.line_found();
        }
    }
}

impl Scan {
    /// Counts a mean and remembers the greatest and the first one with light.
    #[inline(never)]
    fn note(&mut self, reading: Reading, place: [i32; SCAN_AXES]) {
        let level = reading.level();
        self.outcome.samples += 1;
        if reading == Reading::High {
            self.outcome.status |= status::SATURATED;
        }
        if level > self.best.0 {
            self.best = (level, place);
        }
        if level >= self.definition.values[THRESHOLD].wrapping_mul(1000) && reading != Reading::Low {
            if self.outcome.status & status::LIGHT == 0 {
                self.first = place;
            }
            self.outcome.status |= status::LIGHT;
        }
    }
}
