//! Ctrl-C: noticed, not obeyed at once, so that children are stopped in order and files are finished.

use std::sync::atomic::{AtomicU32, Ordering};

static INTERRUPTS: AtomicU32 = AtomicU32::new(0);

extern "C" fn note(_signal: libc::c_int) {
    INTERRUPTS.fetch_add(1, Ordering::SeqCst);
}

/// From now on SIGINT and SIGTERM are only counted.
pub fn catch() {
    let handler = note as extern "C" fn(libc::c_int) as libc::sighandler_t;
    for signal in [libc::SIGINT, libc::SIGTERM] {
        // SAFETY: the handler does nothing but store to an atomic.
        unsafe { libc::signal(signal, handler) };
    }
}

/// Has somebody asked us to stop?
pub fn interrupted() -> bool {
    interrupts() > 0
}

/// How often?
pub fn interrupts() -> u32 {
    INTERRUPTS.load(Ordering::SeqCst)
}
