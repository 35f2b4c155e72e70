//! The serial port: USART2 on PA2 and PA3, 8N1, received and sent by DMA.
//!
//! # Design
//! Reception runs for ever into a ring of [`RING`] bytes, so that nothing is lost while flash is written or the
//! controller is busy. A break is a byte with a broken stop bit after which the line is still low.

use super::port::Plug;
use embassy_futures::select::{Either, select};
use embassy_stm32::mode::Async;
use embassy_stm32::usart::{Config, Error, RingBufferedUartRx, Uart, UartTx};
use embassy_stm32::{Peri, bind_interrupts, dma, pac, peripherals, usart};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Timer;
use stage_controller::hal::PortEvent;
use static_cell::StaticCell;

bind_interrupts!(struct Irqs {
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    DMA1_STREAM5 => dma::InterruptHandler<peripherals::DMA1_CH5>;
    DMA1_STREAM6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
});

/// Bytes that may come while nobody looks: 178 ms at 115200 baud, 20 ms at 1 Mbaud.
const RING: usize = 2048;
/// Bytes that are handed on at once.
const CHUNK: usize = 64;
/// A new baud rate, once everything sent before it is out.
pub static BAUD: Signal<CriticalSectionRawMutex, u32> = Signal::new();
/// The receiver's side of the same.
static RECEIVER_BAUD: Signal<CriticalSectionRawMutex, u32> = Signal::new();

/// Both halves of the port.
pub struct Serial {
    pub receiver: RingBufferedUartRx<'static>,
    pub sender: UartTx<'static, Async>,
}

/// The peripherals that it takes.
pub struct Parts {
    pub usart: Peri<'static, peripherals::USART2>,
    pub rx: Peri<'static, peripherals::PA3>,
    pub tx: Peri<'static, peripherals::PA2>,
    pub tx_dma: Peri<'static, peripherals::DMA1_CH6>,
    pub rx_dma: Peri<'static, peripherals::DMA1_CH5>,
}

/// Sets the port up.
pub fn open(parts: Parts, baud: u32) -> Serial {
    static BUFFER: StaticCell<[u8; RING]> = StaticCell::new();
    let mut config = Config::default();
    config.baudrate = baud;
    let Parts { usart, rx, tx, tx_dma, rx_dma } = parts;
    let Ok(port) = Uart::new(usart, rx, tx, tx_dma, rx_dma, Irqs, config) else {
        defmt::panic!("USART2 cannot run at {} baud", baud)
    };
    let (sender, receiver) = port.split();
    Serial { receiver: receiver.into_ring_buffered(BUFFER.init([0; RING])), sender }
}

/// Bytes that come.
#[embassy_executor::task]
pub async fn receive(mut receiver: RingBufferedUartRx<'static>, plug: &'static Plug) {
    let mut bytes = [0; CHUNK];
    plug.ring(PortEvent::Opened);
    loop {
        match select(receiver.read(&mut bytes), RECEIVER_BAUD.wait()).await {
            Either::First(Ok(count)) => plug.take_in(&bytes[..count]).await,
            Either::First(Err(Error::Overrun)) => plug.ring(PortEvent::Overrun),
            Either::First(Err(_)) => {
                let is_break = is_low();
                plug.ring(if is_break { PortEvent::Break } else { PortEvent::Framing });
                while is_low() {
                    Timer::after_millis(1).await;
                }
            }
            Either::Second(baud) => {
                if receiver.set_baudrate(baud).is_err() {
                    defmt::warn!("{} baud is not possible", baud);
                }
            }
        }
    }
}

/// The line to PA3 is low.
fn is_low() -> bool {
    pac::GPIOA.idr().read().0 & 1 << 3 == 0
}

/// Bytes that go.
#[embassy_executor::task]
pub async fn send(mut sender: UartTx<'static, Async>, plug: &'static Plug) {
    let mut bytes = [0; CHUNK];
    loop {
        match select(plug.fetch(&mut bytes), BAUD.wait()).await {
            Either::First(count) => {
                if sender.write(&bytes[..count]).await.is_err() {
                    defmt::warn!("{} bytes could not be sent", count);
                }
            }
            Either::Second(baud) => {
                let _ = sender.flush().await;
                let _ = sender.set_baudrate(baud);
                RECEIVER_BAUD.signal(baud);
            }
        }
    }
}
