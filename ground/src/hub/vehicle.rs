//! One vehicle as the hub keeps it: the latest of every topic, what is gathered for its viewers, and its history.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use bytes::BytesMut;
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::{Kind, Message};
use plumbline_rest::ground::AtGround;

use super::health::Health;
use super::history::History;
use super::thinned::Thinned;
use super::viewer::{Shared, ViewerQueue};
use crate::agent_link::CommandSender;

/// Gathered frames are flushed early beyond this many bytes.
const FLUSH_BYTES: usize = 256 << 10;
/// A page is sent a batch so often, and no more: it draws no oftener, and each wakes it up.
const PAGE_EVERY: Duration = Duration::from_millis(25);
/// Batches are kept side by side in blocks of this size, which go back to the system whole: batches of minutes between
/// what lives for milliseconds would leave the memory in pieces.
const BLOCK_BYTES: usize = 512 << 10;
/// Most topics of one vehicle whose latest message is kept; more are passed on but not kept.
pub(super) const MAX_TOPICS: usize = 512;
/// A vehicle that says nothing for this long is shown as not connected, whatever its connection may yet become.
pub const SILENT_AFTER: Duration = Duration::from_secs(2);

/// What is known of one vehicle, and who watches it.
#[derive(Debug)]
pub(super) struct Vehicle {
    pub(super) boot_id: u64,
    pub(super) boot_wall_time_us: u64,
    pub(super) version: String,
    /// The ground that its link ends at; `None` where that is this one.
    pub(super) ground: Option<AtGround>,
    /// `None` while disconnected.
    pub(super) commands: Option<CommandSender>,
    /// When anything came from it last.
    pub(super) heard: Instant,
    latest: BTreeMap<(u16, u16), Latest>,
    pub(super) history: History,
    pub(super) health: Health,
    /// Every message.
    whole: Stream,
    /// What is kept for pages.
    thin: Stream,
    thinned: Thinned,
    /// When pages were sent a batch last.
    thin_at: Instant,
    /// What is left of the block that batches are put into.
    block: BytesMut,
}

/// What is gathered for some viewers, and they.
#[derive(Debug, Default)]
struct Stream {
    /// A batch in the making.
    pending: Vec<u8>,
    viewers: Vec<Weak<ViewerQueue>>,
}

impl Stream {
    /// To append frames to.
    fn frames(&mut self) -> &mut Vec<u8> {
        if self.pending.is_empty() {
            codec::begin_batch(&mut self.pending);
        }
        &mut self.pending
    }

    /// Shares what was gathered with the viewers; `None` where it is nothing.
    fn flush(&mut self, block: &mut BytesMut) -> Option<Shared> {
        if self.pending.len() <= codec::BATCH_HEADER {
            return None;
        }
        let messages = codec::decode_batch(&self.pending).map_or(0, |frames| frames.count() as u32);
        if block.capacity() < self.pending.len() {
            *block = BytesMut::with_capacity(BLOCK_BYTES.max(self.pending.len()));
        }
        block.extend_from_slice(&self.pending);
        self.pending.clear();
        let shared = Shared { batch: block.split().freeze(), messages };
        self.viewers.retain(|viewer| viewer.upgrade().map(|queue| queue.push(shared.clone())).is_some());
        Some(shared)
    }
}

#[derive(Debug)]
struct Latest {
    at: Instant,
    frame: Vec<u8>,
}

impl Vehicle {
    pub(super) fn new(boot_id: u64, now: Instant) -> Self {
        Self {
            boot_id,
            boot_wall_time_us: 0,
            version: String::new(),
            ground: None,
            commands: None,
            heard: now,
            latest: BTreeMap::new(),
            history: History::default(),
            health: Health::new(now),
            whole: Stream::default(),
            thin: Stream::default(),
            thinned: Thinned::default(),
            thin_at: now,
            block: BytesMut::new(),
        }
    }

    pub(super) fn linked(&self) -> bool {
        self.commands.as_ref().is_some_and(|c| !c.is_closed())
    }

    pub(super) fn connected(&self) -> bool {
        self.linked() && self.heard.elapsed() < SILENT_AFTER
    }

    pub(super) fn reboot(&mut self, boot_id: u64, now: Instant) {
        self.thin_at = now.checked_sub(PAGE_EVERY).unwrap_or(now);
        self.flush(now);
        self.boot_id = boot_id;
        self.latest.retain(|(kind, _), _| Kind::from_wire(*kind).is_some_and(Kind::is_ground_made));
        self.history.clear();
        self.health = Health::new(now);
        self.thinned = Thinned::default();
    }

    pub(super) fn watch(&mut self, queue: &Arc<ViewerQueue>, thinned: bool) {
        let stream = if thinned { &mut self.thin } else { &mut self.whole };
        if thinned && stream.viewers.is_empty() {
            // What was held for those before is old.
            self.thinned = Thinned::default();
        }
        stream.viewers.push(Arc::downgrade(queue));
    }

    /// Those of whoever watches.
    pub(super) fn queues(&self) -> impl Iterator<Item = Arc<ViewerQueue>> {
        self.whole.viewers.iter().chain(&self.thin.viewers).filter_map(Weak::upgrade)
    }

    pub(super) fn take(&mut self, frame: &Frame<'_>, now: Instant) {
        let key = (frame.kind, frame.instance);
        if self.latest.len() < MAX_TOPICS || self.latest.contains_key(&key) {
            let latest = self.latest.entry(key).or_insert_with(|| Latest { at: now, frame: Vec::new() });
            latest.at = now;
            latest.frame.clear();
            frame.encode(&mut latest.frame);
        }
        frame.encode(self.whole.frames());
        if !self.thin.viewers.is_empty() {
            self.thinned.take(frame, now, self.thin.frames());
        }
        if self.whole.pending.len() >= FLUSH_BYTES {
            self.flush(now);
        }
    }

    /// Is the latest of this topic known?
    #[cfg(feature = "many")]
    pub(super) fn knows(&self, frame: &Frame<'_>) -> bool {
        self.latest.contains_key(&(frame.kind, frame.instance))
    }

    pub(super) fn flush(&mut self, now: Instant) {
        if !self.thin.viewers.is_empty() {
            self.thinned.last(now, self.thin.frames());
        }
        if now.saturating_duration_since(self.thin_at) >= PAGE_EVERY {
            self.thin_at = now;
            self.thin.flush(&mut self.block);
        }
        if let Some(shared) = self.whole.flush(&mut self.block) {
            self.history.push(now, shared);
        }
    }

    /// The latest of every topic as one batch. States come always; samples only when the history,
    /// which begins at `history_start` (`None`: there is none), does not hold them: nothing is plotted twice.
    pub(super) fn snapshot(&self, history_start: Option<Instant>) -> Shared {
        let mut batch = Vec::new();
        codec::begin_batch(&mut batch);
        let mut messages = 0;
        for ((kind, _), latest) in &self.latest {
            let wanted = match Kind::from_wire(*kind) {
                Some(Kind::Event | Kind::Ack | Kind::Scan) => false,
                Some(
                    Kind::Description
                    | Kind::Gains
                    | Kind::Status
                    | Kind::Attacks
                    | Kind::Flight
                    | Kind::Device
                    | Kind::StepResponse
                    | Kind::Secure
                    | Kind::Recording
                    | Kind::Lease
                    | Kind::Link,
                ) => true,
                _ => history_start.is_none_or(|start| latest.at < start),
            };
            if wanted {
                batch.extend_from_slice(&latest.frame);
                messages += 1;
            }
        }
        Shared { batch: batch.into(), messages }
    }

    pub(super) fn latest_message<M: Message + Default>(&self, kind: Kind) -> Option<M> {
        let latest = self.latest.get(&(kind.to_wire(), 0))?;
        codec::decode_frames(&latest.frame).next()?.ok()?.message().ok()
    }
}
