//! The hardware's driver, with some things put right.
//!
//! - It panics when it is told of an endpoint that the hardware does not have. Any host may name one in a request, and
//!   this device announces one.
//! - CLEAR_FEATURE(ENDPOINT_HALT) begins with DATA0 again (USB 2.0, 9.4.5); the driver leaves the toggle as it is, and
//!   the host's next packet would be taken for one that was sent twice.
//! - So do a configuration and an alternate setting that are set (USB 2.0, 9.1.1.5), of which nothing is halted.
//!
//! The instrument is told of a halt that is cleared, which `embassy-usb` tells no class.

use super::instrument::Shared;
use super::{Hardware, composition, otg};
use embassy_usb::driver::{Bus, Driver, EndpointAddress, EndpointAllocError, EndpointType, Event, Unsupported};

/// See above.
pub struct Guarded<D> {
    inner: D,
    shared: &'static Shared,
}

impl<D> Guarded<D> {
    /// Around a driver, or its bus.
    pub fn new(inner: D, shared: &'static Shared) -> Self {
        Guarded { inner, shared }
    }
}

impl Driver<'static> for Guarded<Hardware> {
    type EndpointOut = <Hardware as Driver<'static>>::EndpointOut;
    type EndpointIn = <Hardware as Driver<'static>>::EndpointIn;
    type ControlPipe = <Hardware as Driver<'static>>::ControlPipe;
    type Bus = Guarded<<Hardware as Driver<'static>>::Bus>;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.inner.alloc_endpoint_out(kind, address, size, interval_ms)
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        self.inner.alloc_endpoint_in(kind, address, size, interval_ms)
    }

    fn start(self, size: u16) -> (Self::Bus, Self::ControlPipe) {
        let (bus, pipe) = self.inner.start(size);
        (Guarded::new(bus, self.shared), pipe)
    }
}

/// The hardware has it.
fn exists(endpoint: EndpointAddress) -> bool {
    endpoint.index() < otg::ENDPOINTS
}

impl<B: Bus> Bus for Guarded<B> {
    async fn enable(&mut self) {
        self.inner.enable().await;
    }

    async fn disable(&mut self) {
        self.inner.disable().await;
    }

    async fn poll(&mut self) -> Event {
        self.inner.poll().await
    }

    fn endpoint_set_enabled(&mut self, endpoint: EndpointAddress, enabled: bool) {
        if !exists(endpoint) {
            return;
        }
        if !enabled && endpoint.is_out() {
            // the driver would disable it first, which takes more than that (RM0090, 34.17.6)
            return otg::deactivate_out(endpoint.index());
        }
        self.inner.endpoint_set_enabled(endpoint, enabled);
        if enabled {
            if endpoint.is_in() {
                // it would stand there for ever
                otg::recall(endpoint.index());
            }
            self.endpoint_set_stalled(endpoint, false);
        }
    }

    #[inline(never)] // called in three places
    fn endpoint_set_stalled(&mut self, endpoint: EndpointAddress, stalled: bool) {
        if !exists(endpoint) {
            return;
        }
        if !stalled {
            otg::begin_with_data0(endpoint);
        }
        self.inner.endpoint_set_stalled(endpoint, stalled);
        if !stalled && u8::from(endpoint) == composition::INSTRUMENT.bulk_out {
            self.shared.halt_cleared();
        }
    }

    fn endpoint_is_stalled(&mut self, endpoint: EndpointAddress) -> bool {
        exists(endpoint) && self.inner.endpoint_is_stalled(endpoint)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.inner.remote_wakeup().await
    }
}
