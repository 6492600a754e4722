//! Flight time now, as the browser can know it.
//!
//! The ground measures how old the newest message is (`LinkStatus.age_ms`, clock offset removed).
//! Newest flight time + that age is the flight time at the moment the status arrived; the browser's
//! own monotonic clock carries it on from there. Neither wall clock of agent nor browser enters.

use std::collections::VecDeque;

/// A measurement that makes flight time earlier than others did came late, by its way here or because the page was busy:
/// what it measures is as old as before. The least delayed one of this time, ms, counts.
const WITNESSES_MS: f64 = 10_000.0;

/// Maps the browser's monotonic clock to flight time.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    newest_us: u64,
    /// Flight time minus local time, µs.
    offset_us: Option<f64>,
    /// Measurements that may still be the greatest: local time, ms, rising, and offset, falling.
    witnesses: VecDeque<(f64, f64)>,
}

impl Clock {
    /// The clock of a vehicle whose first message is of flight time `time_us`.
    pub fn starting_at(time_us: u64) -> Self {
        Self { newest_us: time_us, ..Self::default() }
    }

    /// A message of flight time `time_us` was read.
    pub fn seen(&mut self, time_us: u64) {
        self.newest_us = self.newest_us.max(time_us);
    }

    /// Newest flight time seen, µs; 0 before the first message.
    pub fn newest_us(&self) -> u64 {
        self.newest_us
    }

    /// Forgets how flight time runs, but not how far it has come.
    pub fn forget_measurements(&mut self) {
        *self = Self::starting_at(self.newest_us);
    }

    /// The newest message seen is here at `local_ms`: without anything better, it is new.
    pub fn arrived(&mut self, local_ms: f64) {
        if self.newest_us == 0 {
            return;
        }
        let offset = self.newest_us as f64 - local_ms * 1e3;
        match self.offset_us {
            // The least delayed message is the best witness; one from the future says that a measurement is out of date.
            Some(held) if held >= offset => {}
            _ => self.offset_us = Some(offset),
        }
    }

    /// The ground says that the newest message it has, `newest_us`, is `age_ms` old; that is known here at `local_ms`.
    pub fn measure(&mut self, newest_us: u64, age_ms: f64, local_ms: f64) {
        if !age_ms.is_finite() {
            return;
        }
        let offset = newest_us as f64 + age_ms.max(0.0) * 1e3 - local_ms * 1e3;
        self.witnesses.retain(|(at_ms, held)| local_ms - at_ms < WITNESSES_MS && *held > offset);
        self.witnesses.push_back((local_ms, offset));
        self.offset_us = self.witnesses.front().map(|(_, greatest)| *greatest);
    }

    /// Flight time at `local_ms`, µs; `None` before the first message.
    pub fn flight_now_us(&self, local_ms: f64) -> Option<f64> {
        self.offset_us.map(|offset| local_ms * 1e3 + offset)
    }

    /// The same, or the newest flight time seen where nothing tells how it runs.
    pub fn now_us(&self, local_ms: f64) -> f64 {
        self.flight_now_us(local_ms).unwrap_or(self.newest_us as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_on_between_measurements_and_when_nothing_arrives() {
        let mut clock = Clock::default();
        assert_eq!(clock.flight_now_us(5.0), None);
        clock.arrived(0.0);
        assert_eq!((clock.flight_now_us(5.0), clock.now_us(5.0)), (None, 0.0));
        clock.seen(1_000_000);
        clock.seen(900_000);
        assert_eq!(clock.now_us(5.0), 1_000_000.0);
        clock.arrived(50.0);
        clock.measure(1_000_000, 20.0, 50.0);
        assert_eq!(clock.flight_now_us(50.0), Some(1_020_000.0));
        assert_eq!(clock.flight_now_us(1050.0), Some(2_020_000.0));
    }

    #[test]
    fn what_comes_late_does_not_make_old_data_young() {
        let mut clock = Clock::default();
        clock.measure(1_000_000, 5.0, 0.0);
        // The same message a second later, still "5 ms old" when it was sent: it was on its way for a second.
        clock.measure(1_000_000, 5.0, 1000.0);
        assert_eq!(clock.flight_now_us(1000.0), Some(2_005_000.0));
        // A vehicle whose clock stood still for a second is followed in the end.
        for s in 2..20_u64 {
            clock.measure(s * 1_000_000, 5.0, s as f64 * 1000.0);
        }
        assert_eq!(clock.flight_now_us(19_000.0), Some(19_005_000.0));
        // What comes sooner counts at once.
        clock.measure(30_000_000, 0.0, 20_000.0);
        assert_eq!(clock.flight_now_us(20_000.0), Some(30_000_000.0));
    }
}
