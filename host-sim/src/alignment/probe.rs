//! Two coordinates at once: four readings tell where both have their peak.
//!
//! Light is lost on both sides independently, and near the peak of a Gaussian coupling every coordinate takes a parabola
//! in dB. So the levels at the middle and at three corners of a square give both slopes and the common bend.

use super::bus::Bus;
use super::program::Program;
use super::trouble::Trouble;
use crate::bench_twin::Side;
use stage_controller::units::Axis;

/// A coordinate of one of the stages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Knob {
    pub side: Side,
    pub axis: Axis,
}

/// What four readings have told; the stages stand at the last corner.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    knobs: [Knob; 2],
    step: f64,
    /// Levels of both inputs: middle and corners, dBm.
    seen: [[f64; 2]; 4],
    /// Of each input: where both coordinates have their peak, from the middle; none where there is none.
    pub peaks: [Option<[f64; 2]>; 2],
}

/// Farthest from a probe that a peak in x or y is believed, um: the last channel of an array that is 0.8 degrees rolled.
const MOST_UM: f64 = 25.0;
/// The same of an angle, degrees.
const MOST_DEG: f64 = 1.5;

/// Corners that are visited after the middle, in steps: each differs from the one before in as little as can be.
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]];

/// By how much the light of an input is lower a step aside in both coordinates than in the middle, on the mean of both
/// ways, dB.
fn bend_db(seen: &[[f64; 2]; 4], input: usize) -> f64 {
    let [middle, low, _, high] = seen.map(|levels| levels[input]);
    middle - 0.5 * (low + high)
}

impl Probe {
    fn new(knobs: [Knob; 2], step: f64, seen: [[f64; 2]; 4]) -> Self {
        let peak = |input: usize| {
            let [_, low, mixed, high] = seen.map(|levels| levels[input]);
            let bend = bend_db(&seen, input);
            // slope times step over twice the bend: bend is that of both coordinates
            let at = |rise: f64| 0.5 * step * rise / bend;
            (bend > 0.0).then(|| [at(mixed - low), at(high - mixed)])
        };
        Probe { knobs, step, seen, peaks: [peak(0), peak(1)] }
    }

    /// Level of the first input in the middle, dBm.
    pub fn level_dbm(&self) -> f64 {
        self.seen[0][0]
    }

    /// By how much the light of an input is lower a step aside, dB.
    pub fn bend_db(&self, input: usize) -> f64 {
        bend_db(&self.seen, input)
    }

    /// From the last corner to the middle, for both stages.
    pub fn back(&self) -> [[f64; 6]; 2] {
        way(&self.knobs, [-self.step; 2])
    }
}

/// Displacements of both knobs as moves of both stages.
fn way(knobs: &[Knob; 2], by: [f64; 2]) -> [[f64; 6]; 2] {
    let mut moves = [[0.0; 6]; 2];
    for (knob, by) in knobs.iter().zip(by) {
        moves[knob.side.index()][knob.axis.index()] += by;
    }
    moves
}

impl<B: Bus> Program<'_, B> {
    /// Reads the light around here, `step` (um, degrees) to either side.
    pub(super) fn probe(&mut self, knobs: [Knob; 2], step: f64) -> Result<Probe, Trouble> {
        let mut seen = [[0.0; 2]; 4];
        let mut here = CORNERS[0];
        for (corner, seen) in CORNERS.into_iter().zip(&mut seen) {
            if corner != here {
                self.move_both(way(&knobs, [0, 1].map(|k| step * (corner[k] - here[k]))))?;
                here = corner;
            }
            *seen = self.calm_powers()?;
        }
        Ok(Probe::new(knobs, step, seen))
    }

    /// Goes where the first input has its peak; its level in the middle of the probe, dBm.
    pub(super) fn turn_to_peak(&mut self, knobs: [Knob; 2], step: f64) -> Result<f64, Trouble> {
        self.turn_past_peak(knobs, step, 1.0).map(|probe| probe.level_dbm())
    }

    /// Goes so many times as far as where the first input has its peak; what the probe has told.
    pub(super) fn turn_past_peak(&mut self, knobs: [Knob; 2], step: f64, times: f64) -> Result<Probe, Trouble> {
        let probe = self.probe(knobs, step)?;
        let peak = self.peak(&probe, 0)?;
        self.move_both(way(&knobs, peak.map(|peak| times * peak - step)))?;
        Ok(probe)
    }

    /// Where an input has its peak; only when there was light all around, and the peak is near enough to be believed.
    pub(super) fn peak(&self, probe: &Probe, input: usize) -> Result<[f64; 2], Trouble> {
        let levels_dbm = probe.seen.map(|levels| levels[input]);
        for level in levels_dbm {
            self.lit(input, level)?;
        }
        let (most, unit) = if probe.knobs[0].axis.is_rotary() { (MOST_DEG, "deg") } else { (MOST_UM, "um") };
        let near = probe.peaks[input].filter(|peak| peak.iter().all(|way| way.abs() <= most));
        near.ok_or_else(|| {
            let name = |knob: Knob| format!("{:?} of the {:?} side", knob.axis, knob.side).to_lowercase();
            Trouble::NoPeak {
                from: self.sees[input],
                around: probe.knobs.map(name).join(" and "),
                most: format!("{most} {unit}"),
                levels_dbm: levels_dbm.into(),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_readings_tell_both_peaks() {
        let knobs = Side::BOTH.map(|side| Knob { side, axis: Axis::X });
        let level = |a: f64, b: f64| -12.0 - 0.17 * ((a - 0.8).powi(2) + (b + 2.1).powi(2));
        let seen = CORNERS.map(|corner| [level(1.5 * corner[0], 1.5 * corner[1]), -1.0]);
        let probe = Probe::new(knobs, 1.5, seen);
        let [a, b] = probe.peaks[0].unwrap();
        assert!((a - 0.8).abs() < 1e-9 && (b + 2.1).abs() < 1e-9);
        assert_eq!(probe.peaks[1], None, "no bend, no peak");
        assert_eq!(probe.back()[1][0], -1.5);
    }
}
