//! Faces that touch.

use super::{HOME, SEGMENT, still};
use host_sim::bench_twin::{Bench, Side};

#[test]
fn a_contact_is_latched_with_time_side_and_pose() {
    let mut bench = Bench::seeded(5, &still());
    let mut poses = HOME;
    bench.light(0, poses);
    let open = bench.clearance_um(Side::Output, 0, &poses[1]);
    let mut tick = 0;
    while poses[1][2] < open * 1e3 - 300.0 {
        tick += SEGMENT;
        poses[1][2] += 200.0;
        bench.light(tick, poses);
        assert_eq!(bench.check(), Ok(()), "{}", bench.clearance_um(Side::Output, tick, &poses[1]));
    }
    poses[1][2] += 400.0;
    bench.light(tick + SEGMENT, poses);
    let collision = bench.collision().expect("it has touched");
    assert_eq!((collision.side, collision.tick, collision.pose), (Side::Output, tick + SEGMENT, poses[1]));
    assert!(collision.clearance_um <= 0.0 && collision.clearance_um > -0.4);
    bench.light(tick + 2 * SEGMENT, HOME);
    assert_eq!(bench.check(), Err(collision), "going back mends nothing");
    assert!(collision.to_string().contains("output side"), "{collision}");
}

#[test]
fn a_tilted_array_touches_with_a_corner_long_before_its_fibres_are_there() {
    let bench = Bench::seeded(5, &still());
    let mut pose = bench.optimum().poses[1];
    // 10 mrad to this side and to that: one end of the array is 375 um from the fibre point, the other 2125 um
    pose[4] -= 10e6;
    let near = bench.clearance_um(Side::Output, 0, &pose);
    assert!((near - (10.0 - 0.010 * 375.0)).abs() < 0.2, "{near}");
    pose[4] += 20e6;
    let far = bench.clearance_um(Side::Output, 0, &pose);
    assert!((far - (10.0 - 0.010 * 2125.0)).abs() < 0.2, "{far}");
    assert!(far < 0.0 && bench.misalignment(Side::Output, 0, 0, &pose).gap_um > 9.0);
}
