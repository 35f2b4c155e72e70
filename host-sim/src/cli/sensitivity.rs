//! `host-sim sensitivity`: what each single error does to the fibre point.

use super::Failure;
use super::common::load;
use super::sheet::{Sheet, Sizes, Style, positive, three};
use crate::model::{Background, Claim, Options, Sensitivity, UnitMotion, paper_claims, sensitivity};
use serde::Serialize;
use std::path::PathBuf;

/// Print what each single error does to the fibre point (tables 5 and 6 of the paper), and rank the sources.
///
/// A kinematic error is taken with its own stage displaced by the unit; static and mounting errors at home and with
/// all stages displaced. The defaults are those of the paper; order, axis offsets, F and the static errors behind
/// table 5 are the machine's.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    machine: PathBuf,
    /// The point F in the fibre array frame, um, such as 875,100,500 [default: the machine's].
    #[arg(long, value_name = "X,Y,Z", value_parser = three, allow_hyphen_values = true)]
    fibre_point_um: Option<[f64; 3]>,
    /// Displacement of X, Y, Z, um.
    #[arg(long, value_name = "UM", default_value = "1", value_parser = positive)]
    unit_um: f64,
    /// Displacement of alpha, beta, gamma, mrad.
    #[arg(long, value_name = "MRAD", default_value = "1.7", value_parser = positive)]
    unit_mrad: f64,
    #[command(flatten)]
    sizes: Sizes,
    /// Static errors behind table 5: the machine's nine, those and its mounts, or all nine as large as --static-urad.
    #[arg(long, value_enum, default_value_t = Behind::Machine)]
    background: Behind,
    /// Errors as large as the machine file says, instead of the sizes: kinematic functions, static errors, mounts.
    #[arg(long)]
    own: bool,
    /// Sources listed for each direction.
    #[arg(long, value_name = "N", default_value_t = 12)]
    top: usize,
    /// Print as well each number of the paper and whether this model reproduces it.
    #[arg(long)]
    paper_numbers: bool,
    #[command(flatten)]
    style: Style,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Behind {
    Machine,
    Mounted,
    Uniform,
}

impl From<Behind> for Background {
    fn from(behind: Behind) -> Self {
        match behind {
            Behind::Machine => Background::Machine,
            Behind::Mounted => Background::Mounted,
            Behind::Uniform => Background::Uniform,
        }
    }
}

#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    table: Sensitivity,
    #[serde(skip_serializing_if = "Option::is_none")]
    paper_numbers: Option<Vec<Claim>>,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        let options = Options {
            fibre_point_um: self.fibre_point_um,
            magnitudes: self.sizes.into(),
            unit: UnitMotion { linear_um: self.unit_um, angle_rad: self.unit_mrad / 1e3 },
            background: self.background.into(),
            own: self.own,
        };
        let report =
            Report { table: sensitivity(&machine, &options), paper_numbers: self.paper_numbers.then(paper_claims) };
        self.style.print(&report, || sheets(&report, self.top))
    }
}

/// um, to the picometre; no minus before zero.
fn um(v: f64) -> String {
    let text = format!("{v:.6}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').into() } else { text }
}

/// A size as people write it: 5e-5, 0.3.
fn size(v: f64) -> String {
    if v != 0.0 && v.abs() < 1e-2 { format!("{v:e}") } else { v.to_string() }
}

fn sheets(report: &Report, top: usize) -> Vec<Sheet> {
    let table = &report.table;
    let [fx, fy, fz] = table.fibre_point_um;
    let about = format!(
        "{}, F = ({fx}, {fy}, {fz}) um, {} um and {} mrad, E in um",
        table.machine,
        table.unit.linear_um,
        table.unit.angle_rad * 1e3
    );
    let kinematic = |title: &str, errors: &dyn Fn(usize) -> [f64; 3]| {
        let header = ["source", "ISO 230-1", "size (um, rad)", "Ex", "Ey", "Ez"];
        let mut sheet = Sheet::new(format!("{title}: {about}"), header);
        for (i, row) in table.kinematic.iter().enumerate() {
            let [x, y, z] = errors(i).map(um);
            sheet.row([row.source.clone(), row.iso.clone(), size(row.value), x, y, z]);
        }
        sheet
    };
    let mut all = vec![
        kinematic("Table 5, with static errors", &|i| table.kinematic[i].with_static_um),
        kinematic("Table 6, without static errors", &|i| table.kinematic[i].no_static_um),
        kinematic("First order, at home", &|i| table.kinematic[i].first_order_um),
    ];
    let mut behind = Sheet::new("Static errors of table 5 alone, at home, um", ["form", "Ex", "Ey", "Ez"]);
    for (form, e) in [("exact", table.background_at_home_um), ("first order", table.background_first_order_um)] {
        behind.row(std::iter::once(form.to_string()).chain(e.map(um)));
    }
    all.push(behind);
    let header = [
        "source",
        "stage",
        "about",
        "size (um, rad)",
        "Ex home",
        "Ey home",
        "Ez home",
        "Ex unit",
        "Ey unit",
        "Ez unit",
    ];
    let mut statics = Sheet::new(format!("Static and mounting errors: {about}"), header);
    for row in &table.statics {
        let head = [row.source.clone(), row.joint.into(), row.about.into(), size(row.value)];
        statics.row(head.into_iter().chain(row.at_home_um.map(um)).chain(row.at_unit_pose_um.map(um)));
    }
    all.push(statics);
    for (direction, ranks) in ["x", "y", "z"].iter().zip(&table.ranking) {
        let mut sheet = Sheet::new(format!("Strongest sources along {direction}, um"), ["source", "ISO 230-1", "E"]);
        ranks.iter().take(top).for_each(|rank| sheet.row([rank.source.clone(), rank.iso.clone(), um(rank.effect_um)]));
        all.push(sheet);
    }
    if let Some(claims) = &report.paper_numbers {
        let mut sheet =
            Sheet::new("The numbers of the paper", ["quoted", "printed", "here", "unit", "verdict", "how or why not"]);
        for claim in claims {
            let number = |v: Option<f64>| {
                v.map_or("-".into(), |v| format!("{:.6}", v).trim_end_matches('0').trim_end_matches('.').to_string())
            };
            sheet.row([
                claim.quoted.into(),
                number(claim.printed),
                number(claim.ours),
                claim.unit.into(),
                claim.verdict.words().into(),
                claim.why.clone(),
            ]);
        }
        all.push(sheet);
    }
    all
}
