//! The newest message of one topic, and how old it may be before it counts as stale.

/// A value younger than this is never called stale: batches arrive every 10–33 ms and text is
/// written ten times a second, so anything shorter would flicker.
pub const STALE_FLOOR_S: f64 = 0.35;

/// Newest message of a topic with the flight time it was made at.
#[derive(Debug, Clone)]
pub struct Topic<T> {
    value: Option<T>,
    time_us: u64,
    /// Smoothed time between messages, s; 0 before the second one.
    period_s: f64,
}

impl<T> Default for Topic<T> {
    fn default() -> Self {
        Self { value: None, time_us: 0, period_s: 0.0 }
    }
}

impl<T> Topic<T> {
    /// Takes `value` when it is not older than the one held.
    pub fn set(&mut self, value: T, time_us: u64) {
        if self.value.is_some() {
            if time_us < self.time_us {
                return;
            }
            let gap = (time_us - self.time_us) as f64 * 1e-6;
            if gap > 0.0 {
                // An outage is no period.
                let gap = if self.period_s == 0.0 { gap } else { gap.min(self.fresh_s()) };
                self.period_s = if self.period_s == 0.0 { gap } else { self.period_s + 0.1 * (gap - self.period_s) };
            }
        }
        self.value = Some(value);
        self.time_us = time_us;
    }

    /// The newest message.
    pub fn get(&self) -> Option<&T> {
        self.value.as_ref()
    }

    /// Flight time of the newest message, µs.
    pub fn time_us(&self) -> Option<u64> {
        self.value.as_ref().map(|_| self.time_us)
    }

    /// Seconds since it was made, at flight time `now_us`.
    pub fn age_s(&self, now_us: f64) -> Option<f64> {
        self.value.as_ref().map(|_| ((now_us - self.time_us as f64) * 1e-6).max(0.0))
    }

    /// Is it older than three periods?
    pub fn is_stale(&self, now_us: f64) -> bool {
        self.age_s(now_us).is_none_or(|age| age > self.fresh_s())
    }

    /// Age up to which it is not stale, s.
    fn fresh_s(&self) -> f64 {
        (3.0 * self.period_s).max(STALE_FLOOR_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stale_after_three_periods_and_older_messages_do_not_replace_newer() {
        let mut topic = Topic::default();
        assert!(topic.is_stale(0.0) && topic.get().is_none() && topic.age_s(1e9).is_none());
        for i in 0..50 {
            topic.set(i, i * 1_000_000);
        }
        topic.set(99, 3_000_000);
        assert_eq!(topic.get(), Some(&49));
        assert!(!topic.is_stale(51.9e6));
        assert!(topic.is_stale(52.1e6));
        assert!((topic.age_s(50e6).unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn an_outage_does_not_make_the_next_one_look_fresh() {
        let mut topic = Topic::default();
        for i in 0..50 {
            topic.set(i, i * 100_000);
        }
        topic.set(50, 65_000_000);
        assert!(!topic.is_stale(65.35e6) && topic.is_stale(65.5e6));
        // What has become slower is not stale for ever.
        for i in 66..90 {
            topic.set(i, i * 1_000_000);
        }
        assert!(!topic.is_stale(90.5e6));
    }

    #[test]
    fn fast_topics_do_not_flicker() {
        let mut topic = Topic::default();
        topic.set(1, 0);
        topic.set(2, 10_000);
        assert!(!topic.is_stale(300_000.0));
        assert!(topic.is_stale(400_000.0));
    }
}
