//! The light: what the power inputs said at the last borders, and what is recorded of it.

#[cfg(target_os = "none")]
use super::LightMemory;
use super::{Abort, Front};
use crate::error::{Error, ErrorNumber};
use crate::refill::border::{POWER_INPUTS, Sample};
use crate::sense::{FULL_SCALE, Reading, SenseSettings};
use crate::trace::{Record, Source, State, Told, Trace};
use crate::units::SEGMENT_NS;
use core::task::Poll;

/// Samples that may be late: what is asked at rest waits for no older ones.
const RECENT: u64 = 64;

/// How answers with records are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// As text.
    #[default]
    Ascii,
    /// As definite blocks.
    Packed,
}

/// What begins an armed recording or a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trigger {
    /// Nothing: it begins at once.
    #[default]
    Immediate,
    /// `*TRG`.
    Bus,
}

/// What is known of the light.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sense {
    latest: Option<Sample>,
    /// Place of the latest sample in the memory.
    newest: u8,
    /// Samples in the memory.
    count: u16,
    /// Samples at the same counts, the latest ones.
    still: u32,
    /// Bit n: input n was read, or is scanned.
    pub watched: u8,
    pub trace: Trace,
    pub format: Format,
    pub trigger: Trigger,
}

/// Samples that pass until light that is seen now has come from where the stage stands.
pub(super) fn late_segments(settings: &SenseSettings) -> u64 {
    u64::from(settings.delay_ns).div_ceil(SEGMENT_NS)
}

impl Front {
    /// Lends the memory of samples, scans and recordings.
    #[cfg(target_os = "none")]
    pub fn lend(&mut self, memory: &'static mut LightMemory) {
        self.light.lend(memory);
    }

    /// A sample of the board, in the order in which they were taken.
    pub fn receive_sample(&mut self, sample: Sample) {
        let sense = &mut self.sense;
        let still = sense.latest.is_some_and(|last| last.counts == sample.counts);
        sense.still = if still { sense.still.saturating_add(1) } else { 0 };
        let lost = sense.latest.is_some_and(|last| sample.played != last.played + 1);
        sense.latest = Some(sample);
        sense.newest = sense.newest.wrapping_add(1);
        if let Some(memory) = self.light.get_mut() {
            sense.count = (sense.count + 1).min(memory.latest.len() as u16);
            if let Some(place) = memory.latest.get_mut(usize::from(sense.newest)) {
                *place = sample.power;
            }
        }
        let used = self.scan_sample(&sample, lost);
        let sense = &mut self.sense;
        if sense.trace.state == State::Running
            && (used || sense.trace.source == Source::Border)
            && let Some(memory) = self.light.get_mut()
        {
            sense.trace.push(&mut memory.records, &sample);
        }
    }

    /// The sample that was taken last.
    pub fn latest_sample(&self) -> Option<&Sample> {
        self.sense.latest.as_ref()
    }

    /// The samples so far say nothing of the light now.
    pub(super) fn forget_samples(&mut self) {
        (self.sense.latest, self.sense.count) = (None, 0);
    }

    /// Settings of an input, 0 or 1.
    pub fn sense_settings(&self, channel: usize) -> &SenseSettings {
        &self.settings.sense[channel & 1]
    }

    /// Puts settings of an input, 0 or 1, in force; a scan that was stopped cannot go on with others.
    ///
    /// # Errors
    /// -213 while a scan runs.
    pub fn set_sense(&mut self, channel: usize, settings: &SenseSettings) -> Result<(), Error> {
        self.not_scanning()?;
        self.forget_stopped_scan();
        self.settings.sense[channel & 1] = *settings;
        Ok(())
    }

    /// Mean of the latest samples of an input: none before the first one, and while the emergency stop is latched, in which
    /// none are taken. At rest those alone count that were taken since
    /// the motors stand and the meter has followed: pending until there are enough of them.
    pub fn read_power(&mut self, channel: usize) -> Poll<Option<Reading>> {
        self.sense.watched |= 1 << (channel & 7);
        let settings = &self.settings.sense[channel & 1];
        // what was seen before a stop says nothing of now
        let Some(latest) = self.sense.latest.filter(|_| !self.is_stopped()) else { return Poll::Ready(None) };
        let comes = self.report.played.saturating_sub(latest.played) < RECENT;
        if comes && !self.is_moving() && self.abort == Abort::None {
            let wanted = u64::from(settings.average) + late_segments(settings);
            if u64::from(self.sense.still) < wanted {
                return Poll::Pending;
            }
        }
        let mean = self.mean(channel, settings.average);
        Poll::Ready(mean.map(|(sum, count, saturated)| settings.reading(sum, count, saturated)))
    }

    /// Sum of the latest samples of an input, how many they are, and whether one of them is saturated.
    fn mean(&self, channel: usize, average: u16) -> Option<(u32, u16, bool)> {
        let memory = self.light.get()?;
        let count = average.min(self.sense.count);
        let (mut sum, mut saturated) = (0, false);
        for age in 0..count {
            let place = self.sense.newest.wrapping_sub(age as u8);
            let code = memory.latest.get(usize::from(place))?.get(channel).copied()?;
            sum += u32::from(code);
            saturated |= code >= FULL_SCALE;
        }
        (count > 0).then_some((sum, count, saturated))
    }

    /// The latest sample of an input that was read or is scanned is out of range.
    pub fn power_out_of_range(&self) -> bool {
        let Some(sample) = &self.sense.latest else { return false };
        (0..POWER_INPUTS).filter(|n| self.sense.watched >> n & 1 != 0).any(|n| {
            let code = sample.power.get(n).copied().unwrap_or(0);
            let reading = self.sense_settings(n).reading(code.into(), 1, code >= FULL_SCALE);
            !matches!(reading, Reading::Level(_))
        })
    }

    // ---- recordings ----

    /// How records are answered.
    pub fn format(&self) -> Format {
        self.sense.format
    }

    /// Chooses how records are answered.
    pub fn set_format(&mut self, format: Format) {
        self.sense.format = format;
    }

    /// What begins a scan or a recording.
    pub fn trigger_source(&self) -> Trigger {
        self.sense.trigger
    }

    /// Chooses what begins a scan or a recording.
    pub fn set_trigger_source(&mut self, trigger: Trigger) {
        self.sense.trigger = trigger;
    }

    /// The recording.
    pub fn trace(&self) -> &Trace {
        &self.sense.trace
    }

    /// Which samples are recorded; ends a recording, what it has kept stays.
    pub fn configure_trace(&mut self, source: Source, skip: u16) {
        let trace = &mut self.sense.trace;
        (trace.source, trace.skip, trace.state) = (source, skip, State::Idle);
    }

    /// Begins a recording, or lets it wait for its trigger; what was kept is forgotten.
    ///
    /// # Errors
    /// -213 while one runs.
    pub fn arm_trace(&mut self) -> Result<(), Error> {
        if self.sense.trace.state == State::Running {
            return Err(Error::text(ErrorNumber::InitIgnored, "trace running; TRAC:CONF or ABOR ends it"));
        }
        let waits = self.sense.trigger == Trigger::Bus;
        self.sense.trace.arm(if waits { State::Armed } else { State::Running });
        Ok(())
    }

    /// A record; zeros where there is none.
    pub fn trace_record(&self, n: u16) -> Told {
        self.light.get().and_then(|memory| self.sense.trace.told(&memory.records, n)).unwrap_or_default()
    }

    /// `*TRG`: begins what waits for it.
    ///
    /// # Errors
    /// -211 when nothing does; those of [`Front::start_scan`].
    pub fn trigger(&mut self) -> Result<(), Error> {
        let traced = self.sense.trace.state == State::Armed;
        if traced {
            self.sense.trace.state = State::Running;
        }
        if self.trigger_scan()? || traced { Ok(()) } else { Err(ErrorNumber::TriggerIgnored.into()) }
    }

    /// A scan or a recording waits for its trigger.
    pub fn awaits_trigger(&self) -> bool {
        self.sense.trace.state == State::Armed || self.scan_is_armed()
    }

    /// ABORt ends a recording; what it has kept stays.
    pub(super) fn abort_trace(&mut self) {
        self.sense.trace.state = State::Idle;
    }

    /// `*RST`: no scan is defined, nothing is recorded.
    pub(super) fn reset_sense(&mut self) {
        self.settings.sense.iter_mut().for_each(SenseSettings::reset);
        let sense = &mut self.sense;
        (sense.trace, sense.format, sense.trigger, sense.watched) = Default::default();
        if let Some(memory) = self.light.get_mut() {
            memory.kept.iter_mut().for_each(|kept| (kept.definition.defined, kept.outcome.status) = (false, 0));
        }
    }
}

const _: () = assert!(size_of::<Record>() * crate::trace::RECORDS == 32 * 1024);
