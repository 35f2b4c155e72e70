//! A setting with its range: query, `MIN|MAX|DEF`, and the check of a new value.

use crate::error::{Error, ErrorNumber};
use crate::scpi::params::Params;
use crate::scpi::parser::Call;

/// A value with its range and default, in the integer of its unit.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
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
        Setting { now: now.into(), least: 0, most: 1, default: default.into() }
    }

    /// Answers the query, or gives the new value, within the range.
    ///
    /// # Errors
    /// Those of the parameter, -222 beyond the range.
    pub fn access(
        self,
        call: &Call<'_>,
        parse: impl Fn(&mut Params<'_>) -> Result<i64, Error>,
        answer: impl FnMut(i64),
    ) -> Result<Option<i64>, Error> {
        let mut answer = answer;
        self.access_by(call, &parse, &mut answer)
    }

    /// [`Setting::access`], of which the firmware has room for one only.
    #[inline(never)]
    fn access_by(
        self,
        call: &Call<'_>,
        parse: &dyn Fn(&mut Params<'_>) -> Result<i64, Error>,
        answer: &mut dyn FnMut(i64),
    ) -> Result<Option<i64>, Error> {
        let mut params = call.params;
        if call.query {
            let extreme = params.optional_extreme()?;
            answer(extreme.map_or(self.now, |e| e.pick(self.least, self.most, self.default)));
            return Ok(None);
        }
        let mut text = params;
        let value = params.setting(parse)?.resolve(self.least, self.most, self.default);
        params.end()?;
        if !(self.least..=self.most).contains(&value) {
            return Err(Error::token(ErrorNumber::DataOutOfRange, text.token()?));
        }
        Ok(Some(value))
    }

    /// [`Setting::access`] of `ON|OFF`.
    ///
    /// # Errors
    /// As [`Setting::access`].
    pub fn access_switch(self, call: &Call<'_>, answer: impl FnMut(i64)) -> Result<Option<bool>, Error> {
        Ok(self.access(call, |p| p.boolean().map(i64::from), answer)?.map(|v| v != 0))
    }
}

/// ns of a number of ms: the unit of times in the language is the ns.
pub const fn nanoseconds(milliseconds: i64) -> i64 {
    milliseconds * 1_000_000
}
