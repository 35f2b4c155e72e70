//! The latest value that an interrupt leaves for the thread, without a lock.
//!
//! The interrupt may come while the thread reads, never the other way round: what was torn is read again.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

/// One writer in an interrupt, one reader below it.
pub struct Mailbox<T> {
    value: UnsafeCell<MaybeUninit<T>>,
    /// Counts the writes.
    writes: AtomicU32,
}

// SAFETY: plain data; what the reader copies while it is written is thrown away.
unsafe impl<T: Copy + Send> Sync for Mailbox<T> {}

impl<T: Copy> Mailbox<T> {
    /// Empty.
    pub const fn new() -> Self {
        Mailbox { value: UnsafeCell::new(MaybeUninit::uninit()), writes: AtomicU32::new(0) }
    }

    /// Gives it something to [update](Mailbox::update), which is not yet there to be taken.
    ///
    /// # Safety
    /// Before there is a writer or a reader.
    pub unsafe fn prepare(&self, value: T) {
        // SAFETY: nobody else has it.
        unsafe { (*self.value.get()).write(value) };
    }

    /// Leaves a value, written over the one before.
    ///
    /// # Safety
    /// In one interrupt alone, which the reader cannot interrupt, and after [`Mailbox::prepare`].
    #[inline(always)]
    pub unsafe fn update<R>(&self, write: impl FnOnce(&mut T) -> R) -> R {
        // SAFETY: the one writer; a reader that it has interrupted notices by the count.
        let answer = write(unsafe { (*self.value.get()).assume_init_mut() });
        compiler_fence(Ordering::Release);
        self.writes.store(self.writes.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        answer
    }

    /// The latest value, unless it is the one of `seen`, which is brought up to date.
    pub fn take(&self, seen: &mut u32) -> Option<T> {
        loop {
            let before = self.writes.load(Ordering::Relaxed);
            if before == *seen {
                return None;
            }
            compiler_fence(Ordering::Acquire);
            // SAFETY: the bytes of a T, or a mixture of two that is thrown away below without being looked at.
            let value = unsafe { self.value.get().read_volatile() };
            compiler_fence(Ordering::Acquire);
            if self.writes.load(Ordering::Relaxed) == before {
                *seen = before;
                // SAFETY: nothing was written meanwhile.
                return Some(unsafe { value.assume_init() });
            }
        }
    }
}
