//! The readings of all files at one state, kept for as long as the state is the same: weights change more often.

use super::fit::Fit;
use super::observe::{Block, Observer, State};
use super::series::Kind;
use super::zeros::{Centred, Equation, Lines};
use std::cell::RefCell;
use std::rc::Rc;

/// Numbers that are kept at most, 160 MB; what is beyond is evaluated anew each time.
const MOST: usize = 20_000_000;

/// Values of readings at one state.
#[derive(Default)]
pub(super) struct Evaluated(RefCell<Kept>);

#[derive(Default)]
struct Kept {
    /// What the state is told by.
    state: Vec<f64>,
    /// Of each file all rows and residuals.
    files: Vec<Option<Rc<Vec<f64>>>>,
    stored: usize,
}

impl Fit<'_> {
    /// Calls back with every reading of a file as the fit sees it at a state. The common columns come first, then the
    /// file's own.
    pub(super) fn each_reading(&self, state: &State, index: usize, mut use_it: impl FnMut(usize, &Block)) {
        let file = &self.series[index];
        let (count, columns) = (file.readings.len(), file.kind.columns().len());
        let width = self.touched(index).len();
        let size = columns * (width + 1);
        let mut block = Block::new(width);
        let copy = |values: &[f64], block: &mut Block| {
            for (c, part) in values.chunks_exact(width + 1).enumerate() {
                block.rows[c].copy_from_slice(&part[..width]);
                block.residual[c] = part[width];
            }
        };
        let kept = self.kept(state, index);
        let observer = || Observer::new(&self.layout, state, file, index, self.options.drift, &self.weights[index]);
        let values = match kept {
            Some(values) => values,
            // too many to be kept
            None if !self.has_room(count * size) => {
                let observer = observer();
                for k in 0..count {
                    observer.fill(k, &mut block);
                    use_it(k, &block);
                }
                return;
            }
            None => {
                let observer = observer();
                let mut values = Vec::with_capacity(count * size);
                for k in 0..count {
                    observer.reading(k, &mut block);
                    for c in 0..columns {
                        values.extend_from_slice(&block.rows[c]);
                        values.push(block.residual[c]);
                    }
                }
                self.keep(index, Rc::new(values))
            }
        };
        if file.kind == Kind::Diagonal {
            let equation = |part: &[f64]| Equation { residual: part[width], row: part[..width].to_vec() };
            let equations = values.chunks_exact(size).map(equation).collect();
            let centred = Centred::new(Lines::new(file), equations, &self.weights[index]);
            for k in 0..count {
                centred.fill(k, &mut block);
                use_it(k, &block);
            }
        } else {
            for (k, part) in values.chunks_exact(size).enumerate() {
                copy(part, &mut block);
                use_it(k, &block);
            }
        }
    }

    /// What is kept of a file, if it is of this state. What is of another one is forgotten.
    fn kept(&self, state: &State, index: usize) -> Option<Rc<Vec<f64>>> {
        let constants = self.layout.constants.iter().map(|constant| constant.of(&state.machine));
        let plays = state.machine.drives.iter().map(|drive| drive.backlash);
        let told = || constants.clone().chain(plays.clone()).chain(state.own.iter().flatten().copied());
        let mut kept = self.evaluated.0.borrow_mut();
        if !told().eq(kept.state.iter().copied()) {
            *kept = Kept { state: told().collect(), files: vec![None; self.series.len()], stored: 0 };
        }
        kept.files[index].clone()
    }

    fn has_room(&self, numbers: usize) -> bool {
        self.evaluated.0.borrow().stored + numbers <= MOST
    }

    fn keep(&self, index: usize, values: Rc<Vec<f64>>) -> Rc<Vec<f64>> {
        let mut kept = self.evaluated.0.borrow_mut();
        kept.stored += values.len();
        kept.files[index] = Some(Rc::clone(&values));
        values
    }
}
