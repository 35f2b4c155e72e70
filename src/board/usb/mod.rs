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
use instrument::Requests;
use serial::Lines;
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

/// Wakes the task of USB when the controller has done something.
static WOKEN: AtomicWaker = AtomicWaker::new();

/// Polls once: what is dropped then has done nothing, and goes on the next time.
fn once<T>(context: &mut Context<'_>, future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(context) {
        Poll::Ready(value) => Some(value),
        Poll::Pending => None,
    }
}

/// The device, for ever.
#[embassy_executor::task]
pub async fn run(
    parts: Parts,
    serial_number: &'static str,
    port: &'static serial::Shared,
    shared: &'static instrument::Shared,
) {
    static OUT: StaticCell<[u8; 192]> = StaticCell::new();
    static DESCRIPTORS: StaticCell<([u8; composition::SIZE], [u8; 16], [u8; 64])> = StaticCell::new();
    static LINES: StaticCell<Lines> = StaticCell::new();
    static REQUESTS: StaticCell<Requests> = StaticCell::new();

    let mut otg = OtgConfig::default();
    // PA9 carries 4.7 uF on this board: VBUS is not watched
    otg.vbus_detection = false;
    let bus = Otg::new_fs(parts.usb, Irqs, parts.dp, parts.dm, OUT.init([0; 192]), otg);

    let config = composition::identity(serial_number);
    let (configuration, bos, control) = DESCRIPTORS.init(([0; composition::SIZE], [0; 16], [0; 64]));
    let mut builder = Builder::new(Guarded::new(bus, shared), config, configuration, bos, &mut [], control);
    let Announced { mut serial_out, mut serial_in, mut bulk_out, mut bulk_in, mut interrupt_in } =
        composition::announce(&mut builder);
    builder.handler(LINES.init(Lines::new(port)));
    builder.handler(REQUESTS.init(Requests(shared)));
    let mut device = builder.build();
    loop {
        let mut begun = false;
        let endpoints = poll_fn(|context| {
            WOKEN.register(context.waker());
            port.pump(context, &mut serial_out, &mut serial_in);
            shared.pump(context, &mut bulk_out, &mut bulk_in, &mut interrupt_in);
            // A SETUP packet ends the control transfer before it (USB 2.0, 8.5.3), as a reset and a host that is gone
            // do; the device would wait for its end for ever. Each wakes this task, the first event of the bus at
            // least: those behind it are masked until it is handled.
            if core::mem::replace(&mut begun, true) && otg::is_given_up() { Poll::Ready(()) } else { Poll::Pending }
        });
        // what is dropped then waits for a packet, or has nothing to do
        select(device.run(), endpoints).await;
    }
}
