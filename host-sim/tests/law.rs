//! The controller's law in fixed point against the same law in f64 and against the exact stage.

mod stage;

use host_sim::board::{Board, Interleaving};
use stage::{Dice, GOLDEN, Stage, golden, golden_path, homed, turned_by};
use stage_controller::compensation::backlash::{Flank, Play, PlayConfig};
use stage_controller::compensation::coupling::{HALF, row};
use stage_controller::compensation::law::{Law, Remembered, Switches, largest_lever_nm};
use stage_controller::compensation::pivot::{Rotation, Screw, from_sixteenths};
use stage_controller::controller::front::{Front, LEVER_LIMIT_NM};
use stage_controller::units::{AXES, Axis, FinePose, MotorSteps, Pose};

const Q32: f64 = 4_294_967_296.0;

/// How far a pose at rest is from where it should be, each as a share of what is allowed.
#[derive(Default)]
struct Worst {
    linear: f64,
    linear_nm: f64,
    rotary: f64,
    position: f64,
    orientation: f64,
}

impl Worst {
    fn judge(&mut self, stage: &Stage, pose: [i32; AXES]) {
        let law = Law::new(&stage.calibration, Switches::default(), stage.calibration.fibre_point);
        let steps = stage.machine.drives.map(|drive| drive.step);
        let counts = law.steps(Pose(pose)).0;
        let at: [f64; AXES] = std::array::from_fn(|i| f64::from(counts[i]) * steps[i]);
        let q_a = law.actuator_angles(Pose(pose)).map(|q| q as f64 / Q32);

        let displaced = stage.exact.pivot(q_a.map(|q| q * 1e-9));
        let p = nalgebra::Vector3::from_fn(|i, _| f64::from(pose[i])) - displaced;
        let wanted = stage.exact.inverse_slides * p;
        for i in 0..3 {
            let off = (at[i] - wanted[i]).abs();
            self.linear = self.linear.max(off / (0.5 * steps[i] + 2.0));
            self.linear_nm = self.linear_nm.max(off - 0.5 * steps[i]);
            // 31-bit gains: up to 0.09 nrad at the end of a travel of 5 degrees
            self.rotary = self.rotary.max((at[i + 3] - q_a[i]).abs() / (0.5 * steps[i + 3] + 0.1));
        }

        let truth = stage.chain.true_pose(at);
        let off = (0..3).map(|i| (truth[i] - f64::from(pose[i])).powi(2)).sum::<f64>().sqrt();
        let levers = (0..3).map(|i| 0.5e-9 * steps[i + 3] * stage.levers[i]).sum::<f64>();
        let allowed = 0.5 * steps[..3].iter().sum::<f64>() + levers + 5.0;
        self.position = self.position.max(off / allowed);
        let logical = |u: [f64; AXES]| [u[3], u[4], u[5]];
        let turned = turned_by(&stage.chain, logical(pose.map(f64::from)), logical(truth));
        let law_error = if stage.largest_static() > 3e-3 { 15e-6 } else { 5e-6 };
        let allowed = 0.5e-9 * steps[3..].iter().sum::<f64>() + law_error;
        self.orientation = self.orientation.max(turned / allowed);
    }

    fn check(&self, name: &str) {
        let Worst { linear, linear_nm, rotary, position, orientation } = self;
        println!(
            "figure: {name:12} linear {linear:.4} (half a step {linear_nm:+.3} nm)  rotary {rotary:.4}  \
             position {position:.3}  orientation {orientation:.3} of what is allowed"
        );
        for share in [linear, rotary, position, orientation] {
            assert!(*share <= 1.0, "{name}");
        }
    }
}

#[test]
fn every_golden_pose_stands_within_the_half_steps() {
    for name in GOLDEN {
        let (_, poses) = golden(name);
        let stage = Stage::golden(name);
        let mut worst = Worst::default();
        poses.into_iter().for_each(|pose| worst.judge(&stage, pose));
        worst.check(name);
    }
}

#[test]
fn the_words_bring_the_motors_to_the_counts_of_the_law() {
    for (seed, name) in (1..).zip(GOLDEN) {
        let (machine, poses) = golden(name);
        let mut board = Board::new(&machine, homed(&machine), Interleaving::Jittered(3), seed);
        assert!(board.settle());
        let mut reached = 0;
        for pose in poses.into_iter().step_by(3) {
            // a pose with large angles may ask for more than a motor's travel
            if board.front.pose_absolute(pose.map(i64::from)).is_err() {
                continue;
            }
            assert!(board.settle());
            reached += 1;
            let report = board.front.report();
            assert_eq!(report.final_steps, board.front.law().steps(Pose(pose)), "{name} {pose:?}");
            let with_overlay = std::array::from_fn(|i| report.final_steps.0[i] + report.overlay[i]);
            assert_eq!(board.twin().motors().0, with_overlay, "{name} {pose:?}");
            assert_eq!(report.owing, 0, "{name} {pose:?}");
        }
        println!("{name}: {reached} of 14 poses are inside the travel of every motor");
        assert!(reached >= 10);
    }
}

#[test]
fn machines_never_seen_obey_the_same_bounds() {
    let mut dice = Dice::new(2024);
    let mut worst = Worst::default();
    let mut backs = 0;
    for number in 0..200 {
        let stage = dice.stage();
        (0..40).for_each(|_| worst.judge(&stage, dice.pose(&stage.machine)));
        for law in laws(&stage, &mut dice) {
            backs += 100;
            comes_back(&stage, &law, &mut dice, 100, &format!("random machine {number}"));
        }
    }
    worst.check("random");
    println!("figure: {backs} counts came back");
}

/// The law with everything on, without coupling, without pivot, with nothing, and with pivots elsewhere.
fn laws(stage: &Stage, dice: &mut Dice) -> Vec<Law> {
    let calibration = &stage.calibration;
    let all = Switches::default();
    let switches = [
        all,
        Switches { coupling: false, ..all },
        Switches { pivot: false, ..all },
        Switches { compensation: false, ..all },
    ];
    let mut laws = switches.map(|s| Law::new(calibration, s, calibration.fibre_point)).to_vec();
    while laws.len() < 7 {
        let pivot: [f64; 3] = (dice.direction() * dice.between(0.0, 60e6)).into();
        let pivot = pivot.map(|x| (x * 16.0) as i32);
        if largest_lever_nm(calibration, pivot) <= LEVER_LIMIT_NM {
            laws.push(Law::new(calibration, all, pivot));
        }
    }
    laws
}

fn comes_back(stage: &Stage, law: &Law, dice: &mut Dice, times: usize, name: &str) {
    for _ in 0..times {
        let counts = MotorSteps(dice.counts(&stage.machine));
        let pose = law.forward(counts);
        assert_eq!(law.steps(pose), counts, "{name}: {pose:?} {:?}", stage.machine);
    }
}

#[test]
fn a_million_counts_come_back_from_their_pose() {
    let mut dice = Dice::new(7);
    let mut done = 0;
    for name in GOLDEN {
        let stage = Stage::golden(name);
        for law in laws(&stage, &mut dice) {
            comes_back(&stage, &law, &mut dice, 17_858, name);
            done += 17_858;
        }
    }
    println!("figure: {done} counts of the golden machines came back");
    assert!(done >= 1_000_000);
}

#[test]
fn switching_parts_and_pivots_moves_no_motor() {
    let mut dice = Dice::new(11);
    for name in GOLDEN {
        let stage = Stage::golden(name);
        let laws = laws(&stage, &mut dice);
        for _ in 0..200 {
            // wherever one law brought the motors, every other finds a pose that leaves them there
            let counts = laws[0].steps(Pose(dice.pose(&stage.machine)));
            for law in &laws {
                assert_eq!(law.steps(law.forward(counts)), counts, "{name}");
            }
        }
    }
}

#[test]
fn with_nothing_loaded_every_motor_follows_its_own_coordinate_exactly() {
    let mut dice = Dice::new(3);
    let front = Front::new();
    let steps = front.motors().map(|motor| (motor.step_q32 >> 32) as i32);
    for _ in 0..20_000 {
        let counts: [i32; AXES] = std::array::from_fn(|i| {
            let most = i64::from(front.motors()[i].travel_upper / steps[i]);
            dice.integer(-most..=most) as i32
        });
        let pose = Pose(std::array::from_fn(|i| counts[i] * steps[i]));
        assert_eq!(front.law().steps(pose).0, counts);
        assert_eq!(front.law().forward(MotorSteps(counts)), pose);
        // one coordinate moves one motor
        let i = dice.integer(0..=5) as usize;
        let mut other = pose;
        other.0[i] = dice.integer(-25_000_000..=25_000_000) as i32;
        let moved = front.law().steps(other).0;
        assert!((0..AXES).all(|k| k == i || moved[k] == counts[k]));
    }
}

#[test]
fn the_rotation_centre_is_exact_to_a_nanometre_at_sixty_millimetres() {
    let mut dice = Dice::new(5);
    let mut worst = 0.0_f64;
    for _ in 0..300 {
        let stage = dice.stage();
        let c = &stage.calibration;
        let mut exact = stage.exact.clone();
        let pivot: [i32; 3] = loop {
            let point: [f64; 3] = (dice.direction() * dice.between(58e6, 60e6)).into();
            let point = point.map(|x| (x * 16.0) as i32);
            if largest_lever_nm(c, point) <= LEVER_LIMIT_NM {
                break point;
            }
        };
        exact.fibre_home = stage.chain.home_origin()
            + stage.chain.home_rotation() * nalgebra::Vector3::from(pivot.map(|x| f64::from(x) / 16.0));
        let rotation = Rotation {
            screws: c.screws.map(|s| Screw {
                angle: s.axis.index() as u8 - 3,
                direction: s.direction,
                point: s.point.map(from_sixteenths),
            }),
            pivot: std::array::from_fn(|i| (exact.fibre_home[i] * f64::from(1 << 20)).round() as i64),
            held: true,
            ..Rotation::default()
        };
        for _ in 0..200 {
            let angles: [i64; 3] = std::array::from_fn(|_| dice.integer(-87_266_463 << 32..=87_266_463 << 32));
            let turned = rotation.turn(&angles);
            assert_eq!(turned.actuator, angles);
            let wanted = exact.pivot(angles.map(|a| a as f64 / Q32 * 1e-9));
            let got = nalgebra::Vector3::from(turned.displacement.map(|c| c as f64 / Q32));
            worst = worst.max((got - wanted).norm());
        }
    }
    println!("figure: c(q) at up to 60 mm and 5 degrees: {worst:.3} nm from f64");
    assert!(worst <= 1.0);
}

/// The third difference of the motors' targets along a straight slow line is what rounding adds to jerk.
#[test]
fn along_a_slow_line_the_law_is_smooth() {
    let stage = Stage::golden("lever-52mm");
    let law = Law::new(&stage.calibration, Switches::default(), stage.calibration.fibre_point);
    for (name, way) in [("x alone", [1.0, 0.0, 0.0]), ("all six", [1.0, 0.7, -0.4])] {
        let mut remembered = Remembered::default();
        let (mut peak, mut squares, mut count) = ([0.0_f64; AXES], [0.0; AXES], 0.0);
        let mut last = [[0i64; AXES]; 3];
        for k in 0..40_000i64 {
            // 0.4 nm or nrad and a fraction a segment, 1.6 um/s
            let along = |w: f64| ((k * 1_753_086_422) as f64 * w) as i64;
            let turn = if name == "all six" { 1.0 } else { 0.0 };
            let pose = FinePose([
                along(way[0]),
                along(way[1]),
                along(way[2]),
                along(0.9 * turn) + (40_000_000 << 32),
                along(-0.8 * turn) - (60_000_000 << 32),
                along(0.5 * turn),
            ]);
            let mut difference = law.motors(&pose, &mut remembered).0;
            for level in &mut last {
                let now = difference;
                difference = std::array::from_fn(|i| now[i] - level[i]);
                *level = now;
            }
            if k >= 3 {
                count += 1.0;
                for i in 0..AXES {
                    let noise = difference[i] as f64 / Q32 * stage.machine.drives[i].step;
                    peak[i] = peak[i].max(noise.abs());
                    squares[i] += noise * noise;
                }
            }
        }
        let rms = squares.map(|s| (s / count).sqrt());
        println!("figure: {name}: third differences, nm or nrad a segment^3: rms {rms:.4?}, peak {peak:.4?}");
        assert!(peak.iter().all(|p| *p < 0.2));
    }
}

#[test]
fn kernel_and_play_meet_the_fixed_point_vectors_bit_for_bit() {
    #[derive(serde::Deserialize)]
    #[allow(non_snake_case)]
    struct FixedPoint {
        C: [[i32; AXES]; AXES],
        Q: [u8; AXES],
        backlash_steps: [i32; 3],
        deadband: i32,
        vectors: Vec<Vector>,
    }
    #[derive(serde::Deserialize)]
    struct Vector {
        u: [i32; AXES],
        steps: [i32; AXES],
        motor: [i32; AXES],
        flank: [i32; 3],
        overlay: [i32; 3],
    }
    let text = std::fs::read_to_string(golden_path("fixed-point.json")).unwrap();
    let fixed: FixedPoint = serde_json::from_str(&text).unwrap();
    assert_eq!(fixed.vectors.len(), 60);
    let mut plays = [Play::resting(0, Some(Flank::Positive), 0); 3];
    for vector in fixed.vectors {
        let u = Pose(vector.u).fine().0;
        let steps = std::array::from_fn(|i| (row(&fixed.C[i], &u, fixed.Q[i]) >> 32) as i32);
        assert_eq!(steps, vector.steps);
        let mut motor = steps;
        for axis in Axis::LINEAR {
            let i = axis.index();
            let config = PlayConfig { width: fixed.backlash_steps[i], ..PlayConfig::default() };
            plays[i].turn(steps[i], fixed.deadband);
            let overlay = config.overlay_of(plays[i].flank());
            assert_eq!((plays[i].flank().sign(), overlay), (vector.flank[i], vector.overlay[i]));
            motor[i] += overlay;
        }
        assert_eq!(motor, vector.motor);
    }
    assert_eq!(HALF, 1 << 31);
}
