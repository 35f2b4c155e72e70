//! The section on the accuracy field: errors over linear and over angular motion, before and after compensation.

use super::number::figure;
use super::page::{Section, caption};
use super::plot::{Scale, drawing, line, px, rectangle, text};
use crate::machine::{ErrorName, Machine};
use crate::model::{
    Compensation, Ensemble, EnsembleStatistics, ErrorModel, Field, Grid, Magnitudes, Motion, Statistics,
    compensated_field, ensemble, error_field, statistics,
};
use maud::{Markup, html};
use serde::Serialize;
use stage_controller::units::AXES;

/// Points along each of three axes; odd, so that home lies on a point of a symmetric travel.
const POINTS: usize = 21;
/// The same for ensembles, of which there are many fields.
const ENSEMBLE_POINTS: usize = 7;
const STAGES: usize = 200;
const SEED: u64 = 1;
const ENSEMBLES: [Ensemble; 3] = [Ensemble::SameSign, Ensemble::RandomSigns, Ensemble::MonteCarlo];
/// Colours of a map.
const LEVELS: usize = 16;

/// The length of E in one plane through home.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Map {
    /// The two axes: across, up.
    pub axes: [&'static str; 2],
    /// Coordinates along both, um or degrees.
    pub coordinates: [Vec<f64>; 2],
    /// Length of E, um; the first index counts along the axis across.
    pub norm_um: Vec<Vec<f64>>,
}

/// Field of one kind of motion, before or after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Half {
    /// Over the whole grid.
    pub statistics: Statistics,
    /// Planes through home.
    pub maps: Vec<Map>,
}

/// One kind of motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionField {
    /// Which stages move.
    pub motion: Motion,
    /// Poses of the grid.
    pub poses: usize,
    /// The stage as it is, counted from home.
    pub before: Half,
    /// Driven by the controller's law; none when it cannot be.
    pub after: Option<Half>,
    /// Stages of which only the size of the errors is known.
    pub ensembles: Vec<EnsembleStatistics>,
}

/// Linear and angular field.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fields {
    /// How many of the 36 errors of the stages the machine file gives.
    pub kinematic_errors_given: usize,
    /// Size of the errors in the ensembles.
    pub magnitudes: Magnitudes,
    /// Linear motion, angular motion.
    pub motions: Vec<MotionField>,
}

impl Fields {
    pub(super) fn new(machine: &Machine) -> Self {
        let model = ErrorModel::of(machine);
        let magnitudes = Magnitudes::default();
        let one = |motion| {
            let grid = Grid::travel(machine, motion, POINTS);
            let before = error_field(&model, &grid).from_home(&model.error_at([0.0; AXES]));
            let after = compensated_field(machine, &model, &grid, Compensation::Controller).ok();
            let coarse = Grid::travel(machine, motion, ENSEMBLE_POINTS);
            MotionField {
                motion,
                poses: grid.len(),
                before: half(&before),
                after: after.as_ref().map(half),
                ensembles: ENSEMBLES
                    .map(|kind| ensemble(machine, kind, &magnitudes, &coarse, STAGES, SEED, &|| ()))
                    .into(),
            }
        };
        Fields {
            kinematic_errors_given: ErrorName::all().filter(|name| !machine.kinematic.get(*name).is_absent()).count(),
            magnitudes,
            motions: [Motion::Linear, Motion::Angular].map(one).into(),
        }
    }
}

fn half(field: &Field) -> Half {
    Half { statistics: statistics(field), maps: [[0, 1], [0, 2], [1, 2]].map(|plane| map(field, plane)).into() }
}

/// The plane of two axes through the point of the third that is nearest to home.
fn map(field: &Field, [a, b]: [usize; 2]) -> Map {
    let grid = &field.grid;
    let nearest = |line: &[f64]| (0..line.len()).min_by(|&i, &j| line[i].abs().total_cmp(&line[j].abs())).unwrap_or(0);
    let home = grid.coordinates.each_ref().map(|line| nearest(line));
    let norm = |i: usize, j: usize| {
        let mut at = home;
        (at[a], at[b]) = (i, j);
        field.at(at).iter().map(|v| v * v).sum::<f64>().sqrt()
    };
    let shown = |axis: usize| {
        let unit = |q: &f64| if grid.motion == Motion::Angular { q.to_degrees() } else { *q };
        grid.coordinates[axis].iter().map(unit).collect::<Vec<_>>()
    };
    Map {
        axes: [a, b].map(|axis| grid.motion.axes()[axis].name()),
        coordinates: [shown(a), shown(b)],
        norm_um: (0..grid.coordinates[a].len())
            .map(|i| (0..grid.coordinates[b].len()).map(|j| norm(i, j)).collect())
            .collect(),
    }
}

pub(super) fn section(fields: &Fields, refusal: Option<&str>) -> Section {
    let given = fields.kinematic_errors_given;
    let body = html! {
        p {
            "Error of the fibre point against the ideal stage over the travel, counted from home (alignment at home removes \
            what is constant). The machine file gives " (given) " of the 36 errors of the stages as functions of their \
            position" @if given == 0 { ": what is shown comes from the nine static errors and the mounts alone" } ". After: \
            driven by the controller\u{2019}s law, which knows the static errors but not those 36, motors at whole steps, \
            play taken up."
        }
        @if let Some(refusal) = refusal { p.warning { "There is no field after compensation: " (refusal) "." } }
        @for (n, field) in fields.motions.iter().enumerate() {
            h3 { (match field.motion { Motion::Linear => "Linear motion", Motion::Angular => "Angular motion" }) }
            (maps(field))
            (numbers(n, field))
        }
        h3 { "Stages that nobody has measured" }
        (ensembles(fields))
    };
    Section { id: "field", title: "Errors over the travel", body }
}

fn maps(field: &MotionField) -> Markup {
    let unit = if field.motion == Motion::Linear { "um" } else { "deg" };
    let row = |half: &Half, name: &str, top: f64| {
        let largest = half.maps.iter().flat_map(|map| map.norm_um.iter().flatten()).copied().fold(0.0, f64::max);
        html! {
            g transform=(format!("translate(0 {})", px(top))) {
                (text("label", [0.0, 14.0], name))
                @for (n, map) in half.maps.iter().enumerate() {
                    g transform=(format!("translate({} 44)", px(n as f64 * 290.0))) { (plane(map, largest, unit)) }
                }
                g transform="translate(880 44)" { (key(largest)) }
            }
        }
    };
    let halves = 1 + usize::from(field.after.is_some());
    let content = html! {
        (row(&field.before, "before compensation", 0.0))
        @if let Some(after) = &field.after { (row(after, "after compensation (its own colours)", 312.0)) }
    };
    html! {
        figure {
            (drawing([960.0, 312.0 * halves as f64 - 20.0], "Length of the error in three planes through home", content))
            figcaption {
                "Length of the position error, um, in three planes through home, over the coordinates of the stages in "
                (unit) "; the third stage of each plane is at home. Each row has colours of its own, see the scale at its \
                right."
            }
        }
    }
}

fn plane(map: &Map, largest: f64, unit: &str) -> Markup {
    let [across, up] = &map.coordinates;
    let ends = |line: &[f64]| [line[0], line[line.len() - 1]];
    let (x, y) = (Scale::linear(ends(across), [56.0, 266.0]), Scale::linear(ends(up), [210.0, 0.0]));
    let (width, height) = (210.0 / across.len() as f64, 210.0 / up.len() as f64);
    let mut levels = vec![String::new(); LEVELS];
    for (i, line) in map.norm_um.iter().enumerate() {
        for (j, value) in line.iter().enumerate() {
            let (left, top) = (56.0 + i as f64 * width, 210.0 - (j + 1) as f64 * height);
            levels[level(*value, largest)].push_str(&format!(
                "M{} {}h{}v{}h-{}z",
                px(left),
                px(top),
                px(width),
                px(height),
                px(width)
            ));
        }
    }
    html! {
        @for (n, path) in levels.iter().enumerate() {
            @if !path.is_empty() { path style=(colour(n)) shape-rendering="crispEdges" d=(path) {} }
        }
        (rectangle("frame", [56.0, 0.0], [266.0, 210.0]))
        @for (value, name) in x.ticks() {
            (line("mark", [x.at(value), 210.0], [x.at(value), 214.0]))
            (text("tick middle", [x.at(value), 226.0], &name))
        }
        @for (value, name) in y.ticks() {
            (line("mark", [52.0, y.at(value)], [56.0, y.at(value)]))
            (text("tick end", [49.0, y.at(value) + 3.5], &name))
        }
        (text("name middle", [161.0, 242.0], &format!("{}, {unit}", map.axes[0])))
        (text("name", [58.0, -6.0], &format!("{}, {unit}", map.axes[1])))
    }
}

fn level(value: f64, largest: f64) -> usize {
    if largest > 0.0 { ((value / largest * LEVELS as f64) as usize).min(LEVELS - 1) } else { 0 }
}

fn colour(level: usize) -> String {
    format!("fill:color-mix(in oklab,var(--high) {}%,var(--low))", px(level as f64 * 100.0 / (LEVELS - 1) as f64))
}

/// The colours of a row with their values.
fn key(largest: f64) -> Markup {
    let up = Scale::linear([0.0, largest], [210.0, 0.0]);
    let height = 210.0 / LEVELS as f64;
    html! {
        @for n in 0..LEVELS {
            @let top = 210.0 - (n + 1) as f64 * height;
            rect style=(colour(n)) shape-rendering="crispEdges" x="0" y=(px(top)) width="14" height=(px(height)) {}
        }
        (rectangle("frame", [0.0, 0.0], [14.0, 210.0]))
        @if largest > 0.0 {
            @for (value, name) in up.ticks() {
                (line("mark", [14.0, up.at(value)], [18.0, up.at(value)]))
                (text("tick", [21.0, up.at(value) + 3.5], &name))
            }
        }
        (text("name", [0.0, -6.0], "um"))
    }
}

fn numbers(n: usize, field: &MotionField) -> Markup {
    let halves = [("before", "before", Some(&field.before)), ("after", "after", field.after.as_ref())];
    html! {
        (caption("table", format!(
            "Over {} poses on a grid: largest error along each direction; length of the error; rotation of the array \
            against the ideal one less that at home. A tilt of the array at home turns with the array: that stays after \
            compensation, because the controller counts orientation from home.", field.poses
        )))
        div.wide { table {
            thead {
                tr {
                    th rowspan="2" { "" } th colspan="3" { "largest, um" } th colspan="4" { "length, um" }
                    th colspan="2" { "rotation, urad" }
                }
                tr { @for name in ["X", "Y", "Z", "max", "rms", "p50", "p95", "max", "rms"] { th { (name) } } }
            }
            tbody {
                @for (key, name, half) in halves {
                    @if let Some(Half { statistics: s, .. }) = half {
                        @let at = |name: &str| format!("/field/motions/{n}/{key}/statistics/{name}");
                        tr {
                            th { (name) }
                            td { (figure(at("x_um/max"), s.x_um.max)) }
                            td { (figure(at("y_um/max"), s.y_um.max)) }
                            td { (figure(at("z_um/max"), s.z_um.max)) }
                            td { (figure(at("norm_um/max"), s.norm_um.max)) }
                            td { (figure(at("norm_um/rms"), s.norm_um.rms)) }
                            td { (figure(at("norm_um/p50"), s.norm_um.p50)) }
                            td { (figure(at("norm_um/p95"), s.norm_um.p95)) }
                            td { (figure(at("rotation_urad/max"), s.rotation_urad.max)) }
                            td { (figure(at("rotation_urad/rms"), s.rotation_urad.rms)) }
                        }
                    }
                }
            }
        } }
    }
}

fn ensembles(fields: &Fields) -> Markup {
    let m = &fields.magnitudes;
    html! {
        (caption("table", html! {
            "Stages of this geometry whose errors are only known by size (" (super::number::short(m.linear_um)) " um, "
            (super::number::short(m.angular_rad * 1e6)) " urad, squarenesses and tilts "
            (super::number::short(m.squareness_rad * 1e6)) " urad), over the whole travel, without compensation: largest \
            error of a stage, um, as median and 95th percentile over the stages. Same sign: every error positive, one \
            stage. Random signs: signs by chance. Monte Carlo: sizes and shapes by chance."
        }))
        div.wide { table {
            thead {
                tr {
                    th rowspan="2" { "Motion" } th.left rowspan="2" { "ensemble" } th rowspan="2" { "stages" }
                    th colspan="2" { "X" } th colspan="2" { "Y" } th colspan="2" { "Z" } th colspan="2" { "length" }
                }
                tr { @for _ in 0..4 { th { "p50" } th { "p95" } } }
            }
            tbody {
                @for (n, field) in fields.motions.iter().enumerate() {
                    @for (k, e) in field.ensembles.iter().enumerate() {
                        @let at = |name: &str| format!("/field/motions/{n}/ensembles/{k}/{name}");
                        tr {
                            th { (match field.motion { Motion::Linear => "linear", Motion::Angular => "angular" }) }
                            td.left { (match e.ensemble {
                                Ensemble::SameSign => "same sign",
                                Ensemble::RandomSigns => "random signs",
                                Ensemble::MonteCarlo => "Monte Carlo",
                            }) }
                            td { (e.stages) }
                            @for c in 0..3 {
                                td { (figure(at(&format!("max_um/{c}/median")), e.max_um[c].median)) }
                                td { (figure(at(&format!("max_um/{c}/p95")), e.max_um[c].p95)) }
                            }
                            td { (figure(at("norm_max_um/median"), e.norm_max_um.median)) }
                            td { (figure(at("norm_max_um/p95"), e.norm_max_um.p95)) }
                        }
                    }
                }
            }
        } }
    }
}
