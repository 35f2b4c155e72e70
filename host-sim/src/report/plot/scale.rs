//! From values to places on paper: linear and logarithmic axes with round ticks.

/// An axis: which values it shows and where they lie in the drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    domain: [f64; 2],
    range: [f64; 2],
    logarithmic: bool,
}

/// Way between two ticks that an axis is aimed at.
const TICK_DISTANCE: f64 = 50.0;
/// The same between decades, whose names are short.
const DECADE_DISTANCE: f64 = 22.0;

impl Scale {
    /// `domain` of values over `range` of the drawing, widened where it is empty.
    pub fn linear(domain: [f64; 2], range: [f64; 2]) -> Self {
        let [low, high] = domain;
        let domain = if high > low { domain } else { [low - 0.5, low + 0.5] };
        Scale { domain, range, logarithmic: false }
    }

    /// The same, widened so that zero lies inside and both ends are ticks.
    pub fn with_zero(domain: [f64; 2], range: [f64; 2]) -> Self {
        let [low, high] = Scale::linear([domain[0].min(0.0), domain[1].max(0.0)], range).domain;
        let step = round_step((high - low) / intervals(range));
        Scale::linear([(low / step).floor() * step, (high / step).ceil() * step], range)
    }

    /// Whole decades around positive values; what is smaller is drawn at the lower end.
    pub fn decades(domain: [f64; 2], range: [f64; 2]) -> Self {
        let low = domain[0].max(f64::MIN_POSITIVE).log10().floor();
        let high = domain[1].max(f64::MIN_POSITIVE).log10().ceil().max(low + 1.0);
        Scale { domain: [low, high], range, logarithmic: true }
    }

    /// Where a value lies, within the range.
    pub fn at(&self, value: f64) -> f64 {
        let v = if self.logarithmic { value.max(f64::MIN_POSITIVE).log10() } else { value };
        let share = (v.clamp(self.domain[0], self.domain[1]) - self.domain[0]) / (self.domain[1] - self.domain[0]);
        self.range[0] + share * (self.range[1] - self.range[0])
    }

    /// Round values along the axis and how they are written.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        let [low, high] = self.domain;
        if self.logarithmic {
            let step =
                ((high - low) * DECADE_DISTANCE / (self.range[1] - self.range[0]).abs()).ceil().max(1.0) as usize;
            return (low as i32..=high as i32)
                .step_by(step)
                .map(|power| {
                    (10f64.powi(power), if power < 0 { decimals(power) } else { format!("{:.0}", 10f64.powi(power)) })
                })
                .collect();
        }
        let step = round_step((high - low) / intervals(self.range));
        let digits = (-step.log10().floor()).max(0.0) as usize;
        let first = (low / step - 1e-9).ceil() as i64;
        let last = (high / step + 1e-9).floor() as i64;
        let written = |v: f64| format!("{:.*}", digits, v + 0.0).replace('-', "\u{2212}");
        (first..=last).map(|i| i as f64 * step).map(|v| (v, written(if v == 0.0 { 0.0 } else { v }))).collect()
    }
}

/// Ways between ticks for which there is room.
fn intervals(range: [f64; 2]) -> f64 {
    ((range[1] - range[0]).abs() / TICK_DISTANCE).clamp(2.0, 8.0)
}

fn decimals(power: i32) -> String {
    format!("{:.*}", power.unsigned_abs() as usize, 10f64.powi(power))
}

/// 1, 2 or 5 times a power of ten, not below `least`.
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|m| m * power)
        .into_iter()
        .find(|step| *step >= least * (1.0 - 1e-9))
        .unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::Scale;

    #[test]
    fn ticks_are_round_and_lie_in_the_domain() {
        for (low, high) in [(0.0, 1.0), (-5000.0, 5000.0), (-0.03, 0.07), (3.0, 3.0), (1e-9, 2e-9)] {
            let scale = Scale::linear([low, high], [0.0, 100.0]);
            let ticks = scale.ticks();
            assert!((2..=11).contains(&ticks.len()), "{low} {high}: {ticks:?}");
            for (value, _) in ticks {
                assert!((0.0..=100.0).contains(&scale.at(value)));
            }
        }
    }

    #[test]
    fn a_logarithmic_axis_holds_zero_at_its_lower_end() {
        let scale = Scale::decades([0.02, 30.0], [100.0, 0.0]);
        assert_eq!(scale.at(0.0), 100.0);
        assert_eq!(scale.at(100.0), 0.0);
        assert_eq!(scale.ticks().iter().map(|t| t.1.as_str()).collect::<Vec<_>>(), ["0.01", "0.1", "1", "10", "100"]);
    }
}
