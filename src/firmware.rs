//! The firmware: starts the board, puts the saved settings in force, then turns the controller for ever.

use crate::board::backup::Backup;
use crate::board::clock::ResetCause;
use crate::board::flash::{self, SettingsFlash};
use crate::board::port::ARRIVED;
use crate::board::usart::Serial;
use crate::board::{self, Board, refill, supervision, usb};
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_futures::select::select4;
use embassy_time::{Duration, Instant, Timer};
use stage_controller::controller::front::{Front, Health, LightMemory, Start};
use stage_controller::controller::links::Links;
use stage_controller::hal::Port;
use stage_controller::refill::generator::Generator;
use stage_controller::store::standstill::Keeper;
use stage_controller::store::{Buffer, RECORD_CAPACITY, Store, service};
use stage_controller::tasks::Controller;
use static_cell::{ConstStaticCell, StaticCell};

/// Links: the serial port, the one on USB, and USB488.
const PORTS: usize = 3;
/// The controller looks around at least this often.
const TURN: Duration = Duration::from_millis(1);

static USB: StaticCell<usb::Shared> = StaticCell::new();
static FRONT: StaticCell<Front> = StaticCell::new();
/// Samples, scans and recordings: beside the 64 KB of all the rest.
static LIGHT: ConstStaticCell<LightMemory> = ConstStaticCell::new(LightMemory::new());
static LINKS: StaticCell<Links<PORTS>> = StaticCell::new();
static RECORD: ConstStaticCell<Buffer> = ConstStaticCell::new([0; RECORD_CAPACITY]);

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let (parts, start) = board::start();
    defmt::info!("start after {}, crystal {}", start.cause, !start.internal_oscillator);
    let front = new_front();
    front.lend(LIGHT.take());
    let record = RECORD.take();
    let mut store = Store::new(SettingsFlash::new(parts.FLASH), flash::START);
    let backup = Backup::open();
    let keeper = wake_up(front, start, &mut store, &backup, record).await;

    let mut serial = Serial::open(front.baud());
    let shared: &usb::Shared = USB.init(usb::Shared::new());
    if !start.internal_oscillator {
        let parts = usb::Parts { usb: parts.USB_OTG_FS, dp: parts.PA12, dm: parts.PA11 };
        spawner.spawn(usb::run(parts, embassy_stm32::uid::uid_hex(), shared).unwrap());
    }
    let border = start_refill(front);
    spawner.spawn(supervision::supervise(supervision::start(parts.IWDG)).unwrap());

    let mut board = Board::new(border, backup, keeper);
    let mut controller = Controller::new(front, new_links());
    let mut usb = usb::serial::Socket::new(&shared.serial);
    let mut instrument = usb::instrument::Socket(&shared.instrument);
    loop {
        let mut ports: [&mut dyn Port; PORTS] = [&mut serial, &mut usb, &mut instrument];
        // what stands hears of no border: its inputs are looked at all the same, and the watchdog knows that it could
        refill::attend_if_standing();
        controller.turn(&mut board, &mut ports, Instant::now().as_millis());
        supervision::controller_ran();
        if controller.front.storage_due() {
            // the processor stands while flash is written: so must the steps
            refill::pause().await;
            service::serve(&mut store, controller.front, record).await;
            refill::resume();
            serial.after_a_stall();
            continue;
        }
        if controller.has_answered(0) {
            serial.follow(controller.front.baud());
        }
        // the other tasks have their turn even if there is more to do
        embassy_futures::yield_now().await;
        select4(refill::REFILLED.wait(), ARRIVED.wait(), serial.line_end(), Timer::after(TURN)).await;
    }
}

// What is large is made in functions of its own: their stack is free again before the next one needs it.

#[inline(never)]
fn new_front() -> &'static mut Front {
    Front::new_in(FRONT.uninit())
}

#[inline(never)]
fn new_links() -> &'static mut Links<PORTS> {
    LINKS.uninit().write(Links::new())
}

#[inline(never)]
fn start_refill(front: &Front) -> refill::Border {
    let (law, timing) = front.generator_setup();
    refill::start(Generator::new(law, timing))
}

/// Puts the saved settings in force and says where the motors stand.
async fn wake_up(
    front: &mut Front,
    start: board::Start,
    store: &mut Store<SettingsFlash>,
    backup: &Backup,
    record: &mut Buffer,
) -> Keeper {
    let found = service::start(store, front, record).await;
    let (keeper, kept) = Keeper::recover(&backup.read());
    let cause = if start.cause == ResetCause::Power { Start::PowerOn } else { Start::Reset };
    service::stand(front, cause, kept, found);
    front.set_health(Health {
        internal_oscillator: start.internal_oscillator,
        watchdog: start.cause == ResetCause::Watchdog,
    });
    keeper
}
