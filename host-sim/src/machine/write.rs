//! Writes machine files: complete, with units, read back as the same machine.

use super::file::NRAD_PER_DEG;
use super::{ErrorName, Function, Machine, StaticErrors};
use stage_controller::units::Axis;
use std::fmt::Write;

/// The text of a machine file. Reading it gives the same machine to the last bit for every machine that came from a
/// file, and to one unit in the last place of a number for any other.
pub fn to_toml(machine: &Machine) -> String {
    to_toml_with(machine, &[], |_| None)
}

/// The same with comment lines on top and a comment behind the keys for which `note` has one (`static_rad.S_XY`,
/// `mount.chip.rot_rad`, `axes.X.backlash_nm`).
pub fn to_toml_with(machine: &Machine, header: &[String], note: impl Fn(&str) -> Option<String>) -> String {
    let mut text = String::new();
    let mut line = |content: String, key: &str| {
        let comment = note(key).map_or(String::new(), |note| format!("  # {}", note.replace(['\n', '\r'], " ")));
        writeln!(text, "{content}{comment}").expect("writing to a string");
    };
    for comment in header.iter().flat_map(|comment| comment.lines()) {
        line(format!("# {comment}"), "");
    }
    let order = machine.order.map(|axis| format!("\"{}\"", axis.name())).join(", ");
    line(format!("name = {:?}", machine.name), "name");
    line(format!("order = [{order}]  # from the base to the fibre array"), "order");
    line(
        format!("fibre_point_um = {}  # F, in the fibre array frame", row(machine.fibre_point_nm, 1e3)),
        "fibre_point_um",
    );
    line("\n[axis_offset_um]  # nominal position of a joint frame in the one before it".into(), "axis_offset_um");
    for axis in Axis::ALL {
        let name = axis.name();
        let offset = row(machine.axis_offset_nm[axis.index()], 1e3);
        line(format!("{name} = {offset}"), &format!("axis_offset_um.{name}"));
    }
    line("\n[static_rad]  # the nine position-independent angular errors".into(), "static_rad");
    for (name, value) in StaticErrors::NAMES.into_iter().zip(machine.statics.values()) {
        line(format!("{name} = {}", number(value, 1.0)), &format!("static_rad.{name}"));
    }
    for (name, mount) in [("fibre", machine.mounts.fibre), ("chip", machine.mounts.chip)] {
        let frame = if name == "fibre" { "the fibre array on the last stage" } else { "the chip on the base" };
        line(format!("\n[mount.{name}]  # {frame}"), &format!("mount.{name}"));
        line(format!("offset_um = {}", row(mount.offset_nm, 1e3)), &format!("mount.{name}.offset_um"));
        line(format!("rot_rad = {}", row(mount.rotation_rad, 1.0)), &format!("mount.{name}.rot_rad"));
    }
    for axis in Axis::ALL {
        let given: Vec<_> = ErrorName::all()
            .filter(|name| name.axis == axis)
            .map(|name| (name.iso(), machine.kinematic.get(name)))
            .filter(|(_, function)| !function.is_absent())
            .collect();
        if given.is_empty() {
            continue;
        }
        let (name, unit) = (axis.name(), if axis.is_rotary() { "deg" } else { "um" });
        line(
            format!("\n[kinematic.{name}]  # functions of the position in {unit}: um, and rad for rotations"),
            &format!("kinematic.{name}"),
        );
        for (error, function) in given {
            line(format!("{error} = {{ {} }}", forms(function)), &format!("kinematic.{name}.{error}"));
        }
    }
    for axis in Axis::ALL {
        let (fine, coarse, scale) = if axis.is_rotary() { ("nrad", "deg", NRAD_PER_DEG) } else { ("nm", "um", 1e3) };
        let (name, drive) = (axis.name(), &machine.drives[axis.index()]);
        line(format!("\n[axes.{name}]"), &format!("axes.{name}"));
        let mut entry = |key: String, value: String| line(format!("{key} = {value}"), &format!("axes.{name}.{key}"));
        entry(format!("step_{fine}"), number(drive.step, 1.0));
        entry(format!("backlash_{fine}"), number(drive.backlash, 1.0));
        entry(format!("travel_{coarse}"), row(drive.travel, scale));
        entry(format!("switches_{coarse}"), row(drive.switches, scale));
        entry(format!("max_velocity_{coarse}_s"), number(drive.velocity, scale));
        entry(format!("max_acceleration_{coarse}_s2"), number(drive.acceleration, scale));
        entry(format!("max_jerk_{coarse}_s3"), number(drive.jerk, scale));
    }
    text
}

/// The forms of a kinematic error that are given.
fn forms(function: &Function) -> String {
    fn rows<const N: usize>(rows: &[[f64; N]]) -> String {
        rows.iter().map(|values| row(*values, 1.0)).collect::<Vec<_>>().join(", ")
    }
    let (poly, table, fourier) = function.parts();
    let poly = poly.iter().map(|c| number(*c, 1.0)).collect::<Vec<_>>().join(", ");
    [("poly", poly), ("table", rows(table)), ("fourier", rows(fourier))]
        .into_iter()
        .filter(|(_, values)| !values.is_empty())
        .map(|(form, values)| format!("{form} = [{values}]"))
        .collect::<Vec<_>>()
        .join(", ")
}

fn row<const N: usize>(values: [f64; N], scale: f64) -> String {
    format!("[{}]", values.map(|value| number(value, scale)).join(", "))
}

/// The shortest decimal that, read and multiplied by `scale`, is `value` again.
fn number(value: f64, scale: f64) -> String {
    let quotient = value / scale;
    let reads_back = |text: &str| text.parse::<f64>().is_ok_and(|read| read * scale == value);
    let candidates = [quotient, quotient.next_up(), quotient.next_down()];
    let short = (0..17).map(|digits| format!("{quotient:.digits$e}"));
    let exact = candidates.map(|candidate| format!("{candidate:?}"));
    let text = short.chain(exact).find(|text| reads_back(text)).unwrap_or_else(|| format!("{quotient:?}"));
    // the usual notation where it is shorter
    text.parse::<f64>().map_or(text, |read| format!("{read:?}"))
}
