//! Values that an interrupt leaves for the thread, in order, without a lock.
//!
//! `heapless` has a queue like it, whose length is known at run time alone: it divides by it and could panic, which
//! nothing in the refill may.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

/// One writer in an interrupt, one reader below it. `N`: a power of two.
///
/// In the order of declaration: tests of the firmware read it in memory.
#[repr(C)]
pub struct Ring<T, const N: usize> {
    places: [UnsafeCell<MaybeUninit<T>>; N],
    /// Values written and taken; both wrap.
    written: AtomicU32,
    taken: AtomicU32,
}

// SAFETY: a place is the writer's until it is counted as written, and the reader's until it is counted as taken.
unsafe impl<T: Copy + Send, const N: usize> Sync for Ring<T, N> {}

impl<T: Copy, const N: usize> Ring<T, N> {
    const MASK: u32 = {
        assert!(N.is_power_of_two(), "places are found by the lower bits");
        N as u32 - 1
    };

    /// Empty.
    pub const fn new() -> Self {
        Ring {
            places: [const { UnsafeCell::new(MaybeUninit::uninit()) }; N],
            written: AtomicU32::new(0),
            taken: AtomicU32::new(0),
        }
    }

    /// Leaves a value; it is lost if there is no room.
    ///
    /// # Safety
    /// In one interrupt alone, which the reader cannot interrupt.
    #[inline(always)]
    pub unsafe fn write(&self, value: impl FnOnce() -> T) {
        let written = self.written.load(Ordering::Relaxed);
        if written.wrapping_sub(self.taken.load(Ordering::Relaxed)) > Self::MASK {
            return;
        }
        // SAFETY: the one writer, and the reader has left this place.
        unsafe { (*self.places[(written & Self::MASK) as usize].get()).write(value()) };
        // one processor: the order of instructions is the order of memory
        compiler_fence(Ordering::Release);
        self.written.store(written.wrapping_add(1), Ordering::Relaxed);
    }

    /// The oldest value that was not taken yet. One reader alone.
    pub fn take(&self) -> Option<T> {
        let taken = self.taken.load(Ordering::Relaxed);
        if self.written.load(Ordering::Relaxed) == taken {
            return None;
        }
        compiler_fence(Ordering::Acquire);
        // SAFETY: written, and the writer leaves it alone until it is counted as taken.
        let value = unsafe { (*self.places[(taken & Self::MASK) as usize].get()).assume_init_read() };
        compiler_fence(Ordering::Release);
        self.taken.store(taken.wrapping_add(1), Ordering::Relaxed);
        Some(value)
    }
}
