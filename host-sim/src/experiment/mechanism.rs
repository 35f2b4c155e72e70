//! What has kept a climb from its peak, told from the truth of the twin.

use super::climb::{Log, Probe};
use serde::Serialize;

/// Driven sides that are less than this past a place have not passed it: half a step of the motor, nm.
const STOOD_NM: f64 = 25.0;

/// What has kept a climb from its peak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Mechanisms {
    /// A step in the last pass did not get past the best place, and it would have gained if it had, or the other direction
    /// would have, which was not tried because the noise took it for a gain.
    pub trapped_in_play: bool,
    /// An angle was judged by the way of the fibre point instead of the turn.
    pub pivot_confounding: bool,
}

impl Mechanisms {
    /// In words.
    pub const fn words(self) -> &'static str {
        match (self.trapped_in_play, self.pivot_confounding) {
            (false, false) => "none",
            (true, false) => "trapped in play",
            (false, true) => "pivot confounding",
            (true, true) => "trapped in play, pivot confounding",
        }
    }
}

/// Loss of the light that the climb looks at, dB, at a tick and true poses (nm, nrad).
pub type Loss<'a> = &'a dyn Fn(u64, &[[f64; 6]; 2]) -> f64;

/// Judges a climb. Gains of less than `noise_db` do not count: nobody could see them.
pub fn mechanisms(log: &Log, loss: Loss<'_>, noise_db: f64) -> Mechanisms {
    let last: Vec<&Probe> = log.last_lateral().collect();
    Mechanisms {
        trapped_in_play: last
            .iter()
            .any(|probe| is_trapped(probe, loss, noise_db) || is_fooled(probe, &last, loss, noise_db)),
        pivot_confounding: log.turns().any(|probe| is_confounded(probe, loss, noise_db)),
    }
}

/// A step in x or y that was given up because its driven side stayed on the wrong side of the best place.
pub fn is_trapped(probe: &Probe, loss: Loss<'_>, noise_db: f64) -> bool {
    !probe.taken && stood(probe) && free_gain(probe, probe.way, loss) > noise_db
}

/// A step in x or y that moved nothing and was taken all the same, for the noise, so that the other direction, which would
/// have gained, was not tried in this pass.
pub fn is_fooled(probe: &Probe, pass: &[&Probe], loss: Loss<'_>, noise_db: f64) -> bool {
    let other_way = |other: &&Probe| other.at == probe.at && other.way * probe.way < 0.0;
    probe.taken && stood(probe) && free_gain(probe, -probe.way, loss) > noise_db && !pass.iter().any(other_way)
}

/// The motor turned, but the driven side did not get past the best place.
fn stood(probe: &Probe) -> bool {
    let (side, axis) = (probe.at.side.index(), probe.at.axis.index());
    let motor = f64::from(probe.after.motors[side][axis] - probe.before.motors[side][axis]);
    let passed = (probe.after.driven[side][axis] - probe.best.driven[side][axis]) * probe.way.signum();
    motor * probe.way > 0.0 && passed <= STOOD_NM
}

/// What a step of so many um from the best place would gain if nothing were lost on the way, dB.
fn free_gain(probe: &Probe, way: f64, loss: Loss<'_>) -> f64 {
    let mut free = probe.best.poses;
    free[probe.at.side.index()][probe.at.axis.index()] += 1e3 * way;
    loss(probe.best.tick, &probe.best.poses) - loss(probe.best.tick, &free)
}

/// A turn that was given up although it gains about the fibre point, or taken although it loses.
pub fn is_confounded(probe: &Probe, loss: Loss<'_>, noise_db: f64) -> bool {
    let side = probe.at.side.index();
    let mut held = probe.best.poses;
    held[side][3..].copy_from_slice(&probe.after.poses[side][3..]);
    let gain = loss(probe.best.tick, &probe.best.poses) - loss(probe.best.tick, &held);
    if probe.taken { gain < -noise_db } else { gain > noise_db }
}

/// Farthest that the fibre point of a side was carried sideways between the beginning of the angle climb and any of its
/// readings, um.
pub fn carried_um(log: &Log) -> f64 {
    let Some(first) = log.turns().next().map(|probe| probe.before) else { return 0.0 };
    let way = |probe: &Probe| {
        let side = probe.at.side.index();
        let [a, b] = [first, probe.after].map(|snapshot| snapshot.poses[side]);
        1e-3 * (b[0] - a[0]).hypot(b[1] - a[1])
    };
    log.turns().map(way).fold(0.0, f64::max)
}
