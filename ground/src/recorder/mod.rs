//! Records flights: the downlink written down.
//!
//! One thread of its own does all the writing, behind a queue bounded by [`MAX_QUEUED_BYTES`].
//! Policy when the queue is full (a slow or stuck disk): the batch is not recorded, and because the
//! recorder counts sequence numbers, it is a gap like any other and is asked back from the agent's
//! own log. The hub never waits.

mod worker;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use bytes::Bytes;
use plumbline_proto::v1;
use serde::Serialize;
use tokio::sync::Notify;

use crate::agent_link::CommandSender;
use crate::config::GroundConfig;
use crate::error::GroundError;
use crate::sync::lock;

/// Most messages waiting for the recorder.
const MAX_QUEUED: usize = 16_384;
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
    /// It is being recorded.
    #[error("flight {0:?} is being recorded")]
    InProgress(String),
    /// The request makes no sense.
    #[error("{0}")]
    Invalid(String),
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
    /// The index failed; it can be rebuilt from the files.
    #[error("index of flights: {0}")]
    Index(#[from] rusqlite::Error),
}

/// What the recordings take and leave.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Storage {
    /// Size of all flight files, bytes.
    pub used_bytes: u64,
    /// Free on their disk, bytes.
    pub free_bytes: u64,
    /// Flights.
    pub flights: u64,
}

/// What the recorder is told.
#[derive(Debug)]
enum Input {
    Connected { agent_id: String, boot_id: u64, boot_wall_time_us: u64, commands: CommandSender },
    Batch { agent_id: String, batch: Bytes, backfill: bool },
    Unavailable { agent_id: String, request: v1::BackfillRequest },
    Disconnected { agent_id: String },
    Finish,
}

/// What the recorder shows.
#[derive(Debug, Default)]
struct Shared {
    status: Mutex<BTreeMap<String, v1::RecordingStatus>>,
    error: Mutex<Option<String>>,
    set_aside: Mutex<Vec<String>>,
    queued_bytes: AtomicUsize,
    /// Batches that found the queue full, since start.
    refused: AtomicUsize,
    changed: Notify,
}

/// The running recorder.
#[derive(Debug)]
pub struct Recorder {
    handle: RecorderHandle,
    thread: JoinHandle<()>,
}

/// How the rest of the ground reaches the recorder. Cheap to clone; no call waits for the disk
/// unless it says so.
#[derive(Debug, Clone)]
pub struct RecorderHandle {
    queue: SyncSender<Input>,
    shared: Arc<Shared>,
}

/// Starts the recorder's thread.
///
/// # Errors
/// [`GroundError::Thread`].
pub fn start(config: &GroundConfig) -> Result<Recorder, GroundError> {
    let (queue, inputs) = sync_channel(MAX_QUEUED);
    let shared = Arc::new(Shared::default());
    let handle = RecorderHandle { queue, shared: shared.clone() };
    let worker = worker::Worker::new(config.clone(), shared);
    let thread = std::thread::Builder::new()
        .name("recorder".into())
        .spawn(move || worker.run(&inputs))
        .map_err(GroundError::Thread)?;
    Ok(Recorder { handle, thread })
}

impl Recorder {
    /// A handle.
    pub fn handle(&self) -> RecorderHandle {
        self.handle.clone()
    }

    /// Finishes every open recording and ends the thread. Waits for the disk.
    pub fn finish(self) {
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

    pub(crate) fn batch(&self, agent_id: String, batch: Bytes, backfill: bool) {
        let length = batch.len();
        if self.shared.queued_bytes.load(Ordering::Relaxed) + length > MAX_QUEUED_BYTES {
            self.shared.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        self.shared.queued_bytes.fetch_add(length, Ordering::Relaxed);
        if !self.put(Input::Batch { agent_id, batch, backfill }) {
            self.shared.queued_bytes.fetch_sub(length, Ordering::Relaxed);
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
                self.shared.refused.fetch_add(1, Ordering::Relaxed);
                false
            }
            Err(TrySendError::Disconnected(_)) => false,
        }
    }

    /// Waits for the state of a recording to change.
    pub(crate) async fn changed(&self) {
        self.shared.changed.notified().await;
    }

    /// State of the recording of one vehicle.
    pub fn status(&self, agent_id: &str) -> v1::RecordingStatus {
        let mut status = lock(&self.shared.status).get(agent_id).cloned().unwrap_or_default();
        status.error = self.error().unwrap_or_default();
        status
    }

    /// Why nothing can be recorded.
    pub fn error(&self) -> Option<String> {
        lock(&self.shared.error).clone()
    }

    /// Files that were damaged beyond repair, by name.
    pub fn set_aside(&self) -> Vec<String> {
        lock(&self.shared.set_aside).clone()
    }

    /// Space taken and left. Asks the disk.
    pub fn storage(&self) -> Storage {
        Storage::default()
    }
}
