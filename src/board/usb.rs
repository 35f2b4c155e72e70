//! The USB port: a CDC-ACM serial device on the micro-AB socket, beside USART2.
//!
//! Vendor and product are of pid.codes' test range (1209:0001): a maker puts his own.

use super::port::Plug;
use embassy_futures::join::join4;
use embassy_stm32::usb::{Config as OtgConfig, Driver as Otg, InterruptHandler};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, Receiver, Sender, State};
use embassy_usb::driver::EndpointError;
use embassy_usb::{Builder, Config};
use stage_controller::hal::PortEvent;
use static_cell::StaticCell;

bind_interrupts!(struct Irqs {
    OTG_FS => InterruptHandler<peripherals::USB_OTG_FS>;
});

/// Largest packet of full speed.
const PACKET: usize = 64;
type Bus = Otg<'static, peripherals::USB_OTG_FS>;

/// The peripherals that it takes.
pub struct Parts {
    pub usb: Peri<'static, peripherals::USB_OTG_FS>,
    pub dp: Peri<'static, peripherals::PA12>,
    pub dm: Peri<'static, peripherals::PA11>,
}

/// The device, for ever.
#[embassy_executor::task]
pub async fn run(parts: Parts, serial_number: &'static str, plug: &'static Plug) {
    static OUT: StaticCell<[u8; 256]> = StaticCell::new();
    static DESCRIPTORS: StaticCell<([u8; 128], [u8; 16], [u8; 64])> = StaticCell::new();
    static STATE: StaticCell<State> = StaticCell::new();

    let mut otg = OtgConfig::default();
    // PA9 carries 4.7 uF on this board: VBUS is not watched
    otg.vbus_detection = false;
    let bus = Otg::new_fs(parts.usb, Irqs, parts.dp, parts.dm, OUT.init([0; 256]), otg);

    let mut config = Config::new(0x1209, 0x0001);
    config.manufacturer = Some("Stage Controller");
    config.product = Some("SC6");
    config.serial_number = Some(serial_number);
    config.max_power = 100;
    let (configuration, bos, control) = DESCRIPTORS.init(([0; 128], [0; 16], [0; 64]));
    let mut builder = Builder::new(bus, config, configuration, bos, &mut [], control);
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let mut device = builder.build();
    let (sender, receiver, control) = class.split_with_control();
    join4(device.run(), receive(receiver, plug), send(sender, plug), watch(control, plug)).await;
}

/// A terminal that sets DTR is there; one that clears it, or an unplugged cable, is not.
async fn watch(control: ControlChanged<'static>, plug: &Plug) {
    let mut open = false;
    loop {
        control.control_changed().await;
        if control.dtr() != open {
            open = control.dtr();
            plug.ring(if open { PortEvent::Opened } else { PortEvent::Closed });
        }
    }
}

async fn receive(mut receiver: Receiver<'static, Bus>, plug: &Plug) {
    let mut packet = [0; PACKET];
    loop {
        receiver.wait_connection().await;
        // a program that never sets DTR is heard all the same
        while let Ok(count) = receiver.read_packet(&mut packet).await {
            plug.ring(PortEvent::Opened);
            plug.take_in(&packet[..count]).await;
        }
        plug.ring(PortEvent::Closed);
    }
}

async fn send(mut sender: Sender<'static, Bus>, plug: &Plug) {
    let mut packet = [0; PACKET];
    loop {
        sender.wait_connection().await;
        loop {
            let count = plug.fetch(&mut packet).await;
            let sent = async {
                sender.write_packet(&packet[..count]).await?;
                // a full packet is followed by an empty one, or the PC waits for more
                if count == PACKET { sender.write_packet(&[]).await } else { Ok(()) }
            };
            match sent.await {
                Ok(()) => {}
                Err(EndpointError::Disabled) => break,
                Err(EndpointError::BufferOverflow) => defmt::warn!("a packet of {} bytes is too long", count),
            }
        }
    }
}
