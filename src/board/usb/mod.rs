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
mod serial;

use super::port::Plug;
use composition::Announced;
use driver::Guarded;
use embassy_futures::join::join4;
use embassy_stm32::usb::{Config as OtgConfig, Driver as Otg, InterruptHandler};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embassy_usb::Builder;
use instrument::{Requests, Shared};
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

/// The device, for ever.
#[embassy_executor::task]
pub async fn run(parts: Parts, serial_number: &'static str, plug: &'static Plug, shared: &'static Shared) {
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
    let Announced { serial_out, serial_in, bulk_out, bulk_in, interrupt_in } = composition::announce(&mut builder);
    builder.handler(LINES.init(Lines::new(plug)));
    builder.handler(REQUESTS.init(Requests(shared)));
    let mut device = builder.build();
    let instrument = instrument::serve(shared, bulk_out, bulk_in, interrupt_in);
    join4(device.run(), serial::receive(serial_out, plug), serial::send(serial_in, plug), instrument).await;
}
