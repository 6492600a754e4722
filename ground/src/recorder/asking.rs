//! What is asked of one agent: which flight, which ranges, and whether answers still come.
//!
//! At most [`MAX_REQUESTS`] requests for one flight are outstanding. Answers carry sequence numbers
//! and no flight, and sequence numbers begin again with each boot of the agent; so requests for
//! another boot wait until every answer of this one is in, and after a time-out, when late answers
//! may still come, until the agent has reconnected.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use plumbline_proto::v1;

use super::track::Track;
use crate::agent_link::CommandSender;

/// Most requests outstanding.
pub(super) const MAX_REQUESTS: usize = 32;
/// Most messages in one request.
const MAX_MESSAGES: u64 = 4096;
/// Gaps closer than this are asked for as one: a request costs about as much as so many messages.
const JOIN_WITHIN: u64 = 8;
/// A flight that could not be completed is asked for again after this long.
pub(super) const AGAIN: Duration = Duration::from_secs(15);
/// Without any answer for this long, the question is asked again: twice before a flight is left as it is
/// (`GroundConfig::settle_after`).
const SILENCE: Duration = Duration::from_secs(5);

/// The questions to one agent.
#[derive(Debug)]
pub(super) struct Asking {
    pub(super) flight: Option<String>,
    outstanding: Vec<(u64, u64)>,
    heard: Instant,
    /// Only flights of this boot may be asked for on this connection.
    pinned: Option<u64>,
    /// Flights that are not complete, and when to ask for them.
    waiting: VecDeque<(Instant, String)>,
}

impl Asking {
    pub(super) fn new(now: Instant) -> Self {
        Self { flight: None, outstanding: Vec::new(), heard: now, pinned: None, waiting: VecDeque::new() }
    }

    /// These flights are not complete: ask for each from `at` on.
    pub(super) fn await_turn(&mut self, flights: impl IntoIterator<Item = String>, at: Instant) {
        for flight in flights {
            if !self.waiting.iter().any(|(_, waiting)| *waiting == flight) {
                self.waiting.push_back((at, flight));
            }
        }
    }

    /// An answer came.
    pub(super) fn heard(&mut self, now: Instant) {
        self.heard = now;
    }

    /// The next flight of before that it is time to ask for.
    pub(super) fn next_waiting(&mut self, now: Instant) -> Option<String> {
        let due = self.waiting.iter().position(|(at, _)| now >= *at)?;
        self.waiting.remove(due).map(|(_, id)| id)
    }

    /// When the last question was asked or answer came.
    pub(super) fn last_heard(&self) -> Instant {
        self.heard
    }

    /// May flights of `boot_id` be asked for?
    pub(super) fn allows(&self, boot_id: u64) -> bool {
        self.pinned.is_none_or(|pinned| pinned == boot_id)
    }

    /// Takes note of what was answered. Answers whether nothing is outstanding.
    pub(super) fn idle(&mut self, track: Option<&Track>, now: Instant) -> bool {
        let Some(track) = track else {
            // The flight is gone (deleted); its answers may still be on their way.
            return self.outstanding.is_empty() || now.saturating_duration_since(self.heard) >= SILENCE;
        };
        self.outstanding.retain(|(first, last)| !track.settled(*first, *last));
        if !self.outstanding.is_empty() && now.saturating_duration_since(self.heard) >= SILENCE {
            tracing::warn!(flight = track.identity.flight_id, requests = self.outstanding.len(), "backfill: no answer");
            self.pinned = Some(track.identity.boot_id);
            self.outstanding.clear();
        }
        self.outstanding.is_empty()
    }

    /// Asks for the gaps of `track` up to `horizon`. Answers whether anything was asked.
    pub(super) fn ask(&mut self, track: &Track, horizon: u64, to: &CommandSender, now: Instant) -> bool {
        let flight_id = &track.identity.flight_id;
        let gaps = track.gaps(horizon, MAX_REQUESTS * 8);
        for (first_sequence, last_sequence) in join(&gaps).into_iter().take(MAX_REQUESTS) {
            let request = v1::BackfillRequest { flight_id: flight_id.clone(), first_sequence, last_sequence };
            if !to.try_backfill(request) {
                break;
            }
            self.outstanding.push((first_sequence, last_sequence));
        }
        if self.outstanding.is_empty() {
            return false;
        }
        self.flight = Some(flight_id.clone());
        self.heard = now;
        true
    }
}

/// Joins near gaps and cuts long ones; a gap without a known end stays whole.
fn join(gaps: &[(u64, u64)]) -> Vec<(u64, u64)> {
    let mut joined: Vec<(u64, u64)> = Vec::new();
    for &(first, last) in gaps {
        match joined.last_mut() {
            Some(before) if first - before.1 <= JOIN_WITHIN && last - before.0 < MAX_MESSAGES => before.1 = last,
            _ if last == u64::MAX => joined.push((first, last)),
            _ => {
                let mut start = first;
                while last - start >= MAX_MESSAGES && joined.len() < MAX_REQUESTS {
                    joined.push((start, start + MAX_MESSAGES - 1));
                    start += MAX_MESSAGES;
                }
                joined.push((start, last.min(start + MAX_MESSAGES - 1)));
            }
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_gaps_are_joined_and_long_ones_cut() {
        assert_eq!(join(&[(5, 6), (10, 12), (100, 100)]), [(5, 12), (100, 100)]);
        assert_eq!(join(&[(1, 10_000)]), [(1, 4096), (4097, 8192), (8193, 10_000)]);
        assert_eq!(join(&[(7, u64::MAX)]), [(7, u64::MAX)]);
        assert!(join(&[(1, u64::MAX - 1)]).len() <= MAX_REQUESTS + 1);
    }
}
