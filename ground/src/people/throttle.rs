//! Counts failures: so many within so long, then none are heard until the time is over.

use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;
use std::time::{Duration, Instant};

/// Most keys remembered; when full, the one whose time is over first goes.
const MAX_KEYS: usize = 4096;

/// Failures by key.
#[derive(Debug)]
pub(crate) struct Throttle<K> {
    allowed: u32,
    within: Duration,
    failures: HashMap<K, (u32, Instant)>,
    /// The same keys by when their time began: a flood of new ones costs no search.
    begun: BTreeSet<(Instant, K)>,
}

impl<K: Eq + Hash + Ord + Clone> Throttle<K> {
    pub(crate) fn new(allowed: u32, within: Duration) -> Self {
        Self { allowed, within, failures: HashMap::new(), begun: BTreeSet::new() }
    }

    /// How long `key` has to wait, if it has to.
    pub(crate) fn wait(&self, key: &K, now: Instant) -> Option<Duration> {
        let (count, since) = self.failures.get(key)?;
        let left = self.within.saturating_sub(now.saturating_duration_since(*since));
        (*count >= self.allowed && !left.is_zero()).then_some(left)
    }

    pub(crate) fn failed(&mut self, key: K, now: Instant) {
        if let Some((count, since)) = self.failures.get_mut(&key)
            && now.saturating_duration_since(*since) < self.within
        {
            *count += 1;
            return;
        }
        self.forgive(&key);
        if self.failures.len() >= MAX_KEYS
            && let Some((_, oldest)) = self.begun.pop_first()
        {
            self.failures.remove(&oldest);
        }
        self.begun.insert((now, key.clone()));
        self.failures.insert(key, (1, now));
    }

    pub(crate) fn forgive(&mut self, key: &K) {
        if let Some((key, (_, since))) = self.failures.remove_entry(key) {
            self.begun.remove(&(since, key));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_count_within_their_time_and_memory_is_bounded() {
        let start = Instant::now();
        let at = |s| start + Duration::from_secs(s);
        let mut throttle = Throttle::new(2, Duration::from_secs(60));
        throttle.failed(7, at(0));
        assert_eq!(throttle.wait(&7, at(1)), None);
        throttle.failed(7, at(1));
        assert_eq!(throttle.wait(&7, at(2)), Some(Duration::from_secs(58)));
        assert_eq!(throttle.wait(&8, at(2)), None);
        assert_eq!(throttle.wait(&7, at(61)), None);
        throttle.failed(7, at(61));
        assert_eq!(throttle.wait(&7, at(61)), None, "counted anew");
        (0..100_000).for_each(|key| throttle.failed(key, at(62)));
        assert!(throttle.failures.len() <= MAX_KEYS);
        assert!(throttle.failures.contains_key(&99_999) && !throttle.failures.contains_key(&7), "the oldest goes");
        assert_eq!(throttle.begun.len(), throttle.failures.len());
    }
}
