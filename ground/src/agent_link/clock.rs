//! A wall clock that never steps: the machine's time at start plus what has passed since.

use std::sync::OnceLock;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Unix time of `at`, µs, on the ground's steady clock. [`super::LinkEvent::Stats`] offsets refer to it.
pub fn wall_us(at: Instant) -> u64 {
    static START: OnceLock<(Instant, u64)> = OnceLock::new();
    let (start, start_us) = *START.get_or_init(|| {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        (Instant::now(), wall.as_micros() as u64)
    });
    match at.checked_duration_since(start) {
        Some(later) => start_us + later.as_micros() as u64,
        None => start_us.saturating_sub(start.duration_since(at).as_micros() as u64),
    }
}
