//! Light that is a function of the motor counts alone, in integers: what the power inputs say in a session that is to be
//! repeated on another board to the last bit. The optics of the bench are in [`optics`](crate::optics).
//!
//! # Design
//! A spot is a paraboloid over the counts. A logarithmic meter sees a Gaussian beam so; behind a linear one it is no
//! beam, but a maximum all the same. Nothing depends on how a platform rounds: a right shift rounds down everywhere.

use crate::board::Board;
use serde::Deserialize;
use stage_controller::refill::border::POWER_INPUTS;
use stage_controller::sense::FULL_SCALE;
use stage_controller::units::AXES;

/// Right shift behind [`Spot::fall`].
pub const FALL_SHIFT: u32 = 20;

/// What one input sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spot {
    /// Sum of eight conversions where the light is greatest; what is above full scale, 32760, saturates.
    pub top: i32,
    /// Motor counts there.
    pub at: [i32; AXES],
    /// By how much the sum is less one count of each motor away from there, in 2^-20; it grows with the square.
    pub fall: [u32; AXES],
}

impl Spot {
    /// Sum of eight conversions at motor counts.
    pub fn sum(&self, counts: &[i32; AXES]) -> u16 {
        let squares = counts.iter().zip(&self.at).zip(&self.fall).map(|((count, at), fall)| {
            let away = i128::from(*count) - i128::from(*at);
            away * away * i128::from(*fall)
        });
        let less = squares.sum::<i128>() >> FALL_SHIFT;
        (i128::from(self.top) - less).clamp(0, FULL_SCALE.into()) as u16
    }
}

/// What both inputs see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// The spot of each input.
    pub input: [Spot; POWER_INPUTS],
}

impl Light {
    /// Reads a file (TOML).
    ///
    /// # Errors
    /// Where it is not as it should be: line, value and what was expected.
    pub fn parse(text: &str) -> Result<Light, String> {
        toml::from_str(text).map_err(|error| error.to_string())
    }

    /// Shines at the border that the board has just reached.
    pub fn shine(&self, board: &mut Board) {
        let counts = board.twin().motors().0;
        board.set_power(self.input.map(|spot| spot.sum(&counts)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "[[input]]\ntop = 30000\nat = [10, -20, 0, 0, 0, 0]\nfall = [1048576, 524288, 1, 0, 0, 0]\n\
                        [[input]]\ntop = 99999\nat = [0, 0, 0, 0, 0, 0]\nfall = [4294967295, 0, 0, 0, 0, 0]\n";

    #[test]
    fn a_spot_falls_with_the_square_of_the_counts_and_stays_within_the_scale() {
        let light = Light::parse(FILE).unwrap();
        let sums = |counts| light.input.map(|spot| spot.sum(&counts));
        assert_eq!(sums([10, -20, 0, 0, 0, 0]), [30_000, 0]);
        assert_eq!(sums([13, -20, 0, 0, 7, 7]), [30_000 - 9, 0]);
        // 4.5 and a millionth are 4, rounded down
        assert_eq!(sums([10, -17, 1, 0, 0, 0]), [30_000 - 4, 0]);
        assert_eq!(sums([i32::MIN, i32::MAX, i32::MIN, 0, 0, 0]), [0, 0]);
        assert_eq!(sums([0, 0, 0, 0, 0, 0]), [30_000 - 100 - 200, 32_760]);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (wrong, right, expected) in [
            ("top = bright", "top = 30000", "line 2"),
            ("at = [1, 2]", "at = [10, -20, 0, 0, 0, 0]", "line 3"),
            ("fell = 1", "fall = [1048576, 524288, 1, 0, 0, 0]", "fell"),
            ("fall = [-1, 0, 0, 0, 0, 0]", "fall = [1048576, 524288, 1, 0, 0, 0]", "line 4"),
        ] {
            let text = FILE.replacen(right, wrong, 1);
            assert_ne!(text, FILE);
            let error = Light::parse(&text).unwrap_err();
            assert!(error.contains(expected), "{wrong}: {error}");
        }
        assert!(Light::parse(&FILE[..FILE.rfind("[[").unwrap()]).is_err(), "both inputs are told of");
    }
}
