//! Who has the controls: the bus or the front panel (IEEE 488.1, 2.8, function RL1).

/// Who has the controls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Control {
    /// The front panel (LOCS).
    #[default]
    Local,
    /// The bus (REMS); the front panel may take them back.
    Remote,
    /// The front panel, until the bus next addresses the device (LWLS).
    LocalWithLockout,
    /// The bus (RWLS), and the front panel may not take them back.
    RemoteWithLockout,
}

/// Remote and local of one device. It has no front panel that could be locked: commands work in every state, and no
/// safety input ever asks for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RemoteLocal {
    enabled: bool,
    control: Control,
}

impl RemoteLocal {
    /// Local, the bus has not enabled remote control.
    pub const fn new() -> Self {
        RemoteLocal { enabled: false, control: Control::Local }
    }

    /// Who has the controls.
    pub const fn control(&self) -> Control {
        self.control
    }

    /// For a link that keeps these states itself (RL1 of a GPIB): takes them over.
    #[cfg(feature = "gpib")]
    pub const fn follow(&mut self, control: Control) {
        (self.enabled, self.control) = (false, control);
    }

    /// The line REN: without it everything is local, and no lockout is left.
    pub const fn enable(&mut self, enabled: bool) {
        self.enabled = enabled;
        if !enabled {
            self.control = Control::Local;
        }
    }

    /// The device is addressed to listen.
    pub const fn listens(&mut self) {
        if self.enabled {
            self.control = match self.control {
                Control::Local | Control::Remote => Control::Remote,
                Control::LocalWithLockout | Control::RemoteWithLockout => Control::RemoteWithLockout,
            };
        }
    }

    /// Local lockout (LLO).
    pub const fn lock_out(&mut self) {
        if self.enabled {
            self.control = match self.control {
                Control::Local | Control::LocalWithLockout => Control::LocalWithLockout,
                Control::Remote | Control::RemoteWithLockout => Control::RemoteWithLockout,
            };
        }
    }

    /// Go to local (GTL).
    pub const fn go_to_local(&mut self) {
        self.control = match self.control {
            Control::Local | Control::Remote => Control::Local,
            Control::LocalWithLockout | Control::RemoteWithLockout => Control::LocalWithLockout,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enabled() -> RemoteLocal {
        let mut state = RemoteLocal::new();
        state.enable(true);
        state
    }

    #[test]
    fn without_remote_enable_everything_stays_local() {
        let mut state = RemoteLocal::new();
        state.listens();
        state.lock_out();
        assert_eq!(state, RemoteLocal::new());
    }

    #[test]
    fn a_device_that_listens_is_remote_until_the_bus_takes_that_back() {
        let mut state = enabled();
        assert_eq!(state.control(), Control::Local);
        state.listens();
        assert_eq!(state.control(), Control::Remote);
        state.go_to_local();
        assert_eq!(state.control(), Control::Local);
    }

    #[test]
    fn lockout_outlives_go_to_local_and_ends_with_remote_enable() {
        let mut state = enabled();
        state.lock_out();
        assert_eq!(state.control(), Control::LocalWithLockout);
        state.listens();
        assert_eq!(state.control(), Control::RemoteWithLockout);
        state.go_to_local();
        assert_eq!(state.control(), Control::LocalWithLockout);
        state.listens();
        assert_eq!(state.control(), Control::RemoteWithLockout);
        state.enable(false);
        assert_eq!(state.control(), Control::Local);
        state.enable(true);
        state.listens();
        assert_eq!(state.control(), Control::Remote);
    }
}
