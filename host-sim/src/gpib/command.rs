//! The commands of the gateway, as a Prologix GPIB-ETHERNET controller (manual of version 1.6.6.0, chapter 9) has them.

/// Primary address of an instrument; a secondary one reaches nobody here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Address {
    pub primary: u8,
    /// 96 to 126.
    pub secondary: Option<u8>,
}

/// What ends a read, besides END and the time-out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Until {
    End,
    Byte(u8),
}

/// A setting that is a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Setting {
    Auto,
    Eoi,
    Eos,
    EotEnable,
    EotChar,
    Mode,
    ReadTimeout,
    SaveConfig,
}

/// A command; without a value, settings are asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Command {
    Address(Option<Address>),
    Set(Setting, u16),
    Ask(Setting),
    Read(Until),
    /// At the current address, or another.
    SerialPoll(Option<Address>),
    ServiceRequest,
    Clear,
    /// At the current address, or others.
    Trigger(Vec<Address>),
    Local,
    LockOut,
    InterfaceClear,
    Version,
    Reset,
    Help,
}

/// What `++help` says, and all that is understood.
pub(super) const HELP: &str = "\
++addr [0-30 [96-126]]      address of the instrument
++auto [0|1]                read after each line that is sent
++clr                       device clear (SDC)
++eoi [0|1]                 EOI with the last byte that is sent
++eos [0|1|2|3]             appended to what is sent: CR LF, CR, LF, nothing
++eot_char [0-255]          what eot_enable appends
++eot_enable [0|1]          appends eot_char to what is read with EOI
++help                      this text
++ifc                       interface clear
++llo                       local lockout
++loc                       go to local
++mode [1]                  always the controller
++read [eoi|0-255]          reads until EOI, or that byte, or until nothing comes for read_tmo_ms
++read_tmo_ms [1-3000]      longest pause of a read, ms
++rst                       settings as at the start
++savecfg [0|1]             kept for compatibility
++spoll [0-30 [96-126]]     serial poll
++srq                       1: some instrument requests service
++trg [0-30 [96-126]] ...   trigger, up to 15 addresses
++ver                       version
";

impl Command {
    /// Reads the text behind `++`; none when it is not understood.
    pub fn parse(text: &str) -> Option<Self> {
        let mut words = text.split_ascii_whitespace();
        let name = words.next()?.to_ascii_lowercase();
        let values: Vec<&str> = words.collect();
        let setting = |setting, range: std::ops::RangeInclusive<u16>| match values[..] {
            [] => Some(Command::Ask(setting)),
            [value] => Some(Command::Set(setting, value.parse().ok().filter(|value| range.contains(value))?)),
            _ => None,
        };
        let alone = |command| values.is_empty().then_some(command);
        let one = |made: fn(Option<Address>) -> Command| match addresses(&values)?[..] {
            [] => Some(made(None)),
            [address] => Some(made(Some(address))),
            _ => None,
        };
        match name.as_str() {
            "addr" => one(Command::Address),
            "auto" => setting(Setting::Auto, 0..=1),
            "clr" => alone(Command::Clear),
            "eoi" => setting(Setting::Eoi, 0..=1),
            "eos" => setting(Setting::Eos, 0..=3),
            "eot_char" => setting(Setting::EotChar, 0..=255),
            "eot_enable" => setting(Setting::EotEnable, 0..=1),
            "help" => alone(Command::Help),
            "ifc" => alone(Command::InterfaceClear),
            "llo" => alone(Command::LockOut),
            "loc" => alone(Command::Local),
            // a gateway that is itself a device has nobody to control it here
            "mode" => setting(Setting::Mode, 1..=1),
            "read" => match values[..] {
                [] => Some(Command::Read(Until::End)),
                [word] if word.eq_ignore_ascii_case("eoi") => Some(Command::Read(Until::End)),
                [byte] => Some(Command::Read(Until::Byte(byte.parse().ok()?))),
                _ => None,
            },
            "read_tmo_ms" => setting(Setting::ReadTimeout, 1..=3000),
            "rst" => alone(Command::Reset),
            "savecfg" => setting(Setting::SaveConfig, 0..=1),
            "spoll" => one(Command::SerialPoll),
            "srq" => alone(Command::ServiceRequest),
            "trg" => addresses(&values).filter(|all| all.len() <= 15).map(Command::Trigger),
            "ver" => alone(Command::Version),
            _ => None,
        }
    }
}

/// Primary addresses, each with its secondary one where it has one.
fn addresses(values: &[&str]) -> Option<Vec<Address>> {
    let mut found: Vec<Address> = Vec::new();
    for value in values {
        match (value.parse().ok()?, found.last_mut()) {
            (primary @ 0..=30, _) => found.push(Address { primary, secondary: None }),
            (secondary @ 96..=126, Some(last)) if last.secondary.is_none() => last.secondary = Some(secondary),
            _ => return None,
        }
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_come_with_and_without_a_second_part() {
        let at = |primary, secondary| Address { primary, secondary };
        assert_eq!(Command::parse("addr 5"), Some(Command::Address(Some(at(5, None)))));
        assert_eq!(Command::parse("ADDR  9 96"), Some(Command::Address(Some(at(9, Some(96))))));
        assert_eq!(Command::parse("addr"), Some(Command::Address(None)));
        let three = vec![at(5, None), at(6, Some(97)), at(7, None)];
        assert_eq!(Command::parse("trg 5 6 97 7"), Some(Command::Trigger(three)));
    }

    #[test]
    fn what_is_out_of_range_or_too_much_is_not_understood() {
        for text in [
            "",
            "addr 31",
            "addr 96",
            "addr 5 95",
            "addr 5 6",
            "addr x",
            "addr -1",
            "auto 2",
            "eos 4",
            "eot_char 256",
            "read_tmo_ms 0",
            "read_tmo_ms 3001",
            "mode 0",
            "read 256",
            "read eoi 3",
            "clr 5",
            "spoll 5 6",
            "nothing",
            "trg 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16",
            "addr 5 96 97",
        ] {
            assert_eq!(Command::parse(text), None, "{text}");
        }
    }

    #[test]
    fn the_help_names_all_that_is_understood() {
        let names: Vec<&str> = HELP.lines().filter_map(|line| line[2..].split_ascii_whitespace().next()).collect();
        assert_eq!(names.len(), 20);
        assert!(names.iter().all(|name| Command::parse(name).is_some()), "{names:?}");
    }
}
