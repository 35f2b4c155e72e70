//! What a parameter is, and how the manual and the command tree in JSON describe it.

/// What a parameter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Coordinate of the header's axis: um or deg.
    Coordinate,
    /// Distance of the header's axis, `STEP` allowed.
    Displacement,
    /// Rate of the header's axis: 1 velocity, 2 acceleration, 3 jerk.
    Rate(u8),
    /// Size of a motor step of the header's axis.
    StepSize,
    /// `ON|OFF|1|0`.
    Boolean,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// Whole number within these bounds.
    Integer(i64, i64),
    /// Seconds.
    Time,
    /// Percent.
    Percent,
    /// Six coordinates.
    Pose,
    /// Six distances, `STEP` allowed.
    PoseDelta,
    /// Three lengths x, y, z.
    Point,
    /// Definite block.
    Block,
    /// String.
    Text,
    /// Number of an axis, 1..6.
    AxisNumber,
    /// List of axes, `(@1,2)`.
    AxisList,
    /// Length or angle of the axis that was named before.
    Span,
    /// dBm.
    Level,
    /// What an input's voltage means: two numbers or three.
    Meter,
    /// `MIN|MAX|DEF` in a query.
    Extreme,
}

/// A parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Param {
    /// Its name in the manual.
    pub name: &'static str,
    /// What it is.
    pub kind: Kind,
    /// It may be missing (the last ones only).
    pub optional: bool,
    /// `MIN|MAX|DEF` are allowed as well.
    pub extremes: bool,
}

impl Param {
    /// Texts between commas that it takes.
    pub const fn width(&self) -> usize {
        match self.kind {
            Kind::Pose | Kind::PoseDelta => 6,
            Kind::Point => 3,
            Kind::Meter => 2,
            _ => 1,
        }
    }
}

/// Fewest and most texts between commas that these take.
pub(super) const fn arity(params: &[Param]) -> (u8, u8) {
    let (mut least, mut most, mut n) = (0, 0, 0);
    while n < params.len() {
        let width = params[n].width() as u8;
        most += width + matches!(params[n].kind, Kind::Meter) as u8;
        if !params[n].optional {
            least += width;
        }
        n += 1;
    }
    (least, most)
}

impl Kind {
    /// Its name in the manual and in the command tree.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Coordinate => "coordinate",
            Kind::Displacement => "distance",
            Kind::Rate(1) => "velocity",
            Kind::Rate(2) => "acceleration",
            Kind::Rate(_) => "jerk",
            Kind::StepSize => "step size",
            Kind::Boolean => "switch",
            Kind::Choice(_) => "word",
            Kind::Integer(..) => "whole number",
            Kind::Time => "time",
            Kind::Percent => "percent",
            Kind::Pose => "six coordinates",
            Kind::PoseDelta => "six distances",
            Kind::Point => "three lengths",
            Kind::Block => "definite block",
            Kind::Text => "string",
            Kind::AxisNumber => "number of an axis",
            Kind::AxisList => "list of axes",
            Kind::Span => "distance",
            Kind::Level => "power",
            Kind::Meter => "LINear,<W/V> or LOGarithmic,<dB/V>,<dBm at 0 V>",
            Kind::Extreme => "MIN, MAX or DEF",
        }
    }

    /// The unit of a number without suffix; of linear and of rotary axes where they differ. Empty: none.
    pub const fn unit(self) -> &'static str {
        match self {
            Kind::Coordinate | Kind::StepSize | Kind::Span => "um or deg",
            Kind::Displacement => "um or deg; STEP",
            Kind::Rate(1) => "um/s or deg/s",
            Kind::Rate(2) => "um/s2 or deg/s2",
            Kind::Rate(_) => "um/s3 or deg/s3",
            Kind::Time => "s",
            Kind::Percent => "%",
            Kind::Pose => "um, um, um, deg, deg, deg",
            Kind::PoseDelta => "um, um, um, deg, deg, deg; STEP",
            Kind::Point => "um",
            Kind::Level => "dBm",
            Kind::AxisNumber
            | Kind::AxisList
            | Kind::Meter
            | Kind::Boolean
            | Kind::Choice(_)
            | Kind::Integer(..)
            | Kind::Block
            | Kind::Text
            | Kind::Extreme => "",
        }
    }
}
