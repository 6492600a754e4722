//! Locks whose poison is ignored: the guarded state is valid after every statement, and a panic in
//! one request must not silence the ground.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks `mutex`.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// How much threads that may take long give way to everybody else: a `nice` value.
const GIVES_WAY: i32 = 10;

/// Lowers the calling thread's priority; a refusal costs nothing but time.
pub(crate) fn give_way() {
    // Elsewhere this would be the whole process.
    #[cfg(target_os = "linux")]
    // SAFETY: a plain system call; 0 is the calling thread.
    unsafe {
        libc::setpriority(libc::PRIO_PROCESS, 0, GIVES_WAY);
    }
}

/// Wall time, µs since the Unix epoch.
pub(crate) fn wall_time_us() -> u64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_micros() as u64)
}

/// Completes when the ground is asked to stop.
pub(crate) async fn stopping(stopped: &mut tokio::sync::watch::Receiver<bool>) {
    // An error means that nobody can ask any more: that is a stop, too.
    let _ = stopped.wait_for(|stop| *stop).await;
}
