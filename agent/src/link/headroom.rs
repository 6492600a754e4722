//! How fast old messages may be sent again: beneath live telemetry, never beside it.
//!
//! Backfill and live telemetry share one radio of unknown capacity. Backfill gets what live telemetry
//! leaves of the configured total, at most its own cap, and gives way at once when the radio shows
//! that it is full: live messages are given up, or their round trip grows because packets queue.
//! Loss alone is no such sign: a lossy radio loses as much of little as of much.

use std::time::{Duration, Instant};

/// How often the rate is decided.
pub const PERIOD: Duration = Duration::from_millis(100);

/// Backfill never stops for good: this fraction of its cap is always left.
const FLOOR: f64 = 0.02;
/// Growth in one period, as a fraction of the cap, while there is room.
const GROWTH: f64 = 0.1;
/// What is left after a sign that the radio is full.
const RETREAT: f64 = 0.5;
/// A round trip this much above the shortest one means that packets queue …
const QUEUE_FACTOR: f64 = 2.0;
/// … but only beyond the jitter of any radio, s.
const QUEUE_S: f64 = 0.030;
/// The shortest round trip is forgotten this slowly, a fraction in one period: paths change.
const FORGETTING: f64 = 0.002;

/// What the radio shows.
#[derive(Debug, Clone, Copy, Default)]
pub struct Signs {
    /// Live bytes sent since the start.
    pub live_bytes: u64,
    /// Live messages given up since the start.
    pub dropped: u64,
    /// Round trip of the live connection, s.
    pub round_trip_s: f64,
}

/// Decides the rate.
#[derive(Debug)]
pub struct Headroom {
    total: f64,
    cap: f64,
    rate: f64,
    decided: Instant,
    last: Signs,
    shortest_s: f64,
}

impl Headroom {
    /// `total` is what the radio may carry, `cap` the most for backfill, bytes a second. Begins gently.
    pub fn new(total: f64, cap: f64, signs: Signs, now: Instant) -> Self {
        let rate = cap * (FLOOR + GROWTH);
        Self { total, cap, rate, decided: now, last: signs, shortest_s: f64::INFINITY }
    }

    /// Bytes a second, decided so far.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Decides anew when a [`PERIOD`] has passed; answers the rate, bytes a second.
    pub fn update(&mut self, signs: Signs, now: Instant) -> f64 {
        let elapsed = now.saturating_duration_since(self.decided);
        if elapsed < PERIOD {
            return self.rate;
        }
        self.decided = now;
        let live = signs.live_bytes.saturating_sub(self.last.live_bytes) as f64 / elapsed.as_secs_f64();
        self.shortest_s = (self.shortest_s * (1.0 + FORGETTING)).min(signs.round_trip_s);
        let queued = signs.round_trip_s > QUEUE_FACTOR * self.shortest_s + QUEUE_S;
        let full = queued || signs.dropped > self.last.dropped;
        self.last = signs;
        let wanted = if full { self.rate * RETREAT } else { self.rate + self.cap * GROWTH };
        let floor = self.cap * FLOOR;
        self.rate = wanted.min(self.cap).min(self.total - live).max(floor);
        self.rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs `periods`, live telemetry at `live` bytes a second, and answers the rate.
    fn run(headroom: &mut Headroom, signs: &mut Signs, now: &mut Instant, periods: u32, live: f64) -> f64 {
        for _ in 0..periods {
            *now += PERIOD;
            signs.live_bytes += (live * PERIOD.as_secs_f64()) as u64;
            headroom.update(*signs, *now);
        }
        headroom.rate()
    }

    #[test]
    fn backfill_takes_what_live_telemetry_leaves_and_gives_way() {
        let mut now = Instant::now();
        let mut signs = Signs { round_trip_s: 0.006, ..Signs::default() };
        let mut headroom = Headroom::new(1e6, 500e3, signs, now);
        assert_eq!(run(&mut headroom, &mut signs, &mut now, 20, 300e3), 500e3, "its cap, on an idle radio");
        let left = run(&mut headroom, &mut signs, &mut now, 5, 800e3);
        assert!((left - 200e3).abs() < 1.0, "{left} beside 800 kB/s of 1 MB/s");
        assert_eq!(run(&mut headroom, &mut signs, &mut now, 5, 2e6), 10e3, "the floor");
        run(&mut headroom, &mut signs, &mut now, 20, 300e3);
        // Live messages are given up: away at once, back slowly.
        signs.dropped += 5;
        assert_eq!(run(&mut headroom, &mut signs, &mut now, 1, 300e3), 250e3);
        // Packets queue.
        signs.round_trip_s = 0.080;
        assert!(run(&mut headroom, &mut signs, &mut now, 6, 300e3) <= 10e3);
        signs.round_trip_s = 0.007;
        assert_eq!(run(&mut headroom, &mut signs, &mut now, 10, 300e3), 500e3);
    }
}
