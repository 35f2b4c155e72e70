//! The USB port: a CDC-ACM serial device and a USB488 instrument on the micro-AB socket, beside USART2.
//!
//! # Endpoints
//! OTG_FS of the STM32F407 has three endpoints each way beside endpoint 0 (RM0090, 34.1), and this device announces
//! four IN endpoints. Three are real; the fourth is that of CDC-ACM for notifications. Drivers of Linux and macOS refuse
//! a serial port without it, yet this one has nothing to notify: it is announced at an address that the hardware does
//! not have, so that the host's polls of it, while a program has the port open, find nobody. Black Magic Probe does the
//! same on this chip. [`driver`] keeps such addresses from the hardware's driver, which would panic.
//!
//! | | OUT | IN |
//! |---|---|---|
//! | 1 | serial, bulk | serial, bulk |
//! | 2 | USB488, bulk | USB488, bulk |
//! | 3 | | USB488, interrupt |
//! | 4 | | serial, notifications: announced only |

pub mod composition;
pub mod driver;
pub mod instrument;
mod otg;
mod requests;
pub mod serial;

use composition::Announced;
use core::future::{Future, poll_fn};
use core::pin::pin;
use core::task::{Context, Poll};
use driver::Guarded;
use embassy_futures::select::select;
use embassy_stm32::usb::{Config as OtgConfig, Driver as Otg, InterruptHandler};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embassy_sync::waitqueue::AtomicWaker;
use embassy_usb::Builder;
use requests::Requests;
use static_cell::StaticCell;

bind_interrupts!(struct Irqs {
    OTG_FS => InterruptHandler<peripherals::USB_OTG_FS>;
});

type Hardware = Otg<'static, peripherals::USB_OTG_FS>;

/// The peripherals that it takes.
pub struct Parts {
    pub usb: Peri<'static, peripherals::USB_OTG_FS>,
    pub dp: Peri<'static, peripherals::PA12>,
    pub dm: Peri<'static, peripherals::PA11>,
}

/// What its task and the controller share.
pub struct Shared {
    pub serial: serial::Shared,
    pub instrument: instrument::Shared,
}

impl Shared {
    /// Not configured.
    pub const fn new() -> Self {
        Shared { serial: serial::Shared::new(), instrument: instrument::Shared::new() }
    }
}

/// What the device keeps for ever.
struct Kept {
    out: [u8; 192],
    configuration: [u8; composition::SIZE],
    bos: [u8; 16],
    control: [u8; 64],
    requests: Requests,
}

/// Wakes the task of USB when the controller has done something.
static WOKEN: AtomicWaker = AtomicWaker::new();

/// Polls once: what is dropped then has done nothing, and goes on the next time.
#[inline(always)] // most of it is making the future
fn once<T>(context: &mut Context<'_>, future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(context) {
        Poll::Ready(value) => Some(value),
        Poll::Pending => None,
    }
}

/// The device, for ever.
#[embassy_executor::task]
pub async fn run(parts: Parts, serial_number: &'static str, shared: &'static Shared) {
    static KEPT: StaticCell<Kept> = StaticCell::new();

    let Kept { out, configuration, bos, control, requests } = KEPT.init(Kept {
        out: [0; 192],
        configuration: [0; composition::SIZE],
        bos: [0; 16],
        control: [0; 64],
        requests: Requests::new(shared),
    });
    let mut otg = OtgConfig::default();
    // PA9 carries 4.7 uF on this board: VBUS is not watched
    otg.vbus_detection = false;
    let bus = Otg::new_fs(parts.usb, Irqs, parts.dp, parts.dm, out, otg);

    let config = composition::identity(serial_number);
    let mut builder = Builder::new(Guarded::new(bus, &shared.instrument), config, configuration, bos, &mut [], control);
    let Announced { mut serial_out, mut serial_in, mut bulk_out, mut bulk_in, mut interrupt_in } =
        composition::announce(&mut builder);
    builder.handler(requests);
    let mut device = builder.build();
    loop {
        let mut begun = false;
        let endpoints = poll_fn(|context| {
            WOKEN.register(context.waker());
            shared.serial.pump(context, &mut serial_out, &mut serial_in);
            shared.instrument.pump(context, &mut bulk_out, &mut bulk_in, &mut interrupt_in);
            // A SETUP packet ends the control transfer before it (USB 2.0, 8.5.3), as a reset and a host that is gone
            // do; the device would wait for its end for ever. Each wakes this task, the first event of the bus at
            // least: those behind it are masked until it is handled.
            if core::mem::replace(&mut begun, true) && otg::is_given_up() { Poll::Ready(()) } else { Poll::Pending }
        });
        // what is dropped then waits for a packet, or has nothing to do
        select(device.run(), endpoints).await;
    }
}
