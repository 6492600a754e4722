//! The last seconds of one vehicle's telemetry, for viewers that open or reload the page.
//!
//! Bound: [`MAX_SECONDS`], [`MAX_BYTES`], and the vehicle's share of what all have together. Policy when full: the oldest batches go first.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::viewer::Shared;

/// Longest history kept.
pub const MAX_SECONDS: u64 = 120;
/// Most bytes kept for one vehicle.
pub const MAX_BYTES: usize = 64 << 20;

/// A ring of batches.
#[derive(Debug)]
pub(super) struct History {
    batches: VecDeque<(Instant, Shared)>,
    bytes: usize,
    limit: usize,
}

impl Default for History {
    fn default() -> Self {
        Self { batches: VecDeque::new(), bytes: 0, limit: MAX_BYTES }
    }
}

impl History {
    pub(super) fn push(&mut self, now: Instant, shared: Shared) {
        self.bytes += shared.batch.len();
        self.batches.push_back((now, shared));
        self.trim(now);
    }

    /// Keeps no more than `bytes` from now on.
    pub(super) fn keep(&mut self, bytes: usize, now: Instant) {
        self.limit = bytes.min(MAX_BYTES);
        self.trim(now);
    }

    /// Lets go of what is too old or too much.
    pub(super) fn trim(&mut self, now: Instant) {
        let oldest_allowed = now.checked_sub(Duration::from_secs(MAX_SECONDS));
        while let Some((at, oldest)) = self.batches.front() {
            let too_old = oldest_allowed.is_some_and(|limit| *at < limit);
            if !(too_old || self.bytes > self.limit) {
                break;
            }
            self.bytes -= oldest.batch.len();
            self.batches.pop_front();
        }
    }

    /// The batches after `start`, oldest first, and when the first of them was made.
    pub(super) fn since(&self, start: Instant) -> (Option<Instant>, Vec<Shared>) {
        let first = self.batches.partition_point(|(at, _)| *at <= start);
        let kept = self.batches.range(first..);
        (self.batches.get(first).map(|(at, _)| *at), kept.map(|(_, shared)| shared.clone()).collect())
    }

    pub(super) fn clear(&mut self) {
        self.batches.clear();
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;

    #[test]
    fn history_is_bounded_by_seconds_and_bytes() {
        let start = Instant::now();
        let mut history = History::default();
        for s in 0..300 {
            history.push(start + Duration::from_secs(s), Shared { batch: Bytes::from_static(b"x"), messages: 1 });
        }
        assert_eq!(history.batches.len() as u64, MAX_SECONDS + 1);
        let (first, last_minute) = history.since(start + Duration::from_secs(290));
        assert_eq!(last_minute.len(), 9);
        assert_eq!(first, Some(start + Duration::from_secs(291)));
        let big = Bytes::from(vec![0; MAX_BYTES / 2 + 1]);
        for s in 300..304 {
            history.push(start + Duration::from_secs(s), Shared { batch: big.clone(), messages: 1 });
        }
        assert_eq!(history.batches.len(), 1);
        assert!(history.bytes <= MAX_BYTES);
    }
}
