//! What happens to an emitter while its motor stands still.

use super::segment::Emitter;

impl Emitter {
    /// Names the count at which the motor stands; no step is emitted.
    pub fn set_count(&mut self, steps: i32) {
        self.emitted = steps;
        self.waiting = 0;
        self.disturb();
    }

    /// The motor has stood still for more than two segments: all times have passed, and the wrapping clock
    /// must not make the last edge look like one to come. `base` is the tick of the segment to come.
    pub fn rested(&mut self, base: u32) {
        self.next_rise = base;
        self.next_turn = base;
    }
}
