//! Counts what the calling thread asks of the allocator; for tests and benches that promise none.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator, with a count for each thread: a program's `#[global_allocator]`.
pub struct Counting;

thread_local! {
    // Of this thread only: the test harness has others.
    static REQUESTS: Cell<u64> = const { Cell::new(0) };
}

/// Requests of this thread so far, allocations and reallocations; none without [`Counting`].
pub fn requests() -> u64 {
    REQUESTS.get()
}

fn count() {
    // A thread that is ending has no counter left, and nobody who asks for it.
    let _ = REQUESTS.try_with(|requests| requests.set(requests.get() + 1));
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}
