//! Any calibration block: it is refused, or the controller can compute and move with it.
#![no_main]

use host_sim::board::{Board, Interleaving};
use host_sim::machine::Machine;
use libfuzzer_sys::fuzz_target;
use stage_controller::compensation::calibration::Calibration;
use stage_controller::controller::front::Front;
use stage_controller::units::{AXES, MotorSteps};

/// Numbers behind the block: coordinates and step counts.
const NUMBERS: usize = 2 * AXES * 4;
/// Segments of a move that are played.
const SEGMENTS: u64 = 100;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else { return };
    let Some((block, numbers)) = data.split_at_checked(data.len().saturating_sub(NUMBERS)) else { return };
    let mut block = block.to_vec();
    // with a CRC that fits, or the fuzzer would never get past it
    if mode & 1 != 0 && block.len() > 12 {
        let end = block.len() - 4;
        let length = (end - 8) as u16;
        block[..6].copy_from_slice(b"SCAL\x01\x00");
        block[6..8].copy_from_slice(&length.to_le_bytes());
        let crc = Calibration::crc(&block);
        block[end..].copy_from_slice(&crc.to_le_bytes());
    }
    let decoded = Calibration::decode(&block);
    let mut front = Front::new();
    assert!(decoded.is_ok() || front.load(&block).is_err());
    if front.load(&block).is_err() {
        return;
    }
    let mut values = numbers.chunks_exact(4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let pose: [i32; AXES] = std::array::from_fn(|_| values.next().unwrap_or(0));
    let steps: [i32; AXES] = std::array::from_fn(|_| values.next().unwrap_or(0));
    front.assume_homed();
    let found = front.law().forward(MotorSteps(steps.map(|s| s >> (mode >> 3))));
    let _ = front.law().steps(found);
    let _ = front.check(pose.map(i64::from));
    let mut board = Board::new(&Machine::paper(), front, Interleaving::Prompt, 1);
    board.run(SEGMENTS, |_| ());
    let _ = board.front.pose_absolute(pose.map(i64::from));
    board.run(SEGMENTS, |_| ());
    let _ = board.front.pose_relative(pose.map(|u| i64::from(u >> (mode >> 3))));
    board.run(SEGMENTS, |_| ());
    board.front.abort();
    board.run(SEGMENTS, |_| ());
});
