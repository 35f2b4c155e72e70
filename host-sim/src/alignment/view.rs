//! The light as a line of text that lives: time, level, the way it took, and where the stages stand.

use super::lab::Moment;
use std::collections::VecDeque;

/// Looks that a line shows.
const WIDTH: usize = 40;
/// Heights of a bar, from nothing to full.
const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
/// What is no light any more, dBm.
const DARK_DBM: f64 = -60.0;
/// What is full, dBm.
const BRIGHT_DBM: f64 = -8.0;

/// The last looks at a bench.
#[derive(Clone, Debug, Default)]
pub struct LiveLine {
    levels: VecDeque<f64>,
}

impl LiveLine {
    /// The line after another look.
    pub fn line(&mut self, moment: &Moment) -> String {
        if self.levels.len() == WIDTH {
            self.levels.pop_front();
        }
        self.levels.push_back(moment.levels_dbm[0]);
        let bars: String = self.levels.iter().map(|level| bar(*level)).collect();
        let place = |pose: &[i32; 6]| {
            let [x, y, z] = [0, 1, 2].map(|i| f64::from(pose[i]) * 1e-3);
            format!("{x:+8.2} {y:+8.2} {z:+8.2}")
        };
        let [input, output] = moment.poses.each_ref().map(place);
        let level = moment.levels_dbm[0].max(DARK_DBM);
        format!("{:7.2} s {level:7.2} dBm |{bars:<WIDTH$}| in {input}  out {output} um", moment.seconds)
    }
}

fn bar(level_dbm: f64) -> char {
    let share = ((level_dbm - DARK_DBM) / (BRIGHT_DBM - DARK_DBM)).clamp(0.0, 1.0);
    BARS[(share * (BARS.len() - 1) as f64).round() as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_shows_the_last_looks_and_never_grows() {
        let mut line = LiveLine::default();
        let at = |seconds: f64, level: f64| Moment { seconds, levels_dbm: [level, -90.0], poses: [[1500; 6]; 2] };
        let first = line.line(&at(0.0, -120.0));
        assert!(first.contains("-60.00 dBm") && first.contains("+1.50"), "{first}");
        let mut text = String::new();
        for n in 0..100 {
            text = line.line(&at(n as f64, -8.0));
        }
        assert_eq!(text.matches('█').count(), WIDTH);
        assert_eq!(text.chars().count(), first.chars().count());
    }
}
