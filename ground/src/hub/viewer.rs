//! What one viewer still has to be sent.
//!
//! Bound: [`MAX_QUEUED_BYTES`]. Policy when full: the oldest batches go first and their messages
//! are counted; nobody else notices, because batches are shared and never copied per viewer.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use tokio::sync::Notify;

use crate::sync::lock;

/// Most bytes waiting for one viewer.
pub const MAX_QUEUED_BYTES: usize = 4 << 20;

/// One codec batch, shared by all viewers.
#[derive(Debug, Clone)]
pub struct Shared {
    /// The batch, header included.
    pub batch: Bytes,
    /// Messages in it.
    pub messages: u32,
}

/// The bounded queue between the hub and one WebSocket.
#[derive(Debug, Default)]
pub struct ViewerQueue {
    waiting: Mutex<Waiting>,
    ready: Notify,
    /// Messages that all viewers were too slow for.
    all_dropped: Arc<AtomicU64>,
}

#[derive(Debug, Default)]
struct Waiting {
    batches: VecDeque<Shared>,
    bytes: usize,
    dropped: u64,
}

impl ViewerQueue {
    /// A queue that counts what it drops in `all_dropped`, too.
    pub(super) fn new(all_dropped: Arc<AtomicU64>) -> Self {
        Self { all_dropped, ..Self::default() }
    }

    /// Adds a batch; drops the oldest while there are too many bytes.
    pub(crate) fn push(&self, shared: Shared) {
        let mut waiting = lock(&self.waiting);
        waiting.bytes += shared.batch.len();
        waiting.batches.push_back(shared);
        while waiting.bytes > MAX_QUEUED_BYTES && waiting.batches.len() > 1 {
            if let Some(oldest) = waiting.batches.pop_front() {
                waiting.bytes -= oldest.batch.len();
                waiting.dropped += u64::from(oldest.messages);
                self.all_dropped.fetch_add(oldest.messages.into(), Ordering::Relaxed);
            }
        }
        drop(waiting);
        self.ready.notify_one();
    }

    /// The next batch, when there is one. Cancel-safe.
    pub async fn next(&self) -> Shared {
        loop {
            if let Some(shared) = self.pop() {
                return shared;
            }
            self.ready.notified().await;
        }
    }

    fn pop(&self) -> Option<Shared> {
        let mut waiting = lock(&self.waiting);
        let shared = waiting.batches.pop_front()?;
        waiting.bytes -= shared.batch.len();
        Some(shared)
    }

    /// Messages this viewer was too slow for.
    pub fn dropped(&self) -> u64 {
        lock(&self.waiting).dropped
    }

    /// Bytes waiting now.
    pub fn queued_bytes(&self) -> usize {
        lock(&self.waiting).bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_full_queue_drops_the_oldest_and_counts_messages() {
        let queue = ViewerQueue::default();
        let quarter = MAX_QUEUED_BYTES / 4;
        for n in 0..6_u8 {
            queue.push(Shared { batch: Bytes::from(vec![n; quarter]), messages: 10 });
        }
        assert_eq!(queue.dropped(), 20);
        assert_eq!(queue.queued_bytes(), MAX_QUEUED_BYTES);
        let first = queue.next().await;
        assert_eq!(first.batch[0], 2, "the oldest two are gone");
    }
}
