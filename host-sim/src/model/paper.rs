//! The numbers that the paper (doi 10.1177/1687814015589503) prints, each beside what this model gives for its inputs.

use super::ensemble::Ensemble;
use super::field::{Grid, Motion, error_field, statistics};
use super::sensitivity::{Background, Magnitudes, Options, Sensitivity, sensitivity};
use crate::machine::Machine;
use serde::Serialize;
use std::f64::consts::PI;

/// Wavelength of the light, um.
const WAVELENGTH_UM: f64 = 1.55;
/// Refractive index between fibre and chip that fits the paper's tilt figure.
const INDEX: f64 = 1.5;
/// Points along each stage for the fields.
const FIELD_POINTS: usize = 21;

/// Whether a printed number comes out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// To all printed digits.
    Reproduced,
    /// Within the rounding of the text, or in quality only.
    Approximately,
    /// Taken as an input here, because something else follows from it.
    Input,
    /// Not from the inputs that the paper gives.
    NotReproduced,
}

impl Verdict {
    /// In words.
    pub const fn words(self) -> &'static str {
        match self {
            Verdict::Reproduced => "reproduced",
            Verdict::Approximately => "approximately",
            Verdict::Input => "taken as input",
            Verdict::NotReproduced => "not reproduced",
        }
    }
}

/// One printed number.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Claim {
    /// What the paper says.
    pub quoted: &'static str,
    /// The printed number, where it is one.
    pub printed: Option<f64>,
    /// What the model gives; none where nothing can be computed.
    pub ours: Option<f64>,
    /// Unit of both.
    pub unit: &'static str,
    /// Whether it comes out.
    pub verdict: Verdict,
    /// How it is computed, or why it cannot be.
    pub why: String,
}

/// A number that can be computed: it is reproduced when it rounds to the printed one in its last digit (`digit`).
fn computed(quoted: &'static str, printed: f64, digit: f64, ours: f64, unit: &'static str, why: String) -> Claim {
    let off = (ours - printed).abs();
    let verdict = match off {
        _ if off <= 0.5 * digit * (1.0 + 1e-9) => Verdict::Reproduced,
        _ if off <= 0.05 * printed.abs() => Verdict::Approximately,
        _ => Verdict::NotReproduced,
    };
    Claim { quoted, printed: Some(printed), ours: Some(ours), unit, verdict, why }
}

fn stated(quoted: &'static str, ours: Option<f64>, unit: &'static str, verdict: Verdict, why: String) -> Claim {
    Claim { quoted, printed: None, ours, unit, verdict, why }
}

/// All numbers of the paper, computed from its own inputs on its own stage.
pub fn paper_claims() -> Vec<Claim> {
    let machine = Machine::paper();
    let table = sensitivity(&machine, &Options { background: Background::Uniform, ..Options::default() });
    let mut claims = sensitivities(&table);
    claims.extend(units());
    claims.extend(fields(&machine));
    claims.extend(optics());
    claims.extend(backlash(&table));
    claims.extend(experiment());
    claims
}

fn row<'t>(table: &'t Sensitivity, iso: &str) -> &'t super::sensitivity::KinematicRow {
    table.kinematic.iter().find(|row| row.iso == iso).expect("the table has all 36 errors")
}

/// Largest magnitude in a direction of the errors of one kind without static errors.
fn largest(table: &Sensitivity, kind: &str, direction: usize) -> f64 {
    let of_kind = table.kinematic.iter().filter(|row| row.kind == kind);
    of_kind.map(|row| row.first_order_um[direction].abs()).fold(0.0, f64::max)
}

fn sensitivities(table: &Sensitivity) -> Vec<Claim> {
    let effect = table.background_first_order_um;
    let resultant = row(table, "EZX").first_order_um[2] + effect[2];
    let exact = row(table, "EZZ").with_static_um[2];
    let cross = table
        .kinematic
        .iter()
        .filter(|row| row.kind == "linear")
        .flat_map(|row| (0..3).map(move |c| (row.no_static_um[c] - row.first_order_um[c]).abs()))
        .fold(0.0, f64::max);
    vec![
        computed(
            "static errors amplify X by 0.06 um",
            0.06,
            0.01,
            effect[0],
            "um",
            "sum of the nine static errors at home, first order: 3 x 50 urad x 500 um - 3 x 50 urad x 100 um".into(),
        ),
        computed(
            "static errors amplify Y by 0.0563 um",
            0.0563,
            0.0001,
            effect[1],
            "um",
            "sum of the nine static errors at home, first order: 3 x 50 urad x 875 um - 3 x 50 urad x 500 um".into(),
        ),
        computed(
            "static errors amplify Z by 0.1838 um",
            0.1838,
            0.0001,
            resultant,
            "um",
            format!(
                "it is the resultant Ez of a displacement of 0.30 um along z with all static errors (exact \
                 {exact:.6} um), no amplification: the static errors alone give {:.5} um, a reduction",
                effect[2]
            ),
        ),
        computed(
            "largest X by an angular error without static errors 0.025 um",
            0.025,
            0.001,
            largest(table, "angular", 0),
            "um",
            format!(
                "rotations about y at a height of 500 um; the largest in Y, by rotations about z, is {:.5} um",
                largest(table, "angular", 1)
            ),
        ),
        computed(
            "linear errors appear equally in the same direction (0.30 um)",
            0.30,
            0.01,
            largest(table, "linear", 0),
            "um",
            format!("without static errors; the other directions change by at most {cross:.5} um"),
        ),
    ]
}

fn units() -> Vec<Claim> {
    let degrees =
        |quoted, printed, digit, rad: f64| computed(quoted, printed, digit, rad.to_degrees(), "deg", "unit".into());
    vec![
        degrees("50 urad is about 0.003 deg", 0.003, 0.001, 50e-6),
        degrees("1.7 mrad is about 0.1 deg", 0.1, 0.1, 1.7e-3),
        computed("0.005 deg is 87 urad", 87.0, 1.0, 0.005_f64.to_radians() * 1e6, "urad", "unit".into()),
        computed("an ideal 1x8 splitter loses 9.03 dB", 9.03, 0.01, 10.0 * 8.0_f64.log10(), "dB", "10 log10 8".into()),
    ]
}

fn fields(machine: &Machine) -> Vec<Claim> {
    let max = |motion, half| {
        let grid = Grid::symmetric(motion, half, FIELD_POINTS);
        let model = Ensemble::SameSign.stage(machine, &Magnitudes::default(), &grid, 0, 0);
        statistics(&error_field(&model, &grid)).max_um()
    };
    let near = max(Motion::Linear, 5.0);
    let far = max(Motion::Linear, 5000.0);
    let small = max(Motion::Angular, 1.7e-3);
    let large = max(Motion::Angular, 5.0_f64.to_radians());
    vec![
        stated(
            "Fig. 5, linear motion: X and Y errors are the same",
            Some(near[0] / near[1]),
            "(ratio X to Y)",
            Verdict::Approximately,
            format!(
                "all errors of the same sign, X and Y at most {:.4} and {:.4} um over +-5 um, the printed travel of \
                 10 um; over +-5 mm, which a stage has, {:.2} and {:.2} um",
                near[0], near[1], far[0], far[1]
            ),
        ),
        stated(
            "Fig. 5, angular motion: the X error is larger",
            Some(large[0] / large[1]),
            "(ratio X to Y)",
            Verdict::Approximately,
            format!(
                "only by a hundredth: {:.4} and {:.4} um over +-1.7 mrad, {:.3} and {:.3} um over +-5 deg",
                small[0], small[1], large[0], large[1]
            ),
        ),
        stated(
            "travel of about 10 um",
            None,
            "",
            Verdict::NotReproduced,
            "cannot be the travel of the stage (10 mm is meant), but what Fig. 5 is said to show holds for +-5 um only"
                .into(),
        ),
    ]
}

fn optics() -> Vec<Claim> {
    let per_neper = 10.0 / 10.0_f64.ln();
    // Gaussian beams of equal width: loss = per_neper (d / w)^2
    let width = (per_neper / 0.15).sqrt();
    let tilt = (0.15 / per_neper).sqrt() * WAVELENGTH_UM / (PI * INDEX * width);
    let gap = |index: f64| (10.0_f64.powf(0.015) - 1.0).sqrt() * 2.0 * PI * index * width * width / WAVELENGTH_UM;
    vec![
        stated(
            "0.15 dB for 1 um of lateral offset",
            Some(width),
            "um",
            Verdict::Input,
            format!("fixes the mode radius w at {width:.3} um (mode field diameter {:.2} um)", 2.0 * width),
        ),
        computed(
            "0.15 dB for 0.65 deg of tilt",
            0.65,
            0.01,
            tilt.to_degrees(),
            "deg",
            format!("with that w, wavelength {WAVELENGTH_UM} um, index {INDEX}"),
        ),
        computed(
            "0.15 dB for 16 um of gap",
            16.0,
            1.0,
            gap(INDEX),
            "um",
            format!(
                "with that w and index {INDEX} ({:.1} um with index 1); {:.1} um, the printed figure, follows only if \
                 the gap is divided by the Rayleigh range instead of twice that",
                gap(1.0),
                0.5 * gap(INDEX)
            ),
        ),
    ]
}

fn backlash(table: &Sensitivity) -> Vec<Claim> {
    let play = 0.005_f64.to_radians();
    let lever = table.fibre_point_um[0];
    vec![
        stated(
            "angular backlash can be ignored",
            Some(play * lever),
            "um",
            Verdict::Approximately,
            format!(
                "0.005 deg at a lever of {lever} um, against 0.3 um of linear backlash; at a lever of 50 mm it is {:.1} \
                 um and cannot be ignored",
                play * 50e3
            ),
        ),
        stated(
            "bidirectional repeatability 0.001 deg with a backlash of 0.005 deg",
            None,
            "",
            Verdict::NotReproduced,
            "the two contradict each other: repeatability from both sides contains the backlash".into(),
        ),
    ]
}

fn experiment() -> Vec<Claim> {
    vec![
        computed(
            "compensation lowers the loss by more than 1 dB (11.14 to 9.92 dB)",
            1.22,
            0.01,
            11.14 - 9.92,
            "dB",
            "difference of the two printed losses".into(),
        ),
        stated(
            "11.14 dB, 0.22 dB, 3 min without and 9.92 dB, 0.20 dB, 2 min with compensation",
            None,
            "",
            Verdict::NotReproduced,
            "the losses follow from where and by what rule the search starts, which the text does not give; only the \
             trend can be derived"
                .into(),
        ),
    ]
}
