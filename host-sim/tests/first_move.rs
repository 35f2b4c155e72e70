//! A first move.
use host_sim::board::{Board, Interleaving};
use host_sim::calibrate::calibrate;
use host_sim::machine::Machine;
use stage_controller::controller::front::Front;
use stage_controller::units::Pose;

fn board(machine: &Machine, interleaving: Interleaving) -> Board {
    let (calibration, _) = calibrate(machine).unwrap();
    let mut block = [0; 1024];
    let length = calibration.encode(&mut block).unwrap();
    let mut front = Front::new();
    front.load(&block[..length]).unwrap();
    front.assume_homed();
    let mut board = Board::new(machine, front, interleaving, 1);
    assert!(board.settle());
    board
}

#[test]
fn moves() {
    let machine = Machine::paper();
    let mut b = board(&machine, Interleaving::Prompt);
    let goal = [1_000_000, -500_000, 250_000, 8_000_000, -17_000_000, 3_000_000];
    b.front.pose_absolute(goal).unwrap();
    assert!(b.settle());
    println!("t = {} ms", b.now() * 128 / 1000);
    println!("{:?} {:?}", b.front.position(), b.front.commanded());
    println!("{:?} {:?} {:?}", b.front.motor_counts(), b.twin().motors(), b.twin().true_pose());
    println!("law {:?}", b.front.law().steps(Pose(goal.map(|x| x as i32))));
}
