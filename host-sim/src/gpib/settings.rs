//! What the commands of a gateway set.

use super::command::{Address, Setting};
use std::time::Duration;

/// The settings of one client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Settings {
    pub address: Address,
    pub auto: bool,
    pub eoi: bool,
    eos: u8,
    pub eot_enable: bool,
    pub eot_char: u8,
    pub read_timeout: Duration,
    save: bool,
}

impl Settings {
    /// As at the start, with the address of then.
    pub fn new(primary: u8) -> Self {
        Settings {
            address: Address { primary, secondary: None },
            auto: false,
            eoi: true,
            eos: 0,
            eot_enable: false,
            eot_char: 0,
            read_timeout: Duration::from_millis(1000),
            save: true,
        }
    }

    pub fn set(&mut self, setting: Setting, value: u16) {
        match setting {
            Setting::Auto => self.auto = value == 1,
            Setting::Eoi => self.eoi = value == 1,
            Setting::Eos => self.eos = value as u8,
            Setting::EotEnable => self.eot_enable = value == 1,
            Setting::EotChar => self.eot_char = value as u8,
            Setting::Mode => {}
            Setting::ReadTimeout => self.read_timeout = Duration::from_millis(value.into()),
            Setting::SaveConfig => self.save = value == 1,
        }
    }

    pub fn get(&self, setting: Setting) -> u128 {
        match setting {
            Setting::Auto => self.auto.into(),
            Setting::Eoi => self.eoi.into(),
            Setting::Eos => self.eos.into(),
            Setting::EotEnable => self.eot_enable.into(),
            Setting::EotChar => self.eot_char.into(),
            Setting::Mode => 1,
            Setting::ReadTimeout => self.read_timeout.as_millis(),
            Setting::SaveConfig => self.save.into(),
        }
    }

    /// What is appended to a line of data.
    pub fn end(&self) -> &'static [u8] {
        match self.eos {
            0 => b"\r\n",
            1 => b"\r",
            2 => b"\n",
            _ => b"",
        }
    }
}
