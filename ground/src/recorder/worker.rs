//! The recorder's thread: takes what the hub passes on, decides which flight each message belongs to,
//! writes, flushes and asks for what is missing. Whatever takes longer it leaves to the keeper.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

use bytes::Bytes;
use plumbline_agent::log::Syncer;
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::ids::FlightId;
use plumbline_proto::{Kind, v1};

use super::asking::{AGAIN, Asking};
use super::flight::{Completeness, in_place};
use super::identity::Identity;
use super::keeper::{Done, Job, Keeper};
use super::store::{Files, Labels, RecordingStore};
use super::track::{Past, Track};
use super::writer::FlightWriter;
use super::{Input, RecordingError, Shared, explain, free_bytes};
use crate::agent_link::CommandSender;
use crate::config::GroundConfig;
use crate::sync::lock;

/// Work that time drives is done this often.
const TICK: Duration = Duration::from_millis(20);
/// The index entry of a flight in progress, and the free space, are renewed this often.
const RENEW_EVERY: Duration = Duration::from_secs(1);
/// A file that failed is tried again after this long.
const RETRY_AFTER: Duration = Duration::from_secs(1);
/// A flight that the agent's status contradicts for this long is over.
const CONTRADICTED_FOR: Duration = Duration::from_secs(2);
/// Complete flights remembered: a late status of one of them begins nothing.
const REMEMBERED: usize = 64;
/// Live batches kept, for flights whose beginning is announced a little late.
const RECENT: Duration = Duration::from_secs(3);
const RECENT_BYTES: usize = 8 << 20;

pub(super) struct Worker {
    config: GroundConfig,
    store: RecordingStore,
    keeper: Keeper,
    shared: Arc<Shared>,
    agents: BTreeMap<String, Agent>,
    tracks: BTreeMap<String, Track>,
    /// Flights that the keeper reads back.
    reading: BTreeSet<String>,
    /// Flights that the keeper closes.
    closing: BTreeSet<String>,
    /// The last ones that were closed with nothing missing.
    complete: VecDeque<String>,
    topics: HashMap<(u16, u16), String>,
    ticked: Instant,
    renewed: Option<Instant>,
    free_bytes: u64,
    syncer: Syncer,
}

struct Agent {
    boot_id: u64,
    boot_wall_time_us: u64,
    commands: Option<CommandSender>,
    /// Highest live sequence number of this boot.
    highest: u64,
    /// How it grew: what lies below an old entry is late, not on its way.
    heights: VecDeque<(Instant, u64)>,
    /// Live batches as they came.
    recent: VecDeque<(Instant, Bytes)>,
    recent_bytes: usize,
    asking: Asking,
    greeting: Greeting,
}

/// Has the keeper been asked what an agent should be told, and asked for, on this connection?
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Greeting {
    Due,
    Asked,
    Done,
}

impl Worker {
    pub(super) fn new(
        config: GroundConfig,
        store: RecordingStore,
        keeper: Keeper,
        shared: Arc<Shared>,
        syncer: Syncer,
    ) -> Self {
        Self {
            config,
            store,
            keeper,
            shared,
            agents: BTreeMap::new(),
            tracks: BTreeMap::new(),
            reading: BTreeSet::new(),
            closing: BTreeSet::new(),
            complete: VecDeque::new(),
            topics: HashMap::new(),
            ticked: Instant::now(),
            renewed: None,
            free_bytes: 0,
            syncer,
        }
    }

    pub(super) fn run(mut self, inputs: &Receiver<Input>) {
        if let Err(error) = self.store.probe() {
            self.shared.complain(&error.to_string());
        }
        self.store.sweep();
        // Listed before anything is written: what is repaired is never what is being recorded.
        let _ = self.keeper.give(Job::CatchUp(self.store.list()));
        loop {
            match inputs.recv_timeout(TICK) {
                Ok(Input::Finish) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(input) => self.take(input),
                Err(RecvTimeoutError::Timeout) => {}
            }
            let now = Instant::now();
            if now.saturating_duration_since(self.ticked) >= TICK {
                self.ticked = now;
                self.tick(now);
            }
        }
        let close = |(id, track): (String, Track)| {
            let completeness = if track.complete() { Completeness::Complete } else { Completeness::Filling };
            Job::Close { id, track: Box::new(track), completeness }
        };
        self.keeper.finish(self.tracks.into_iter().map(close));
    }

    fn take(&mut self, input: Input) {
        let now = Instant::now();
        match input {
            Input::Connected { agent_id, boot_id, boot_wall_time_us, commands } => {
                self.connected(&agent_id, boot_id, boot_wall_time_us, commands, now);
            }
            Input::Batch { agent_id, batch, backfill } => {
                self.shared.queued_bytes.fetch_sub(batch.len(), Ordering::Relaxed);
                self.batch(&agent_id, batch, backfill, now);
            }
            Input::Unavailable { agent_id, request } => {
                if let Some(agent) = self.agents.get_mut(&agent_id) {
                    agent.asking.heard(now);
                }
                if let Some(track) = self.tracks.get_mut(&request.flight_id)
                    && track.identity.agent_id == agent_id
                {
                    track.refuse(request.first_sequence, request.last_sequence);
                }
            }
            Input::Disconnected { agent_id } => {
                // A session that was replaced by a newer one must not close the newer one.
                if let Some(agent) = self.agents.get_mut(&agent_id)
                    && agent.commands.as_ref().is_some_and(CommandSender::is_closed)
                {
                    agent.commands = None;
                }
            }
            Input::Delete { id, answer } => self.delete(id, answer),
            Input::Finish => {}
        }
    }

    fn connected(
        &mut self,
        agent_id: &str,
        boot_id: u64,
        boot_wall_time_us: u64,
        commands: CommandSender,
        now: Instant,
    ) {
        for track in self.tracks.values_mut() {
            if track.identity.agent_id == agent_id && track.identity.boot_id != boot_id && track.ended.is_none() {
                // The agent was started again in flight. Its old log may hold the end.
                track.ended = Some(now);
                track.limit = Some(u64::MAX);
            }
        }
        let asking = Asking::new(now);
        match self.agents.get_mut(agent_id) {
            Some(agent) if agent.boot_id == boot_id => {
                agent.commands = Some(commands);
                agent.asking = asking;
                agent.greeting = Greeting::Due;
            }
            _ => {
                let agent = Agent {
                    boot_id,
                    boot_wall_time_us,
                    commands: Some(commands),
                    highest: 0,
                    heights: VecDeque::new(),
                    recent: VecDeque::new(),
                    recent_bytes: 0,
                    asking,
                    greeting: Greeting::Due,
                };
                self.agents.insert(agent_id.to_owned(), agent);
            }
        }
    }

    fn batch(&mut self, agent_id: &str, batch: Bytes, backfill: bool, now: Instant) {
        let Some(agent) = self.agents.get_mut(agent_id) else { return };
        if backfill {
            agent.asking.heard(now);
        } else {
            agent.remember(batch.clone(), now);
        }
        let Ok(frames) = codec::decode_batch(&batch) else { return };
        for frame in frames {
            // What follows a broken frame cannot be read; the hub has said so already.
            let Ok(frame) = frame else { return };
            if frame.sequence == 0 || frame.known_kind().is_some_and(Kind::is_ground_made) {
                continue;
            }
            if backfill {
                self.filled_in(agent_id, &frame, now);
            } else {
                self.live(agent_id, &frame, now);
            }
        }
    }

    fn live(&mut self, agent_id: &str, frame: &Frame<'_>, now: Instant) {
        let Some(agent) = self.agents.get_mut(agent_id) else { return };
        agent.rise(frame.sequence, now);
        let boot_id = agent.boot_id;
        match frame.known_kind() {
            Some(Kind::Flight) => {
                if let Ok(mark) = frame.message::<v1::FlightMark>() {
                    self.mark(agent_id, &mark, frame.sequence, now);
                }
            }
            Some(Kind::Status) => {
                if let Ok(status) = frame.message::<v1::Status>() {
                    self.status(agent_id, &status, now);
                }
            }
            _ => {}
        }
        let belongs = |t: &Track| {
            t.identity.boot_id == boot_id
                && t.identity.agent_id == agent_id
                && t.contradicted.is_none()
                && t.wants(frame.sequence, frame.time_us)
        };
        if let Some(id) = self.tracks.iter().find(|(_, t)| belongs(t)).map(|(id, _)| id.clone()) {
            self.record(&id, frame, false, now);
        }
    }

    fn filled_in(&mut self, agent_id: &str, frame: &Frame<'_>, now: Instant) {
        let Some(id) = self.agents.get(agent_id).and_then(|a| a.asking.flight.clone()) else { return };
        let Some(track) = self.tracks.get_mut(&id) else { return };
        if frame.known_kind() == Some(Kind::Flight)
            && let Ok(mark) = frame.message::<v1::FlightMark>()
            && mark.flight_id == id
        {
            track.learn(&mark, frame.sequence, now);
        }
        if track.wants(frame.sequence, frame.time_us) {
            self.record(&id, frame, true, now);
        }
    }

    /// The agent opened or closed a flight.
    fn mark(&mut self, agent_id: &str, mark: &v1::FlightMark, sequence: u64, now: Instant) {
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
                track.limit = Some(mark.first_sequence.saturating_sub(1));
            }
        }
        self.show(agent_id);
        self.shared.changed.notify_one();
    }

    /// The agent's status says which flight goes on; marks may have been lost, or the ground restarted.
    fn status(&mut self, agent_id: &str, status: &v1::Status, now: Instant) {
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
                    track.limit = self.agents.get(agent_id).map(|a| a.highest);
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
            track.past = Past::Due(track.part);
        }
        track.start_us = start_us;
        let recent: Vec<_> = agent.recent.iter().map(|(_, batch)| batch.clone()).collect();
        self.tracks.insert(id.to_owned(), track);
        for frame in
            recent.iter().filter_map(|batch| codec::decode_batch(batch).ok()).flat_map(|f| f.map_while(Result::ok))
        {
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

    fn record(&mut self, id: &str, frame: &Frame<'_>, backfill: bool, now: Instant) {
        if !self.ready_to_write(id, now) {
            return;
        }
        let Some(track) = self.tracks.get_mut(id) else { return };
        let topic = self.topics.entry((frame.kind, frame.instance)).or_insert_with(|| {
            frame.known_kind().map_or_else(
                || format!("/unknown/{}/{}", frame.kind, frame.instance),
                |kind| kind.topic(frame.instance),
            )
        });
        if let Err(error) = track.write(frame, topic, backfill, now) {
            self.failed(id, &explain(&error), now);
        }
    }

    /// Opens the file of a flight where none is open. `false` while nothing can be written.
    fn ready_to_write(&mut self, id: &str, now: Instant) -> bool {
        let Some(track) = self.tracks.get_mut(id) else { return false };
        if track.writer.is_some() {
            return true;
        }
        if track.retry.is_some_and(|at| now < at) {
            return false;
        }
        let path = self.store.part_path(id, track.part);
        track.part += 1;
        let created = self.store.probe().map_err(|e| e.to_string()).and_then(|()| {
            let free = free_bytes(self.store.folder());
            if free < self.config.reserve_bytes {
                return Err(low_space(self.store.folder(), free, self.config.reserve_bytes));
            }
            FlightWriter::create(&path, &track.identity, &self.syncer)
                .map_err(|e| format!("{}: {}", path.display(), explain(&e)))
        });
        match created {
            Ok(writer) => {
                track.writer = Some((path, writer));
                track.retry = None;
                self.shared.recover();
                true
            }
            Err(error) => {
                track.retry = Some(now + RETRY_AFTER);
                self.shared.complain(&error);
                false
            }
        }
    }

    /// A file failed: what was not flushed is missing, and will be asked for again.
    fn failed(&mut self, id: &str, error: &str, now: Instant) {
        self.shared.complain(error);
        let Some(track) = self.tracks.get_mut(id) else { return };
        track.writer = None;
        track.retry = Some(now + RETRY_AFTER);
        track.fall_back();
    }

    fn tick(&mut self, now: Instant) {
        let renew = self.renewed.is_none_or(|at| now.saturating_duration_since(at) >= RENEW_EVERY);
        if renew {
            self.renewed = Some(now);
            self.check_disk(now);
        }
        while let Some(done) = self.keeper.done() {
            self.done(done, now);
        }
        let renew = renew && self.keeper.idle();
        for agent in self.agents.values_mut() {
            let track = agent.asking.flight.as_ref().and_then(|id| self.tracks.get(id));
            agent.asking.idle(track, now);
        }
        for id in self.tracks.keys().cloned().collect::<Vec<_>>() {
            let Some(track) = self.tracks.get_mut(&id) else { continue };
            if let Err(error) = track.flush(now, false) {
                self.failed(&id, &explain(&error), now);
            }
            self.read_past(&id);
            self.turn_over(&id);
            if let Some(completeness) = self.verdict(&id, now) {
                self.close(&id, completeness);
            } else if renew {
                self.renew(&id);
            }
        }
        for agent_id in self.agents.keys().cloned().collect::<Vec<_>>() {
            self.greet(&agent_id);
            self.ask(&agent_id, now);
            self.show(&agent_id);
        }
    }

    /// Should a flight be closed now, and as what?
    fn verdict(&mut self, id: &str, now: Instant) -> Option<Completeness> {
        let track = self.tracks.get_mut(id)?;
        let ended = track.ended?;
        if track.retry.is_some() || track.past != Past::Known {
            // Nothing can be written now, or it is not known what is missing.
            return None;
        }
        if track.complete() {
            return Some(Completeness::Complete);
        }
        let agent = self.agents.get(&track.identity.agent_id);
        let heard = agent.filter(|a| a.asking.flight.as_deref() == Some(id)).map(|a| a.asking.last_heard());
        let quiet = now.saturating_duration_since(ended.max(track.progressed).max(heard.unwrap_or(ended)));
        let end = track.newest().unwrap_or(0);
        if track.gaps(end, 1).is_empty() && quiet >= self.config.backfill_after {
            let same_boot = agent.is_some_and(|a| a.boot_id == track.identity.boot_id && a.commands.is_some());
            if same_boot && !track.rechecked {
                track.recheck();
                return None;
            }
            return Some(Completeness::Truncated);
        }
        (quiet >= self.config.settle_after).then_some(Completeness::Filling)
    }

    /// Has the files finished. The flight stays where it is when the keeper has too much to do.
    fn close(&mut self, id: &str, completeness: Completeness) {
        let Some(track) = self.tracks.remove(id) else { return };
        match self.keeper.give(Job::Close { id: id.to_owned(), track: Box::new(track), completeness }) {
            Ok(()) => drop(self.closing.insert(id.to_owned())),
            Err(Job::Close { id, track, .. }) => drop(self.tracks.insert(id, *track)),
            Err(_) => {}
        }
    }

    /// Has the files from before read, once.
    fn read_past(&mut self, id: &str) {
        let Some(track) = self.tracks.get_mut(id) else { return };
        let Past::Due(before) = track.past else { return };
        if self.keeper.give(Job::Read { id: id.to_owned(), before }).is_ok() {
            track.past = Past::Asked;
            self.reading.insert(id.to_owned());
        }
    }

    /// Goes on in a new part when the one being written has become long; they are merged at the end of the flight.
    fn turn_over(&mut self, id: &str) {
        let Some(track) = self.tracks.get_mut(id) else { return };
        let Some((path, writer)) = track.writer.take_if(|(_, writer)| writer.long()) else { return };
        let bytes = writer.size();
        match self.keeper.give(Job::Finish(Box::new(writer))) {
            Err(Job::Finish(writer)) => track.writer = Some((path, *writer)),
            _ => track.ended_bytes += bytes,
        }
    }

    fn greet(&mut self, agent_id: &str) {
        let Some(agent) = self.agents.get_mut(agent_id).filter(|agent| agent.greeting == Greeting::Due) else { return };
        let Some(commands) = agent.commands.clone() else { return };
        if self.keeper.give(Job::Greet { agent_id: agent_id.to_owned(), commands }).is_ok() {
            agent.greeting = Greeting::Asked;
        }
    }

    /// What the keeper has done.
    fn done(&mut self, done: Done, now: Instant) {
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
                        if track.last.is_some() {
                            track.ended.get_or_insert(now);
                        }
                    }
                    None if reading.learner.messages() == 0 => {}
                    None => {
                        let mut track = Track::resume(*reading, part, now);
                        track.ended = Some(now);
                        if track.last.is_none() {
                            track.limit = Some(u64::MAX);
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

    fn renew(&self, id: &str) {
        let Some(track) = self.tracks.get(id) else { return };
        let completeness = if track.ended.is_some() { Completeness::Filling } else { Completeness::Recording };
        // Name, notes and size are the keeper's to add.
        let _ = self.keeper.give(Job::Renew(Box::new(track.flight(Labels::default(), completeness, 0))));
    }

    fn ask(&mut self, agent_id: &str, now: Instant) {
        let Some(agent) = self.agents.get_mut(agent_id) else { return };
        let Some(commands) = agent.commands.clone().filter(|c| !c.is_closed()) else { return };
        let current = agent.asking.flight.as_ref().and_then(|id| self.tracks.get(id));
        if !agent.asking.idle(current, now) {
            return;
        }
        agent.asking.flight = None;
        let horizon = agent.horizon(now, self.config.backfill_after);
        for track in self.tracks.values() {
            let settled = track.ended.is_none_or(|e| now.saturating_duration_since(e) >= self.config.backfill_after);
            if track.identity.agent_id == agent_id
                && settled
                && track.past == Past::Known
                && track.retry.is_none_or(|at| now >= at)
                && agent.asking.allows(track.identity.boot_id)
                && agent.asking.ask(track, horizon, &commands, now)
            {
                return;
            }
        }
        // One after the other: memory is that of one reading.
        if !self.reading.is_empty() {
            return;
        }
        let Some(id) = agent.asking.next_waiting(now) else { return };
        if self.tracks.contains_key(&id) || self.closing.contains(&id) {
            return;
        }
        match self.keeper.give(Job::Read { id: id.clone(), before: u32::MAX }) {
            Ok(()) => drop(self.reading.insert(id)),
            Err(_) => agent.asking.await_turn([id], now),
        }
    }

    fn delete(&mut self, id: String, answer: SyncSender<Result<(), RecordingError>>) {
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

    /// Renews the state of one vehicle's recording for the page.
    fn show(&self, agent_id: &str) {
        let Some(agent) = self.agents.get(agent_id) else { return };
        let mine = |t: &&Track| t.identity.agent_id == agent_id && t.identity.boot_id == agent.boot_id;
        let track = self
            .tracks
            .values()
            .filter(mine)
            .max_by_key(|t| (t.ended.is_none(), t.identity.first_sequence.unwrap_or(u64::MAX)));
        let mut status = v1::RecordingStatus { free_bytes: self.free_bytes, ..Default::default() };
        if let Some(track) = track {
            let (first, last) = track.learner.times_us().unwrap_or_default();
            status.recording = track.ended.is_none() && track.writer.is_some();
            status.flight_id.clone_from(&track.identity.flight_id);
            status.duration_s = last.saturating_sub(first) as f64 * 1e-6;
            status.messages = track.learner.messages();
            status.missing = track.missing();
            status.bytes = track.ended_bytes + track.writer.as_ref().map_or(0, |(_, writer)| writer.size());
        }
        let mut shown = lock(&self.shared.status);
        let changed = shown
            .insert(agent_id.to_owned(), status.clone())
            .is_none_or(|s| s.recording != status.recording || s.flight_id != status.flight_id);
        drop(shown);
        if changed {
            self.shared.changed.notify_one();
        }
    }

    /// Looks at the disk while nothing is written to it, so that a problem shows before a flight.
    fn check_disk(&mut self, now: Instant) {
        self.free_bytes = free_bytes(self.store.folder());
        let reserve = self.config.reserve_bytes;
        if self.free_bytes < reserve {
            let text = low_space(self.store.folder(), self.free_bytes, reserve);
            for id in self.tracks.keys().cloned().collect::<Vec<_>>() {
                if self.tracks.get(&id).is_some_and(|t| t.writer.is_some()) {
                    let flushed = self.tracks.get_mut(&id).map(|t| t.flush(now, true));
                    tracing::error!(flight = %id, ?flushed, "recording stopped: {text}");
                    self.failed(&id, &text, now);
                }
            }
            self.shared.complain(&text);
        } else if self.tracks.values().all(|t| t.writer.is_none() && t.retry.is_none()) {
            match self.store.probe() {
                Ok(()) => self.shared.recover(),
                Err(error) => self.shared.complain(&error.to_string()),
            }
        }
    }
}

impl Agent {
    fn rise(&mut self, sequence: u64, now: Instant) {
        self.highest = self.highest.max(sequence);
        if self.heights.back().is_none_or(|(at, _)| now.saturating_duration_since(*at) >= TICK) {
            self.heights.push_back((now, self.highest));
            // At most one entry each tick, for as long as a horizon reaches back.
            if self.heights.len() > 1024 {
                self.heights.pop_front();
            }
        }
    }

    fn remember(&mut self, batch: Bytes, now: Instant) {
        self.recent_bytes += batch.len();
        self.recent.push_back((now, batch));
        while let Some((at, oldest)) = self.recent.front()
            && (self.recent_bytes > RECENT_BYTES || now.saturating_duration_since(*at) > RECENT)
        {
            self.recent_bytes -= oldest.len();
            self.recent.pop_front();
        }
    }

    /// Everything up to here has had time to arrive and to reach the agent's own log.
    fn horizon(&self, now: Instant, after: Duration) -> u64 {
        let old = |(at, _): &&(Instant, u64)| now.saturating_duration_since(*at) >= after;
        self.heights.iter().rev().find(old).map_or(0, |(_, height)| *height)
    }
}

fn low_space(folder: &Path, free: u64, reserve: u64) -> String {
    format!("{}: {free} bytes are free, recording needs {reserve}", folder.display())
}

/// Holds the data folder for this ground alone.
pub(super) fn lock_folder(folder: &Path) -> Result<Option<File>, crate::GroundError> {
    let open = || {
        std::fs::create_dir_all(folder)?;
        File::options().write(true).create(true).truncate(false).open(folder.join("lock"))
    };
    // A folder that cannot be written is said loudly by the recorder; flying goes on.
    let Ok(file) = open() else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Err(crate::GroundError::Locked {
            folder: folder.to_owned(),
            source: std::io::Error::from(std::io::ErrorKind::WouldBlock),
        }),
        Err(std::fs::TryLockError::Error(_)) => Ok(None),
    }
}
