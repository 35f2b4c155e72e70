//! What the HAL's driver of OTG_FS cannot do: halt an endpoint, take a packet back, begin with DATA0 (RM0090, 34.17).
//!
//! EPENA can only be set, not cleared, by a write (RM0090, 34.16.4): what was read of it is not written back, but with
//! EPDIS, or a packet that the host has fetched in between would be sent again.

use embassy_stm32::pac::USB_OTG_FS;
use embassy_usb::driver::EndpointAddress;

/// Endpoints each way, with endpoint 0 (RM0090, 34.1).
pub const ENDPOINTS: usize = 4;
/// Reads of a register that last longer than the core takes to do what it was told: microseconds.
const PATIENCE: usize = 1000;

/// The next packet is DATA0.
pub fn begin_with_data0(endpoint: EndpointAddress) {
    let n = endpoint.index();
    critical_section::with(|_| match (n, endpoint.is_in()) {
        (0, _) => {}
        (_, true) => USB_OTG_FS.diepctl(n).modify(|w| {
            w.set_epena(false);
            w.set_sd0pid_sevnfrm(true);
        }),
        (_, false) => USB_OTG_FS.doepctl(n).modify(|w| {
            w.set_epena(false);
            w.set_sd0pid_sevnfrm(true);
        }),
    });
}

/// Bulk OUT answers with STALL from now on.
pub fn halt_out(n: usize) {
    critical_section::with(|_| {
        USB_OTG_FS.doepctl(n).modify(|w| {
            w.set_epena(false);
            w.set_stall(true);
        });
    });
}

/// An IN endpoint has no packet: the host has fetched it.
pub fn is_empty(n: usize) -> bool {
    !USB_OTG_FS.diepctl(n).read().epena()
}

/// Takes the packet of an IN endpoint back; true when the host has fetched it before (RM0090, 34.17.6, IN endpoint
/// disable).
pub fn recall(n: usize) -> bool {
    let usb = USB_OTG_FS;
    let control = usb.diepctl(n);
    let until = |done: &dyn Fn() -> bool| (0..PATIENCE).any(|_| done());
    // the interrupt clears the flags that are waited for here
    critical_section::with(|_| {
        if is_empty(n) {
            return true;
        }
        control.modify(|w| {
            w.set_epena(false);
            w.set_snak(true);
        });
        until(&|| usb.diepint(n).read().inepne() || is_empty(n));
        if is_empty(n) {
            return true;
        }
        control.modify(|w| {
            w.set_snak(true);
            w.set_epdis(true);
        });
        until(&|| usb.diepint(n).read().epdisd() || is_empty(n));
        usb.diepint(n).write(|w| w.set_epdisd(true));
        usb.grstctl().write(|w| {
            w.set_txfflsh(true);
            w.set_txfnum(n as u8);
        });
        until(&|| !usb.grstctl().read().txfflsh());
        false
    })
}

/// Deactivates an OUT endpoint: it no longer hears tokens (RM0090, 34.17.5, endpoint deactivation).
pub fn deactivate_out(n: usize) {
    critical_section::with(|_| {
        USB_OTG_FS.doepctl(n).modify(|w| {
            w.set_epena(false);
            w.set_snak(true);
            w.set_usbaep(false);
        });
    });
}

/// The host has given the control transfer up: another SETUP packet has come (the core counts down from the three that
/// the driver allows), or the bus was reset, or nothing moves on it any more.
pub fn is_given_up() -> bool {
    let (bus, setups) = (USB_OTG_FS.gintsts().read(), USB_OTG_FS.doeptsiz(0).read().rxdpid_stupcnt());
    bus.usbrst() || bus.usbsusp() || setups != 3
}
