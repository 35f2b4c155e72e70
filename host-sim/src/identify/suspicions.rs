//! Whether a file that does not fit the others was noisy, or misread: before noise is believed, mistakes are tried.
//!
//! Every trial fits one file again with all others in the background, which are held as the linear system they have at
//! the present solution. So a trial costs as much as a hundred readings do, whatever else was measured.

use super::Refusal;
use super::changes::{Change, pairs};
use super::fit::{Fit, LEAST_NOISE, Told, possible};
use super::gauge::per_unit;
use super::least_squares::{Rows, Solution};
use super::observe::{Block, Observer, State};
use super::outliers::huber;
use super::series::{Kind, Series};
use super::units::{Quantity, UNITS, Unit};
use super::weights::{HOPELESS_NOISE, Left, MOST_REJECTED, largest, robust_noise};
use nalgebra::DVector;
use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor};
use std::fmt::Write;

/// A file whose residuals are less than this many times its stated noise is not suspected.
const SUSPICIOUS: f64 = 3.0;
/// The same where none is stated, nm and nrad: good instruments are no worse.
const GOOD_LENGTH: f64 = 100.0;
const GOOD_ANGLE: f64 = 1500.0;
/// A mistake is believed that makes the squares of the residuals so many times smaller, ...
const EXPLAINS: f64 = 10.0;
/// ... and more than noise does by chance in so few readings: one file in ten thousand.
const CHANCE: f64 = 1e-4;
/// Readings of a file that a trial looks at.
const SAMPLE: usize = 100;
/// A file that is read rightly shows at most this many times the noise it states, ...
const FITS: f64 = 2.0;
/// ... and, where it states none, this many times what good instruments show.
const FITS_UNSTATED: f64 = 3.0;
/// A backlash so many standard deviations below zero is none.
const NO_PLAY: f64 = 3.0;
/// One of several files is the misread one if its residuals fall by so much more than those of the next one.
const CLEARLY: f64 = 3.0;
/// Rounds of a trial, and of the search for a core.
const ROUNDS: usize = 6;
const CORE_ROUNDS: usize = 12;
/// Fewer values than this have no median to speak of.
const FEW: usize = 10;
/// Other explanations up to so many times the residuals of the best one are as good: none of them is proven.
const AS_GOOD: f64 = 1.5;

/// In the core (within this many standard deviations of the stated noise), and far out.
const CORE: f64 = 4.0;
const FAR: f64 = 8.0;
/// The spread of a core that keeps to the stated noise.
const CORE_SPREAD: f64 = 1.5;
/// Between core and far out there are at most so many readings for each one far out: errors of a stage leave no gap.
const GAP: f64 = 0.3;
/// A noise so many times too small may be one of another unit; errors of a stage reach the smaller ratios of units.
const NOISE_UNIT: f64 = 500.0;
/// Share of the constants' information below which a file has no say.
const UNHEARD: f64 = 0.05;
/// ... which is worth a warning where the noise is also so many times that of a good instrument.
const COARSE: f64 = 10.0;

/// The largest noise that is believed of a kind, nm or nrad: residuals beyond are no instrument and no stage but
/// another unit, sign, axis or point. Errors of the stage count as noise here. Linear stages of lead screws err by up
/// to 5 um over their travel before any compensation, rotary ones by 0.01 deg; an autocollimator that is 20 arcsec off is
/// not one.
pub(super) fn believable(kind: Kind) -> f64 {
    match kind {
        Kind::Autocollimator(_) => 100_000.0,
        Kind::Orientation => 200_000.0,
        // a straightness of some um makes a square at home as wrong as a badly built stage
        Kind::Squareness => 1_000_000.0,
        _ if kind.quantity() == Quantity::Angle => 200_000.0,
        _ => 5_000.0,
    }
}

/// Noise of a kind's values that is no reason to look closer where a file states none.
fn good(kind: Kind) -> f64 {
    match kind.quantity() {
        Quantity::Length => GOOD_LENGTH,
        Quantity::Angle => GOOD_ANGLE,
    }
}

/// Residuals of a file are neither the noise stated nor errors of a stage: too large in both measures.
pub(super) fn hopeless(file: &Series, shown: f64) -> bool {
    shown > HOPELESS_NOISE * file.noise.unwrap_or(f64::INFINITY) && shown > believable(file.kind)
}

/// By what share of the noise stated the residuals must be larger before that noise is doubted: five standard deviations
/// of a median of so many, and a little more where the worst of three small groups is looked at.
pub(super) fn few_repeats(file: &Series) -> f64 {
    let of_pair = |pair| file.readings.iter().filter(|reading| reading.pair == Some(pair)).count();
    match (file.kind, pairs(file).into_iter().map(of_pair).min()) {
        (Kind::Squareness, Some(least)) => 6.0 / (least as f64).sqrt(),
        _ => 5.0 / (file.readings.len() as f64).sqrt(),
    }
}

/// The two units that a noise stated so many times too small was confused with: real one and written one.
pub(super) fn noise_unit(file: &Series, ratio: f64) -> Option<(&'static str, &'static str)> {
    let alike = UNITS.iter().filter(|unit| unit.quantity == file.kind.quantity());
    alike.clone().flat_map(|real| alike.clone().map(move |written| (real, written))).find_map(|(real, written)| {
        let near = (real.size / written.size / ratio).ln().abs() < 0.2 && ratio > NOISE_UNIT;
        near.then_some((real.name, written.name))
    })
}

/// The next smaller unit of the values in which the noise would be believable.
fn smaller_unit(file: &Series, shown: f64) -> String {
    let Some(written) = file.units.first() else { return String::new() };
    let believed = UNITS.iter().filter(|unit| unit.quantity == written.quantity && unit.size < written.size);
    let noise = |unit: &Unit| shown * unit.size / written.size;
    believed
        .filter(|unit| noise(unit) <= believable(file.kind))
        .max_by(|a, b| a.size.total_cmp(&b.size))
        .map_or(String::new(), |unit| {
            format!(" (in {} it would be {})", unit.name, size(noise(unit), written.quantity))
        })
}

/// A length or an angle for people.
pub(super) fn size(value: f64, quantity: Quantity) -> String {
    let (small, large) = match quantity {
        Quantity::Length => ("nm", "um"),
        Quantity::Angle => ("nrad", "urad"),
    };
    if value < 1.0 { format!("{value:.3} {small}") } else { format!("{:.3} {large}", value * 1e-3) }
}

/// A file under trial: its readings, and the common unknowns as far as all others tell them.
struct Trial<'t, 'f> {
    fit: &'t Fit<'f>,
    index: usize,
    file: &'t Series,
    others: &'t Rows,
    touched: &'t [usize],
    /// Readings that are looked at.
    sample: &'t [usize],
    /// From the solution of the fit.
    moved: DVector<f64>,
    /// At `moved`: one for each reading of the sample.
    blocks: Vec<Block>,
    /// Of the last step.
    solution: Option<Solution>,
}

impl Trial<'_, '_> {
    fn look(&mut self, state: &State) {
        let fit = self.fit;
        let observer =
            Observer::new(&fit.layout, state, self.file, self.index, fit.options.drift, &fit.weights[self.index]);
        let fill = |k: &usize| {
            let mut block = Block::new(self.touched.len());
            observer.fill(*k, &mut block);
            block
        };
        self.blocks = self.sample.iter().map(fill).collect();
    }

    /// Least squares with these weights of the sample. False where that leads nowhere.
    fn step(&mut self, weight: impl Fn(usize, &[f64; 3]) -> f64, noise: f64) -> bool {
        let mut rows = self.others.clone();
        let columns = self.file.kind.columns().len();
        let mut row = vec![0.0; self.touched.len()];
        for (n, block) in self.blocks.iter().enumerate() {
            let scale = weight(n, &block.residual).sqrt() / noise;
            for c in 0..columns {
                row.iter_mut().zip(&block.rows[c]).for_each(|(entry, value)| *entry = value * scale);
                let already: f64 = self.touched.iter().zip(&block.rows[c]).map(|(j, d)| d * self.moved[*j]).sum();
                rows.push(&row, (block.residual[c] + already) * scale);
            }
        }
        let solution = rows.solve();
        let step = solution.step(0.0);
        self.solution = Some(solution);
        for (column, value) in self.touched.iter().zip(step.iter()) {
            self.moved[*column] = *value;
        }
        if !step.iter().all(|value| value.is_finite()) {
            return false;
        }
        let state = self.fit.moved(&self.moved);
        self.look(&state);
        self.blocks.iter().all(|block| block.residual.iter().all(|residual| residual.is_finite()))
    }

    /// The noise that the residuals show, of the worst column, nm or nrad.
    fn spread(&self) -> f64 {
        if self.blocks.len() < FEW && self.file.kind != Kind::Squareness {
            let column = |c: usize| {
                let squares: f64 = self.blocks.iter().map(|block| block.residual[c].powi(2)).sum();
                (squares / self.blocks.len() as f64).sqrt()
            };
            return (0..self.file.kind.columns().len()).map(column).fold(0.0, f64::max);
        }
        let residuals: Vec<_> = self.sample.iter().zip(&self.blocks).map(|(k, block)| (*k, block.residual)).collect();
        robust_noise(self.file, &residuals)
    }

    /// The stage that the trial ends at can be one, and all other files fit it as well as before.
    fn believable(&self) -> bool {
        let (fit, Some(solution)) = (self.fit, &self.solution) else { return false };
        let machine = fit.moved(&self.moved).machine;
        let mut constants = fit.layout.constants.iter().zip(fit.layout.constant_columns);
        if constants.any(|(c, column)| column.is_some() && !possible(*c, c.of(&machine) / per_unit(*c))) {
            return false;
        }
        let root = solution.root();
        let negative = machine.drives.iter().zip(fit.layout.play_columns).any(|(drive, column)| {
            let row = column.and_then(|column| self.touched.iter().position(|touched| *touched == column));
            row.is_some_and(|row| drive.backlash < -NO_PLAY * root.row(row).norm())
        });
        let mut worse = 0.0;
        self.others.clone().triangle(|row, right| {
            let taken: f64 = row.iter().zip(self.touched).map(|(value, column)| value * self.moved[*column]).sum();
            worse += (right - taken).powi(2) - right.powi(2);
        });
        let chance = ChiSquared::new(self.touched.len() as f64).map_or(0.0, |d| d.inverse_cdf(1.0 - CHANCE));
        !negative && worse <= chance
    }

    /// Size of a reading's worst residual.
    fn worst(&self, n: usize) -> f64 {
        let columns = self.file.kind.columns().len();
        largest(&self.blocks[n].residual[..columns])
    }
}

/// What explains a file that does not fit.
struct Mistake {
    index: usize,
    /// How many times smaller the residuals become.
    times: f64,
    reason: String,
    /// It cannot be by chance, and no other mistake explains it as well.
    alone: bool,
}

/// A file on its own against the others.
struct Case {
    index: usize,
    others: Rows,
    touched: Vec<usize>,
    sample: Vec<usize>,
    /// Values less what the fit takes from them.
    free: f64,
}

impl<'f> Fit<'f> {
    /// What all tell the common unknowns but the file, with its own unknowns free.
    fn case(&self, index: usize, others: &Rows, left: &[Left]) -> Case {
        let count = self.weights[index].len();
        let touched = self.touched(index);
        let mut all = Rows::new(touched.len());
        let mut row = vec![0.0; touched.len()];
        others.clone().triangle(|common, right| {
            row[..common.len()].copy_from_slice(common);
            all.push(&row, right);
        });
        row.fill(0.0);
        let common = self.layout.common();
        let first = self.layout.first[index];
        for prior in self.priors.iter().filter(|prior| (first..first + self.own[index].len()).contains(&prior.column)) {
            row[common + prior.column - first] = 1.0 / prior.sigma;
            all.push(&row, (prior.value - self.value(&self.state, prior.column)) / prior.sigma);
            row[common + prior.column - first] = 0.0;
        }
        let every = count.div_ceil(SAMPLE);
        let sample: Vec<usize> = (0..count).step_by(every).collect();
        let columns = self.series[index].kind.columns().len();
        let share = sample.len() as f64 / count as f64;
        let free = share * ((count * columns) as f64 - self.taken(index, left));
        Case { index, others: all, touched, free, sample }
    }

    /// Of each file what all but it tell the common unknowns.
    fn all_but_one(&self) -> Vec<Rows> {
        let (_, parts, _) = self.assemble_with_parts(&self.state, &self.noise);
        let common = self.layout.common();
        let with = |rows: &Rows, part: &Told| {
            let mut rows = rows.clone();
            part.iter().for_each(|(row, right)| rows.push(row, *right));
            rows
        };
        // those behind each, then those before it
        let mut behind = vec![with(&Rows::new(common), &parts[self.series.len()])];
        for part in parts[1..self.series.len()].iter().rev() {
            let next = with(&behind[behind.len() - 1], part);
            behind.push(next);
        }
        let mut before = Rows::new(common);
        let mut all = Vec::new();
        for (part, behind) in parts.iter().zip(behind.into_iter().rev()) {
            let mut but_one = before.clone();
            behind.triangle(|row, right| but_one.push(row, right));
            all.push(but_one);
            before = with(&before, part);
        }
        all
    }

    fn trial<'t>(&'t self, case: &'t Case, file: &'t Series) -> Trial<'t, 'f> {
        let mut trial = Trial {
            fit: self,
            index: case.index,
            file,
            others: &case.others,
            touched: &case.touched,
            sample: &case.sample,
            moved: DVector::zeros(self.layout.width),
            blocks: Vec::new(),
            solution: None,
        };
        trial.look(&self.state);
        trial
    }

    /// The noise that a file shows when it is read in some way, nm or nrad, and the trial it shows it in. None where no
    /// fit is better than `enough`.
    fn shown<'t>(&'t self, case: &'t Case, file: &'t Series, enough: f64) -> Option<(f64, Trial<'t, 'f>)> {
        let mut trial = self.trial(case, file);
        let mut least = f64::INFINITY;
        for round in 0..ROUNDS {
            let noise = trial.spread().max(LEAST_NOISE);
            let columns = file.kind.columns().len();
            if !trial.step(|_, residual| huber(largest(&residual[..columns]) / noise), noise) {
                return None;
            }
            let now = trial.spread();
            let done = now > 0.98 * least;
            least = least.min(now);
            if done || (round == 2 && least > enough) {
                break;
            }
        }
        (least < enough).then_some((least, trial))
    }

    /// What was mistaken in a file, if that makes it fit as its noise says, on a stage that can be one.
    fn mistake(&self, case: &Case) -> Option<Mistake> {
        let file = &self.series[case.index];
        let (before, _) = self.shown(case, file, f64::INFINITY)?;
        if before <= file.noise.map_or(good(file.kind), |stated| SUSPICIOUS * stated) || case.free < 1.0 {
            return None;
        }
        let chance = FisherSnedecor::new(case.free, case.free).ok()?.inverse_cdf(1.0 - CHANCE);
        let tried = Change::all(file, &self.state.machine).into_iter().filter_map(|change| {
            // a noise is written in the unit of the values, and mistaken with it
            let factors = change.factors(file).map(f64::abs);
            let unit = factors.into_iter().fold(1.0, f64::max);
            // whatever is read in a smaller unit has smaller residuals: they must be smaller as written, too
            let smaller = factors.into_iter().fold(1.0, f64::min);
            let fits = file.noise.map_or(FITS_UNSTATED * good(file.kind), |stated| FITS * stated * unit);
            let changed = change.applied(file);
            let (after, trial) =
                self.shown(case, &changed, fits.min(smaller * before / EXPLAINS.max(chance).sqrt()))?;
            trial.believable().then_some((after, change))
        });
        let mut explains: Vec<(f64, Change)> = tried.collect();
        explains.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (least, best) = *explains.first()?;
        let same: Vec<String> =
            explains.iter().take_while(|(after, _)| *after <= AS_GOOD * least).map(|(_, c)| c.said(file)).collect();
        let quantity = file.kind.quantity();
        let mut reason = format!(
            "the readings fit with {}: residuals of {} become {}",
            same.join(", or with "),
            size(before, quantity),
            size(least, quantity)
        );
        if let (Change::Unit(_, unit) | Change::AllUnit(unit), 1) = (best, same.len()) {
            let _ = write!(reason, "; they look like {} written as {}", unit.name, file.units[0].name);
        }
        // one number is read many times: turning its sign round fits by chance where the stage is as far off as the pair
        let proven = !matches!(best, Change::PairReversed(..)) || before > believable(file.kind);
        Some(Mistake {
            index: case.index,
            times: before / least.max(LEAST_NOISE),
            reason,
            alone: proven && same.len() == 1,
        })
    }

    /// What is held on request, as another reason why something may not fit; nothing where nothing is.
    pub(super) fn held(&self) -> String {
        let name =
            |(name, value): &(String, Option<f64>)| value.map_or(name.clone(), |value| format!("{name}={value}"));
        let held: Vec<String> = self.options.hold.iter().map(name).collect();
        if held.is_empty() {
            return String::new();
        }
        format!(" (held on request: {}; a wrong value there shows in the files like this)", held.join(", "))
    }

    /// Refuses a file as misread. Where constants are held at values that somebody gave, those may be what is wrong: then
    /// it is a warning.
    pub(super) fn misread(&mut self, index: usize, reason: String) -> Result<(), Refusal> {
        if self.options.hold.iter().any(|(_, value)| value.is_some()) {
            self.doubt(index, &reason);
            return Ok(());
        }
        let file = &self.series[index];
        Err(Refusal::line(file, file.readings[0].line, reason + &self.held()))
    }

    /// A warning, the last one of each file.
    fn doubt(&mut self, index: usize, reason: &str) {
        self.said.retain(|(of, _)| *of != index);
        self.said.push((index, format!("{}: {reason}.", self.series[index].file)));
    }

    /// Refuses the file that a mistake explains, if one stands out; warns where several could be the one, or one could
    /// be misread in several ways.
    pub(super) fn refuse_mistakes(&mut self, suspects: &[usize]) -> Result<(), Refusal> {
        if suspects.is_empty() {
            return Ok(());
        }
        let (others, left) = (self.all_but_one(), self.left(self.joint()));
        let mut found = Vec::new();
        for index in suspects {
            (self.progress)(&format!("looking for mistakes in {}", self.series[*index].file));
            let case = self.case(*index, &others[*index], &left[*index]);
            found.extend(self.mistake(&case));
        }
        found.sort_by(|a: &Mistake, b| b.times.total_cmp(&a.times));
        let clear = match found.as_slice() {
            [] => return Ok(()),
            [best] => best.alone,
            [best, next, ..] => best.alone && best.times > CLEARLY * next.times,
        };
        if clear {
            let Mistake { index, reason, .. } = found.swap_remove(0);
            return self.misread(index, reason + "; correct the file");
        }
        for Mistake { index, reason, .. } in found {
            self.doubt(index, &format!("misread? {reason}; other files or other mistakes explain it as well"));
        }
        Ok(())
    }

    /// Files whose stated noise was not believed: misread, partly wrong, or noisy indeed. Those of which only some
    /// readings are wrong get their noise back.
    pub(super) fn judge_doubted(&mut self) -> Result<(), Refusal> {
        let doubted: Vec<usize> =
            self.fitted().filter(|(index, file)| self.estimated[*index] && file.noise.is_some()).map(|f| f.0).collect();
        if doubted.is_empty() {
            return Ok(());
        }
        // a file that states little noise can make the others look wrong
        let all: Vec<usize> = self.fitted().map(|(index, _)| index).collect();
        self.refuse_mistakes(&all)?;
        for index in doubted {
            let file = &self.series[index];
            let (unit, stated) = (file.kind.quantity().unit(), file.noise.expect("those alone"));
            // of few pairs read many times one pair may well stand apart: that is the stage, not its readings
            let (out, kept) =
                if file.kind == Kind::Squareness { (None, false) } else { self.out_of_core(index, stated) };
            let far = out.filter(|(out, off)| {
                *out as f64 > MOST_REJECTED * file.readings.len() as f64 && *off > believable(file.kind)
            });
            if let (Kind::Fibre(_) | Kind::Orientation, Some((out, _))) = (file.kind, far) {
                let reason = format!(
                    "{out} of {} readings do not fit the others of the file, which keep to its noise of {stated:.3} {unit}: \
                     look for what disturbed them, or leave them out",
                    file.readings.len()
                );
                self.misread(index, reason)?;
            }
            if kept {
                self.estimated[index] = false;
                self.noise[index] = stated;
                continue;
            }
            let shown = self.noise[index];
            if hopeless(file, shown) {
                let ratio = shown / stated;
                let reason = format!(
                    "the readings do not fit the other files: residuals of {shown:.1} {unit} are {ratio:.0} times the noise \
                     stated, {stated:.3} {unit}; look for a wrong unit (of the noise too), sign, axis or point"
                );
                self.misread(index, reason)?;
            }
        }
        Ok(())
    }

    /// How many readings are far out around a core that keeps to the stated noise, and the median of how far, nm or nrad;
    /// none without such a core. And whether the core keeps to it so well that nothing is wrong with the noise.
    fn out_of_core(&mut self, index: usize, stated: f64) -> (Option<(usize, f64)>, bool) {
        let left = self.left(self.joint());
        let mut case = self.case(index, &self.all_but_one()[index], &left[index]);
        let count = self.series[index].readings.len();
        let columns = self.series[index].kind.columns().len();
        let free_share = (case.free / (case.sample.len() * columns) as f64).clamp(0.1, 1.0);
        case.sample = (0..count).collect();
        let mut trial = self.trial(&case, &self.series[index]);
        for round in 0..CORE_ROUNDS {
            // the half that fits best, then all that belongs to it
            let sizes: Vec<f64> = (0..count).map(|n| trial.worst(n)).collect();
            let inside: Vec<bool> = if round < CORE_ROUNDS - 3 {
                let mut sorted = sizes.clone();
                sorted.sort_by(f64::total_cmp);
                sizes.iter().map(|size| *size <= sorted[count / 2]).collect()
            } else {
                sizes.iter().map(|size| *size <= CORE * stated).collect()
            };
            if !trial.step(|n, _| if inside[n] { 1.0 } else { 1e-9 }, stated) {
                return (None, false);
            }
        }
        let sizes: Vec<f64> = (0..count).map(|n| trial.worst(n) / stated).collect();
        let far = sizes.iter().filter(|size| **size > FAR).count();
        let core = sizes.iter().filter(|size| **size <= CORE).count();
        let out = count - core;
        let squares: f64 = (0..count)
            .filter(|n| sizes[*n] <= CORE)
            .map(|n| trial.blocks[n].residual[..columns].iter().map(|r| (r / stated).powi(2)).sum::<f64>())
            .sum();
        let values = (core * columns) as f64;
        let spread = (squares / (values * free_share).max(1.0)).sqrt();
        let gap = (out - far) as f64 <= GAP * far as f64 && 2 * core >= count;
        let kept = spread < 1.0 + 2.5 / values.sqrt() && out as f64 <= MOST_REJECTED * count as f64;
        let mut off: Vec<f64> = sizes.into_iter().filter(|size| *size > CORE).map(|size| size * stated).collect();
        off.sort_by(f64::total_cmp);
        let off = off.get(off.len() / 2).copied().unwrap_or(0.0);
        ((gap && spread < CORE_SPREAD).then_some((out, off)), kept && (gap || out * 50 < count))
    }

    /// Files that do not state their noise, and all where no reading is left out: misread, or noisier than can be.
    pub(super) fn judge_unstated(&mut self) -> Result<(), Refusal> {
        let suspects: Vec<usize> = self
            .fitted()
            .filter(|(index, file)| match file.noise {
                Some(_) => !self.options.reject,
                None => self.noise[*index] > good(file.kind),
            })
            .map(|(index, _)| index)
            .collect();
        self.refuse_mistakes(&suspects)?;
        for (index, file) in self.series.iter().enumerate() {
            let (shown, most) = (self.noise[index], believable(file.kind));
            if file.noise.is_none() && shown > most {
                let quantity = file.kind.quantity();
                let reason = format!(
                    "the readings do not fit the other files: the noise, which the file does not state, would have to be {}, \
                     and more than {} is no noise of {}; look for a wrong unit{}, sign, axis or point",
                    size(shown, quantity),
                    size(most, quantity),
                    file.kind.name(),
                    smaller_unit(file, shown)
                );
                self.misread(index, reason)?;
            }
        }
        Ok(())
    }

    /// Warnings for files that have next to no say in the result, though their kind should.
    pub(super) fn unheard(&self) -> Vec<String> {
        let left = self.left(self.joint());
        let mut warnings = Vec::new();
        for (index, file) in self.fitted() {
            let tells = !matches!(file.kind, Kind::Straightness { to_chip: false, .. });
            if !self.estimated[index] || self.noise[index] <= COARSE * good(file.kind) || !tells {
                continue;
            }
            let say = self.taken(index, &left[index]) - self.own[index].len() as f64;
            if say < UNHEARD {
                warnings.push(format!(
                    "{}: with a noise of {} it has next to no weight in the result: all it tells the other files tell \
                     better. Is that its noise? State it (# noise_<unit>), or look for a wrong unit or sign.",
                    file.file,
                    size(self.noise[index], file.kind.quantity())
                ));
            }
        }
        warnings
    }
}
