//! Why an alignment has ended before its end, and where the stages stand then.

use super::bus::BusError;
use crate::bench_twin::{Sees, Side};
use std::fmt;

/// What has gone wrong. Levels in dBm, lengths in um.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Trouble {
    /// A controller, its link, or the bench.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// No light on either side, as wide as it was looked for.
    #[error(
        "no light from {} within {search_um} um of the start on the {} side: none of {least_dbm} dBm or more; is the \
         laser on, are both fibres whole and plugged in? If so, start nearer or look farther (option search_um)",
        light(*from), sides(searched)
    )]
    Nowhere {
        /// What was looked at.
        from: Sees,
        /// Where it was looked for.
        searched: Vec<Side>,
        /// To either side in x and y.
        search_um: f64,
        /// What counts as light.
        least_dbm: f64,
    },
    /// A light that was or should be there is not.
    #[error(
        "no light from {}: {level_dbm:.2} dBm at input {}, below {least_dbm} dBm; is this fibre broken or unplugged, \
         or the laser off?", light(*from), input + 1
    )]
    Dark {
        /// What the input looks at.
        from: Sees,
        /// Which, from 0.
        input: usize,
        /// What it reads.
        level_dbm: f64,
        /// What counts as light.
        least_dbm: f64,
    },
    /// More light than can be measured.
    #[error(
        "input {} is saturated by {}: take power from the laser, put an attenuator before the meter, or choose its less \
         sensitive range", input + 1, light(*from)
    )]
    Saturated {
        /// What the input looks at.
        from: Sees,
        /// Which, from 0.
        input: usize,
    },
    /// Two readings of a light that should stand still differ, again and again.
    #[error(
        "the light from {} does not stand still: {} and {} dBm one after the other at input {}, and no better for \
         {seconds:.1} s; is the laser steady, does a fibre or the bench move?",
        light(*from), pair_dbm[0], pair_dbm[1], input + 1
    )]
    Unsteady {
        /// What the input looks at.
        from: Sees,
        /// Which, from 0.
        input: usize,
        /// The last two.
        pair_dbm: [f64; 2],
        /// For how long.
        seconds: f64,
    },
    /// The light around here has no peak that could be believed.
    #[error(
        "no peak of {} within {most} of {around}: {levels_dbm:.2?} dBm at the places that were tried; begin nearer to \
         the light, and see that nothing but the stages moves", light(*from)
    )]
    NoPeak {
        /// What was looked at.
        from: Sees,
        /// Coordinates that were tried.
        around: String,
        /// As far as a peak would be believed, with its unit.
        most: String,
        /// What was seen.
        levels_dbm: Vec<f64>,
    },
    /// A turn takes the fibre aside: what the light says of angles is nothing.
    #[error(
        "a turn about {around} bends the light {times:.1} times as much as modes of these radii do: the fibre goes aside as \
         it turns, and how the faces stand is not told; nothing approaches the chip. Is the compensation on \
         (COMP:STATe ON) and the calibration that of this stage?"
    )]
    Astray {
        /// Coordinate of both sides.
        around: String,
        /// Against what the data sheets say.
        times: f64,
    },
    /// A stage has not come as much nearer as it went.
    #[error(
        "{side:?} side: the gap was {:.1} um and, {way_um:.1} um nearer, {:.1} um; nothing approaches the chip farther. \
         Does the chip move, does the stage go where it is told?", gaps_um[0], gaps_um[1]
    )]
    Way {
        /// Which side.
        side: Side,
        /// How far it went, um.
        way_um: f64,
        /// What was told before and after, um.
        gaps_um: [f64; 2],
    },
    /// The way to the chip is not known, and is not gone.
    #[error(
        "{side:?} side: how far the faces are apart is not told by {} dBm: {reason}; nothing approaches the chip. Is the \
         light at its peak, are mode radii, wavelength and index those of the data sheets?",
        retreats(seen)
    )]
    Gap {
        /// Which side.
        side: Side,
        /// Retreats in um and the levels there.
        seen: Vec<(f64, f64)>,
        /// What is wrong with them.
        reason: &'static str,
    },
}

/// Where a stage stands after an alignment that has ended early.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stand {
    /// At rest at this pose (um, degrees; as commanded).
    Rests([f64; 6]),
    /// At rest, and drawn back: it had been nearer to the chip.
    DrawnBack([f64; 6]),
    /// Nearer to the chip than where it was drawn back, which its controller now refuses to do.
    Near([f64; 6]),
    /// Its controller does not answer: it ends what it was told last, and rests there.
    Unknown,
    /// All its motors were stopped at once, because the faces have touched.
    Stopped,
}

/// An alignment that has ended before its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Ended {
    /// Why.
    pub trouble: Trouble,
    /// The last step that was done.
    pub after: Option<String>,
    /// Time from the beginning until it went wrong, s.
    pub seconds: f64,
    /// Where the stages stand.
    pub stands: [Stand; 2],
}

impl std::error::Error for Ended {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.trouble)
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let after = self.after.as_deref().unwrap_or("the start");
        write!(f, "{} ({:.1} s, after {after})", self.trouble, self.seconds)?;
        for (side, stand) in Side::BOTH.into_iter().zip(self.stands) {
            write!(f, "; {side:?} stage ")?;
            let place = |[x, y, z, ..]: [f64; 6]| format!("at X {x:.2}, Y {y:.2}, Z {z:.2} um");
            match stand {
                Stand::Rests(pose) => write!(f, "rests {}", place(pose))?,
                Stand::DrawnBack(pose) => write!(f, "drawn back, rests {}", place(pose))?,
                Stand::Near(pose) => {
                    write!(f, "rests near the chip {}: draw it back along Z before anything turns", place(pose))?;
                }
                Stand::Unknown => write!(f, "unknown: it ends what it was told last, and rests there")?,
                Stand::Stopped => write!(f, "stopped where it was")?,
            }
        }
        Ok(())
    }
}

fn light(sees: Sees) -> String {
    match sees {
        Sees::Fibre(channel) => format!("fibre {} of the array", channel + 1),
        Sees::Detector => "the detector behind the chip".into(),
        Sees::Nothing => "an open switch".into(),
    }
}

fn sides(sides: &[Side]) -> String {
    sides.iter().map(|side| format!("{side:?}").to_lowercase()).collect::<Vec<_>>().join(" or the ")
}

fn retreats(seen: &[(f64, f64)]) -> String {
    seen.iter().map(|(back, level)| format!("{level:.2} at {back:.0} um back")).collect::<Vec<_>>().join(", ")
}
