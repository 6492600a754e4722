//! One flight that is being recorded, or completed later: which messages it has, lacks, and cannot get.

use std::path::PathBuf;
use std::time::Instant;

use mcap::McapResult;
use plumbline_proto::codec::Frame;
use plumbline_proto::v1;

use super::flight::{Completeness, Flight, Learner, in_place};
use super::identity::{Ending, Identity};
use super::numbers::Numbers;
use super::reading::Reading;
use super::store::Labels;
use super::writer::FlightWriter;

/// Messages recorded after the end of a flight, before its end was known, are of this time at most, µs.
const OVERSHOOT_US: u64 = 5_000_000;

/// What is known of the files that a flight had before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Past {
    /// Everything, or there is none.
    Known,
    /// To be read: all but the parts from this number on.
    Due(u32),
    /// Being read. Until then nothing is asked of the agent, and the flight is not closed.
    Asked,
}

/// Where a flight begins and ends, beside its first message, which its identity names.
#[derive(Debug, Default)]
pub(super) struct Ends {
    /// Where the beginning was not seen: messages sensed from here on belong to the flight.
    pub(super) start_us: Option<u64>,
    /// Where the beginning was not seen: nobody holds an earlier message than this one.
    earliest: Option<u64>,
    /// Last sequence number, from the closing mark.
    pub(super) last: Option<u64>,
    /// No message of the flight comes after this one, where the closing mark was not seen.
    pub(super) limit: Option<u64>,
}

/// The part of a flight that is being written.
pub(super) struct Output {
    pub(super) writer: Option<(PathBuf, FlightWriter)>,
    /// Number of the next part.
    pub(super) part: u32,
    /// Bytes of the parts that this track has ended.
    pub(super) ended_bytes: u64,
    /// No new file before this moment: the last one failed.
    pub(super) retry: Option<Instant>,
}

impl Output {
    /// Bytes written so far, all parts together.
    pub(super) fn bytes(&self) -> u64 {
        self.ended_bytes + self.writer.as_ref().map_or(0, |(_, writer)| writer.size())
    }
}

/// Sequence-number accounting of one flight, and its open file.
pub(super) struct Track {
    pub(super) identity: Identity,
    pub(super) ends: Ends,
    /// When the flight ended, as far as the ground can tell.
    pub(super) ended: Option<Instant>,
    /// The status has contradicted this flight since then.
    pub(super) contradicted: Option<Instant>,
    /// Was everything that the agent could not send asked once more after the end?
    pub(super) rechecked: bool,
    /// Last time a message was added.
    pub(super) progressed: Instant,
    /// What files from before this track hold.
    pub(super) past: Past,
    pub(super) learner: Learner,
    /// As the learner was at the last flush.
    flushed: Learner,
    live: u64,
    filled: u64,
    numbers: Numbers,
    pub(super) output: Output,
}

impl Track {
    pub(super) fn new(identity: Identity, part: u32, now: Instant) -> Self {
        let learner = Learner::of(&identity.flight_id);
        Self {
            identity,
            ends: Ends::default(),
            past: Past::Known,
            ended: None,
            contradicted: None,
            rechecked: false,
            progressed: now,
            flushed: learner.clone(),
            learner,
            live: 0,
            filled: 0,
            numbers: Numbers::default(),
            output: Output { writer: None, part, ended_bytes: 0, retry: None },
        }
    }

    /// A flight whose files exist; its next part has this number.
    pub(super) fn resume(reading: Reading, part: u32, now: Instant) -> Self {
        let mut track = Self::new(reading.identity.clone(), part, now);
        track.remember(reading);
        track
    }

    /// Takes in what the files from before hold.
    pub(super) fn remember(&mut self, past: Reading) {
        let (first, last) = (past.first(), past.range().1);
        let ending = past.ending();
        self.past = Past::Known;
        self.identity.first_sequence = self.identity.first_sequence.or(first);
        self.ends.last = self.ends.last.or(last);
        self.live += ending.live;
        self.filled += ending.filled;
        self.learner.absorb(&past.learner);
        self.flushed.absorb(&past.learner);
        self.numbers.absorb(&past.have);
    }

    /// Forgets what was written and not flushed: the file has failed.
    pub(super) fn fall_back(&mut self) {
        self.numbers.fall_back();
        self.learner = self.flushed.clone();
        self.live = self.learner.messages().saturating_sub(self.filled);
    }

    /// Takes in what a mark says of the flight. Answers whether it counts: a mark that is not in its place, whose
    /// number is that of a message held, that contradicts an earlier one, or comes long before messages that are held,
    /// changes nothing.
    pub(super) fn learn(&mut self, mark: &v1::FlightMark, sequence: u64, now: Instant) -> bool {
        let newest_us = self.learner.times_us().map_or(0, |(_, last)| last);
        let other = |known: Option<u64>, named: u64| known.is_some_and(|known| known != named);
        if !in_place(mark, sequence)
            || self.numbers.holds(sequence)
            || other(self.identity.first_sequence, mark.first_sequence)
            || mark.last_sequence.is_some_and(|last| other(self.ends.last, last))
            || mark.last_sequence.is_some() && mark.time_us.saturating_add(OVERSHOOT_US) < newest_us
        {
            return false;
        }
        self.identity.first_sequence = Some(mark.first_sequence);
        if let Some(last) = mark.last_sequence {
            self.ends.last = Some(last);
            self.ended.get_or_insert(now);
        }
        true
    }

    /// Does this message belong to the flight, and is it new?
    pub(super) fn wants(&self, sequence: u64, time_us: u64) -> bool {
        let after_start = match (self.identity.first_sequence, self.ends.start_us) {
            (Some(first), _) => sequence >= first,
            (None, Some(start)) => time_us >= start,
            (None, None) => true,
        };
        after_start && self.ends.last.is_none_or(|last| sequence <= last) && !self.numbers.holds(sequence)
    }

    /// Writes a message that the flight [wants](Track::wants). The writer must be open.
    pub(super) fn write(&mut self, frame: &Frame<'_>, topic: &str, backfill: bool, now: Instant) -> McapResult<()> {
        let Some((_, writer)) = &mut self.output.writer else { return Ok(()) };
        writer.write(frame, topic)?;
        self.numbers.written(frame.sequence);
        self.learner.observe(topic, frame.sequence, frame.time_us, frame.payload);
        *(if backfill { &mut self.filled } else { &mut self.live }) += 1;
        self.progressed = now;
        Ok(())
    }

    /// Makes what was written durable, when due or `now_or_never`.
    pub(super) fn flush(&mut self, now: Instant, always: bool) -> McapResult<()> {
        let Some((_, writer)) = &mut self.output.writer else { return Ok(()) };
        if always || writer.due(now) {
            writer.flush(now)?;
            self.numbers.flushed();
            self.flushed.clone_from(&self.learner);
        }
        Ok(())
    }

    /// The agent's log does not hold these.
    pub(super) fn refuse(&mut self, first: u64, last: u64) {
        self.numbers.refuse(first, last);
        let oldest = self.numbers.oldest();
        if self.identity.first_sequence.is_none() && oldest.is_some_and(|oldest| last.saturating_add(1) == oldest) {
            self.ends.earliest = oldest;
        }
    }

    /// Asks once more for everything that was refused while the agent was still writing its log.
    pub(super) fn recheck(&mut self) {
        self.rechecked = true;
        self.numbers.recheck();
    }

    /// First sequence number to account for.
    fn begin(&self) -> u64 {
        self.identity.first_sequence.or(self.ends.earliest).unwrap_or(1)
    }

    /// Largest number held.
    pub(super) fn newest(&self) -> Option<u64> {
        self.numbers.newest()
    }

    /// Ranges worth asking the agent for, up to `horizon` while the flight goes on.
    pub(super) fn gaps(&self, horizon: u64, limit: usize) -> Vec<(u64, u64)> {
        let end = self.ends.last.or(self.ends.limit).unwrap_or(horizon);
        self.numbers.gaps(self.begin(), end, limit)
    }

    /// Is `first..=last` settled: held, refused, or beyond the end?
    pub(super) fn settled(&self, first: u64, last: u64) -> bool {
        let last = self.ends.last.map_or(last, |end| last.min(end));
        let first = first.max(self.begin());
        first > last || self.numbers.settled(first, last)
    }

    /// Messages known to be missing.
    pub(super) fn missing(&self) -> u64 {
        let Some(end) = self.ends.last.or(self.newest()) else { return 0 };
        let begin = self.identity.first_sequence.or(self.numbers.oldest()).unwrap_or(end);
        self.numbers.missing(begin, end)
    }

    /// Were messages written that came after the end, before the end was known?
    pub(super) fn overshot(&self) -> bool {
        self.ends.last.is_some_and(|last| self.newest().is_some_and(|newest| newest > last))
    }

    /// Is the flight over and everything of it here?
    pub(super) fn complete(&self) -> bool {
        self.past == Past::Known
            && self.ends.last.is_some()
            && self.identity.first_sequence.is_some()
            && self.missing() == 0
    }

    /// What is said at the end of the file.
    pub(super) fn ending(&self, completeness: Completeness) -> Ending {
        Ending { last_sequence: self.ends.last, completeness, live: self.live, filled: self.filled }
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
            last_sequence: self.ends.last,
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
        Track::new(identity, 1, Instant::now())
    }

    #[test]
    fn gaps_are_what_is_neither_held_nor_refused() {
        let mut track = track(10);
        (10..20).chain(30..40).for_each(|sequence| track.numbers.written(sequence));
        assert_eq!(track.gaps(45, 9), [(20, 29), (40, 45)]);
        assert_eq!(track.missing(), 10);
        track.refuse(22, 24);
        assert_eq!(track.gaps(39, 9), [(20, 21), (25, 29)]);
        assert_eq!(track.missing(), 10, "refused is still missing");
        track.ends.last = Some(39);
        assert!(!track.complete());
        assert!(track.settled(22, 24) && !track.settled(20, 24) && track.settled(40, u64::MAX));
        track.recheck();
        assert_eq!(track.gaps(0, 9), [(20, 29)]);
    }

    #[test]
    fn a_mark_counts_once_and_in_its_place() {
        let now = Instant::now();
        let mark = |first_sequence, last_sequence, time_us| v1::FlightMark {
            time_us,
            first_sequence,
            last_sequence,
            ..Default::default()
        };
        let mut track = track(10);
        (10..=80).for_each(|sequence| track.numbers.written(sequence));
        assert!(!track.learn(&mark(10, Some(60), 0), 90, now), "it speaks of another place");
        assert!(!track.learn(&mark(10, Some(60), 0), 60, now), "a message of this number is held");
        assert!(!track.learn(&mark(70, None, 0), 70, now) && !track.learn(&mark(11, Some(90), 0), 90, now));
        assert!(track.learn(&mark(10, Some(90), 0), 90, now));
        assert!(!track.learn(&mark(10, Some(85), 0), 85, now), "it has ended already");
        assert_eq!((track.identity.first_sequence, track.ends.last), (Some(10), Some(90)));
        let mut track = Track::new(Identity::default(), 1, now);
        track.learner.observe("/control", 90, OVERSHOOT_US + 2, &[]);
        assert!(!track.learn(&mark(10, Some(60), 1), 60, now), "seconds of messages would be lost");
        assert!(track.learn(&mark(10, Some(60), 2), 60, now));
    }

    #[test]
    fn nothing_is_asked_before_the_earliest_there_is_and_a_flight_without_its_beginning_is_not_complete() {
        let mut track = track(1);
        track.identity.first_sequence = None;
        track.ends.start_us = Some(100);
        assert!(!track.wants(50, 99) && track.wants(50, 100));
        (50..=60).for_each(|sequence| track.numbers.written(sequence));
        assert_eq!(track.gaps(60, 9), [(1, 49)]);
        track.refuse(1, 49);
        assert_eq!((track.begin(), track.gaps(60, 9)), (50, vec![]));
        track.ends.last = Some(60);
        assert!(track.missing() == 0 && !track.complete());
    }
}
