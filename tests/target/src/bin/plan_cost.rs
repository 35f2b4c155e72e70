//! What a pose costs before it moves, on a Cortex-M4F: check and plan of every pose of the golden files.
//!
//! `tests/emulator/plan_cost.py` runs it. When the program asks, by a store to `NEXT`, it writes a calibration block
//! or a pose into the statics; it counts what happens inside `counted_pose` and `counted_plan`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    println!("runs in an emulator: tests/emulator/plan_cost.py");
}

/// The firmware's copies of memory, which are a part of what planning costs.
#[cfg(target_os = "none")]
#[path = "../../../../src/board/memory.rs"]
mod memory;

#[cfg(target_os = "none")]
mod target {
    use core::sync::atomic::{AtomicI32, AtomicU8, AtomicU32, Ordering::Relaxed};
    use cortex_m_rt::entry;
    use embassy_stm32 as _; // the interrupt vectors
    use stage_controller::compensation::calibration::BLOCK_CAPACITY;
    use stage_controller::controller::front::Front;
    use stage_controller::error::Error;
    use stage_controller::refill::border::Report;
    use stage_controller::units::AXES;
    use static_cell::StaticCell;

    /// Stored by the program to ask for the next task; what it reads then: 0 end, 1 load a block, 2 go to a pose.
    static NEXT: AtomicU32 = AtomicU32::new(0);
    /// Length of the block.
    static LENGTH: AtomicU32 = AtomicU32::new(0);
    static BLOCK: [AtomicU8; BLOCK_CAPACITY] = [const { AtomicU8::new(0) }; BLOCK_CAPACITY];
    static POSE: [AtomicI32; AXES] = [const { AtomicI32::new(0) }; AXES];
    /// Orders that came of a pose; 0: it was refused.
    #[used] // read by the emulator alone
    static ORDERS: AtomicU32 = AtomicU32::new(0);

    /// The check of a pose.
    #[inline(never)]
    fn counted_pose(front: &mut Front, target: [i64; AXES]) -> Result<(), Error> {
        front.pose_absolute(target)
    }

    /// The plan of the pose, which is at rest.
    #[inline(never)]
    fn counted_plan(front: &mut Front) {
        front.plan();
    }

    /// Every order is done, and what it started has ended.
    fn settle(front: &mut Front) {
        let mut answered = front.report().answered;
        let mut orders = 0;
        while let Some(order) = front.next_order() {
            answered = order.sequence;
            orders += 1;
        }
        ORDERS.store(orders, Relaxed);
        let next = front.report().next + (1 << 40);
        let report = Report { next, played: next, answered, settled: true, ..*front.report() };
        front.receive_report(report);
    }

    fn load(front: &mut Front) {
        let mut block = [0; BLOCK_CAPACITY];
        for (to, from) in block.iter_mut().zip(&BLOCK) {
            *to = from.load(Relaxed);
        }
        *front = Front::new();
        if front.load(&block[..LENGTH.load(Relaxed) as usize]).is_err() {
            panic!("a block was refused");
        }
        settle(front);
        front.assume_homed();
        settle(front);
    }

    #[entry]
    fn main() -> ! {
        static FRONT: StaticCell<Front> = StaticCell::new();
        let front = FRONT.init_with(Front::new);
        // somebody else writes them
        core::hint::black_box((&LENGTH, &BLOCK, &POSE, &NEXT));
        loop {
            NEXT.store(u32::MAX, Relaxed);
            match NEXT.load(Relaxed) {
                1 => load(front),
                2 => {
                    let target = core::array::from_fn(|i| i64::from(POSE[i].load(Relaxed)));
                    let _ = counted_pose(front, target);
                    counted_plan(front);
                    settle(front);
                }
                _ => panic!("the end"),
            }
        }
    }

    #[panic_handler]
    #[inline(never)]
    fn panic(_: &core::panic::PanicInfo) -> ! {
        loop {
            cortex_m::asm::nop();
        }
    }
}
