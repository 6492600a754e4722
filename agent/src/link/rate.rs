//! A token bucket: so many bytes a second, and a burst.

use std::time::Instant;

/// How much may be sent now.
#[derive(Debug, Clone)]
pub struct Rate {
    bytes_per_second: f64,
    burst: f64,
    tokens: f64,
    last: Instant,
}

impl Rate {
    /// `bytes_per_second` on average, `burst` bytes at once; full at the start.
    pub fn new(bytes_per_second: f64, burst: f64, now: Instant) -> Self {
        Self { bytes_per_second, burst, tokens: burst, last: now }
    }

    /// Takes `bytes` when they may be sent at `now`.
    pub fn take(&mut self, bytes: usize, now: Instant) -> bool {
        self.refill(now);
        // A message above the burst goes out when the bucket is full, and is paid for afterwards.
        let needed = (bytes as f64).min(self.burst);
        if self.tokens < needed {
            return false;
        }
        self.tokens -= bytes as f64;
        true
    }

    /// Seconds until `bytes` may be sent.
    pub fn wait_s(&mut self, bytes: usize, now: Instant) -> f64 {
        self.refill(now);
        (((bytes as f64).min(self.burst) - self.tokens) / self.bytes_per_second).max(0.0)
    }

    /// Changes the average.
    pub fn set(&mut self, bytes_per_second: f64) {
        self.bytes_per_second = bytes_per_second;
    }

    fn refill(&mut self, now: Instant) {
        let elapsed = now.saturating_duration_since(self.last).as_secs_f64();
        self.last = now;
        self.tokens = (self.tokens + elapsed * self.bytes_per_second).min(self.burst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_flood_is_held_to_the_rate() {
        let start = Instant::now();
        let mut rate = Rate::new(10_000.0, 1_000.0, start);
        let mut sent = 0;
        for millisecond in 0..1_000 {
            let now = start + Duration::from_millis(millisecond);
            while rate.take(100, now) {
                sent += 100;
            }
        }
        assert!((10_900..=11_000).contains(&sent), "{sent} bytes in a second at 10 000 B/s and 1 000 B burst");
    }

    #[test]
    fn a_message_above_the_burst_still_goes() {
        let start = Instant::now();
        let mut rate = Rate::new(1_000.0, 100.0, start);
        assert!(rate.take(500, start));
        assert!(!rate.take(1, start + Duration::from_millis(400)));
        assert!(rate.wait_s(100, start + Duration::from_millis(400)) > 0.09);
        assert!(rate.take(100, start + Duration::from_millis(501)));
    }
}
