//! Flight time now, as the browser can know it.
//!
//! The ground measures how old the newest message is (`LinkStatus.age_ms`, clock offset removed).
//! Newest flight time + that age is the flight time at the moment the status arrived; the browser's
//! own monotonic clock carries it on from there. Neither wall clock of agent nor browser enters.

/// Larger errors than this are taken over at once; smaller ones are smoothed, so charts glide.
const JUMP_US: f64 = 400_000.0;

/// Maps the browser's monotonic clock to flight time.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    /// Flight time minus local time, µs.
    offset_us: Option<f64>,
    measured: bool,
}

impl Clock {
    /// A message of flight time `newest_us` is here at `local_ms`: without anything better, it is new.
    pub fn arrived(&mut self, newest_us: u64, local_ms: f64) {
        let offset = newest_us as f64 - local_ms * 1e3;
        match self.offset_us {
            None => self.offset_us = Some(offset),
            // Without a measurement the least delayed message is the best witness.
            Some(held) if !self.measured && offset > held => self.offset_us = Some(offset),
            // A message from the future: the measurement is out of date.
            Some(held) if offset > held => self.offset_us = Some(offset),
            Some(_) => {}
        }
    }

    /// The ground says the newest message, `newest_us`, is `age_ms` old at `local_ms`.
    pub fn measure(&mut self, newest_us: u64, age_ms: f64, local_ms: f64) {
        if !age_ms.is_finite() {
            return;
        }
        let offset = newest_us as f64 + age_ms.max(0.0) * 1e3 - local_ms * 1e3;
        self.offset_us = Some(match self.offset_us {
            Some(held) if self.measured && (offset - held).abs() < JUMP_US => held + 0.1 * (offset - held),
            _ => offset,
        });
        self.measured = true;
    }

    /// Flight time at `local_ms`, µs; `None` before the first message.
    pub fn flight_now_us(&self, local_ms: f64) -> Option<f64> {
        self.offset_us.map(|offset| local_ms * 1e3 + offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_on_between_measurements_and_when_nothing_arrives() {
        let mut clock = Clock::default();
        assert_eq!(clock.flight_now_us(5.0), None);
        clock.arrived(1_000_000, 50.0);
        clock.measure(1_000_000, 20.0, 50.0);
        assert_eq!(clock.flight_now_us(50.0), Some(1_020_000.0));
        assert_eq!(clock.flight_now_us(1050.0), Some(2_020_000.0));
    }

    #[test]
    fn small_errors_are_smoothed_large_ones_taken_over() {
        let mut clock = Clock::default();
        clock.measure(1_000_000, 0.0, 0.0);
        clock.measure(1_000_000, 10.0, 0.0);
        assert_eq!(clock.flight_now_us(0.0), Some(1_001_000.0));
        clock.measure(9_000_000, 0.0, 0.0);
        assert_eq!(clock.flight_now_us(0.0), Some(9_000_000.0));
    }
}
