//! What a hand can do at the stage (press the emergency stop, bring a driver into fault) and at the bench (break a fibre,
//! turn the laser).

use crate::bench_twin::Bench;
use crate::board::Board;
use std::str::FromStr;

/// What the words are, for a message that refuses others.
const WORDS: &str = "`stop open`, `stop closed`, `fault <1..6> on` or `fault <1..6> off`";

/// Something done to the stage, not over a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// The contact of the emergency stop opens or closes.
    Stop(bool),
    /// The driver of a motor (from 0) reports a fault, or no longer.
    Fault(usize, bool),
}

impl FromStr for Control {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let words: Vec<_> = text.split_whitespace().collect();
        let refused = || format!("{text:?} is none of {WORDS}");
        match words.as_slice() {
            ["stop", "open"] => Ok(Control::Stop(true)),
            ["stop", "closed"] => Ok(Control::Stop(false)),
            ["fault", motor, state @ ("on" | "off")] => match motor.parse() {
                Ok(n @ 1..=6) => Ok(Control::Fault(n - 1, *state == "on")),
                _ => Err(refused()),
            },
            _ => Err(refused()),
        }
    }
}

impl Control {
    /// Does it.
    pub fn apply(self, board: &mut Board) {
        match self {
            Control::Stop(open) => board.press_stop(open),
            Control::Fault(motor, active) => board.set_fault(motor, active),
        }
    }
}

/// What the words at a bench are beside those.
const BENCH_WORDS: &str = "`laser off`, `laser <dBm>`, `fibre <1..8> broken` or `fibre <1..8> whole`";
/// Power of a laser that is not dangerous to the model, dBm.
const LASER_DBM: std::ops::RangeInclusive<f64> = -100.0..=30.0;

/// Something done to the light of a bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightControl {
    /// Power in the input fibre, dBm; none is off.
    Laser(Option<f64>),
    /// A fibre of the array (from 0) is broken, or whole again.
    Fibre(usize, bool),
}

impl FromStr for LightControl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let words: Vec<_> = text.split_whitespace().collect();
        let refused = || format!("{text:?} is none of {BENCH_WORDS}");
        match words.as_slice() {
            ["laser", "off"] => Ok(LightControl::Laser(None)),
            ["laser", level] => match level.parse() {
                Ok(dbm) if LASER_DBM.contains(&dbm) => Ok(LightControl::Laser(Some(dbm))),
                _ => Err(format!("laser {level}: must be off, or -100 to 30 dBm")),
            },
            ["fibre", fibre, state @ ("broken" | "whole")] => match fibre.parse() {
                Ok(n @ 1..=8) => Ok(LightControl::Fibre(n - 1, *state == "broken")),
                _ => Err(refused()),
            },
            _ => Err(refused()),
        }
    }
}

impl LightControl {
    /// Does it.
    pub fn apply(self, bench: &mut Bench) {
        match self {
            LightControl::Laser(dbm) => bench.laser(dbm),
            LightControl::Fibre(fibre, broken) => bench.break_fibre(fibre, broken),
        }
    }
}

/// Something that a hand does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hand {
    /// At every stage.
    Stage(Control),
    /// At the bench, if there is one.
    Light(LightControl),
}

impl Hand {
    /// Reads what is done; the words of a bench only where there is one.
    ///
    /// # Errors
    /// What it is not, and what would be.
    pub fn parse(text: &str, bench: bool) -> Result<Self, String> {
        match text.split_whitespace().next() {
            Some("laser" | "fibre") if bench => text.parse().map(Hand::Light),
            _ if bench => text.parse().map(Hand::Stage).map_err(|why: String| format!("{why}, {BENCH_WORDS}")),
            _ => text.parse().map(Hand::Stage),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_hand_are_read_and_others_are_refused_with_what_is_allowed() {
        assert_eq!("stop open".parse(), Ok(Control::Stop(true)));
        assert_eq!(" fault 2 off ".parse(), Ok(Control::Fault(1, false)));
        for wrong in ["", "stop", "fault 0 on", "fault 7 on", "fault 2 perhaps", "stop open now"] {
            assert!(wrong.parse::<Control>().unwrap_err().contains(WORDS), "{wrong}");
        }
    }

    #[test]
    fn a_bench_has_words_of_its_own_and_a_stage_alone_has_not() {
        assert_eq!(Hand::parse("laser -3.5", true), Ok(Hand::Light(LightControl::Laser(Some(-3.5)))));
        assert_eq!(Hand::parse("fibre 8 broken", true), Ok(Hand::Light(LightControl::Fibre(7, true))));
        assert_eq!(Hand::parse("stop open", true), Ok(Hand::Stage(Control::Stop(true))));
        for (wrong, told) in [("laser 31", "-100 to 30"), ("laser NaN", "-100 to 30"), ("fibre 9 broken", "1..8")] {
            assert!(Hand::parse(wrong, true).unwrap_err().contains(told), "{wrong}");
            assert!(Hand::parse(wrong, false).unwrap_err().contains(WORDS), "{wrong}");
        }
        assert!(Hand::parse("light off", true).unwrap_err().contains(BENCH_WORDS));
    }
}
