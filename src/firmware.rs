//! The firmware: starts the board, then turns the controller for ever.

use crate::board::port::{ARRIVED, Plug, Socket};
use crate::board::{self, Board, refill, supervision, usart, usb};
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_futures::select::select3;
use embassy_time::{Duration, Instant, Timer};
use stage_controller::controller::front::Front;
use stage_controller::controller::generator::Generator;
use stage_controller::hal::Port;
use stage_controller::tasks::Controller;
use static_cell::StaticCell;

/// Links: the serial port and USB.
const PORTS: usize = 2;
/// The controller looks around at least this often.
const TURN: Duration = Duration::from_millis(1);

static SERIAL: Plug = Plug::new();
static USB: Plug = Plug::new();

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let (parts, start) = board::start();
    defmt::info!("start after {}, crystal {}", start.cause, !start.internal_oscillator);
    static CONTROLLER: StaticCell<Controller<PORTS>> = StaticCell::new();
    let controller = CONTROLLER.init_with(|| Controller::new(Front::new()));

    let serial = usart::open(
        usart::Parts {
            usart: parts.USART2,
            rx: parts.PA3,
            tx: parts.PA2,
            tx_dma: parts.DMA1_CH6,
            rx_dma: parts.DMA1_CH5,
        },
        usart::DEFAULT_BAUD,
    );
    spawner.spawn(usart::receive(serial.receiver, &SERIAL).unwrap());
    spawner.spawn(usart::send(serial.sender, &SERIAL).unwrap());
    if !start.internal_oscillator {
        let usb = usb::Parts { usb: parts.USB_OTG_FS, dp: parts.PA12, dm: parts.PA11 };
        spawner.spawn(usb::run(usb, embassy_stm32::uid::uid_hex(), &USB).unwrap());
    }

    let (law, timing) = controller.front.generator_setup();
    let border = refill::start(Generator::new(law, timing));
    spawner.spawn(supervision::supervise(board::watchdog(parts.IWDG)).unwrap());

    let mut board = Board::new(border);
    let (mut serial, mut usb) = (Socket::new(&SERIAL), Socket::new(&USB));
    loop {
        let mut ports: [&mut dyn Port; PORTS] = [&mut serial, &mut usb];
        controller.turn(&mut board, &mut ports, Instant::now().as_millis());
        supervision::controller_ran();
        select3(refill::REFILLED.wait(), ARRIVED.wait(), Timer::after(TURN)).await;
    }
}
