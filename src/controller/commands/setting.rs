//! A setting with its range: query, `MIN|MAX|DEF`, and the check of a new value.

use crate::error::{Error, ErrorNumber};
use crate::scpi::params::Params;
use crate::scpi::parser::Call;
use crate::scpi::response::{Response, axis_unit};
use crate::units::Axis;
use crate::units::decimal::Unit;

/// How a value is written and answered, as an integer.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// `ON|OFF`, 1 or 0; answered 1 or 0.
    Switch,
    /// The index of a word; answered in its short form.
    Words(&'static [&'static str]),
    /// The integer of the unit.
    Number(Unit),
    /// nm or nrad, within the range of coordinates.
    Coordinate(Axis),
    /// The size of a motor's step, Q32 nm or nrad.
    StepSize(Axis),
}

impl Kind {
    fn parse(self, params: &mut Params<'_>) -> Result<i64, Error> {
        match self {
            Kind::Switch => params.boolean().map(i64::from),
            Kind::Words(words) => params.choice(words).map(|index| index as i64),
            Kind::Number(unit) => params.number(unit),
            Kind::Coordinate(axis) => params.coordinate(axis).map(i64::from),
            Kind::StepSize(axis) => params.step_size_q32(axis),
        }
    }

    fn answer(self, value: i64, out: &mut Response) {
        match self {
            Kind::Switch => out.integer(value),
            Kind::Words(words) => out.short_form(words.get(value as usize).unwrap_or(&"")),
            Kind::Number(unit) => out.quantity(value, unit),
            Kind::Coordinate(axis) => out.axis_quantity(axis, value, 0),
            Kind::StepSize(axis) => out.fine_quantity(value, axis_unit(axis)),
        }
    }
}

/// A value with its range and default, in the integer of its kind.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// How it is written and answered.
    pub kind: Kind,
    /// In force.
    pub now: i64,
    /// Least.
    pub least: i64,
    /// Most.
    pub most: i64,
    /// Default.
    pub default: i64,
}

impl Setting {
    /// A switch.
    pub fn switch(now: bool, default: bool) -> Self {
        Setting { kind: Kind::Switch, now: now.into(), least: 0, most: 1, default: default.into() }
    }

    /// Answers the query, or gives the new value, within the range.
    ///
    /// # Errors
    /// Those of the parameter, -222 beyond the range.
    #[inline(never)]
    pub fn access(self, call: &Call<'_>, out: &mut Response) -> Result<Option<i64>, Error> {
        let mut params = call.params;
        if call.query {
            let extreme = params.optional_extreme()?;
            self.kind.answer(extreme.map_or(self.now, |e| e.pick(self.least, self.most, self.default)), out);
            return Ok(None);
        }
        let mut text = params;
        let value = params.setting(|p| self.kind.parse(p))?.resolve(self.least, self.most, self.default);
        params.end()?;
        if !(self.least..=self.most).contains(&value) {
            return Err(Error::token(ErrorNumber::DataOutOfRange, text.token()?));
        }
        Ok(Some(value))
    }

    /// [`Setting::access`] of a switch.
    ///
    /// # Errors
    /// As [`Setting::access`].
    pub fn access_switch(self, call: &Call<'_>, out: &mut Response) -> Result<Option<bool>, Error> {
        Ok(self.access(call, out)?.map(|v| v != 0))
    }
}

/// ns of a number of ms: the unit of times in the language is the ns.
pub const fn nanoseconds(milliseconds: i64) -> i64 {
    milliseconds * 1_000_000
}
