//! What an analog output of the power meter makes of power.

use super::{dbm, milliwatts};

/// Power to voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrontEnd {
    /// A voltage proportional to the power.
    Linear {
        /// Volts per watt.
        volts_per_watt: f64,
    },
    /// A voltage proportional to the power in dB.
    Logarithmic {
        /// dB per volt.
        db_per_volt: f64,
        /// dBm at 0 V.
        dbm_at_zero: f64,
    },
}

impl FrontEnd {
    /// 15 V per mW: a tenth of a milliwatt is 1.5 V.
    pub const LINEAR: FrontEnd = FrontEnd::Linear { volts_per_watt: 15e3 };
    /// 20 dB per volt from -60 dBm: 3.3 V is +6 dBm.
    pub const LOGARITHMIC: FrontEnd = FrontEnd::Logarithmic { db_per_volt: 20.0, dbm_at_zero: -60.0 };

    /// Volts at a power in mW; not below 0.
    pub fn volts(&self, milliwatts: f64) -> f64 {
        let volts = match *self {
            FrontEnd::Linear { volts_per_watt } => milliwatts * 1e-3 * volts_per_watt,
            FrontEnd::Logarithmic { db_per_volt, dbm_at_zero } => (dbm(milliwatts) - dbm_at_zero) / db_per_volt,
        };
        volts.max(0.0)
    }

    /// Power in mW at a voltage.
    pub fn power(&self, volts: f64) -> f64 {
        match *self {
            FrontEnd::Linear { volts_per_watt } => volts / volts_per_watt * 1e3,
            FrontEnd::Logarithmic { db_per_volt, dbm_at_zero } => milliwatts(volts * db_per_volt + dbm_at_zero),
        }
    }
}
