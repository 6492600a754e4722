//! One agent, as the recorder knows it: how far its messages have come, and the last of them.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use plumbline_proto::codec::Batch;

use super::TICK;
use crate::agent_link::CommandSender;
use crate::recorder::asking::Asking;

/// Live batches kept, for flights whose beginning is announced a little late.
const RECENT: Duration = Duration::from_secs(3);
const RECENT_BYTES: usize = 8 << 20;

/// What the recorder knows of one connected agent, or one that was.
pub(super) struct Agent {
    pub(super) boot_id: u64,
    pub(super) boot_wall_time_us: u64,
    pub(super) commands: Option<CommandSender>,
    /// Highest live sequence number of this boot.
    pub(super) highest: u64,
    /// How it grew: what lies below an old entry is late, not on its way.
    heights: VecDeque<(Instant, u64)>,
    /// Live batches as they came.
    recent: VecDeque<(Instant, Batch)>,
    recent_bytes: usize,
    pub(super) asking: Asking,
    pub(super) greeting: Greeting,
}

/// Has the keeper been asked what an agent should be told, and asked for, on this connection?
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Greeting {
    Due,
    Asked,
    Done,
}

impl Agent {
    pub(super) fn new(boot_id: u64, boot_wall_time_us: u64, commands: CommandSender, now: Instant) -> Self {
        Self {
            boot_id,
            boot_wall_time_us,
            commands: Some(commands),
            highest: 0,
            heights: VecDeque::new(),
            recent: VecDeque::new(),
            recent_bytes: 0,
            asking: Asking::new(now),
            greeting: Greeting::Due,
        }
    }

    /// Connected once more, after the same start.
    pub(super) fn came_back(&mut self, commands: CommandSender, now: Instant) {
        self.commands = Some(commands);
        self.asking = Asking::new(now);
        self.greeting = Greeting::Due;
    }

    /// The last live batches, oldest first.
    pub(super) fn recent(&self) -> Vec<Batch> {
        self.recent.iter().map(|(_, batch)| batch.clone()).collect()
    }

    /// A live message of this number came.
    pub(super) fn rise(&mut self, sequence: u64, now: Instant) {
        self.highest = self.highest.max(sequence);
        if self.heights.back().is_none_or(|(at, _)| now.saturating_duration_since(*at) >= TICK) {
            self.heights.push_back((now, self.highest));
            // At most one entry each tick, for as long as a horizon reaches back.
            if self.heights.len() > 1024 {
                self.heights.pop_front();
            }
        }
    }

    /// Keeps a live batch for a while.
    pub(super) fn remember(&mut self, batch: Batch, now: Instant) {
        self.recent_bytes += batch.held_bytes();
        self.recent.push_back((now, batch));
        while let Some((at, oldest)) = self.recent.front()
            && (self.recent_bytes > RECENT_BYTES || now.saturating_duration_since(*at) > RECENT)
        {
            self.recent_bytes -= oldest.held_bytes();
            self.recent.pop_front();
        }
    }

    /// Everything up to here has had time to arrive and to reach the agent's own log.
    pub(super) fn horizon(&self, now: Instant, after: Duration) -> u64 {
        let old = |(at, _): &&(Instant, u64)| now.saturating_duration_since(*at) >= after;
        self.heights.iter().rev().find(old).map_or(0, |(_, height)| *height)
    }
}
