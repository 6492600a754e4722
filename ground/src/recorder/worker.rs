//! The recorder's thread: takes what the hub passes on, decides which flight each message belongs to,
//! writes, flushes, asks for what is missing, and finishes.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use plumbline_agent::log::Syncer;
use plumbline_proto::codec::{self, Frame};
use plumbline_proto::ids::FlightId;
use plumbline_proto::{Kind, v1};

use super::asking::{AGAIN, Asking};
use super::flight::Completeness;
use super::identity::Identity;
use super::index::{FlightIndex, Stamp};
use super::repair::Damage;
use super::store::{Files, Reading, RecordingStore};
use super::track::Track;
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
/// Flights that an agent is told again are whole here, when it connects.
const TOLD_AGAIN: usize = 16;
/// Live messages kept, for flights whose beginning is announced a little late.
const RECENT: Duration = Duration::from_secs(3);
const RECENT_BYTES: usize = 8 << 20;

pub(super) struct Worker {
    config: GroundConfig,
    store: RecordingStore,
    index: Arc<FlightIndex>,
    shared: Arc<Shared>,
    agents: BTreeMap<String, Agent>,
    tracks: BTreeMap<String, Track>,
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
    recent: VecDeque<(Instant, Vec<u8>)>,
    recent_bytes: usize,
    asking: Asking,
}

impl Worker {
    pub(super) fn new(
        config: GroundConfig,
        store: RecordingStore,
        index: Arc<FlightIndex>,
        shared: Arc<Shared>,
        syncer: Syncer,
    ) -> Self {
        Self {
            config,
            store,
            index,
            shared,
            agents: BTreeMap::new(),
            tracks: BTreeMap::new(),
            topics: HashMap::new(),
            ticked: Instant::now(),
            renewed: None,
            free_bytes: 0,
            syncer,
        }
    }

    pub(super) fn run(mut self, inputs: &Receiver<Input>) {
        self.catch_up();
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
        for id in self.tracks.keys().cloned().collect::<Vec<_>>() {
            let complete = self.tracks.get(&id).is_some_and(Track::complete);
            self.finish(&id, if complete { Completeness::Complete } else { Completeness::Filling });
        }
    }

    /// Repairs what a crash left and brings the index in line with the files.
    fn catch_up(&mut self) {
        if let Err(error) = self.store.probe() {
            self.complain(&error.to_string());
        }
        self.store.sweep();
        let files = self.store.list();
        for (id, files) in &files {
            if let Err(error) = self.catch_up_with(id, files) {
                tracing::error!(flight = %id, %error, "cannot be read");
            }
        }
        for flight in self.index.list().unwrap_or_default() {
            if !files.contains_key(&flight.id) {
                self.indexed(self.index.remove(&flight.id));
            }
        }
        *lock(&self.shared.set_aside) = self.store.set_aside();
        self.shared.ready.store(true, Ordering::Release);
        self.shared.changed.notify_one();
    }

    fn catch_up_with(&self, id: &str, files: &Files) -> Result<(), RecordingError> {
        let stamp = files.finished.as_deref().and_then(Stamp::of);
        if files.parts.is_empty() && stamp.is_some() && self.index.stamp(id)? == stamp {
            return Ok(());
        }
        let mut reading = Reading::default();
        if files.parts.is_empty() {
            reading = self.store.read(files)?;
        }
        if !files.parts.is_empty() || reading.damage != Damage::None {
            tracing::warn!(flight = id, damage = ?reading.damage, parts = files.parts.len(), "repairing");
            reading = self.store.merge(id, None)?;
        }
        self.enter(id, &reading)
    }

    fn enter(&self, id: &str, reading: &Reading) -> Result<(), RecordingError> {
        let path = self.store.finished_path(id);
        match Stamp::of(&path) {
            Some(stamp) => {
                let flight = reading.flight(id, self.store.labels(id), stamp.size as u64);
                self.index.put(&flight, stamp)?;
            }
            None => self.index.remove(id)?,
        }
        Ok(())
    }

    fn take(&mut self, input: Input) {
        let now = Instant::now();
        match input {
            Input::Connected { agent_id, boot_id, boot_wall_time_us, commands } => {
                self.connected(&agent_id, boot_id, boot_wall_time_us, commands, now);
            }
            Input::Batch { agent_id, batch, backfill } => {
                self.shared.queued_bytes.fetch_sub(batch.len(), Ordering::Relaxed);
                self.batch(&agent_id, &batch, backfill, now);
            }
            Input::Unavailable { agent_id, request } => {
                if let Some(agent) = self.agents.get_mut(&agent_id) {
                    agent.asking.heard(now);
                }
                if let Some(track) = self.tracks.get_mut(&request.flight_id) {
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
            Input::Delete { id, answer } => {
                let _ = answer.send(self.delete(&id));
            }
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
        let unfinished = |f: &super::Flight| {
            f.vehicle_id == agent_id && f.completeness == Completeness::Filling && !self.tracks.contains_key(&f.id)
        };
        let waiting =
            self.index.list().unwrap_or_default().into_iter().filter(unfinished).map(|f| (now, f.id)).collect();
        let asking = Asking::new(waiting, now);
        // The newest that fit into the queue: older ones were told before, or are gone from the onboard log.
        let whole = |f: &super::Flight| f.vehicle_id == agent_id && f.completeness == Completeness::Complete;
        for flight in self.index.list().unwrap_or_default().iter().filter(|f| whole(f)).take(TOLD_AGAIN) {
            commands.try_flight_kept(&flight.id);
        }
        match self.agents.get_mut(agent_id) {
            Some(agent) if agent.boot_id == boot_id => {
                agent.commands = Some(commands);
                agent.asking = asking;
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
                };
                self.agents.insert(agent_id.to_owned(), agent);
            }
        }
    }

    fn batch(&mut self, agent_id: &str, batch: &[u8], backfill: bool, now: Instant) {
        let Some(agent) = self.agents.get_mut(agent_id) else { return };
        let Ok(frames) = codec::decode_batch(batch) else { return };
        if backfill {
            agent.asking.heard(now);
        }
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
        agent.remember(frame, now);
        let boot_id = agent.boot_id;
        match frame.known_kind() {
            Some(Kind::Flight) => {
                if let Ok(mark) = frame.message::<v1::FlightMark>() {
                    self.mark(agent_id, &mark, now);
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
            track.identity.first_sequence = Some(mark.first_sequence);
            if let Some(last) = mark.last_sequence {
                track.last = Some(last);
                track.ended.get_or_insert(now);
            }
        }
        if track.wants(frame.sequence, frame.time_us) {
            self.record(&id, frame, true, now);
        }
    }

    /// The agent opened or closed a flight.
    fn mark(&mut self, agent_id: &str, mark: &v1::FlightMark, now: Instant) {
        let id = match FlightId::new(mark.flight_id.clone()) {
            Ok(id) => id.as_str().to_owned(),
            Err(error) => {
                tracing::error!(%agent_id, %error, "a flight cannot be recorded");
                return;
            }
        };
        if !self.tracks.contains_key(&id) && !self.open(agent_id, &id, Some(mark.first_sequence), None, now) {
            return;
        }
        for (other, track) in &mut self.tracks {
            // One flight at a time: a new one ends the one before, whose closing mark was lost.
            if *other != id && track.identity.agent_id == agent_id && track.ended.is_none() {
                track.ended = Some(now);
                track.limit = Some(mark.first_sequence.saturating_sub(1));
            }
        }
        let Some(track) = self.tracks.get_mut(&id) else { return };
        track.identity.first_sequence = Some(mark.first_sequence);
        track.contradicted = None;
        if let Some(last) = mark.last_sequence {
            tracing::info!(flight = %id, reason = mark.reason, "flight ended");
            track.last = Some(last);
            track.ended.get_or_insert(now);
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

    /// Begins or resumes the recording of a flight. `false` when there is nothing (more) to record.
    fn open(
        &mut self,
        agent_id: &str,
        id: &str,
        first_sequence: Option<u64>,
        start_us: Option<u64>,
        now: Instant,
    ) -> bool {
        let Some(agent) = self.agents.get(agent_id) else { return false };
        let files = self.store.files(id);
        let mut track = if files == Files::default() {
            let identity = Identity {
                flight_id: id.to_owned(),
                agent_id: agent_id.to_owned(),
                boot_id: agent.boot_id,
                boot_wall_time_us: agent.boot_wall_time_us,
                first_sequence,
            };
            tracing::info!(flight = id, %agent_id, first_sequence, "flight begins");
            Track::new(identity, now)
        } else {
            match self.store.read(&files) {
                Ok(reading) if reading.identity.boot_id == agent.boot_id => {
                    if reading.range().1.is_some() && reading.missing() == 0 {
                        return false;
                    }
                    tracing::info!(flight = id, %agent_id, "flight goes on after a gap");
                    Track::resume(reading, now)
                }
                Ok(reading) => {
                    let other = reading.identity.boot_id;
                    tracing::error!(flight = id, %agent_id, other, "the name is that of a flight of another boot");
                    return false;
                }
                Err(error) => {
                    tracing::error!(flight = id, %error, "cannot be resumed");
                    return false;
                }
            }
        };
        track.start_us = start_us;
        let recent: Vec<_> = agent.recent.iter().map(|(_, bytes)| bytes.clone()).collect();
        self.tracks.insert(id.to_owned(), track);
        for bytes in recent {
            if let Some(Ok(frame)) = codec::decode_frames(&bytes).next()
                && self.tracks.get(id).is_some_and(|t| t.wants(frame.sequence, frame.time_us))
            {
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
        let path = self.store.next_part(id);
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
                self.recover();
                true
            }
            Err(error) => {
                track.retry = Some(now + RETRY_AFTER);
                self.complain(&error);
                false
            }
        }
    }

    /// A file failed: what was not flushed is missing, and will be asked for again.
    fn failed(&mut self, id: &str, error: &str, now: Instant) {
        self.complain(error);
        let Some(track) = self.tracks.get_mut(id) else { return };
        track.writer = None;
        track.retry = Some(now + RETRY_AFTER);
        match self.store.read(&self.store.files(id)) {
            Ok(reading) => track.fall_back(reading),
            Err(error) => tracing::error!(flight = id, %error, "cannot be read back"),
        }
    }

    fn tick(&mut self, now: Instant) {
        let renew = self.renewed.is_none_or(|at| now.saturating_duration_since(at) >= RENEW_EVERY);
        if renew {
            self.renewed = Some(now);
            self.check_disk(now);
        }
        for agent in self.agents.values_mut() {
            let track = agent.asking.flight.as_ref().and_then(|id| self.tracks.get(id));
            agent.asking.idle(track, now);
        }
        for id in self.tracks.keys().cloned().collect::<Vec<_>>() {
            let Some(track) = self.tracks.get_mut(&id) else { continue };
            if let Err(error) = track.flush(now, false) {
                self.failed(&id, &explain(&error), now);
            }
            if let Some(completeness) = self.verdict(&id, now) {
                self.finish(&id, completeness);
            } else if renew {
                self.renew(&id);
            }
        }
        for agent_id in self.agents.keys().cloned().collect::<Vec<_>>() {
            self.ask(&agent_id, now);
            self.show(&agent_id);
        }
    }

    /// Should a flight be closed now, and as what?
    fn verdict(&mut self, id: &str, now: Instant) -> Option<Completeness> {
        let track = self.tracks.get_mut(id)?;
        let ended = track.ended?;
        if track.retry.is_some() {
            // Nothing can be written now; what is missing is asked for when it can.
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

    fn finish(&mut self, id: &str, mut completeness: Completeness) {
        let now = Instant::now();
        let Some(mut track) = self.tracks.remove(id) else { return };
        let agent_id = track.identity.agent_id.clone();
        let finished = track.flush(now, true).and_then(|()| match track.writer.take() {
            Some((path, writer)) => {
                let ending = track.ending(completeness).to_metadata();
                writer.finish(&ending).map(|()| Some(path))
            }
            None => Ok(None),
        });
        let files = self.store.files(id);
        let result = match (finished, files.parts.as_slice()) {
            (Ok(Some(path)), [only]) if files.finished.is_none() && *only == path && !track.overshot() => {
                self.store.promote(id, &path)
            }
            (_, []) if !track.overshot() => Ok(()),
            (outcome, _) => {
                if let Err(error) = outcome {
                    self.complain(&explain(&error));
                }
                self.store.merge(id, track.last).map(|reading| {
                    if completeness == Completeness::Complete && reading.missing() > 0 {
                        completeness = Completeness::Filling;
                    }
                    let keep = track.ended;
                    let identity = track.identity.clone();
                    track = Track::resume(Reading { identity, ..reading }, now);
                    track.ended = keep;
                })
            }
        };
        if let Err(error) = result {
            self.complain(&error.to_string());
        }
        let path = self.store.finished_path(id);
        let stamp = Stamp::of(&path).unwrap_or_default();
        if self.store.files(id) == Files::default() {
            self.indexed(self.index.remove(id));
        } else {
            let flight = track.flight(self.store.labels(id), completeness, stamp.size as u64);
            tracing::info!(flight = id, ?completeness, messages = flight.messages, missing = flight.missing, "closed");
            self.indexed(self.index.put(&flight, stamp));
            if completeness == Completeness::Complete
                && let Some(commands) = self.agents.get(&agent_id).and_then(|agent| agent.commands.as_ref())
            {
                commands.try_flight_kept(id);
            }
            if completeness == Completeness::Filling
                && let Some(agent) = self.agents.get_mut(&agent_id)
            {
                agent.asking.waiting.push_back((now + AGAIN, id.to_owned()));
            }
        }
        *lock(&self.shared.set_aside) = self.store.set_aside();
        self.show(&agent_id);
        self.shared.changed.notify_one();
    }

    fn renew(&self, id: &str) {
        let Some(track) = self.tracks.get(id) else { return };
        let completeness = if track.ended.is_some() { Completeness::Filling } else { Completeness::Recording };
        let size = self.store.size(&self.store.files(id));
        let flight = track.flight(self.store.labels(id), completeness, size);
        self.indexed(self.index.put(&flight, Stamp::default()));
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
                && track.retry.is_none_or(|at| now >= at)
                && agent.asking.allows(track.identity.boot_id)
                && agent.asking.ask(track, horizon, &commands, now)
            {
                return;
            }
        }
        let Some(id) = agent.asking.next_waiting(now) else { return };
        if self.tracks.contains_key(&id) {
            return;
        }
        match self.store.read(&self.store.files(&id)) {
            Ok(reading) if reading.learner.messages() > 0 => {
                let mut track = Track::resume(reading, now);
                track.ended = Some(now);
                if track.last.is_none() {
                    track.limit = Some(u64::MAX);
                }
                self.tracks.insert(id, track);
            }
            Ok(_) => {}
            Err(error) => tracing::error!(flight = %id, %error, "cannot be completed"),
        }
    }

    fn delete(&mut self, id: &str) -> Result<(), RecordingError> {
        if let Some(track) = self.tracks.get(id) {
            if track.ended.is_none() {
                return Err(RecordingError::InProgress(id.to_owned()));
            }
            self.tracks.remove(id);
        }
        if self.store.files(id) == Files::default() && self.index.get(id)?.is_none() {
            return Err(RecordingError::Unknown(id.to_owned()));
        }
        self.store.delete(id)?;
        self.index.remove(id)?;
        tracing::info!(flight = id, "deleted");
        Ok(())
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
            status.bytes = track.writer.as_ref().map_or(0, |(_, writer)| writer.size());
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
            self.complain(&text);
        } else if self.tracks.values().all(|t| t.writer.is_none() && t.retry.is_none()) {
            match self.store.probe() {
                Ok(()) => self.recover(),
                Err(error) => self.complain(&error.to_string()),
            }
        }
    }

    fn complain(&self, error: &str) {
        let mut shown = lock(&self.shared.error);
        if shown.as_deref() != Some(error) {
            tracing::error!(error, "nothing can be recorded");
            *shown = Some(error.to_owned());
            self.shared.changed.notify_one();
        }
    }

    fn recover(&self) {
        let mut shown = lock(&self.shared.error);
        if shown.take().is_some() {
            tracing::info!("recording is possible again");
            self.shared.changed.notify_one();
        }
    }

    #[allow(clippy::unused_self)]
    fn indexed(&self, result: rusqlite::Result<()>) {
        if let Err(error) = result {
            tracing::error!(%error, "index of flights cannot be written; it is rebuilt from the files at the next start");
        }
    }
}

impl Agent {
    fn remember(&mut self, frame: &Frame<'_>, now: Instant) {
        self.highest = self.highest.max(frame.sequence);
        if self.heights.back().is_none_or(|(at, _)| now.saturating_duration_since(*at) >= TICK) {
            self.heights.push_back((now, self.highest));
            // At most one entry each tick, for as long as a horizon reaches back.
            if self.heights.len() > 1024 {
                self.heights.pop_front();
            }
        }
        let mut bytes = Vec::with_capacity(frame.encoded_len());
        frame.encode(&mut bytes);
        self.recent_bytes += bytes.len();
        self.recent.push_back((now, bytes));
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
