//! A controller as after power-up with a machine's calibration, and a scripted session with it.

use crate::calibrate::calibrate;
use crate::flash::{Flash, at_once};
use crate::machine::Machine;
use stage_controller::compensation::calibration::BLOCK_CAPACITY;
use stage_controller::controller::front::{Front, Start};
use stage_controller::store::{RECORD_CAPACITY, Store, service};

/// The calibration block of a machine.
///
/// # Errors
/// The calibration's refusal as text.
pub fn block_of(machine: &Machine) -> Result<Vec<u8>, String> {
    let (calibration, _) = calibrate(machine).map_err(|refusal| refusal.to_string())?;
    let mut block = vec![0; BLOCK_CAPACITY];
    let length = calibration.encode(&mut block).ok_or("calibration block too long")?;
    block.truncate(length);
    Ok(block)
}

/// The front with the machine's calibration loaded as if saved; unless `cold`, enabled and homed at 0.
///
/// # Errors
/// The calibration's refusal as text.
pub fn power_up(machine: &Machine, cold: bool) -> Result<Front, String> {
    let mut front = Front::new();
    front.load(&block_of(machine)?).map_err(|error| error.to_string())?;
    if !cold {
        front.assume_homed();
    }
    Ok(front)
}

/// The front as a board starts it from its flash; the machine's calibration where none could be read. `cold`: not
/// homed, the motors where they were saved. Otherwise enabled and homed at 0, where the virtual stage begins.
///
/// # Errors
/// The calibration's refusal as text.
pub fn power_up_from(store: &mut Store<Flash>, machine: &Machine, cold: bool) -> Result<Front, String> {
    let mut front = Front::new();
    let mut buffer = Box::new([0; RECORD_CAPACITY]);
    let found = at_once(service::start(store, &mut front, &mut buffer));
    if !found.record {
        front.load(&block_of(machine)?).map_err(|error| error.to_string())?;
    }
    match cold {
        true => service::stand(&mut front, Start::PowerOn, None, found),
        false => front.assume_homed(),
    }
    Ok(front)
}
