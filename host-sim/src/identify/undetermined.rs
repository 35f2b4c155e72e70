//! What the measurements do not tell, by name, and what would tell it.

use super::Refusal;
use super::constants::backlash_name;
use super::fit::Fit;
use super::series::Kind;
use nalgebra::DVector;
use stage_controller::units::Axis;

/// Share of a direction that changes nothing from which on a parameter belongs to it.
const SEEN: f64 = 1e-3;

impl Fit<'_> {
    /// Names of the columns of constants and plays.
    fn names(&self) -> Vec<(usize, String)> {
        let constants = self.layout.constants.iter().zip(self.layout.constant_columns);
        let plays = Axis::ALL.into_iter().zip(self.layout.play_columns);
        let mut names: Vec<_> = constants.filter_map(|(c, column)| Some((column?, c.to_string()))).collect();
        names.extend(plays.filter_map(|(axis, column)| Some((column?, backlash_name(axis)))));
        names
    }

    /// Refuses what changes no reading, by name, before anything is fitted.
    pub(super) fn refuse_undetermined(&self) -> Result<(), Refusal> {
        // somewhere beside the nominal machine, where nothing is by chance exactly straight
        let mut state = self.state.clone();
        for (n, constant) in self.layout.constants.iter().enumerate() {
            let some = if constant.is_angle() { 1e-5 } else { 1e3 };
            let value = constant.of(&state.machine) + some * (1.0 + n as f64 * 0.37).sin();
            constant.set(&mut state.machine, value);
        }
        let solution = self.assemble(&state).0.solve();
        self.refuse(&solution.null_space(), |_| false)
    }

    pub(super) fn refuse(&self, null: &[DVector<f64>], vague: impl Fn(usize) -> bool) -> Result<(), Refusal> {
        let names = self.names();
        let share = |column: usize| null.iter().map(|vector| vector[column] * vector[column]).sum::<f64>().sqrt();
        let seen: Vec<&(usize, String)> = names.iter().filter(|(c, _)| share(*c) > SEEN || vague(*c)).collect();
        if seen.is_empty() {
            return Ok(());
        }
        // Gauss-Jordan over the null space: hold mounts rather than angles of the stage
        let mut rest: Vec<DVector<f64>> = null.to_vec();
        let mut hold: Vec<String> = seen.iter().filter(|(c, _)| vague(*c)).map(|(_, name)| name.clone()).collect();
        let rank_of = |name: &str| {
            let classes = ["mount.fibre.rot", "mount.chip.rot", "mount.chip", "mount.fibre", "axis_offset", "axes", ""];
            classes.iter().position(|class| name.starts_with(class)).unwrap_or(classes.len())
        };
        let mut preferred = seen.clone();
        preferred.sort_by_key(|(_, name)| rank_of(name));
        for (column, name) in preferred {
            let largest = (0..rest.len()).max_by(|a, b| rest[*a][*column].abs().total_cmp(&rest[*b][*column].abs()));
            if let Some(pivot) = largest.filter(|i| rest[*i][*column].abs() > SEEN) {
                let pivot = rest.swap_remove(pivot);
                for vector in &mut rest {
                    let factor = vector[*column] / pivot[*column];
                    *vector -= &pivot * factor;
                }
                hold.push(name.clone());
            }
        }
        let undetermined: Vec<String> = seen.into_iter().map(|(_, name)| name.clone()).collect();
        Err(Refusal::Undetermined { advice: self.advice(&undetermined), undetermined, hold })
    }

    /// Positions of more than one point are measured.
    fn second_point(&self) -> bool {
        let points =
            self.fitted().filter_map(|(_, file)| if let Kind::Fibre(point) = file.kind { Some(point) } else { None });
        let points: Vec<_> = points.collect();
        points.iter().any(|point| *point != points[0])
    }

    fn advice(&self, undetermined: &[String]) -> String {
        let has = |kind: fn(&Kind) -> bool| self.fitted().any(|(_, file)| kind(&file.kind));
        let lacks = |start: &str| undetermined.iter().any(|name| name.starts_with(start));
        let mut advice = Vec::new();
        if !has(|kind| matches!(kind, Kind::Fibre(_))) {
            advice.push("measure fibre positions (kind: fibre) at poses that use all six axes".to_string());
        } else if lacks("mount.fibre.rot") && !has(|kind| matches!(kind, Kind::Orientation)) {
            advice.push(
                "measure the array's orientation (kind: orientation) or positions of two more of its points (point_um)"
                    .to_string(),
            );
        } else if !has(|kind| matches!(kind, Kind::Orientation)) && !self.second_point() {
            advice.push(
                "positions of one point tell angles by its lever alone: measure with a longer lever, or also the \
                 orientation (kind: orientation) or a second point (point_um)"
                    .to_string(),
            );
        } else if lacks("static") || lacks("axis_offset") || lacks("mount") {
            advice.push("add poses at which more axes, and each on its own, are away from home".to_string());
        }
        let plays = Axis::ALL.into_iter().filter(|axis| undetermined.contains(&backlash_name(*axis)));
        let plays: Vec<&str> = plays.map(Axis::name).collect();
        if !plays.is_empty() {
            advice.push(format!("add bidirectional runs (kind: positioning) of {}", plays.join(", ")));
        }
        advice.join("; ")
    }
}
