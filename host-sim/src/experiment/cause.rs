//! Why a run has failed, told from the run itself: what the search said and after which of its steps, or where the stages
//! truly stood.

use super::mechanism::Mechanisms;
use crate::alignment::{BusError, Ended, Trouble};
use crate::bench_twin::{Bench, Optimum, Side};
use crate::optics::worst_db;
use serde::Serialize;

/// A run that ends farther from the optimum has failed, dB.
pub const NEAR_ENOUGH_DB: f64 = 0.5;
/// A robust search that takes longer has failed, s.
pub const IN_TIME_S: f64 = 20.0;
/// To either side of a place, um and rad: where the parabola of the loss is told.
const PROBE: [f64; 6] = [1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3];
/// Rounds over the coordinates: the loss in dB is a parabola of offsets and tilts, so that few are enough.
const ROUNDS: usize = 12;

/// How a run has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The search gave an error.
    Error,
    /// The faces have touched.
    Collision,
    /// More than 0.5 dB above the optimum.
    Far,
    /// A robust search that ended nearer to the chip than the working gap of the bench.
    Close,
    /// A robust search that took more than 20 s.
    Late,
}

impl Kind {
    /// In the order in which the tables have them.
    pub const ALL: [Kind; 5] = [Kind::Error, Kind::Collision, Kind::Far, Kind::Close, Kind::Late];

    /// Its name in tables.
    pub const fn words(self) -> &'static str {
        ["error", "collision", "> 0.5 dB", "too near", "> 20 s"][self as usize]
    }

    /// The run came to an end all the same.
    pub const fn has_ended(self) -> bool {
        !matches!(self, Kind::Error | Kind::Collision)
    }
}

/// A failure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Failure {
    /// How.
    pub kind: Kind,
    /// Why, in words without figures: for counting.
    pub cause: String,
    /// When: after or in which step, without figures; none of a run that came to an end.
    pub when: Option<String>,
    /// All that the search has said of it.
    pub error: Option<String>,
}

impl Failure {
    /// Of an alignment that has ended early.
    pub fn of_alignment(ended: &Ended) -> Self {
        let after = without_figures(ended.after.as_deref().unwrap_or("the start"));
        Self::early(&ended.trouble, format!("after \u{201c}{after}\u{201d}"))
    }

    /// Of a climb that has ended in a step of it.
    pub fn of_climb(error: BusError, step: &str) -> Self {
        Self::early(&error.into(), format!("in \u{201c}{step}\u{201d}"))
    }

    fn early(trouble: &Trouble, when: String) -> Self {
        let kind = if matches!(trouble, Trouble::Bus(BusError::Collision(_))) { Kind::Collision } else { Kind::Error };
        Failure { kind, cause: cause(trouble), when: Some(when), error: Some(trouble.to_string()) }
    }

    /// Of a run that came to its end.
    pub fn of_end(kind: Kind, cause: impl Into<String>) -> Self {
        Failure { kind, cause: cause.into(), when: None, error: None }
    }

    /// Cause and step.
    pub fn words(&self) -> String {
        self.when.as_ref().map_or_else(|| self.cause.clone(), |when| format!("{} {when}", self.cause))
    }
}

/// Why, without figures.
fn cause(trouble: &Trouble) -> String {
    let name = |side: Side| format!("{side:?}").to_lowercase();
    match trouble {
        Trouble::Bus(BusError::Collision(collision)) => {
            format!("the {} side was driven into the chip", name(collision.side))
        }
        Trouble::Bus(BusError::Silent { side, .. }) => format!("the {} controller did not answer", name(*side)),
        Trouble::Bus(BusError::Refused { side, error, .. }) => {
            format!("the {} controller refused: {}", name(*side), without_figures(error))
        }
        Trouble::Bus(BusError::Strange { side, .. }) => {
            format!("the {} controller answered what nobody asked", name(*side))
        }
        Trouble::Bus(BusError::Calibration { side, .. }) => {
            format!("the calibration of the {} side could not be loaded", name(*side))
        }
        Trouble::Bus(BusError::NoCommand { .. }) => "a set-up message was no command".into(),
        Trouble::Nowhere { .. } => "no light was found".into(),
        Trouble::Dark { .. } => "the light was lost".into(),
        Trouble::Saturated { .. } => "the meter was saturated".into(),
        Trouble::Unsteady { .. } => "the light did not stand still".into(),
        Trouble::NoPeak { around, .. } => format!("no peak that could be believed of {around}"),
        Trouble::Astray { around, .. } => {
            format!("a turn took the fibre aside, about {}", without_figures(around))
        }
        Trouble::Way { side, .. } => format!("the {} side did not come as near as it went", name(*side)),
        Trouble::Gap { side, reason, .. } => format!("the gap of the {} side was not told: {reason}", name(*side)),
    }
}

/// Words whose figures are dots, so that the same ones can be counted.
fn without_figures(text: &str) -> String {
    let mut words = String::new();
    for piece in text.split_inclusive(' ') {
        let figure =
            piece.starts_with(|c: char| c.is_ascii_digit() || c == '-') && piece.contains(|c: char| c.is_ascii_digit());
        let space = if piece.ends_with(' ') { " " } else { "" };
        words.push_str(&if figure { format!("\u{2026}{space}") } else { piece.into() });
    }
    words
}

/// What keeps the stages from the optimum, from where they truly stand (nm, nrad): what has to be mended until the worst
/// channel is within 0.5 dB of it.
pub fn what_is_left(bench: &Bench, tick: u64, poses: &[[f64; 6]; 2], optimum: &Optimum) -> &'static str {
    let worst = |poses: &_| worst_db(&bench.losses(tick, poses));
    let enough = |poses: &_| worst(poses) - optimum.worst_db <= NEAR_ENOUGH_DB;
    if enough(&mended(bench, tick, *poses, &[0, 1])) {
        "beside the peak in x and y"
    } else if enough(&mended(bench, tick, *poses, &[0, 1, 3, 4])) {
        "turned away in pitch and yaw"
    } else if enough(&mended(bench, tick, *poses, &[0, 1, 3, 4, 5])) {
        "turned away in roll"
    } else {
        "too far from the chip"
    }
}

/// The poses with some axes of both sides at the peak of the mean of all channels.
fn mended(bench: &Bench, tick: u64, mut poses: [[f64; 6]; 2], axes: &[usize]) -> [[f64; 6]; 2] {
    let loss = |poses: &_| {
        let losses = bench.losses(tick, poses);
        losses.iter().sum::<f64>() / losses.len() as f64
    };
    for _ in 0..ROUNDS {
        for side in 0..2 {
            for &axis in axes {
                let probe = PROBE[axis] * if axis < 3 { 1e3 } else { 1e9 };
                let here = poses[side][axis];
                let [low, middle, high] = [-probe, 0.0, probe].map(|way| {
                    poses[side][axis] = here + way;
                    loss(&poses)
                });
                let bend = low - 2.0 * middle + high;
                poses[side][axis] = if bend > 0.0 { here + 0.5 * probe * (low - high) / bend } else { here };
            }
        }
    }
    poses
}

/// What is left, and what the mechanism of the climb was.
pub fn with_mechanism(left: &str, mechanisms: Option<Mechanisms>) -> String {
    match mechanisms {
        Some(mechanisms) if mechanisms != Mechanisms::default() => format!("{left}; {}", mechanisms.words()),
        Some(_) => format!("{left}; no mechanism of the stage found"),
        None => left.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_step_is_the_same_whatever_its_figures() {
        let of = |gap: f64| without_figures(&format!("Output side: {gap:.1} um were left, now 12.5"));
        assert_eq!(of(31.2), of(8.0));
        assert_eq!(of(1.0), "Output side: \u{2026} um were left, now \u{2026}");
        assert_eq!(without_figures("pitch and yaw"), "pitch and yaw");
    }

    #[test]
    fn what_has_to_be_mended_is_named() {
        let bench = Bench::seeded(3, &crate::bench_twin::Options::default());
        let optimum = bench.optimum();
        let best = mended(&bench, 0, Side::BOTH.map(|side| bench.seat(side)), &[0, 1, 3, 4, 5]);
        let moved = |axis: usize, way: f64| {
            let mut poses = best;
            poses[1][axis] += way;
            // at the gap of the optimum, or as far back as wanted
            poses.iter_mut().for_each(|pose| pose[2] -= 12_000.0);
            what_is_left(&bench, 0, &poses, &optimum)
        };
        assert_eq!(moved(0, 3_000.0), "beside the peak in x and y");
        assert_eq!(moved(4, 3f64.to_radians() * 1e9), "turned away in pitch and yaw");
        assert_eq!(moved(5, 1f64.to_radians() * 1e9), "turned away in roll");
        assert_eq!(moved(2, -200_000.0), "too far from the chip");
    }
}
