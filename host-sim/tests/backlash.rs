//! Backlash through the real words: what the play of the twin leaves of a commanded position.

mod stage;

use host_sim::board::{Board, Interleaving};
use host_sim::machine::{Machine, StaticErrors};
use stage::{board, golden, homed, loaded};
use stage_controller::compensation::backlash::Flank;
use stage_controller::compensation::law::Switches;
use stage_controller::settings::BacklashMode;
use stage_controller::units::{AXES, Axis, Pose};

/// nm; the machine's linear steps, and the width of the play of X.
const STEP: f64 = 10.0;
const PLAY: f64 = 300.0;

/// Squareness of X and Y alone, 1 mrad: Y moves motor X without X being commanded.
fn skewed() -> Machine {
    let mut machine = golden("long-lever").0;
    machine.statics = StaticErrors { S_XY: 1e-3, ..StaticErrors::default() };
    for drive in &mut machine.drives[..3] {
        (drive.step, drive.backlash) = (STEP, PLAY);
    }
    machine
}

fn go(board: &mut Board, axis: Axis, to: i64) {
    board.front.move_absolute(axis, to).expect("a move inside the travel");
    assert!(board.settle());
}

/// What play leaves: where the stage of a motor stands, less where its count says, nm.
fn left_by_play(board: &Board, axis: Axis) -> f64 {
    let i = axis.index();
    let target = board.front.law().steps(board.front.commanded()).0[i];
    board.twin().actuators()[i] - f64::from(target) * STEP
}

/// Stops of a scan of Y, up and down twice.
fn stops(end: i64, stride: i64) -> Vec<i64> {
    let up: Vec<_> = (0..=2 * end / stride).map(|k| k * stride - end).collect();
    let down = up.iter().rev().skip(1).copied();
    let cycle: Vec<_> = up.iter().copied().chain(down).collect();
    [cycle.clone(), cycle].concat()
}

/// The play behind a motor as a plain operator, at home on the positive flank: largest error, nm, when motor X is
/// stepped to the law's targets with an overlay that only a reversal of *logical* X would change.
fn left_by_logical_judgement(machine: &Machine, stops: &[i64]) -> f64 {
    let front = homed(machine);
    let (mut driven, mut worst) = (0.0_f64, 0.0_f64);
    for y in stops {
        // logical X never moves, hence never turns: the overlay stays 0
        let motor = f64::from(front.law().steps(Pose([0, *y as i32, 0, 0, 0, 0])).0[0]) * STEP;
        driven = driven.clamp(motor, motor + PLAY);
        worst = worst.max(driven - motor);
    }
    worst
}

#[test]
fn a_scan_of_y_leaves_at_most_the_dead_band_on_x() {
    let machine = skewed();
    for (end, stride, logical) in [(50_000, 5_000, 100.0), (1_000_000, 50_000, 300.0)] {
        let stops = stops(end, stride);
        let mut board = board(&machine);
        let (mut by_play, mut of_truth) = (0.0_f64, 0.0_f64);
        for y in &stops {
            go(&mut board, Axis::Y, *y);
            by_play = by_play.max(left_by_play(&board, Axis::X).abs());
            of_truth = of_truth.max(board.twin().true_pose()[0].abs());
        }
        let emulated = left_by_logical_judgement(&machine, &stops);
        println!(
            "figure: Y +-{} um: X is left {by_play:.1} nm by play ({of_truth:.1} nm with the rounding); \
             judged on the logical axis: {emulated:.1} nm",
            end / 1000
        );
        assert!(by_play <= STEP + 1e-6);
        assert!(of_truth <= 1.5 * STEP + 2.0);
        assert!((emulated - logical).abs() <= STEP);
    }
}

/// Moves X between two counts and answers how far the overlay went.
fn dithered(dead_band: i32, ends: [i64; 2]) -> i32 {
    let mut board = board(&skewed());
    let mut settings = *board.front.settings();
    settings.axes[0].backlash.dead_band = dead_band;
    board.front.set_axes(&settings).unwrap();
    let mut farthest = 0;
    for round in 0..12 {
        go(&mut board, Axis::X, ends[round % 2] * STEP as i64);
        farthest = farthest.max(board.front.report().overlay[0].abs());
        let overlaid = board.twin().motors().0[0] - board.front.law().steps(board.front.commanded()).0[0];
        farthest = farthest.max(overlaid.abs());
    }
    farthest
}

#[test]
fn a_dither_within_the_dead_band_takes_nothing_up() {
    assert_eq!(dithered(1, [1, 0]), 0, "one step peak to peak");
    assert_eq!(dithered(2, [1, -1]), 0, "one step either way");
    assert_eq!(dithered(1, [1, -1]), 30, "beyond the dead band all of it is taken up");
    assert_eq!(dithered(0, [1, 0]), 30);
}

/// Stops on both flanks of X: far enough to turn, and short ones after a turn.
const VISITS: [i64; 9] = [200_000, -300_000, -299_000, -310_000, 40_000, 39_000, 500_000, 499_900, 0];

/// Visits them; the largest error of true X.
fn visit(board: &mut Board) -> f64 {
    VISITS.iter().fold(0.0, |worst, x| {
        go(board, Axis::X, *x);
        f64::max(worst, (board.twin().true_pose()[0] - *x as f64).abs())
    })
}

fn with_mode(mode: BacklashMode) -> Board {
    let mut board = board(&skewed());
    let mut settings = *board.front.settings();
    settings.axes[0].backlash.mode = mode;
    board.front.set_axes(&settings).unwrap();
    assert!(board.settle());
    board
}

#[test]
fn one_directional_modes_end_on_their_flank_and_stand_true() {
    for (mode, flank, overlay) in
        [(BacklashMode::UniPositive, Flank::Positive, 0), (BacklashMode::UniNegative, Flank::Negative, -30)]
    {
        let mut board = with_mode(mode);
        for x in VISITS {
            go(&mut board, Axis::X, x);
            assert_eq!(board.front.flank(Axis::X), Some(flank), "{mode:?} at {x}");
            assert_eq!(board.front.report().overlay[0], overlay, "{mode:?} at {x}");
            let off = board.twin().true_pose()[0] - x as f64;
            assert!(off.abs() <= 0.5 * STEP + 2.0, "{mode:?} at {x}: {off} nm");
            assert_eq!(i64::from(board.front.position().0[0]), x);
        }
    }
}

#[test]
fn one_directional_modes_hold_for_pose_moves_of_all_motors() {
    let mut board = board(&skewed());
    let mut settings = *board.front.settings();
    for axis in &mut settings.axes {
        axis.backlash.mode = BacklashMode::UniPositive;
    }
    board.front.set_axes(&settings).unwrap();
    for pose in [[300_000, -200_000, 100_000, 4_000_000, -3_000_000, 2_000_000], [-1000; AXES], [0; AXES]] {
        board.front.pose_absolute(pose).unwrap();
        assert!(board.settle());
        assert!(Axis::ALL.into_iter().all(|axis| board.front.flank(axis) == Some(Flank::Positive)));
        let truth = board.twin().true_pose();
        let off: [f64; AXES] = std::array::from_fn(|i| truth[i] - pose[i] as f64);
        // half steps of 10 nm and of 1 urad at 52 mm
        assert!(off[..3].iter().all(|e| e.abs() < 60.0), "{off:?}");
        assert!(off[3..].iter().all(|e| e.abs() < 6_500.0), "{off:?}");
    }
}

#[test]
fn reversal_stands_true_within_the_dead_band_and_off_leaves_the_play() {
    let reversal = visit(&mut with_mode(BacklashMode::Reversal));
    let off = visit(&mut with_mode(BacklashMode::Off));
    println!("figure: true X: REVersal {reversal:.1} nm, OFF {off:.1} nm");
    assert!(reversal <= 1.5 * STEP + 2.0);
    assert!((off - PLAY).abs() <= 0.5 * STEP + 2.0);
}

/// Freezes the overlay of X, one way or the other, and lets go of it again.
fn frozen(freeze: impl Fn(&mut Board, bool)) {
    let mut board = board(&skewed());
    go(&mut board, Axis::X, 200_000);
    go(&mut board, Axis::X, 100_000);
    assert_eq!(board.front.report().overlay[0], -30);
    let (position, motors, truth) = (board.front.position(), board.twin().motors(), board.twin().true_pose());

    freeze(&mut board, true);
    assert!(board.settle());
    assert_eq!(board.front.position(), position);
    assert_eq!((board.twin().motors(), board.twin().true_pose()), (motors, truth));

    // on the other flank: tracked, but the overlay stays and the stage is off by the play
    go(&mut board, Axis::X, 150_000);
    assert_eq!(board.front.report().overlay[0], -30);
    assert_eq!(board.front.flank(Axis::X), Some(Flank::Positive));
    assert_eq!(board.front.position().0[0], 150_000);
    assert!((board.twin().true_pose()[0] - 150_000.0 + PLAY).abs() <= 0.5 * STEP + 2.0);

    let motors = board.twin().motors();
    freeze(&mut board, false);
    assert!(board.settle());
    assert_eq!(board.twin().motors(), motors, "letting go moves nothing");
    assert_eq!(board.front.position().0[0], 150_000);
    go(&mut board, Axis::X, 151_000);
    assert_eq!(board.front.report().overlay[0], 0, "the next move takes up what is owed");
    assert!((board.twin().true_pose()[0] - 151_000.0).abs() <= 0.5 * STEP + 2.0);
}

#[test]
fn the_switch_freezes_the_overlay_and_nothing_jumps() {
    frozen(|board, on| {
        let switches = Switches { backlash: !on, ..board.front.settings().switches };
        board.front.set_switches(switches).unwrap();
    });
}

#[test]
fn all_compensation_off_freezes_the_overlay_too() {
    let mut board = board(&skewed());
    go(&mut board, Axis::X, 200_000);
    go(&mut board, Axis::X, 100_000);
    let motors = board.twin().motors();
    board.front.set_switches(Switches { compensation: false, ..Switches::default() }).unwrap();
    assert!(board.settle());
    assert_eq!(board.twin().motors(), motors);
    assert_eq!(board.front.report().overlay[0], -30);
    go(&mut board, Axis::X, 150_000);
    assert_eq!(board.front.report().overlay[0], -30);
}

#[test]
fn mode_off_freezes_the_overlay_of_its_motor() {
    frozen(|board, on| {
        let mut settings = *board.front.settings();
        settings.axes[0].backlash.mode = if on { BacklashMode::Off } else { BacklashMode::Reversal };
        board.front.set_axes(&settings).unwrap();
    });
}

#[test]
fn preload_makes_an_unknown_flank_known_and_the_count_true() {
    for flank in [Flank::Positive, Flank::Negative] {
        for way in [150_000, -150_000] {
            let mut front = loaded(&skewed());
            for axis in Axis::ALL {
                front.set_enabled(axis, true).unwrap();
            }
            let mut board = Board::new(&skewed(), front, Interleaving::Prompt, 1);
            assert!(board.settle());
            board.front.move_relative(Axis::X, way).unwrap();
            assert!(board.settle());
            assert_eq!(board.front.flank(Axis::X), None);
            assert_eq!(board.front.report().overlay[0], 0, "on an unknown flank nothing is taken up");

            let position = board.front.position();
            board.front.preload(Axis::X, flank).unwrap();
            assert!(board.settle());
            assert_eq!(board.front.flank(Axis::X), Some(flank));
            assert_eq!(board.front.position(), position, "preload ends where it began");
            let off = board.twin().true_pose()[0] - f64::from(position.0[0]);
            assert!(off.abs() <= 0.5 * STEP + 2.0, "{flank:?} after {way}: {off} nm");
        }
    }
}

#[test]
fn a_motor_that_turns_again_while_it_takes_up_still_ends_true() {
    let mut board = board(&skewed());
    go(&mut board, Axis::X, 100_000);
    for ahead in [1, 10, 25, 50, 100, 200] {
        // back by a little, and forward again before the take-up has ended
        board.front.move_absolute(Axis::X, 99_900).unwrap();
        (0..ahead).for_each(|_| board.step(|_| ()));
        board.front.move_absolute(Axis::X, 100_000).unwrap();
        assert!(board.settle());
        assert_eq!(board.front.report().owing, 0, "after {ahead} segments");
        let off = board.twin().true_pose()[0] - 100_000.0;
        assert!(off.abs() <= 1.5 * STEP + 2.0, "after {ahead} segments: {off} nm");
    }
}
