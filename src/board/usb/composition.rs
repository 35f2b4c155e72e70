//! Interfaces and endpoints of the device, whatever hardware is below.

use embassy_usb::descriptor::{SynchronizationType, UsageType};
use embassy_usb::driver::{Driver, EndpointAddress, EndpointInfo, EndpointType};
use embassy_usb::{Builder, Config};
use stage_usb488::{PACKET, descriptor};

/// Bytes of the configuration descriptor.
pub const SIZE: usize = 108;

/// Number of the instrument's interface: the first, for it is the one from which pyvisa-py detaches the driver of Linux.
pub const INSTRUMENT_INTERFACE: u16 = 0;
/// Number of the serial port's first interface.
pub const SERIAL_INTERFACE: u16 = 1;
/// Number of its second one, which has the data.
pub const DATA_INTERFACE: u16 = 2;
/// Where the instrument has its endpoints.
pub const INSTRUMENT: descriptor::Endpoints =
    descriptor::Endpoints { bulk_out: 0x02, bulk_in: 0x82, interrupt_in: 0x83 };
/// Where the serial port has its own, each way.
const SERIAL_OUT: u8 = 0x01;
pub const SERIAL_IN: u8 = 0x81;
/// The serial port's notifications, where there is no endpoint.
const NOWHERE: u8 = 0x84;

/// CDC 1.2, 4.2 to 4.5: class, subclass, class of the data interface.
const CDC: u8 = 0x02;
const ACM: u8 = 0x02;
const CDC_DATA: u8 = 0x0a;
/// CDC 1.2, 5.2.3: type of functional descriptors.
const FUNCTIONAL: u8 = 0x24;

/// The endpoints that are there.
pub struct Announced<O, I> {
    pub serial_out: O,
    pub serial_in: I,
    pub bulk_out: O,
    pub bulk_in: I,
    pub interrupt_in: I,
}

/// Who it is. Vendor and product are of pid.codes' test range (1209:0001): a maker puts his own.
pub fn identity(serial_number: &str) -> Config<'_> {
    let mut config = Config::new(0x1209, 0x0001);
    config.manufacturer = Some("Stage Controller");
    config.product = Some("SC6");
    config.serial_number = Some(serial_number);
    config.max_power = 100;
    config
}

/// Writes the descriptors of all interfaces, and sets their endpoints up.
pub fn announce<'d, D: Driver<'d>>(builder: &mut Builder<'d, D>) -> Announced<D::EndpointOut, D::EndpointIn> {
    let at = |address: u8| Some(EndpointAddress::from(address));
    let size = PACKET as u16;

    let mut function = builder.function(descriptor::CLASS, descriptor::SUBCLASS, descriptor::PROTOCOL);
    let mut interface = function.interface();
    let mut instrument = interface.alt_setting(descriptor::CLASS, descriptor::SUBCLASS, descriptor::PROTOCOL, None);
    let bulk_out = instrument.endpoint_bulk_out(at(INSTRUMENT.bulk_out), size);
    let bulk_in = instrument.endpoint_bulk_in(at(INSTRUMENT.bulk_in), size);
    let interrupt_in = instrument.endpoint_interrupt_in(
        at(INSTRUMENT.interrupt_in),
        descriptor::NOTIFICATION,
        descriptor::INTERVAL_MS,
    );
    drop(function);

    let mut function = builder.function(CDC, ACM, 0);
    let mut interface = function.interface();
    let mut serial = interface.alt_setting(CDC, ACM, 0, None);
    serial.descriptor(FUNCTIONAL, &[0, 0x10, 0x01]); // header: CDC 1.10
    serial.descriptor(FUNCTIONAL, &[2, 0x02]); // ACM: line coding and lines
    serial.descriptor(FUNCTIONAL, &[6, SERIAL_INTERFACE as u8, DATA_INTERFACE as u8]); // union
    let nowhere =
        EndpointInfo { addr: NOWHERE.into(), ep_type: EndpointType::Interrupt, max_packet_size: 8, interval_ms: 255 };
    serial.endpoint_descriptor(&nowhere, SynchronizationType::NoSynchronization, UsageType::DataEndpoint, &[]);
    let mut interface = function.interface();
    let mut data = interface.alt_setting(CDC_DATA, 0, 0, None);
    let serial_out = data.endpoint_bulk_out(at(SERIAL_OUT), size);
    let serial_in = data.endpoint_bulk_in(at(SERIAL_IN), size);
    Announced { serial_out, serial_in, bulk_out, bulk_in, interrupt_in }
}
