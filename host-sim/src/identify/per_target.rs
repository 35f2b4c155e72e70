//! Least squares of runs: a mean for each target, the play and a drift. The means are eliminated in closed form, so
//! that a file of any number of targets takes one pass over its readings.

/// A column whose part that no other column gives is below this share of its length tells nothing.
const NOTHING: f64 = 1e-9;

/// Readings of runs: deviation = mean of the target + play on the way down + drift times hours. Without a 1 in `down`
/// there is no play among the unknowns.
pub(super) struct PerTarget {
    /// Number of targets.
    pub targets: usize,
    /// Which target each reading is of.
    pub place: Vec<usize>,
    /// 1 on the way down, else 0.
    pub down: Vec<f64>,
    /// Hours since the first reading, where a drift is fitted.
    pub hours: Option<Vec<f64>>,
    /// Measured less target, nm or nrad.
    pub deviation: Vec<f64>,
}

/// Solution of [`PerTarget`]; deviations in nm or nrad.
pub(super) struct Solved {
    /// Of each target, upwards and at the beginning.
    pub means: Vec<f64>,
    pub play: f64,
    /// Per hour; 0 where none is fitted.
    pub drift: f64,
    /// Standard deviation of the play per one of a reading of weight 1; infinite where there is none.
    pub play_sigma: f64,
    /// Measured less fitted of all readings, those of weight 0 included.
    pub left: Vec<f64>,
    /// Variance of what is fitted, per one of a reading of weight 1.
    pub leverage: Vec<f64>,
}

impl PerTarget {
    /// Unknowns: means, play and drift.
    pub(super) fn unknowns(&self) -> usize {
        self.targets + usize::from(self.has_play()) + usize::from(self.hours.is_some())
    }

    fn has_play(&self) -> bool {
        self.down.iter().any(|down| *down != 0.0)
    }

    /// Solution with these weights of the readings; none where they do not tell all unknowns.
    pub(super) fn solve(&self, weights: &[f64]) -> Option<Solved> {
        let mut sum = vec![0.0; self.targets];
        self.place.iter().zip(weights).for_each(|(place, weight)| sum[*place] += weight);
        if sum.iter().any(|sum| *sum <= 0.0) {
            return None;
        }
        let means = |values: &[f64]| {
            let mut means = vec![0.0; self.targets];
            for ((place, weight), value) in self.place.iter().zip(weights).zip(values) {
                means[*place] += weight * value / sum[*place];
            }
            means
        };
        let centred = |values: &[f64], means: &[f64]| -> Vec<f64> {
            values.iter().zip(&self.place).map(|(value, place)| value - means[*place]).collect()
        };
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).zip(weights).map(|((a, b), w)| w * a * b).sum::<f64>();
        let told = |part: f64, whole: f64| part > NOTHING * NOTHING * whole;

        let (deviation_means, down_means) = (means(&self.deviation), means(&self.down));
        let (deviation, down) = (centred(&self.deviation, &deviation_means), centred(&self.down, &down_means));
        // what is divided by it is nothing where there is no play
        let down_square = if self.has_play() { product(&down, &down) } else { f64::INFINITY };
        if self.has_play() && !told(down_square, product(&self.down, &self.down)) {
            return None;
        }
        let mut play = product(&down, &deviation) / down_square;
        let mut play_variance = if self.has_play() { 1.0 / down_square } else { f64::INFINITY };
        let mut drift = 0.0;
        let mut leverage: Vec<f64> = self.place.iter().map(|place| 1.0 / sum[*place]).collect();
        leverage.iter_mut().zip(&down).for_each(|(h, down)| *h += down * down / down_square);
        let mut target_means: Vec<f64> = deviation_means;
        if let Some(hours) = &self.hours {
            let hours_means = means(hours);
            let mut alone = centred(hours, &hours_means);
            // what the time tells beyond targets and direction
            let along = product(&down, &alone) / down_square;
            alone.iter_mut().zip(&down).for_each(|(hours, down)| *hours -= along * down);
            let square = product(&alone, &alone);
            if !told(square, product(hours, hours)) {
                return None;
            }
            drift = product(&alone, &deviation) / square;
            play -= drift * along;
            play_variance += along * along / square;
            leverage.iter_mut().zip(&alone).for_each(|(h, hours)| *h += hours * hours / square);
            target_means.iter_mut().zip(&hours_means).for_each(|(mean, hours)| *mean -= drift * hours);
        }
        target_means.iter_mut().zip(&down_means).for_each(|(mean, down)| *mean -= play * down);
        let left = (0..self.place.len()).map(|k| {
            let drifted = self.hours.as_ref().map_or(0.0, |hours| drift * hours[k]);
            self.deviation[k] - target_means[self.place[k]] - play * self.down[k] - drifted
        });
        let left = left.collect();
        Some(Solved { means: target_means, play, drift, play_sigma: play_variance.sqrt(), left, leverage })
    }
}

#[cfg(test)]
mod tests {
    use super::PerTarget;
    use crate::identify::least_squares::Rows;

    /// Runs that leave targets out, with times that are no rounder than those of a person's watch.
    fn uneven() -> PerTarget {
        let mut system = PerTarget { targets: 7, place: vec![], down: vec![], hours: Some(vec![]), deviation: vec![] };
        for k in 0..60_usize {
            if k % 11 == 3 {
                continue;
            }
            let (place, down) = (k % 7, f64::from(u8::from((k / 7) % 2 == 1)));
            let hours = 0.01 * k as f64 + 0.002 * (k as f64 * 1.7).sin();
            system.place.push(place);
            system.down.push(down);
            system.hours.as_mut().unwrap().push(hours);
            system
                .deviation
                .push(100.0 * (place as f64).cos() + 250.0 * down - 40.0 * hours + 30.0 * (k as f64 * 12.9898).sin());
        }
        system
    }

    #[test]
    fn elimination_gives_what_the_whole_system_gives() {
        let mut with = uneven();
        for drift in [true, false] {
            if !drift {
                with.hours = None;
            }
            let weights: Vec<f64> = (0..with.place.len()).map(|k| [1.0, 0.3, 0.0, 1.0, 0.7][k % 5]).collect();
            let solved = with.solve(&weights).unwrap();
            let row = |k: usize| {
                let mut row = vec![0.0; with.unknowns()];
                row[with.place[k]] = 1.0;
                row[with.targets] = with.down[k];
                if let Some(hours) = &with.hours {
                    row[with.targets + 1] = hours[k];
                }
                row
            };
            let mut rows = Rows::new(with.unknowns());
            for (k, weight) in weights.iter().enumerate() {
                let scaled: Vec<f64> = row(k).iter().map(|value| value * weight.sqrt()).collect();
                rows.push(&scaled, with.deviation[k] * weight.sqrt());
            }
            let whole = rows.solve();
            let (found, root) = (whole.step(0.0), whole.root());
            let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
            (0..with.targets).for_each(|t| near(solved.means[t], found[t]));
            near(solved.play, found[with.targets]);
            near(solved.drift, if drift { found[with.targets + 1] } else { 0.0 });
            near(solved.play_sigma, root.row(with.targets).norm());
            for k in 0..weights.len() {
                let fitted: f64 = row(k).iter().zip(found.iter()).map(|(a, x)| a * x).sum();
                near(solved.left[k], with.deviation[k] - fitted);
                near(solved.leverage[k], (root.transpose() * nalgebra::DVector::from(row(k))).norm_squared());
            }
        }
    }

    #[test]
    fn runs_without_a_way_down_have_no_play_and_the_same_means() {
        let mut with = uneven();
        with.deviation.iter_mut().zip(&with.down).for_each(|(deviation, down)| *deviation -= 250.0 * down);
        with.down.fill(0.0);
        assert_eq!(with.unknowns(), with.targets + 1);
        let weights: Vec<f64> = (0..with.place.len()).map(|k| [1.0, 0.3, 0.0, 1.0, 0.7][k % 5]).collect();
        let solved = with.solve(&weights).unwrap();
        let mut rows = Rows::new(with.unknowns());
        for (k, weight) in weights.iter().enumerate() {
            let mut row = vec![0.0; with.unknowns()];
            row[with.place[k]] = weight.sqrt();
            row[with.targets] = with.hours.as_ref().unwrap()[k] * weight.sqrt();
            rows.push(&row, with.deviation[k] * weight.sqrt());
        }
        let found = rows.solve().step(0.0);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
        (0..with.targets).for_each(|t| near(solved.means[t], found[t]));
        near(solved.drift, found[with.targets]);
        assert!(solved.play == 0.0 && solved.play_sigma.is_infinite());
        assert!(solved.left.iter().chain(&solved.leverage).all(|value| value.is_finite()));
    }

    #[test]
    fn what_cannot_be_told_has_no_solution() {
        let all = |system: &PerTarget| vec![1.0; system.place.len()];
        let mut one_way = uneven();
        one_way.down.fill(1.0);
        assert!(one_way.solve(&all(&one_way)).is_none());
        let mut still = uneven();
        still.hours.as_mut().unwrap().fill(0.0);
        assert!(still.solve(&all(&still)).is_none());
        let mut time_is_direction = uneven();
        time_is_direction.hours = Some(time_is_direction.down.iter().map(|down| 0.1 * down).collect());
        assert!(time_is_direction.solve(&all(&time_is_direction)).is_none());
        let whole = uneven();
        let without: Vec<f64> = whole.place.iter().map(|place| if *place == 2 { 0.0 } else { 1.0 }).collect();
        assert!(whole.solve(&without).is_none() && whole.solve(&all(&whole)).is_some());
    }
}
