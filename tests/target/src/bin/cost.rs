//! What a refill and the planning of a move cost on a Cortex-M4F: moves of the machine `bench`, all compensation on.
//!
//! `tests/emulator/cost.py` runs it, counts what happens inside [`counted_refill`](target) and `counted_pose`, and
//! learns from the statics `SCENE`, `STEPS` and `RATE` what was going on. Nothing in here measures anything.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    println!("runs in an emulator: tests/emulator/cost.py");
}

#[cfg(target_os = "none")]
mod target {
    use core::sync::atomic::{AtomicU32, Ordering::Relaxed};
    use cortex_m_rt::entry;
    use embassy_stm32 as _; // the interrupt vectors
    use heapless::spsc::{Consumer, Producer, Queue};
    use stage_controller::controller::border::{Order, Report};
    use stage_controller::controller::front::Front;
    use stage_controller::controller::generator::Generator;
    use stage_controller::error::Error;
    use stage_controller::stepgen::pins::RESET_STEPS;
    use stage_controller::stepgen::segment::Words;
    use stage_controller::units::{AXES, MotorSteps, SEGMENT_TICKS, TICKS_PER_SECOND};
    use static_cell::StaticCell;

    /// Calibration block of host-sim/machines/bench.toml, as `host-sim calibrate` writes it (a test of host-sim
    /// compares the two).
    static BLOCK: &[u8] = include_bytes!("../../bench.block");

    /// What the refills belong to now; see [`Scene`]. The last value ends the run.
    #[used] // read by the emulator alone
    static SCENE: AtomicU32 = AtomicU32::new(0);
    /// Steps of all motors so far; wraps.
    #[used] // read by the emulator alone
    static STEPS: AtomicU32 = AtomicU32::new(0);
    /// Slowest motor in the scene, steps per second.
    #[used] // read by the emulator alone
    static RATE: AtomicU32 = AtomicU32::new(0);

    /// The scenes, in the order of `SCENES` in cost.py.
    #[derive(Clone, Copy)]
    #[repr(u32)]
    enum Scene {
        Between,
        Idle,
        Slow,
        Fast,
        Reversal,
        Finished,
    }

    /// Orders between the two halves, one more than the front keeps itself.
    const ORDERS: usize = 8;
    /// Segments that the board's ring holds.
    const RING: u64 = 4;
    /// Steps per second at home, half the window around home in steps, and half the way in steps, which leaves room
    /// to get up to speed within the machine's acceleration and jerk.
    const SLOW: [i32; 3] = [100_000, 50_000, 60_000];
    const FAST: [i32; 3] = [490_000, 24_500, 102_000];

    /// Above what any motor of the machine may do, in steps per second squared and cubed.
    const ACCELERATION: u64 = 4_000_000;
    const JERK: u64 = 80_000_000;

    /// The board: both halves and a ring that plays at once.
    struct Rig<'a> {
        front: &'a mut Front,
        generator: &'a mut Generator,
        sender: Producer<'a, Order>,
        orders: Consumer<'a, Order>,
        words: Words,
    }

    /// One refill, a symbol of its own.
    #[inline(never)]
    fn counted_refill(
        generator: &mut Generator,
        orders: &mut Consumer<'_, Order>,
        played: u64,
        words: &mut Words,
    ) -> Report {
        generator.refill_cleared(orders, played, words);
        generator.report(played)
    }

    /// Check and plan of a move of all axes from rest.
    #[inline(never)]
    fn counted_pose(front: &mut Front, target: [i64; AXES]) -> Result<(), Error> {
        front.pose_absolute(target)?;
        front.plan();
        Ok(())
    }

    /// The way of a motor of number `i` in a course whose odd motors go the other way.
    fn signed(i: usize, way: i32) -> i32 {
        if i.is_multiple_of(2) { way } else { -way }
    }

    impl Rig<'_> {
        /// One segment; answers the steps of each motor.
        fn step(&mut self, scene: Scene) -> [u32; AXES] {
            self.front.plan();
            while self.sender.ready() {
                let Some(order) = self.front.next_order() else { break };
                let _ = self.sender.enqueue(order);
            }
            // on the board a second DMA stream clears what has been played
            self.words = [RESET_STEPS; SEGMENT_TICKS];
            let before: [i32; AXES] = core::array::from_fn(|i| self.generator.emitted(i).0);
            let played = self.front.report().next.saturating_sub(RING - 1);
            SCENE.store(scene as u32, Relaxed);
            let report = counted_refill(self.generator, &mut self.orders, played, &mut self.words);
            SCENE.store(Scene::Between as u32, Relaxed);
            self.front.receive_report(report);
            let steps = core::array::from_fn(|i| self.generator.emitted(i).0.abs_diff(before[i]));
            STEPS.store(STEPS.load(Relaxed).wrapping_add(steps.iter().sum()), Relaxed);
            steps
        }

        /// Runs until nothing is pending.
        fn settle(&mut self) {
            while self.front.operation_pending() {
                self.step(Scene::Between);
            }
        }

        /// The two ends of a straight move through home on which every motor goes `half` to each side.
        fn ends(&self, half: i32) -> [[i64; AXES]; 2] {
            [-1, 1].map(|side| {
                let steps = MotorSteps(core::array::from_fn(|i| side * signed(i, half)));
                self.front.law().forward(steps).0.map(i64::from)
            })
        }

        /// Lets the axes go so fast that every motor turns at `rate` at home, as far as the motors allow.
        fn set_rates(&mut self, ends: &[[i64; AXES]; 2], rate: i32) -> Result<(), Error> {
            let mut settings = *self.front.settings();
            let motors = self.front.motors();
            let law = self.front.law();
            // the slope of every motor at home, steps per path
            let near = |side: i64| {
                let at = core::array::from_fn(|i| {
                    ((ends[0][i] + ends[1][i]) / 2 + side * (ends[1][i] - ends[0][i]) / 64) as i32
                });
                law.steps(stage_controller::units::Pose(at))
            };
            let (below, above) = (near(-1), near(1));
            let slope = (0..AXES).map(|i| above.0[i].abs_diff(below.0[i]) * 32).min().unwrap_or(1);
            for (i, own) in settings.axes.iter_mut().enumerate() {
                // the smallest reserve for take-up leaves the most for the move
                own.backlash.velocity = (motors[i].velocity / 100).max(1);
                let way = (ends[1][i] - ends[0][i]).unsigned_abs();
                let along = |rate: u64| (way * rate).div_ceil(u64::from(slope)).max(1);
                own.velocity = along(rate as u64);
                // what the axes need where the motors go to their limits
                own.acceleration = along(ACCELERATION);
                own.jerk = along(JERK);
            }
            self.front.set_axes(&settings)
        }

        /// A straight move through home, counted in the window around it.
        fn course(&mut self, scene: Scene, [rate, window, half]: [i32; 3]) -> Result<(), Error> {
            let ends = self.ends(half);
            self.set_rates(&ends, rate)?;
            self.front.pose_absolute(ends[0])?;
            self.settle();
            counted_pose(self.front, ends[1])?;
            let (mut sums, mut segments) = ([0u32; AXES], 0);
            while self.front.operation_pending() {
                let near = self.generator.emitted(0).0.abs() < window;
                let steps = self.step(if near { scene } else { Scene::Between });
                if near {
                    segments += 1;
                    sums = core::array::from_fn(|i| sums[i] + steps[i]);
                }
            }
            let slowest = u64::from(sums.into_iter().min().unwrap_or(0));
            let ticks = (segments * SEGMENT_TICKS as u32).max(1);
            RATE.store((slowest * u64::from(TICKS_PER_SECOND) / u64::from(ticks)) as u32, Relaxed);
            SCENE.store(scene as u32, Relaxed);
            Ok(())
        }

        /// All motors turn and take up their play, until the last has done so.
        fn reversal(&mut self) -> Result<(), Error> {
            let ends = self.ends(SLOW[2]);
            let home = self.front.law().forward(MotorSteps::default()).0.map(i64::from);
            self.front.pose_absolute(ends[1])?;
            self.settle();
            self.front.pose_absolute(home)?;
            let mut begun = false;
            while self.front.operation_pending() {
                self.step(Scene::Reversal);
                let taking_up = self.front.report().taking_up != 0;
                if begun && !taking_up {
                    break;
                }
                begun |= taking_up;
            }
            self.settle();
            Ok(())
        }

        #[inline(never)]
        fn scenes(&mut self) -> Result<(), Error> {
            self.settle();
            for _ in 0..1000 {
                self.step(Scene::Idle);
            }
            self.course(Scene::Slow, SLOW)?;
            self.reversal()?;
            self.course(Scene::Fast, FAST)
        }
    }

    /// Not in the frame of `main`, which stays for ever.
    #[inline(never)]
    fn new_front() -> Front {
        Front::new()
    }

    #[inline(never)]
    fn new_generator(front: &Front) -> Generator {
        let (law, timing) = front.generator_setup();
        Generator::new(law, timing)
    }

    #[entry]
    fn main() -> ! {
        static QUEUE: StaticCell<Queue<Order, ORDERS>> = StaticCell::new();
        static FRONT: StaticCell<Front> = StaticCell::new();
        static GENERATOR: StaticCell<Generator> = StaticCell::new();
        let (sender, orders) = QUEUE.init_with(Queue::new).split();
        let front = FRONT.init_with(new_front);
        let loaded = front.load(BLOCK);
        front.assume_homed();
        let generator = GENERATOR.init_with(|| new_generator(front));
        let mut rig = Rig { front, generator, sender, orders, words: [0; SEGMENT_TICKS] };
        if loaded.and_then(|()| rig.scenes()).is_err() {
            panic!("a move was refused");
        }
        SCENE.store(Scene::Finished as u32, Relaxed);
        loop {
            cortex_m::asm::nop();
        }
    }

    /// A stop for the emulator.
    #[panic_handler]
    #[inline(never)]
    fn panic(_: &core::panic::PanicInfo) -> ! {
        loop {
            SCENE.store(u32::MAX, Relaxed);
        }
    }
}
