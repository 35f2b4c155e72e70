//! One motor: where it stands, and one segment of it.

use super::HISTORY;
use crate::compensation::backlash::{Play, PlayConfig, TakeUp};
use crate::stepgen::segment::{Emitter, Words};
use crate::stepgen::timing::Line;
use crate::units::AXES;

/// Where a motor stands at a border of segments: what a roll-back needs, small enough to be copied in a few
/// instructions.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Standing {
    /// Law's target, half added.
    pub(super) target: i64,
    /// Target plus overlay: what the steps follow.
    pub(super) position: i64,
    pub(super) emitter: Emitter,
    pub(super) play: Play,
}

/// One motor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motor {
    /// At the end of what was generated.
    pub(super) now: Standing,
    /// At the start of each of the last segments.
    pub(super) starts: [Standing; HISTORY],
    pub(super) take_up: TakeUp,
    pub(super) config: PlayConfig,
    pub(super) line: Line,
}

/// One segment of every motor to new targets: true where a play or an emitter has news, and the motors that step up,
/// down, if none has. A leaf of its own with slices, lest the compiler unroll the motors and run out of registers.
/// `place`: where the start of this segment is remembered. `UNIT`: the grid is one tick.
#[inline(never)]
pub(super) fn follow_all<const UNIT: bool>(
    motors: &mut [Motor],
    place: usize,
    targets: &[i64],
    moving: bool,
    base: u32,
    words: &mut Words,
) -> (bool, u8, u8) {
    let (mut any, mut signs) = (false, 0u32);
    for (Motor { now, starts, take_up, config, line }, target) in motors.iter_mut().zip(targets) {
        starts[place % HISTORY] = *now;
        now.target = *target;
        let whole = (*target >> 32) as i32;
        let overlay = if now.play.goes_on(whole) {
            i64::from(now.play.overlay()) << 32
        } else {
            let (overlay, news) = now.play.advance(take_up, whole, moving, config);
            if news {
                any = true;
            }
            overlay
        };
        let from = now.position;
        now.position = target.wrapping_add(overlay);
        let by = ((now.position >> 32) as i32).wrapping_sub((from >> 32) as i32);
        // a bit for upwards in the upper half, for downwards in the lower one; the last motor's come to lie lowest
        signs = signs << 1 | by.wrapping_neg() as u32 >> 31 << 16 | by as u32 >> 31;
        if now.emitter.place::<UNIT>(line, from, now.position, base, words) {
            any = true;
        }
    }
    let half = |signs: u32| (signs.reverse_bits() >> (32 - AXES)) as u8;
    (any, half(signs >> 16), half(signs))
}
