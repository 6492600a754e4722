//! What the keeper is given to do, and what becomes of what it has done.

use std::sync::mpsc::SyncSender;
use std::time::Instant;

use super::Worker;
use super::agent::Greeting;
use crate::recorder::RecordingError;
use crate::recorder::asking::AGAIN;
use crate::recorder::flight::Completeness;
use crate::recorder::keeper::{Done, Job};
use crate::recorder::store::Labels;
use crate::recorder::track::{Past, Track};

/// Complete flights remembered: a late status of one of them begins nothing.
const REMEMBERED: usize = 64;

impl Worker {
    /// Has the files finished. The flight stays where it is when the keeper has too much to do.
    pub(super) fn close(&mut self, id: &str, completeness: Completeness) {
        let Some(track) = self.tracks.remove(id) else { return };
        match self.keeper.give(Job::Close { id: id.to_owned(), track: Box::new(track), completeness }) {
            Ok(()) => drop(self.closing.insert(id.to_owned())),
            Err(Job::Close { id, track, .. }) => drop(self.tracks.insert(id, *track)),
            Err(_) => {}
        }
    }

    /// Has the files from before read, once.
    pub(super) fn read_past(&mut self, id: &str) {
        let Some(track) = self.tracks.get_mut(id) else { return };
        let Past::Due(before) = track.past else { return };
        if self.keeper.give(Job::Read { id: id.to_owned(), before }).is_ok() {
            track.past = Past::Asked;
            self.reading.insert(id.to_owned());
        }
    }

    /// Goes on in a new part when the one being written has become long; they are merged at the end of the flight.
    pub(super) fn turn_over(&mut self, id: &str) {
        let Some(track) = self.tracks.get_mut(id) else { return };
        let Some((path, writer)) = track.output.writer.take_if(|(_, writer)| writer.long()) else { return };
        let bytes = writer.size();
        match self.keeper.give(Job::Finish(Box::new(writer))) {
            Err(Job::Finish(writer)) => track.output.writer = Some((path, *writer)),
            _ => track.output.ended_bytes += bytes,
        }
    }

    pub(super) fn greet(&mut self, agent_id: &str) {
        let Some(agent) = self.agents.get_mut(agent_id).filter(|agent| agent.greeting == Greeting::Due) else { return };
        let Some(commands) = agent.commands.clone() else { return };
        if self.keeper.give(Job::Greet { agent_id: agent_id.to_owned(), commands }).is_ok() {
            agent.greeting = Greeting::Asked;
        }
    }

    /// What the keeper has done.
    pub(super) fn done(&mut self, done: Done, now: Instant) {
        match done {
            Done::Unfinished { agent_id, flights } => {
                if let Some(agent) = self.agents.get_mut(&agent_id).filter(|agent| agent.greeting == Greeting::Asked) {
                    agent.greeting = Greeting::Done;
                    agent.asking.await_turn(flights, now);
                }
            }
            Done::Read { id, reading, part } => {
                // It may have been deleted meanwhile.
                if !self.reading.remove(&id) {
                    return;
                }
                match self.tracks.get_mut(&id) {
                    Some(track) if track.past == Past::Known => {}
                    Some(track) => {
                        track.remember(*reading);
                        if track.ends.last.is_some() {
                            track.ended.get_or_insert(now);
                        }
                    }
                    None if reading.learner.messages() == 0 => {}
                    None => {
                        let mut track = Track::resume(*reading, part, now);
                        track.ended = Some(now);
                        if track.ends.last.is_none() {
                            track.ends.limit = Some(u64::MAX);
                        }
                        self.tracks.insert(id, track);
                    }
                }
            }
            Done::Closed { id, agent_id, completeness } => {
                self.closing.remove(&id);
                let agent = self.agents.get_mut(&agent_id);
                match (completeness, agent) {
                    (Completeness::Complete, agent) => {
                        if let Some(commands) = agent.and_then(|agent| agent.commands.as_ref()) {
                            commands.try_flight_kept(&id);
                        }
                        self.complete.push_back(id);
                        if self.complete.len() > REMEMBERED {
                            self.complete.pop_front();
                        }
                    }
                    (Completeness::Filling, Some(agent)) => agent.asking.await_turn([id], now + AGAIN),
                    _ => {}
                }
                self.show(&agent_id);
            }
        }
    }

    pub(super) fn renew(&self, id: &str) {
        let Some(track) = self.tracks.get(id) else { return };
        let completeness = if track.ended.is_some() { Completeness::Filling } else { Completeness::Recording };
        // Name, notes and size are the keeper's to add.
        let _ = self.keeper.give(Job::Renew(Box::new(track.flight(Labels::default(), completeness, 0))));
    }

    pub(super) fn delete(&mut self, id: String, answer: SyncSender<Result<(), RecordingError>>) {
        if self.tracks.get(&id).is_some_and(|track| track.ended.is_none()) {
            let _ = answer.send(Err(RecordingError::InProgress(id)));
            return;
        }
        self.tracks.remove(&id);
        self.reading.remove(&id);
        if let Err(Job::Delete { answer, .. }) = self.keeper.give(Job::Delete { id, answer }) {
            let _ = answer.send(Err(RecordingError::Busy));
        }
    }
}
