//! The section on the accuracy field: errors over linear and over angular motion, before and after compensation.

use super::number::{figure, short};
use super::page::{Section, caption};
use super::plot::{Scale, drawing, line, px, rectangle, text};
use crate::machine::{ErrorName, Machine};
use crate::model::{Accuracy, AccuracyOptions, Ensemble, Field, Motion, MotionAccuracy, Statistics, accuracy};
use maud::{Markup, html};
use serde::Serialize;

/// Errors that differ by less are drawn as one, um: rounding of the computation.
const FLAT_UM: f64 = 1e-7;
/// A coordinate as small as that is home, um or degrees: rounding of the computation.
const AT_HOME: f64 = 1e-6;
/// Colours of a map.
const LEVELS: usize = 16;

/// The length of E in one plane through home, or as near to it as a computed pose is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Map {
    /// The two axes: across, up.
    pub axes: [&'static str; 2],
    /// The third axis.
    pub third: &'static str,
    /// Where the third axis stands, um or degrees: of the poses computed the nearest to home.
    pub third_at: f64,
    /// Coordinates along both, um or degrees.
    pub coordinates: [Vec<f64>; 2],
    /// Length of E, um; the first index counts along the axis across.
    pub norm_um: Vec<Vec<f64>>,
}

/// The planes of one kind of motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Maps {
    /// All errors of the same sign, as in Fig. 5 of the paper.
    pub same_sign: Vec<Map>,
    /// The stage as it is, counted from home.
    pub before: Vec<Map>,
    /// Driven by the controller's law; none when it cannot be.
    pub after: Option<Vec<Map>>,
}

/// Linear and angular field.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fields {
    /// How many of the 36 errors of the stages the machine file gives.
    pub kinematic_errors_given: usize,
    /// What `host-sim field` prints without further options.
    pub accuracy: Accuracy,
    /// Planes through or near home, linear and angular motion.
    pub maps: [Maps; 2],
}

impl Fields {
    pub(super) fn new(machine: &Machine, progress: &(dyn Fn() + Sync)) -> Self {
        let accuracy = accuracy(machine, &AccuracyOptions::default(), progress);
        let maps = accuracy.motions.each_ref().map(|motion| Maps {
            same_sign: planes(&motion.fields.same_sign),
            before: planes(&motion.fields.before),
            after: motion.fields.after.as_ref().map(planes),
        });
        Fields {
            kinematic_errors_given: ErrorName::all().filter(|name| !machine.kinematic.get(*name).is_absent()).count(),
            accuracy,
            maps,
        }
    }
}

fn planes(field: &Field) -> Vec<Map> {
    [[0, 1], [0, 2], [1, 2]].map(|plane| map(field, plane)).into()
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
    let third = 3 - a - b;
    Map {
        third: grid.motion.axes()[third].name(),
        third_at: shown(third)[home[third]],
        axes: [a, b].map(|axis| grid.motion.axes()[axis].name()),
        coordinates: [shown(a), shown(b)],
        norm_um: (0..grid.coordinates[a].len())
            .map(|i| (0..grid.coordinates[b].len()).map(|j| norm(i, j)).collect())
            .collect(),
    }
}

pub(super) fn section(fields: &Fields, refusal: Option<&str>) -> Section {
    let given = fields.kinematic_errors_given;
    let m = &fields.accuracy.magnitudes;
    let body = html! {
        p {
            "Error of the fibre point against the ideal stage over the travel of three axes, the others at home. Same sign: a \
            stage of this geometry with every error as large as in the paper (" (short(m.linear_um)) " um, "
            (short(m.angular_rad * 1e6)) " urad, squarenesses and tilts " (short(m.squareness_rad * 1e6))
            " urad) and positive, as in its Fig. 5. Before: this stage, counted from home (alignment at home removes what is \
            constant). After: driven by the controller\u{2019}s law, which knows the static errors but not the 36 errors of \
            the stages, motors at whole steps, play taken up. The machine file gives " (given) " of those 36"
            @if given == 0 { ": what is shown of this stage comes from the nine static errors and the mounts alone" } "."
        }
        @if let Some(refusal) = refusal { p.warning { "There is no field after compensation: " (refusal) "." } }
        @for (n, (motion, maps)) in fields.accuracy.motions.iter().zip(&fields.maps).enumerate() {
            h3 { (match motion.motion { Motion::Linear => "Linear motion", Motion::Angular => "Angular motion" }) }
            (drawings(motion, maps))
            (numbers(n, motion))
        }
        h3 { "Stages that nobody has measured" }
        (ensembles(&fields.accuracy))
    };
    Section { id: "field", title: "Errors over the travel", body }
}

fn drawings(motion: &MotionAccuracy, maps: &Maps) -> Markup {
    const ROW: f64 = 312.0;
    let unit = if motion.motion == Motion::Linear { "um" } else { "deg" };
    let rows: Vec<(&str, &[Map])> = [
        ("all errors of the same sign (Fig. 5)", Some(&maps.same_sign)),
        ("this stage before compensation", Some(&maps.before)),
        ("this stage after compensation", maps.after.as_ref()),
    ]
    .into_iter()
    .filter_map(|(name, maps)| Some((name, maps?.as_slice())))
    .collect();
    html! {
        @for (name, planes) in &rows {
            @let [least, largest] = ends(planes);
            @let content = html! {
                (text("label", [0.0, 14.0], name))
                @for (n, map) in planes.iter().enumerate() {
                    g transform=(format!("translate({} 44)", px(n as f64 * 290.0))) { (plane(map, [least, largest], unit)) }
                }
                g transform="translate(880 44)" { (key([least, largest])) }
            };
            figure {
                (drawing([960.0, ROW - 20.0], &format!("Length of the error, {name}"), content))
                figcaption {
                    "Length of the position error, um, in three planes, over the coordinates of the stages in " (unit) "; "
                    (thirds(planes, unit)) ". "
                    "The colours are those of this figure alone: from " (short(least)) " to " (short(largest)) " um."
                }
            }
        }
    }
}

/// Where the axes stand that are in no plane, in words.
fn thirds(planes: &[Map], unit: &str) -> String {
    if planes.iter().all(|map| map.third_at.abs() < AT_HOME) {
        return "the third axis of each plane is at home".into();
    }
    let places: Vec<String> =
        planes.iter().map(|map| format!("{} at {} {unit}", map.third, short(map.third_at))).collect();
    format!("the third axis of each plane is as near to home as a computed pose: {}", places.join(", "))
}

/// Least and largest error of some planes, um.
fn ends(planes: &[Map]) -> [f64; 2] {
    let values = || planes.iter().flat_map(|map| map.norm_um.iter().flatten()).copied();
    [values().fold(f64::MAX, f64::min), values().fold(0.0, f64::max)]
}

fn plane(map: &Map, ends_um: [f64; 2], unit: &str) -> Markup {
    let [across, up] = &map.coordinates;
    let travel = |line: &[f64]| [line[0], line[line.len() - 1]];
    let (x, y) = (Scale::linear(travel(across), [56.0, 266.0]), Scale::linear(travel(up), [210.0, 0.0]));
    let (width, height) = (210.0 / across.len() as f64, 210.0 / up.len() as f64);
    let mut levels = vec![String::new(); LEVELS];
    for (i, line) in map.norm_um.iter().enumerate() {
        for (j, value) in line.iter().enumerate() {
            let (left, top) = (56.0 + i as f64 * width, 210.0 - (j + 1) as f64 * height);
            levels[level(*value, ends_um)].push_str(&format!(
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

fn level(value: f64, [least, largest]: [f64; 2]) -> usize {
    let share = if largest - least > FLAT_UM { (value - least) / (largest - least) } else { 0.0 };
    ((share * LEVELS as f64) as usize).min(LEVELS - 1)
}

fn colour(level: usize) -> String {
    format!("fill:color-mix(in oklab,var(--high) {}%,var(--low))", px(level as f64 * 100.0 / (LEVELS - 1) as f64))
}

/// The colours of a row with their values.
fn key(ends_um: [f64; 2]) -> Markup {
    let up = Scale::linear(ends_um, [210.0, 0.0]);
    let height = 210.0 / LEVELS as f64;
    html! {
        @for n in 0..LEVELS {
            @let top = 210.0 - (n + 1) as f64 * height;
            rect style=(colour(n)) shape-rendering="crispEdges" x="0" y=(px(top)) width="14" height=(px(height)) {}
        }
        (rectangle("frame", [0.0, 0.0], [14.0, 210.0]))
        @if ends_um[1] - ends_um[0] > FLAT_UM {
            @for (value, name) in up.ticks() {
                (line("mark", [14.0, up.at(value)], [18.0, up.at(value)]))
                (text("tick", [21.0, up.at(value) + 3.5], &name))
            }
        }
        (text("name", [0.0, -6.0], "um"))
    }
}

fn numbers(n: usize, motion: &MotionAccuracy) -> Markup {
    let rows: [(&str, &str, Option<&Statistics>); 4] = [
        ("same_sign", "same sign", Some(&motion.same_sign)),
        ("before", "before", Some(&motion.before)),
        ("after", "after", motion.after.as_ref()),
        ("after_exact", "after, exact law", motion.after_exact.as_ref()),
    ];
    html! {
        (caption("table", format!(
            "Over {} poses on a grid: largest error along each direction; length of the error; rotation of the array \
            against the ideal one, but for \u{201c}same sign\u{201d} less that at home. A tilt of the array at home turns \
            with the array: that stays after compensation, because the controller counts orientation from home. Exact law: \
            without rounding, motors anywhere.", motion.points.pow(3)
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
                @for (key, name, statistics) in rows {
                    @if let Some(s) = statistics {
                        @let at = |name: &str| format!("/field/accuracy/motions/{n}/{key}/{name}");
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

fn ensembles(accuracy: &Accuracy) -> Markup {
    html! {
        (caption("table", "Stages of this geometry whose errors are only known by their size (the same as above), over the \
            whole travel, without compensation: largest error of a stage, um, as median and 95th percentile over the \
            stages. Random signs: signs by chance. Monte Carlo: sizes and shapes by chance."))
        div.wide { table {
            thead {
                tr {
                    th rowspan="2" { "Motion" } th.left rowspan="2" { "ensemble" } th rowspan="2" { "stages" }
                    th colspan="2" { "X" } th colspan="2" { "Y" } th colspan="2" { "Z" } th colspan="2" { "length" }
                }
                tr { @for _ in 0..4 { th { "p50" } th { "p95" } } }
            }
            tbody {
                @for (n, motion) in accuracy.motions.iter().enumerate() {
                    @for (k, e) in motion.ensembles.iter().enumerate() {
                        @let at = |name: &str| format!("/field/accuracy/motions/{n}/ensembles/{k}/{name}");
                        tr {
                            th { (match motion.motion { Motion::Linear => "linear", Motion::Angular => "angular" }) }
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
