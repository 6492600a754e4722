//! The recorder's thread: takes what the hub passes on, decides which flight each message belongs to,
//! writes, flushes and asks for what is missing. Whatever takes longer it leaves to the keeper.

mod agent;
mod jobs;
mod marks;
mod writing;

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use plumbline_file::Syncer;
use plumbline_proto::codec::{Batch, Frame};
use plumbline_proto::{Kind, v1};

use self::agent::Agent;
use super::flight::Completeness;
use super::keeper::{Job, Keeper};
use super::store::RecordingStore;
use super::track::{Past, Track};
use super::{Input, Shared, explain};
use crate::agent_link::CommandSender;
use crate::config::GroundConfig;
use crate::sync::lock;

/// Work that time drives is done this often.
const TICK: Duration = Duration::from_millis(20);
/// The index entry of a flight in progress, and the free space, are renewed this often.
const RENEW_EVERY: Duration = Duration::from_secs(1);

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
                self.shared.queued_bytes.fetch_sub(batch.held_bytes(), Ordering::Relaxed);
                self.shared.queued.fetch_sub(1, Ordering::Relaxed);
                self.batch(&agent_id, &batch, backfill, now);
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
                track.ends.limit = Some(u64::MAX);
            }
        }
        match self.agents.get_mut(agent_id) {
            Some(agent) if agent.boot_id == boot_id => agent.came_back(commands, now),
            _ => {
                let agent = Agent::new(boot_id, boot_wall_time_us, commands, now);
                self.agents.insert(agent_id.to_owned(), agent);
            }
        }
    }

    fn batch(&mut self, agent_id: &str, batch: &Batch, backfill: bool, now: Instant) {
        let Some(agent) = self.agents.get_mut(agent_id) else { return };
        if backfill {
            agent.asking.heard(now);
        } else {
            agent.remember(batch.clone(), now);
        }
        for frame in batch.frames() {
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
        if track.output.retry.is_some() || track.past != Past::Known {
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
                && track.output.retry.is_none_or(|at| now >= at)
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
            status.recording = track.ended.is_none() && track.output.writer.is_some();
            status.flight_id.clone_from(&track.identity.flight_id);
            status.duration_s = last.saturating_sub(first) as f64 * 1e-6;
            status.messages = track.learner.messages();
            status.missing = track.missing();
            status.bytes = track.output.bytes();
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
}
