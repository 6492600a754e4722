//! The keeper's thread: what the recorder does that takes as long as a disk or a long flight pleases.
//!
//! The recorder's thread appends to open files and flushes them, nothing else: whatever is merged, nothing live waits
//! for it. What must be read back, merged, finished, indexed or deleted is a [`Job`] for this thread: one after the
//! other, in the order they were given, with less claim to the processor than the recorder.
//!
//! Bound: [`MAX_JOBS`] waiting. Policy when full: the recorder keeps what it wanted done and gives it again at its
//! next tick; the renewal of an index entry is left out.

use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Instant;

use super::export::Export;
use super::flight::{Completeness, Flight};
use super::index::{FlightIndex, Stamp};
use super::reading::Reading;
use super::repair::Damage;
use super::shared::SharedArchive;
use super::store::{Files, RecordingStore};
use super::track::Track;
use super::writer::FlightWriter;
use super::{RecordingError, Shared, explain};
use crate::agent_link::CommandSender;
use crate::sync::{give_way, lock};

/// Most jobs waiting.
const MAX_JOBS: usize = 256;
/// Flights that an agent is told again are whole here, when it connects.
const TOLD_AGAIN: usize = 16;

/// Something to be done.
pub(super) enum Job {
    /// Repair what a crash left in these files, and bring the index in line with them.
    CatchUp(BTreeMap<String, Files>),
    /// An agent connected: tell it what is whole here, and answer what is not.
    Greet { agent_id: String, commands: CommandSender },
    /// Read what the files of a flight hold, without the parts from this number on: they are being written.
    Read { id: String, before: u32 },
    /// Finish a part of a flight that goes on in the next one.
    Finish(Box<FlightWriter>),
    /// Finish the files of a flight.
    Close { id: String, track: Box<Track>, completeness: Completeness },
    /// Renew the index entry of a flight that is being recorded.
    Renew(Box<Flight>),
    /// Remove a flight.
    Delete { id: String, answer: SyncSender<Result<(), RecordingError>> },
}

/// What came of it.
pub(super) enum Done {
    /// Flights of this agent that are not complete.
    Unfinished { agent_id: String, flights: Vec<String> },
    /// What there is of a flight, and the number of its next part.
    Read { id: String, reading: Box<Reading>, part: u32 },
    /// A flight is closed.
    Closed { id: String, agent_id: String, completeness: Completeness },
}

/// The recorder's end.
#[derive(Debug)]
pub(super) struct Keeper {
    jobs: SyncSender<Job>,
    /// At most one for each job.
    done: Receiver<Done>,
    /// Jobs given and not done.
    open: Arc<AtomicUsize>,
    thread: JoinHandle<()>,
}

impl Keeper {
    /// Starts the thread.
    ///
    /// # Errors
    /// No thread.
    pub(super) fn start(desk: Desk) -> io::Result<Self> {
        let (jobs, given) = sync_channel::<Job>(MAX_JOBS);
        let (answers, done) = channel();
        let open = Arc::new(AtomicUsize::new(0));
        let thread = {
            let open = open.clone();
            std::thread::Builder::new().name("keeper".into()).spawn(move || {
                give_way();
                for job in given {
                    desk.work(job, &answers);
                    open.fetch_sub(1, Ordering::AcqRel);
                }
            })?
        };
        Ok(Self { jobs, done, open, thread })
    }

    /// Gives a job; never waits.
    ///
    /// # Errors
    /// The job, when too many are waiting.
    pub(super) fn give(&self, job: Job) -> Result<(), Job> {
        self.open.fetch_add(1, Ordering::AcqRel);
        self.jobs.try_send(job).map_err(|error| {
            self.open.fetch_sub(1, Ordering::AcqRel);
            match error {
                TrySendError::Full(job) | TrySendError::Disconnected(job) => job,
            }
        })
    }

    /// Is there nothing to do?
    pub(super) fn idle(&self) -> bool {
        self.open.load(Ordering::Acquire) == 0
    }

    /// The next thing that was done.
    pub(super) fn done(&self) -> Option<Done> {
        self.done.try_recv().ok()
    }

    /// Does these last jobs as well and ends. Waits for the disk.
    pub(super) fn finish(self, last: impl IntoIterator<Item = Job>) {
        for job in last {
            if self.jobs.send(job).is_err() {
                break;
            }
        }
        drop(self.jobs);
        if self.thread.join().is_err() {
            tracing::error!("the keeper thread panicked");
        }
    }
}

/// Where the work on flights is done.
#[derive(Debug, Clone)]
pub(super) struct Desk {
    pub(super) store: RecordingStore,
    pub(super) index: Arc<FlightIndex>,
    pub(super) shared: Arc<Shared>,
    /// What it shares with other grounds.
    pub(super) archive: Option<Arc<dyn SharedArchive>>,
    /// Held while a flight comes from there.
    pub(super) fetching: Arc<Mutex<()>>,
}

impl Desk {
    fn work(&self, job: Job, answers: &Sender<Done>) {
        let answer = |done| drop(answers.send(done));
        match job {
            Job::CatchUp(files) => self.catch_up(&files),
            Job::Greet { agent_id, commands } => {
                let flights = self.greet(&agent_id, &commands);
                answer(Done::Unfinished { agent_id, flights });
            }
            Job::Read { id, before } => {
                let files = self.store.files(&id).before(before);
                let reading = self.store.read(&files).unwrap_or_else(|error| {
                    tracing::error!(flight = %id, %error, "cannot be read back");
                    Reading::default()
                });
                answer(Done::Read { id, reading: Box::new(reading), part: files.next_part() });
            }
            Job::Finish(writer) => {
                if let Err(error) = writer.finish(None) {
                    tracing::error!(error = %explain(&error), "a part of a flight cannot be finished");
                }
            }
            Job::Close { id, track, completeness } => {
                let agent_id = track.identity.agent_id.clone();
                let completeness = self.close(&id, *track, completeness);
                answer(Done::Closed { id: id.clone(), agent_id, completeness });
                self.keep_overview(&id);
            }
            Job::Renew(mut flight) => {
                let labels = self.store.labels(&flight.id);
                (flight.name, flight.notes) = (labels.name, labels.notes);
                flight.size_bytes = self.store.size(&self.store.files(&flight.id));
                indexed(self.index.put(&flight, Stamp::default()));
            }
            Job::Delete { id, answer } => drop(answer.send(self.delete(&id))),
        }
    }

    fn catch_up(&self, files: &BTreeMap<String, Files>) {
        for (id, files) in files {
            if self.shared.stopping.load(Ordering::Acquire) {
                // What is left is repaired at the next start.
                return;
            }
            match self.catch_up_with(id, files) {
                Ok(()) | Err(RecordingError::Stopped) => {}
                Err(error) => tracing::error!(flight = %id, %error, "cannot be read"),
            }
        }
        for flight in self.index.list().unwrap_or_default() {
            if !files.contains_key(&flight.id) {
                indexed(self.index.remove(&flight.id));
            }
        }
        *lock(&self.shared.set_aside) = self.store.set_aside();
        self.shared.ready.store(true, Ordering::Release);
        self.shared.changed.notify_one();
    }

    /// Repairs what is damaged of a flight's files and brings the index in line with them.
    ///
    /// # Errors
    /// [`RecordingError`]; the files stay.
    pub(super) fn catch_up_with(&self, id: &str, files: &Files) -> Result<(), RecordingError> {
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
            reading = match self.store.merge(id, files, None, &self.shared.stopping) {
                Ok(reading) => reading,
                Err(RecordingError::Stopped) => return Err(RecordingError::Stopped),
                Err(error) => {
                    // No room, say: it is listed and read as it is, and the next start tries again.
                    tracing::error!(flight = id, %error, "not repaired");
                    let reading = self.store.read(files)?;
                    let flight = reading.flight(id, self.store.labels(id), self.store.size(files));
                    return Ok(self.index.put(&flight, Stamp::default())?);
                }
            };
        }
        match Stamp::of(&self.store.finished_path(id)) {
            Some(stamp) => {
                let flight = reading.flight(id, self.store.labels(id), stamp.size as u64);
                self.index.put(&flight, stamp)?;
            }
            None => self.index.remove(id)?,
        }
        Ok(())
    }

    fn greet(&self, agent_id: &str, commands: &CommandSender) -> Vec<String> {
        let flights = self.index.list().unwrap_or_default();
        let of = |wanted: Completeness| {
            flights.iter().filter(move |f| f.vehicle_id == agent_id && f.completeness == wanted).map(|f| &f.id)
        };
        // The newest that fit into the queue: older ones were told before, or are gone from the onboard log.
        for id in of(Completeness::Complete).take(TOLD_AGAIN) {
            commands.try_flight_kept(id);
        }
        of(Completeness::Filling).cloned().collect()
    }

    fn close(&self, id: &str, mut track: Track, mut completeness: Completeness) -> Completeness {
        let now = Instant::now();
        let finished = track.flush(now, true).and_then(|()| match track.output.writer.take() {
            Some((path, writer)) => {
                let ending = track.ending(completeness).to_metadata();
                writer.finish(Some(&ending)).map(|()| Some(path))
            }
            None => Ok(None),
        });
        let files = self.store.files(id);
        let result = match (finished, files.parts.as_slice()) {
            (Ok(Some(path)), [only]) if files.finished.is_none() && *only == path && !track.overshot() => {
                self.store.promote(id, &path)
            }
            (Ok(_), []) if !track.overshot() => Ok(()),
            (outcome, _) => {
                if let Err(error) = outcome {
                    tracing::error!(flight = id, error = %explain(&error), "its file cannot be finished");
                }
                let merged = self.store.merge(id, &files, track.ends.last, &self.shared.stopping);
                let one_file = merged.is_ok();
                let reading = merged.or_else(|error| match error {
                    RecordingError::Stopped => Err(error),
                    error => {
                        // No room, say: it is listed and read as it is, and closed again a little later; a truncated one is merged
                        // at the next start.
                        tracing::error!(flight = id, %error, "not merged");
                        self.store.read(&self.store.files(id))
                    }
                });
                reading.map(|reading| {
                    completeness = match (completeness, reading.whole()) {
                        (_, true) if one_file => Completeness::Complete,
                        (_, true) | (Completeness::Complete, _) => Completeness::Filling,
                        (other, _) => other,
                    };
                    let identity = track.identity.clone();
                    track = Track::resume(Reading { identity, ..reading }, 0, now);
                })
            }
        };
        match result {
            Ok(()) => {}
            Err(RecordingError::Stopped) => tracing::info!(flight = id, "its parts are merged at the next start"),
            Err(error) => {
                tracing::error!(flight = id, %error, "its files are not as they should be");
                if completeness == Completeness::Complete {
                    completeness = Completeness::Filling;
                }
            }
        }
        let files = self.store.files(id);
        if files == Files::default() {
            indexed(self.index.remove(id));
        } else {
            let stamp = Stamp::of(&self.store.finished_path(id)).unwrap_or_default();
            let flight = track.flight(self.store.labels(id), completeness, self.store.size(&files));
            tracing::info!(flight = id, ?completeness, messages = flight.messages, missing = flight.missing, "closed");
            indexed(self.index.put(&flight, stamp));
        }
        *lock(&self.shared.set_aside) = self.store.set_aside();
        self.shared.changed.notify_one();
        completeness
    }

    /// What has just landed is what people open next. Takes as long as reading the flight: nothing waits for it but the next job.
    fn keep_overview(&self, id: &str) {
        if !self.store.has(id) {
            return;
        }
        let going_on = || !self.shared.stopping.load(Ordering::Acquire);
        let keep = || {
            let export = Export::overview(self.store.open(id)?)?;
            if export.is_kept() { export.write(&mut |_| going_on()) } else { Ok(()) }
        };
        if let Err(error) = keep() {
            tracing::warn!(flight = id, %error, "what charts show of it is made when it is opened");
        }
    }

    fn delete(&self, id: &str) -> Result<(), RecordingError> {
        if self.store.files(id) == Files::default() && self.index.get(id)?.is_none() {
            return Err(RecordingError::Unknown(id.to_owned()));
        }
        self.store.delete(id)?;
        self.index.remove(id)?;
        tracing::info!(flight = id, "deleted");
        Ok(())
    }
}

fn indexed(result: rusqlite::Result<()>) {
    if let Err(error) = result {
        tracing::error!(%error, "index of flights cannot be written; it is rebuilt from the files at the next start");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recorder::identity::{Ending, Identity};
    use plumbline_proto::Kind;
    use plumbline_proto::codec::Frame;

    /// Of a folder where flight `f1` cannot be merged.
    fn desk() -> (tempfile::TempDir, Desk, Identity) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("flights/f1.merge.tmp")).unwrap();
        let desk = Desk {
            store: RecordingStore::new(folder.path(), 0),
            index: Arc::new(FlightIndex::open(folder.path()).unwrap()),
            shared: Arc::default(),
            archive: None,
            fetching: Arc::default(),
        };
        (folder, desk, Identity { flight_id: "f1".into(), first_sequence: Some(1), ..Identity::default() })
    }

    #[test]
    fn what_is_whole_and_cannot_be_merged_is_complete_once_it_is() {
        // GIVEN a flight that came whole in a part
        let (_folder, desk, identity) = desk();
        let part = desk.store.part_path("f1", 1);
        let mut writer = FlightWriter::create(&part, &identity, &plumbline_file::Syncer::start().unwrap()).unwrap();
        let frame = Frame { kind: Kind::Event.to_wire(), instance: 0, sequence: 1, time_us: 1, payload: b"" };
        writer.write(&frame, "/event").unwrap();
        let ending = Ending { last_sequence: Some(1), completeness: Completeness::Complete, live: 1, filled: 0 };
        writer.finish(Some(&ending.to_metadata())).unwrap();
        let close = || {
            let reading = desk.store.read(&desk.store.files("f1")).unwrap();
            assert!(reading.whole());
            let closed = desk.close("f1", Track::resume(reading, 2, Instant::now()), Completeness::Complete);
            assert_eq!(desk.index.get("f1").unwrap().unwrap().completeness, closed);
            closed
        };
        // WHEN it cannot be merged THEN it is not complete; WHEN it can THEN it is, in one file
        assert_eq!(close(), Completeness::Filling);
        std::fs::remove_dir(desk.store.folder().join("f1.merge.tmp")).unwrap();
        assert_eq!(close(), Completeness::Complete);
        let files = desk.store.files("f1");
        assert!(files.finished.is_some() && files.parts.is_empty(), "{files:?}");
    }

    #[test]
    fn what_cannot_be_merged_is_as_complete_as_its_files_and_others_are_recorded() {
        // GIVEN a flight that came whole, of whose file nothing can be read, and which cannot be merged
        let (_folder, desk, identity) = desk();
        std::fs::write(desk.store.part_path("f1", 1), "this is not a flight").unwrap();
        // WHEN it is closed THEN it is not told to be complete, and has the size of what there is
        let closed = desk.close("f1", Track::new(identity, 2, Instant::now()), Completeness::Complete);
        let flight = desk.index.get("f1").unwrap().unwrap();
        assert_eq!((closed, flight.completeness), (Completeness::Filling, Completeness::Filling));
        assert_eq!(flight.size_bytes, 20);
        assert_eq!(*lock(&desk.shared.error), None);
    }
}
