//! One flight that is being recorded, or completed later: which messages it has, lacks, and cannot get.

use std::path::PathBuf;
use std::time::Instant;

use mcap::McapResult;
use plumbline_proto::codec::Frame;

use super::flight::{Completeness, Flight, Learner};
use super::identity::{Ending, Identity};
use super::intervals::IntervalSet;
use super::store::{Labels, Reading};
use super::writer::FlightWriter;

/// Sequence-number accounting of one flight, and its open file.
pub(super) struct Track {
    pub(super) identity: Identity,
    /// Where the beginning was not seen: messages sensed from here on belong to the flight.
    pub(super) start_us: Option<u64>,
    /// Last sequence number, from the closing mark.
    pub(super) last: Option<u64>,
    /// No message of the flight comes after this one, where the closing mark was not seen.
    pub(super) limit: Option<u64>,
    /// When the flight ended, as far as the ground can tell.
    pub(super) ended: Option<Instant>,
    /// The status has contradicted this flight since then.
    pub(super) contradicted: Option<Instant>,
    /// Was everything that the agent could not send asked once more after the end?
    pub(super) rechecked: bool,
    /// Last time a message was added.
    pub(super) progressed: Instant,
    pub(super) learner: Learner,
    live: u64,
    filled: u64,
    /// Flushed.
    have: IntervalSet,
    /// Written, not flushed.
    pending: IntervalSet,
    /// `have`, `pending` and what the agent's log does not hold (any more).
    covered: IntervalSet,
    pub(super) writer: Option<(PathBuf, FlightWriter)>,
    /// No new file before this moment: the last one failed.
    pub(super) retry: Option<Instant>,
}

impl Track {
    pub(super) fn new(identity: Identity, now: Instant) -> Self {
        Self {
            identity,
            start_us: None,
            last: None,
            limit: None,
            ended: None,
            contradicted: None,
            rechecked: false,
            progressed: now,
            learner: Learner::default(),
            live: 0,
            filled: 0,
            have: IntervalSet::default(),
            pending: IntervalSet::default(),
            covered: IntervalSet::default(),
            writer: None,
            retry: None,
        }
    }

    /// A flight whose files exist.
    pub(super) fn resume(reading: Reading, now: Instant) -> Self {
        let (first, last) = reading.range();
        let ending = reading.ending();
        let mut track = Self::new(Identity { first_sequence: first, ..reading.identity }, now);
        track.last = last;
        track.live = ending.live;
        track.filled = ending.filled;
        track.learner = reading.learner;
        track.covered = reading.have.clone();
        track.have = reading.have;
        track
    }

    /// Forgets what was written and not flushed: `reading` is what the files really hold.
    pub(super) fn fall_back(&mut self, reading: Reading) {
        let unavailable = self.unavailable();
        self.pending = IntervalSet::default();
        self.learner = reading.learner;
        self.live = self.learner.messages().saturating_sub(self.filled);
        self.covered = reading.have.clone();
        self.covered.absorb(&unavailable);
        self.have = reading.have;
    }

    fn unavailable(&self) -> IntervalSet {
        let mut set = IntervalSet::default();
        let (Some(first), Some(last)) = (self.covered.min(), self.covered.max()) else { return set };
        let mut held = self.have.clone();
        held.absorb(&self.pending);
        for (start, end) in held.gaps(first, last, usize::MAX) {
            // Part of a gap may be neither held nor refused.
            let mut next = start;
            for (s, e) in self.covered.gaps(start, end, usize::MAX) {
                if s > next {
                    set.insert(next, s - 1);
                }
                next = e.saturating_add(1);
            }
            if next <= end && next != 0 {
                set.insert(next, end);
            }
        }
        set
    }

    /// Does this message belong to the flight, and is it new?
    pub(super) fn wants(&self, sequence: u64, time_us: u64) -> bool {
        let after_start = match (self.identity.first_sequence, self.start_us) {
            (Some(first), _) => sequence >= first,
            (None, Some(start)) => time_us >= start,
            (None, None) => true,
        };
        after_start
            && self.last.is_none_or(|last| sequence <= last)
            && !self.have.contains(sequence)
            && !self.pending.contains(sequence)
    }

    /// Writes a message that the flight [wants](Track::wants). The writer must be open.
    pub(super) fn write(&mut self, frame: &Frame<'_>, topic: &str, backfill: bool, now: Instant) -> McapResult<()> {
        let Some((_, writer)) = &mut self.writer else { return Ok(()) };
        writer.write(frame, topic)?;
        self.pending.insert(frame.sequence, frame.sequence);
        self.covered.insert(frame.sequence, frame.sequence);
        self.learner.observe(topic, frame.time_us, frame.payload);
        *(if backfill { &mut self.filled } else { &mut self.live }) += 1;
        self.progressed = now;
        Ok(())
    }

    /// Makes what was written durable, when due or `now_or_never`.
    pub(super) fn flush(&mut self, now: Instant, always: bool) -> McapResult<()> {
        let Some((_, writer)) = &mut self.writer else { return Ok(()) };
        if always || writer.due(now) {
            writer.flush(now)?;
            self.have.absorb(&self.pending);
            self.pending = IntervalSet::default();
        }
        Ok(())
    }

    /// The agent's log does not hold these.
    pub(super) fn refuse(&mut self, first: u64, last: u64) {
        self.covered.insert(first, last);
        let nothing_before = self.have.min().or(self.pending.min()).is_some_and(|min| last.saturating_add(1) == min);
        if self.identity.first_sequence.is_none() && nothing_before {
            // Nobody has anything earlier: the flight begins with what is here.
            self.identity.first_sequence = self.have.min().or(self.pending.min());
        }
    }

    /// Asks once more for everything that was refused while the agent was still writing its log.
    pub(super) fn recheck(&mut self) {
        self.rechecked = true;
        self.covered = self.have.clone();
        self.covered.absorb(&self.pending);
    }

    /// First sequence number to account for.
    fn begin(&self) -> u64 {
        self.identity.first_sequence.unwrap_or(1)
    }

    /// Largest number held.
    pub(super) fn newest(&self) -> Option<u64> {
        self.have.max().max(self.pending.max())
    }

    /// Ranges worth asking the agent for, up to `horizon` while the flight goes on.
    pub(super) fn gaps(&self, horizon: u64, limit: usize) -> Vec<(u64, u64)> {
        let end = self.last.or(self.limit).unwrap_or(horizon);
        self.covered.gaps(self.begin(), end, limit)
    }

    /// Is `first..=last` settled: held, refused, or beyond the end?
    pub(super) fn settled(&self, first: u64, last: u64) -> bool {
        let last = self.last.map_or(last, |end| last.min(end));
        let first = first.max(self.begin());
        first > last || self.covered.missing(first, last) == 0
    }

    /// Messages known to be missing.
    pub(super) fn missing(&self) -> u64 {
        let Some(end) = self.last.or(self.newest()) else { return 0 };
        let begin = self.identity.first_sequence.or(self.have.min()).or(self.pending.min()).unwrap_or(end);
        let both = self.have.missing(begin, end);
        // Pending numbers are few and disjoint from `have`.
        both.saturating_sub(self.pending.count())
    }

    /// Were messages written that came after the end, before the end was known?
    pub(super) fn overshot(&self) -> bool {
        self.last.is_some_and(|last| self.newest().is_some_and(|newest| newest > last))
    }

    /// Is the flight over and everything of it here?
    pub(super) fn complete(&self) -> bool {
        self.last.is_some() && self.identity.first_sequence.is_some() && self.missing() == 0
    }

    /// What is said at the end of the file.
    pub(super) fn ending(&self, completeness: Completeness) -> Ending {
        Ending { last_sequence: self.last, completeness, live: self.live, filled: self.filled }
    }

    /// The record of the flight as it stands.
    pub(super) fn flight(&self, labels: Labels, completeness: Completeness, size_bytes: u64) -> Flight {
        let mut flight = Flight {
            id: self.identity.flight_id.clone(),
            name: labels.name,
            notes: labels.notes,
            vehicle_id: self.identity.agent_id.clone(),
            boot_id: self.identity.boot_id,
            live: self.live,
            filled: self.filled,
            missing: self.missing(),
            first_sequence: self.identity.first_sequence,
            last_sequence: self.last,
            completeness,
            size_bytes,
            ..Flight::default()
        };
        self.learner.describe(&mut flight, self.identity.boot_wall_time_us);
        flight
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(first: u64) -> Track {
        let identity = Identity { first_sequence: Some(first), ..Identity::default() };
        Track::new(identity, Instant::now())
    }

    #[test]
    fn gaps_are_what_is_neither_held_nor_refused() {
        let mut track = track(10);
        track.have.insert(10, 19);
        track.pending.insert(30, 39);
        track.covered.insert(10, 19);
        track.covered.insert(30, 39);
        assert_eq!(track.gaps(45, 9), [(20, 29), (40, 45)]);
        assert_eq!(track.missing(), 10);
        track.refuse(22, 24);
        assert_eq!(track.gaps(39, 9), [(20, 21), (25, 29)]);
        assert_eq!(track.missing(), 10, "refused is still missing");
        assert_eq!(track.unavailable().gaps(20, 26, 9), [(20, 21), (25, 26)]);
        track.last = Some(39);
        assert!(!track.complete());
        assert!(track.settled(22, 24) && !track.settled(20, 24) && track.settled(40, u64::MAX));
        track.recheck();
        assert_eq!(track.gaps(0, 9), [(20, 29)]);
    }

    #[test]
    fn a_flight_whose_beginning_was_lost_begins_where_the_agent_has_nothing_earlier() {
        let mut track = track(1);
        track.identity.first_sequence = None;
        track.start_us = Some(100);
        assert!(!track.wants(50, 99) && track.wants(50, 100));
        track.have.insert(50, 60);
        track.covered.insert(50, 60);
        assert_eq!(track.gaps(60, 9), [(1, 49)]);
        track.refuse(1, 49);
        assert_eq!(track.identity.first_sequence, Some(50));
    }
}
