//! Records flights: the downlink written down.
//!
//! The recorder's thread writes what comes, behind a queue bounded by [`MAX_QUEUED_BYTES`]. Policy when the queue is
//! full (a stuck disk): the batch is not recorded, and because the recorder counts sequence numbers, it is a gap like
//! any other and is asked back from the agent's own log. What is said only once, as that an agent has connected, finds
//! [`KEPT_FREE`] places that no batch takes. The hub never waits. Reading back, merging, finishing, indexing and deleting
//! are done by a second thread (`keeper`): nothing live waits for them.

pub mod archive;
mod asking;
mod export;
mod figures;
mod flatten;
mod flight;
mod folder;
mod foxglove;
#[cfg(feature = "many")]
mod given;
mod identity;
mod index;
mod intervals;
mod keeper;
mod numbers;
mod outline;
mod overview;
mod reader;
mod reading;
mod repair;
mod ros2;
mod shared;
mod sheet;
mod signal;
mod snapshot;
mod store;
mod track;
mod worker;
mod writer;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use plumbline_proto::codec::Batch;
use plumbline_proto::v1;
use serde::Serialize;
use tempfile::TempDir;
use tokio::sync::Notify;

use crate::agent_link::CommandSender;
use crate::config::GroundConfig;
use crate::error::GroundError;
use crate::sync::lock;
pub use export::{Export, Sink, WRITTEN};
pub(crate) use figures::figures;
pub use flight::{Completeness, Flight, FlownAttack, Step};
use folder::free_bytes;
use index::FlightIndex;
pub use intervals::IntervalSet;
use keeper::Desk;
pub use plumbline_rest::ground::Storage;
pub use shared::SharedArchive;
pub use sheet::{Format, Selection};
pub(crate) use signal::{SignalReader, live as live_signal, thinned};
pub use snapshot::Snapshot;
use store::RecordingStore;
pub use store::{Labels, MAX_NAME, MAX_NOTES};

/// Most messages waiting for the recorder.
const MAX_QUEUED: usize = 16_384;
/// Places of them that batches leave free.
const KEPT_FREE: usize = 512;
/// Most bytes waiting for the recorder.
pub const MAX_QUEUED_BYTES: usize = 64 << 20;

/// Why a recording cannot be read or changed.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// There is no such flight.
    #[error("there is no flight {0:?}")]
    Unknown(String),
    /// The flight has no such topic.
    #[error("the flight has no topic {0:?}")]
    NoTopic(String),
    /// The ground has just started and is still putting its index in line with the files.
    #[error("the index of flights is not ready yet, try again in a moment")]
    NotReady,
    /// It is being recorded.
    #[error("flight {0:?} is being recorded")]
    InProgress(String),
    /// The request makes no sense.
    #[error("{0}")]
    Invalid(String),
    /// Too much of what takes long is being done.
    #[error("the recorder is busy with other flights, try again in a moment")]
    Busy,
    /// The recorder is shutting down.
    #[error("the recorder has stopped")]
    Stopped,
    /// The disk said no.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{path}: {reason}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The archive that this ground shares with others.
    #[error("archive of the fleet: {0}")]
    Archive(String),
    /// The index failed; it can be rebuilt from the files.
    #[error("index of flights: {0}")]
    Index(#[from] rusqlite::Error),
}

/// What the recorder is told.
#[derive(Debug)]
enum Input {
    Connected { agent_id: String, boot_id: u64, boot_wall_time_us: u64, commands: CommandSender },
    Batch { agent_id: String, batch: Batch, backfill: bool },
    Unavailable { agent_id: String, request: v1::BackfillRequest },
    Disconnected { agent_id: String },
    Delete { id: String, answer: SyncSender<Result<(), RecordingError>> },
    Finish,
}

/// What the recorder shows.
#[derive(Debug, Default)]
struct Shared {
    status: Mutex<BTreeMap<String, v1::RecordingStatus>>,
    error: Mutex<Option<String>>,
    set_aside: Mutex<Vec<String>>,
    queued_bytes: AtomicUsize,
    /// Batches waiting.
    queued: AtomicUsize,
    /// Batches that found the queue full, since start.
    refused: AtomicUsize,
    /// What a crash left is repaired and the index is in line with the files.
    ready: AtomicBool,
    /// The ground is about to end: nothing long is begun.
    stopping: AtomicBool,
    changed: Notify,
}

impl Shared {
    fn complain(&self, error: &str) {
        let mut shown = lock(&self.error);
        if shown.as_deref() != Some(error) {
            tracing::error!(error, "nothing can be recorded");
            *shown = Some(error.to_owned());
            self.changed.notify_one();
        }
    }

    fn recover(&self) {
        if lock(&self.error).take().is_some() {
            tracing::info!("recording is possible again");
            self.changed.notify_one();
        }
    }
}

/// The running recorder.
#[derive(Debug)]
pub struct Recorder {
    handle: RecorderHandle,
    thread: JoinHandle<()>,
    /// Held until the recorder is gone.
    _folder: Option<folder::Held>,
}

/// How the rest of the ground reaches the recorder. Cheap to clone; no call waits for the disk
/// unless it says so.
#[derive(Debug, Clone)]
pub struct RecorderHandle {
    queue: SyncSender<Input>,
    desk: Desk,
}

/// Starts the recorder's threads; flights of `archive` are shown beside its own.
///
/// # Errors
/// [`GroundError`] when another ground uses the data folder, or the thread or the index cannot start.
/// A folder that cannot be written is no such error: it is shown, and flying goes on.
pub fn start(config: &GroundConfig, archive: Option<Arc<dyn SharedArchive>>) -> Result<Recorder, GroundError> {
    let folder = folder::lock(&config.data_folder)?;
    let (queue, inputs) = sync_channel(MAX_QUEUED);
    let shared = Arc::new(Shared::default());
    let store = RecordingStore::new(&config.data_folder, config.reserve_bytes);
    let index = FlightIndex::open(&config.data_folder).map_err(|e| GroundError::Index(e.to_string()))?;
    let desk = Desk {
        store: store.clone(),
        index: Arc::new(index),
        shared: shared.clone(),
        archive,
        fetching: Arc::default(),
    };
    let handle = RecorderHandle { queue, desk: desk.clone() };
    let syncer = plumbline_file::Syncer::start().map_err(GroundError::Thread)?;
    let keeper = keeper::Keeper::start(desk).map_err(GroundError::Thread)?;
    let worker = worker::Worker::new(config.clone(), store, keeper, shared, syncer);
    let thread = std::thread::Builder::new()
        .name("recorder".into())
        .spawn(move || worker.run(&inputs))
        .map_err(GroundError::Thread)?;
    Ok(Recorder { handle, thread, _folder: folder })
}

impl Recorder {
    /// A handle.
    pub fn handle(&self) -> RecorderHandle {
        self.handle.clone()
    }

    /// Finishes every open recording and ends the threads. Waits for the disk.
    pub fn finish(self) {
        self.handle.desk.shared.stopping.store(true, Ordering::Release);
        let _ = self.handle.queue.send(Input::Finish);
        if self.thread.join().is_err() {
            tracing::error!("the recorder thread panicked");
        }
    }
}

impl RecorderHandle {
    pub(crate) fn connected(&self, agent_id: String, boot_id: u64, boot_wall_time_us: u64, commands: CommandSender) {
        self.put(Input::Connected { agent_id, boot_id, boot_wall_time_us, commands });
    }

    pub(crate) fn batch(&self, agent_id: String, batch: Batch, backfill: bool) {
        let (shared, length) = (&self.desk.shared, batch.held_bytes());
        if shared.queued_bytes.load(Ordering::Relaxed) + length > MAX_QUEUED_BYTES
            || shared.queued.load(Ordering::Relaxed) >= MAX_QUEUED - KEPT_FREE
        {
            shared.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        shared.queued_bytes.fetch_add(length, Ordering::Relaxed);
        shared.queued.fetch_add(1, Ordering::Relaxed);
        if !self.put(Input::Batch { agent_id, batch, backfill }) {
            shared.queued_bytes.fetch_sub(length, Ordering::Relaxed);
            shared.queued.fetch_sub(1, Ordering::Relaxed);
        }
    }

    pub(crate) fn unavailable(&self, agent_id: String, request: v1::BackfillRequest) {
        self.put(Input::Unavailable { agent_id, request });
    }

    pub(crate) fn disconnected(&self, agent_id: String) {
        self.put(Input::Disconnected { agent_id });
    }

    fn put(&self, input: Input) -> bool {
        match self.queue.try_send(input) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.desk.shared.refused.fetch_add(1, Ordering::Relaxed);
                false
            }
            Err(TrySendError::Disconnected(_)) => false,
        }
    }

    /// Waits for the state of a recording to change.
    pub(crate) async fn changed(&self) {
        self.desk.shared.changed.notified().await;
    }

    /// State of the recording of one vehicle.
    pub fn status(&self, agent_id: &str) -> v1::RecordingStatus {
        let mut status = lock(&self.desk.shared.status).get(agent_id).cloned().unwrap_or_default();
        status.error = self.error().unwrap_or_default();
        status
    }

    /// Why nothing can be recorded.
    pub fn error(&self) -> Option<String> {
        lock(&self.desk.shared.error).clone()
    }

    /// Files that were damaged beyond repair, by name.
    pub fn set_aside(&self) -> Vec<String> {
        lock(&self.desk.shared.set_aside).clone()
    }

    /// Is the start over: everything repaired and indexed?
    pub fn ready(&self) -> bool {
        self.desk.shared.ready.load(Ordering::Acquire)
    }

    /// Batches that the recorder was too slow for, since start; they are asked for again.
    pub fn refused(&self) -> usize {
        self.desk.shared.refused.load(Ordering::Relaxed)
    }

    /// Bytes waiting to be written.
    pub fn queued_bytes(&self) -> usize {
        self.desk.shared.queued_bytes.load(Ordering::Relaxed)
    }

    /// Has the disk room for so many bytes more, beside what is reserved for recording? Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn room_for(&self, bytes: u64) -> Result<(), RecordingError> {
        self.desk.store.room_for(bytes)
    }

    /// A folder on the disk of the flights for what is being made, which goes with its end. Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn scratch(&self) -> Result<TempDir, RecordingError> {
        self.desk.store.scratch()
    }

    /// Space taken and left. Asks the disk.
    pub fn storage(&self) -> Storage {
        let flights = self.desk.store.list();
        Storage {
            used_bytes: flights.iter().map(|(id, files)| self.desk.store.taken(id, files)).sum(),
            free_bytes: free_bytes(self.desk.store.folder()),
            flights: flights.len() as u64,
        }
    }

    /// One flight. Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError::Unknown`], [`RecordingError::NotReady`], [`RecordingError::Index`].
    pub fn flight(&self, id: &str) -> Result<Flight, RecordingError> {
        // Asked before the index: one that is ready lacks nothing.
        let ready = self.ready();
        let unknown = || if ready { RecordingError::Unknown(crate::names::clip(id)) } else { RecordingError::NotReady };
        if let Some(flight) = self.desk.index.get(id)? {
            return Ok(flight);
        }
        let shared = self.desk.archive.as_ref().map_or(Ok(None), |archive| archive.flight(id))?;
        shared.ok_or_else(unknown)
    }

    /// Changes name or notes of a flight. Writes to the disk.
    ///
    /// # Errors
    /// [`RecordingError`] when there is no such flight, a text is too long, or the disk refuses.
    pub fn label(&self, id: &str, name: Option<String>, notes: Option<String>) -> Result<Flight, RecordingError> {
        // The start sweeps the folder: a label being written then would vanish with it.
        if !self.ready() {
            return Err(RecordingError::NotReady);
        }
        let flight = self.flight(id)?;
        let labels = Labels { name: name.unwrap_or(flight.name), notes: notes.unwrap_or(flight.notes) };
        for (what, text, limit) in [("name", &labels.name, MAX_NAME), ("notes", &labels.notes, MAX_NOTES)] {
            let length = text.chars().count();
            if length > limit {
                return Err(RecordingError::Invalid(format!("{what} has {length} characters, limit {limit}")));
            }
        }
        match &self.desk.archive {
            Some(archive) if flight.away => archive.label(id, &labels)?,
            _ => self.relabel(id, &labels)?,
        }
        self.flight(id)
    }

    /// Takes in a flight file from elsewhere on the same disk, under the id that it carries; damage is repaired, with the original kept
    /// beside it. One that is here already stays. Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError`] when it carries no id of a flight, nothing of it can be read, or the disk refuses.
    pub fn take_in(&self, file: &Path) -> Result<Flight, RecordingError> {
        let carried = identity::Identity::of(file).unwrap_or_default().flight_id;
        let Ok(id) = plumbline_proto::ids::FlightId::new(carried) else {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            return Err(RecordingError::Invalid(format!(
                "{:?} is not a flight of Plumbline",
                crate::names::clip(&name)
            )));
        };
        let id = id.as_str();
        // The start reads the folder: a file that came meanwhile would be read twice.
        if !self.ready() {
            return Err(RecordingError::NotReady);
        }
        if let Some(known) = self.desk.index.get(id)? {
            return Ok(known);
        }
        self.adopt(id, file)?;
        self.flight(id)
    }

    /// Makes a file on the same disk the one of a flight that has none.
    fn adopt(&self, id: &str, file: &Path) -> Result<(), RecordingError> {
        let path = self.desk.store.finished_path(id);
        std::fs::rename(file, &path).map_err(|source| RecordingError::Io { path, source })?;
        self.desk.catch_up_with(id, &self.desk.store.files(id))
    }

    /// Name and notes of a flight of this folder, as they are. Writes to the disk.
    ///
    /// # Errors
    /// [`RecordingError`] of the disk.
    pub(crate) fn relabel(&self, id: &str, labels: &Labels) -> Result<(), RecordingError> {
        self.desk.store.label(id, labels)?;
        Ok(self.desk.index.label(id, labels)?)
    }

    /// Deletes a flight, in the archive of the fleet as well. Waits for the recorder, the disk and the network.
    ///
    /// # Errors
    /// [`RecordingError`] when there is no such flight, it is being recorded, or the disk or the archive refuses.
    pub fn delete(&self, id: &str) -> Result<(), RecordingError> {
        let away = self.flight(id)?.away;
        if let Some(archive) = &self.desk.archive {
            if lock(&self.desk.shared.status).values().any(|status| status.recording && status.flight_id == id) {
                return Err(RecordingError::InProgress(id.to_owned()));
            }
            archive.delete(id)?;
        }
        if away { Ok(()) } else { self.delete_here(id) }
    }

    /// Deletes a flight of this ground's folder. Waits for the recorder and the disk.
    ///
    /// # Errors
    /// [`RecordingError`] when there is no such flight, it is being recorded, or the disk refuses.
    pub fn delete_here(&self, id: &str) -> Result<(), RecordingError> {
        if !self.ready() {
            return Err(RecordingError::NotReady);
        }
        let (answer, answered) = sync_channel(1);
        let input = Input::Delete { id: id.to_owned(), answer };
        self.queue.send(input).map_err(|_| RecordingError::Stopped)?;
        answered.recv().map_err(|_| RecordingError::Stopped)?
    }

    /// Opens a flight for reading: the finished file, or what was written so far. Asks the disk; where it is only in the
    /// archive of the fleet, waits for the network.
    ///
    /// # Errors
    /// [`RecordingError`] when there is no such flight, it cannot be read, or too many are being read.
    pub fn open(&self, id: &str) -> Result<Snapshot, RecordingError> {
        if plumbline_proto::ids::FlightId::new(id).is_err() {
            return Err(RecordingError::Unknown(crate::names::clip(id)));
        }
        self.fetched(id)?;
        self.desk.store.open(id)
    }
}

/// What one file of a flight holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Inspection {
    /// Messages that can be read.
    pub messages: u64,
    /// Flight it belongs to; empty when it does not say.
    pub flight_id: String,
    /// What is wrong with it.
    pub damage: Option<String>,
}

/// Reads a file as the repair at start does, finished or not, without changing it.
///
/// # Errors
/// The file cannot be opened or read; damage is no error.
pub fn inspect(path: &Path) -> Result<Inspection, RecordingError> {
    let scan = repair::scan(path, |_, _, _| Ok(()))
        .map_err(|error| RecordingError::Damaged { path: path.to_owned(), reason: explain(&error) })?;
    let damage = match scan.damage {
        repair::Damage::None => None,
        repair::Damage::Unfinished => Some("it ends in the middle, as a crash leaves it".to_owned()),
        repair::Damage::Corrupt(reason) => Some(reason),
    };
    let flight_id = scan.identity.map_or_else(String::new, |identity| identity.flight_id);
    Ok(Inspection { messages: scan.messages, flight_id, damage })
}

/// What went wrong, with the system's own words where it was the system.
fn explain(error: &mcap::McapError) -> String {
    match error {
        mcap::McapError::Io(source) => source.to_string(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_leave_room_for_what_is_said_once() {
        let folder = tempfile::tempdir().unwrap();
        let recorder = start(&GroundConfig::new(folder.path()), None).unwrap();
        // GIVEN a recorder that takes nothing, and more batches than there are places
        let (queue, inputs) = sync_channel(MAX_QUEUED);
        let handle = RecorderHandle { queue, ..recorder.handle() };
        let mut empty = Vec::new();
        plumbline_proto::codec::begin_batch(&mut empty);
        let batch = Batch::parse(empty.into()).unwrap();
        for _ in 0..=MAX_QUEUED {
            handle.batch("iris-1".into(), batch.clone(), false);
        }
        assert_eq!(handle.refused(), KEPT_FREE + 1);
        // WHEN an agent goes THEN that is known
        handle.disconnected("iris-1".into());
        drop(handle);
        assert!(matches!(inputs.into_iter().last(), Some(Input::Disconnected { .. })));
        recorder.finish();
    }
}
