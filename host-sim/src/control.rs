//! What a hand at the stage can do: press the emergency stop, bring a driver into fault.

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
}
