//! What the alignment program knows of fibre, chip and array: from their data sheets, nothing of the bench.

use nalgebra::{Complex, Matrix3, Vector3};
use std::f64::consts::PI;

/// Data sheets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Mode radius of the fibres, um.
    pub fibre_um: f64,
    /// Mode radius of the guides, um.
    pub guide_um: f64,
    /// Wavelength in vacuum, um.
    pub wavelength_um: f64,
    /// Refractive index between the faces.
    pub index: f64,
    /// Channels of the array.
    pub channels: usize,
    /// From one to the next, um; the next lies towards -x.
    pub pitch_um: f64,
}

impl Default for Optics {
    fn default() -> Self {
        Optics { fibre_um: 5.2, guide_um: 4.8, wavelength_um: 1.55, index: 1.5, channels: 8, pitch_um: 250.0 }
    }
}

impl Optics {
    /// Sum of the squares of both radii, um^2.
    fn squares(&self) -> f64 {
        self.fibre_um * self.fibre_um + self.guide_um * self.guide_um
    }

    /// Loss by an offset, dB per um^2: exp(-2 d^2 / (w1^2 + w2^2)) of the power.
    pub fn lateral_db(&self) -> f64 {
        20.0 / std::f64::consts::LN_10 / self.squares()
    }

    /// Gap at which half of the light is lost, um: pi n (w1^2 + w2^2) / lambda.
    pub fn reach_um(&self) -> f64 {
        PI * self.index * self.squares() / self.wavelength_um
    }

    /// Loss by a gap, dB; the fibre is on the axis.
    pub fn gap_db(&self, gap_um: f64) -> f64 {
        10.0 * (1.0 + (gap_um / self.reach_um()).powi(2)).log10()
    }

    /// How far aside a fibre that is turned about its end has its peak, um per rad, towards where its end looks: at a gap
    /// it meets the guide's beam there, which runs apart.
    pub fn lean_um(&self, gap_um: f64) -> f64 {
        // the maximum over d
        let [offset, both, _] = self.bends(gap_um);
        0.5 * both / offset
    }

    /// Loss by an angle of a fibre that stays in its place, dB per rad^2.
    pub fn angle_db(&self, gap_um: f64) -> f64 {
        let [.., angle] = self.bends(gap_um);
        10.0 / std::f64::consts::LN_10 * angle
    }

    /// A fibre that is on its peak in x and y before it is turned to its peak leans aside then, and is only this share of
    /// the way to where it would stand straight: by how much more it must turn, at least 1.
    pub fn overturn(&self, gap_um: f64) -> f64 {
        let [offset, both, angle] = self.bends(gap_um);
        1.0 / (1.0 - 0.25 * both * both / (offset * angle))
    }

    /// Factors of -d^2, +dt and -t^2 in the logarithm of the coupling; offset d in um, slope t in rad.
    fn bends(&self, gap_um: f64) -> [f64; 3] {
        // overlap of two paraxial Gaussian beams: ln eta = 2 Re(b^2 / 4a) - 2 d^2 / wf^2 + constant with
        // a = 1 / wf^2 + ik / 2q and b = 2d / wf^2 + ikt
        let k = 2.0 * PI * self.index / self.wavelength_um;
        let q = Complex::new(gap_um, PI * self.index * self.guide_um.powi(2) / self.wavelength_um);
        let waist = self.fibre_um.powi(-2);
        let inverse = (Complex::new(waist, 0.0) + Complex::new(0.0, 0.5 * k) / q).inv();
        [2.0 * waist * (1.0 - waist * inverse.re), -2.0 * waist * k * inverse.im, 0.5 * k * k * inverse.re]
    }

    /// x of a channel (from 0) in the array, from the first one, um.
    pub fn channel_um(&self, channel: usize) -> f64 {
        -self.pitch_um * channel as f64
    }
}

/// How the light falls when a fibre draws back along the axis of its guide, and what that tells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fall {
    /// The gap where the retreats are counted from, um.
    pub gap_um: f64,
    /// The gap at which half of the light is lost, um: of these fibres and guides, whatever their data sheets say.
    pub reach_um: f64,
    /// Standard uncertainty of the gap for levels that are each uncertain by so many dB, um per dB.
    pub um_per_db: f64,
    /// What the levels are off, dB: root of the sum of squares over the degrees of freedom.
    pub residual_db: f64,
}

impl Fall {
    /// Of levels (dBm) at retreats (um): at least four, three of them different. None when the light does not fall as it
    /// must between Gaussian modes.
    ///
    /// The reciprocal of the power is C (R^2 + (g + b)^2) at a retreat b, a parabola: so gap g, reach R and C come from
    /// linear least squares, and there is one answer only. Any guess of the reach makes two: with R known wrong, gaps on
    /// both sides of R / 2 explain the same levels almost as well.
    pub fn of(seen: &[(f64, f64)]) -> Option<Fall> {
        const UNIT_UM: f64 = 100.0;
        let (_, first) = *seen.first()?;
        let (mut square, mut side) = (Matrix3::zeros(), Vector3::zeros());
        let mut rows = Vec::with_capacity(seen.len());
        for (back, level) in seen {
            let (b, loss) = (back / UNIT_UM, 10f64.powf(0.1 * (first - level)));
            // relative errors are alike
            let row = Vector3::new(b * b, b, 1.0) / loss;
            square += row * row.transpose();
            side += row;
            rows.push(row);
        }
        let covariance = square.try_inverse()?;
        let fit = covariance * side;
        let [a, b, c] = [fit[0], fit[1], fit[2]];
        let freedom = rows.len().checked_sub(3).filter(|freedom| *freedom > 0)?;
        let gap = 0.5 * b / a;
        let reach_square = c / a - gap * gap;
        if !(a > 0.0 && reach_square > 0.0) {
            return None;
        }
        let db = 10.0 / std::f64::consts::LN_10;
        let slope = Vector3::new(-gap / a, 0.5 / a, 0.0);
        let squares: f64 = rows.iter().map(|row| (1.0 - row.dot(&fit)).powi(2)).sum();
        Some(Fall {
            gap_um: gap * UNIT_UM,
            reach_um: reach_square.sqrt() * UNIT_UM,
            um_per_db: slope.dot(&(covariance * slope)).sqrt() * UNIT_UM / db,
            residual_db: db * (squares / freedom as f64).sqrt(),
        })
    }
}

/// How a channel sees a displacement of the array: where it would have its most light, and how much, relative to here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Displacement of the array to the peak, um.
    pub x_um: f64,
    /// The same in y.
    pub y_um: f64,
    /// Level there, dBm.
    pub level_dbm: f64,
}

impl Peak {
    /// From levels at the middle, at -step and +step in x, and the same in y: a parabola in dB each.
    pub fn of_star(levels_dbm: [f64; 5], step_um: f64) -> Option<Self> {
        let [middle, left, right, below, above] = levels_dbm;
        let along = |low: f64, high: f64| {
            let (slope, bend) = (high - low, 2.0 * middle - low - high);
            (bend > 0.0).then(|| (0.5 * step_um * slope / bend, 0.125 * slope * slope / bend))
        };
        let ((x_um, dx), (y_um, dy)) = (along(left, right)?, along(below, above)?);
        Some(Peak { x_um, y_um, level_dbm: middle + dx + dy })
    }
}

/// A displacement of the array in its plane: x and y in um, roll about channel 1 in rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shift {
    /// um.
    pub x_um: f64,
    /// um.
    pub y_um: f64,
    /// rad.
    pub roll_rad: f64,
}

/// How much the mean of the channels counts beside the weakest: where one weak channel leaves the others room, they take it.
const MEAN: f64 = 0.01;

/// The displacement after which the weakest channel is as strong as it can be.
pub fn best_for_all(optics: &Optics, peaks: &[Peak]) -> Shift {
    let weakest = |shift: &Shift| {
        let level = |(i, peak): (usize, &Peak)| {
            let (x, y) = (shift.x_um - peak.x_um, shift.y_um + optics.channel_um(i) * shift.roll_rad - peak.y_um);
            peak.level_dbm - optics.lateral_db() * (x * x + y * y)
        };
        let levels = peaks.iter().enumerate().map(level);
        let (least, sum) = levels.fold((f64::INFINITY, 0.0), |(least, sum), level| (least.min(level), sum + level));
        least + MEAN * sum / peaks.len().max(1) as f64
    };
    let mean = |of: fn(&Peak) -> f64| peaks.iter().map(of).sum::<f64>() / peaks.len().max(1) as f64;
    // a straight line through the places in y begins near the end
    let (along, y) = (mean_along(optics, peaks.len()), mean(|peak| peak.y_um));
    let (mut products, mut squares) = (0.0, 0.0);
    for (i, peak) in peaks.iter().enumerate() {
        let x = optics.channel_um(i) - along;
        (products, squares) = (products + x * (peak.y_um - y), squares + x * x);
    }
    let roll_rad = if squares > 0.0 { products / squares } else { 0.0 };
    let mut best = Shift { x_um: mean(|peak| peak.x_um), y_um: y - roll_rad * along, roll_rad };
    let (mut level, mut step) = (weakest(&best), 0.5);
    // the array turns about its middle here, so that the three do not work against each other
    while step > 1e-5 {
        let reach = (0.5 * optics.pitch_um * optics.channels as f64).max(1.0);
        let turned = |angle: f64| Shift { y_um: best.y_um - angle * along, roll_rad: best.roll_rad + angle, ..best };
        let mut tries = Vec::new();
        for a in [-step, 0.0, step] {
            for b in [-step, 0.0, step] {
                for c in [-step, 0.0, step] {
                    let turned = turned(c / reach);
                    tries.push(Shift { x_um: turned.x_um + a, y_um: turned.y_um + b, ..turned });
                }
            }
        }
        let better = tries.into_iter().map(|shift| (weakest(&shift), shift)).max_by(|a, b| a.0.total_cmp(&b.0));
        match better {
            Some((found, shift)) if found > level => (level, best) = (found, shift),
            _ => step *= 0.5,
        }
    }
    best
}

fn mean_along(optics: &Optics, channels: usize) -> f64 {
    (0..channels).map(|i| optics.channel_um(i)).sum::<f64>() / channels.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gap_is_told_by_how_the_light_falls_whatever_the_modes_are() {
        for (radius_um, index) in [(5.2, 1.5), (4.7, 1.0), (5.7, 1.55), (4.7, 1.425)] {
            let optics = Optics { fibre_um: radius_um, index, ..Optics::default() };
            for gap in [-1.0, 3.0, 20.0, 70.0, 95.0, 200.0] {
                let seen: Vec<_> =
                    [0.0, 40.0, 80.0, 140.0, 0.0].map(|back| (back, -9.7 - optics.gap_db(gap + back))).into();
                let fall = Fall::of(&seen).unwrap();
                assert!((fall.gap_um - gap).abs() < 1e-6, "{gap} {fall:?}");
                assert!((fall.reach_um - optics.reach_um()).abs() < 1e-6 && fall.residual_db < 1e-9, "{fall:?}");
            }
        }
        assert_eq!(Fall::of(&[(0.0, -9.0), (50.0, -8.0), (90.0, -7.0), (0.0, -9.0)]), None, "brighter the farther");
        assert_eq!(Fall::of(&[(0.0, -9.0), (50.0, -9.6), (90.0, -10.4)]), None, "nothing left to tell its error");
    }

    #[test]
    fn the_uncertainty_of_a_gap_is_that_of_the_levels_carried_over() {
        let optics = Optics::default();
        let seen = [0.0, 40.0, 80.0, 140.0, 0.0].map(|back| (back, -optics.gap_db(60.0 + back)));
        let told = Fall::of(&seen).unwrap();
        let moved = |i: usize| {
            let mut seen = seen;
            seen[i].1 += 1e-4;
            (Fall::of(&seen).unwrap().gap_um - told.gap_um) / 1e-4
        };
        let sum: f64 = (0..seen.len()).map(|i| moved(i).powi(2)).sum();
        assert!((sum.sqrt() / told.um_per_db - 1.0).abs() < 1e-2, "{} {told:?}", sum.sqrt());
    }

    #[test]
    fn a_fibre_on_its_peak_that_turns_by_as_much_as_told_stands_straight() {
        let optics = Optics::default();
        for gap in [0.0, 40.0, 90.0] {
            let (lean, turn) = (optics.lean_um(gap), 7e-3);
            // the loss that Optics::bends says, in dB; the fibre is turned and has its peak in x
            let [offset, both, angle] = optics.bends(gap);
            let loss = |d: f64, t: f64| offset * d * d - both * d * t + angle * t * t;
            let d = lean * turn;
            let best = (-1000..1000).map(|n| 1e-5 * f64::from(n)).min_by(|a, b| loss(d, *a).total_cmp(&loss(d, *b)));
            let told = best.unwrap() - turn;
            assert!((turn + told * optics.overturn(gap)).abs() < 2e-5, "{gap} {told}");
            assert!(gap == 0.0 || optics.overturn(gap) > 1.02);
        }
    }

    #[test]
    fn a_star_tells_the_peak_of_a_channel() {
        let optics = Optics::default();
        let level = |x: f64, y: f64| -10.0 - optics.lateral_db() * ((x - 0.4).powi(2) + (y + 0.7).powi(2));
        let star = [level(0.0, 0.0), level(-1.5, 0.0), level(1.5, 0.0), level(0.0, -1.5), level(0.0, 1.5)];
        let peak = Peak::of_star(star, 1.5).unwrap();
        assert!((peak.x_um - 0.4).abs() < 1e-9 && (peak.y_um + 0.7).abs() < 1e-9, "{peak:?}");
        assert!((peak.level_dbm + 10.0).abs() < 1e-9);
    }

    #[test]
    fn no_displacement_nearby_is_better_for_the_weakest_channel() {
        let optics = Optics::default();
        let wave = |n: usize| ((n as f64 + 0.3) * 78.233).sin();
        let peaks: Vec<Peak> = (0..8)
            .map(|i| Peak {
                x_um: 0.3 * wave(i),
                y_um: 0.3 * wave(i + 20) + 0.002 * optics.channel_um(i),
                level_dbm: -10.0 + 0.05 * wave(i + 40),
            })
            .collect();
        let weakest = |shift: Shift| {
            (0..8)
                .map(|i| {
                    let y = shift.y_um + optics.channel_um(i) * shift.roll_rad - peaks[i].y_um;
                    peaks[i].level_dbm - optics.lateral_db() * ((shift.x_um - peaks[i].x_um).powi(2) + y * y)
                })
                .fold(f64::INFINITY, f64::min)
        };
        let best = best_for_all(&optics, &peaks);
        let level = weakest(best);
        for n in 0..3000 {
            let by = |k: usize| 0.6 * wave(3 * n + k);
            let other =
                Shift { x_um: best.x_um + by(0), y_um: best.y_um + by(1), roll_rad: best.roll_rad + by(2) * 1e-3 };
            assert!(weakest(other) <= level + 2e-3, "{other:?} {best:?}");
        }
    }
}
