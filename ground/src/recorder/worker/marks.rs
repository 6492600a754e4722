//! Which flight goes on: the marks and the status of an agent, and the tracks they begin and end.

use std::time::{Duration, Instant};

use plumbline_proto::codec::Batch;
use plumbline_proto::ids::FlightId;
use plumbline_proto::{Kind, v1};

use super::Worker;
use crate::recorder::flight::in_place;
use crate::recorder::identity::Identity;
use crate::recorder::store::Files;
use crate::recorder::track::{Past, Track};

/// A flight that the agent's status contradicts for this long is over.
const CONTRADICTED_FOR: Duration = Duration::from_secs(2);

impl Worker {
    /// The agent opened or closed a flight.
    pub(super) fn mark(&mut self, agent_id: &str, mark: &v1::FlightMark, sequence: u64, now: Instant) {
        let id = match FlightId::new(mark.flight_id.clone()) {
            Ok(id) => id.as_str().to_owned(),
            Err(error) => {
                tracing::error!(%agent_id, %error, "a flight cannot be recorded");
                return;
            }
        };
        let Some(boot_id) = self.agents.get(agent_id).map(|agent| agent.boot_id) else { return };
        let fresh = !self.tracks.contains_key(&id);
        if fresh && !(in_place(mark, sequence) && self.open(agent_id, &id, Some(mark.first_sequence), None, now)) {
            return;
        }
        let Some(track) = self.tracks.get_mut(&id) else { return };
        // Nobody speaks of another's flight, nor of one of another start.
        let own = track.identity.agent_id == agent_id && track.identity.boot_id == boot_id;
        // What opened the track is learnt with the recent messages.
        if !own || !fresh && !track.learn(mark, sequence, now) {
            let (first, last) = (mark.first_sequence, mark.last_sequence);
            tracing::warn!(flight = %id, %agent_id, own, first, last, sequence, "a mark is not taken");
            return;
        }
        track.contradicted = None;
        if mark.last_sequence.is_some() {
            tracing::info!(flight = %id, reason = mark.reason, "flight ended");
        }
        for (other, track) in &mut self.tracks {
            // One flight at a time: a new one ends the one before, whose closing mark was lost.
            if *other != id && track.identity.agent_id == agent_id && track.ended.is_none() {
                track.ended = Some(now);
                track.ends.limit = Some(mark.first_sequence.saturating_sub(1));
            }
        }
        self.show(agent_id);
        self.shared.changed.notify_one();
    }

    /// The agent's status says which flight goes on; marks may have been lost, or the ground restarted.
    pub(super) fn status(&mut self, agent_id: &str, status: &v1::Status, now: Instant) {
        let id = &status.flight_id;
        for (other, track) in &mut self.tracks {
            if track.identity.agent_id != agent_id || track.ended.is_some() {
                continue;
            }
            let newest_us = track.learner.times_us().map_or(0, |(_, last)| last);
            if other == id {
                track.contradicted = None;
            } else if status.time_us.saturating_add(1_000_000) > newest_us {
                let since = *track.contradicted.get_or_insert(now);
                if now.saturating_duration_since(since) >= CONTRADICTED_FOR {
                    track.ended = Some(now);
                    track.ends.limit = self.agents.get(agent_id).map(|a| a.highest);
                }
            }
        }
        if !id.is_empty() && !self.tracks.contains_key(id) && FlightId::new(id.clone()).is_ok() {
            let id = id.clone();
            self.open(agent_id, &id, None, Some(status.flight_start_us), now);
        }
    }

    /// Begins or resumes the recording of a flight. `false` when there is nothing (more) to record, or not yet.
    fn open(
        &mut self,
        agent_id: &str,
        id: &str,
        first_sequence: Option<u64>,
        start_us: Option<u64>,
        now: Instant,
    ) -> bool {
        let Some(agent) = self.agents.get(agent_id) else { return false };
        if self.closing.contains(id) || self.complete.iter().any(|complete| complete == id) {
            return false;
        }
        let files = self.store.files(id);
        let before = files.identity();
        let other = before.boot_id != agent.boot_id || before.agent_id != agent_id;
        if before.boot_id != 0 && other {
            let Identity { agent_id: theirs, boot_id, .. } = before;
            tracing::error!(flight = id, %agent_id, theirs, boot_id, "the name is that of another vehicle's or boot's flight");
            return false;
        }
        let identity = Identity {
            flight_id: id.to_owned(),
            agent_id: agent_id.to_owned(),
            boot_id: agent.boot_id,
            boot_wall_time_us: agent.boot_wall_time_us,
            first_sequence: first_sequence.or(before.first_sequence),
        };
        let mut track = Track::new(identity, files.next_part(), now);
        if files == Files::default() {
            tracing::info!(flight = id, %agent_id, first_sequence, "flight begins");
        } else {
            // Recorded from here on at once; what was recorded before is read back meanwhile.
            tracing::info!(flight = id, %agent_id, "flight goes on after a gap");
            track.past = Past::Due(track.output.part);
        }
        track.ends.start_us = start_us;
        let recent = agent.recent();
        self.tracks.insert(id.to_owned(), track);
        for frame in recent.iter().flat_map(Batch::frames) {
            let numbered = frame.sequence > 0 && !frame.known_kind().is_some_and(Kind::is_ground_made);
            if frame.known_kind() == Some(Kind::Flight)
                && let Ok(mark) = frame.message::<v1::FlightMark>()
                && mark.flight_id == id
                && let Some(track) = self.tracks.get_mut(id)
            {
                track.learn(&mark, frame.sequence, now);
            }
            if numbered && self.tracks.get(id).is_some_and(|t| t.wants(frame.sequence, frame.time_us)) {
                self.record(id, &frame, false, now);
            }
        }
        true
    }
}
