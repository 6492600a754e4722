//! Flight time as other threads see it.
//!
//! The flight thread knows only the time of its frames. The runner tells here how that time runs
//! against the machine's clock, so that the link can stamp a heartbeat between two ticks.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock};
use std::time::Instant;

use plumbline_proto::time::FlightTime;

/// A tick may carry a time this far ahead of the clock, s.
const AHEAD_MAX_S: f64 = 0.5;

/// Flight time that can be asked for at any moment.
#[derive(Debug)]
pub struct FlightClock {
    latest_us: AtomicU64,
    anchor: RwLock<Option<Anchor>>,
}

/// Flight time `flight` was due at `at`, and runs at `speed`.
#[derive(Debug, Clone, Copy)]
struct Anchor {
    at: Instant,
    flight: FlightTime,
    speed: f64,
}

impl Default for FlightClock {
    fn default() -> Self {
        Self { latest_us: AtomicU64::new(0), anchor: RwLock::new(None) }
    }
}

impl FlightClock {
    /// From now on `flight` corresponds to `at`, and time runs at `speed` times real time.
    pub fn run(&self, at: Instant, flight: FlightTime, speed: f64) {
        *self.anchor.write().unwrap_or_else(PoisonError::into_inner) = Some(Anchor { at, flight, speed });
    }

    /// As [`run`](Self::run), for what differs from before by next to nothing. Never waits: while somebody reads it stays as it was.
    pub fn follow(&self, at: Instant, flight: FlightTime, speed: f64) {
        if let Ok(mut anchor) = self.anchor.try_write() {
            *anchor = Some(Anchor { at, flight, speed });
        }
    }

    /// From now on time is that of the last tick (stepped, or as fast as possible).
    pub fn stop(&self) {
        *self.anchor.write().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// One tick happened. Never blocks.
    pub fn tick(&self, time: FlightTime) {
        self.latest_us.store(time.0, Ordering::Relaxed);
    }

    /// Time of the newest tick.
    pub fn last_tick(&self) -> FlightTime {
        FlightTime(self.latest_us.load(Ordering::Relaxed))
    }

    /// How long ago flight time was `seen`, s of the machine's clock; infinite for a time that has not come (of another
    /// start of the agent), zero where time stands or is stepped.
    pub fn since_s(&self, seen: FlightTime) -> f64 {
        let speed = self.anchor.read().unwrap_or_else(PoisonError::into_inner).map_or(0.0, |anchor| anchor.speed);
        let since_s = self.now().seconds_since(seen);
        match (since_s < -AHEAD_MAX_S, speed > 0.0) {
            (true, _) => f64::INFINITY,
            (false, true) => (since_s / speed).max(0.0),
            (false, false) => 0.0,
        }
    }

    /// Flight time now.
    pub fn now(&self) -> FlightTime {
        match *self.anchor.read().unwrap_or_else(PoisonError::into_inner) {
            Some(anchor) => {
                let elapsed = Instant::now().saturating_duration_since(anchor.at).as_secs_f64() * anchor.speed;
                FlightTime(anchor.flight.0.saturating_add((elapsed * 1e6) as u64))
            }
            None => FlightTime(self.latest_us.load(Ordering::Relaxed)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn it_runs_between_ticks_and_stands_when_stopped() {
        let clock = FlightClock::default();
        clock.tick(FlightTime(5_000));
        assert_eq!(clock.now(), FlightTime(5_000));
        clock.run(Instant::now() - Duration::from_millis(100), FlightTime(1_000_000), 2.0);
        let now = clock.now().0;
        assert!((1_200_000..1_300_000).contains(&now), "{now}");
        let since_s = clock.since_s(FlightTime(1_000_000));
        assert!((0.099..0.15).contains(&since_s), "{since_s}");
        assert_eq!(clock.since_s(FlightTime(9_000_000)), f64::INFINITY);
        clock.stop();
        assert_eq!(clock.now(), FlightTime(5_000));
        assert_eq!(clock.since_s(FlightTime(0)), 0.0);
    }
}
