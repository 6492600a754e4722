//! The onboard log: one MCAP file for each flight, written on a thread of its own.
//!
//! Frames come from the flight thread's ring exactly as telemetry encoded them. A flight begins with
//! its opening [`v1::FlightMark`] and ends with its closing one; what lies outside is not kept.
//! Settings against crashes: no seeking, chunks closed, flushed and synced to the disk every
//! [`FLUSH_PERIOD`]. A killed agent loses at most the last flush, a power cut at most that and what the disk took to
//! sync the one before.
//!
//! The folder stays below its configured size: finished flights go, those that the ground has confirmed to hold
//! first, the oldest of each first, by the number that each flight has. What a killed agent left is finished at the next start. A full or
//! broken disk ends the file, is reported ([`LogState::error`]) and never stops the flight; the next
//! flight tries again.

mod archive;
mod records;
mod repair;
mod room;
mod writer;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use plumbline_file::Syncer;
use plumbline_proto::codec::{Frame, decode_frames};
use plumbline_proto::time::WallTime;
use plumbline_proto::{Kind, v1};
use rtrb::Consumer;

pub use archive::LogArchive;
pub use repair::{finish_all, unfinished};
use writer::LogFile;

/// A chunk is closed, handed to the system and sent on to the disk at least this often.
pub const FLUSH_PERIOD: Duration = Duration::from_millis(150);
/// Size of the folder and health of the disk are looked at this often.
const LOOK_PERIOD: Duration = Duration::from_millis(900);
/// Bytes that may wait for the disk: more than ten seconds of a full suite at 200 Hz.
pub const RING_BYTES: usize = 8 << 20;
/// Default bound of the folder.
pub const DEFAULT_MAX_BYTES: u64 = 4 << 30;

/// How often the ring is emptied.
const POLL_PERIOD: Duration = Duration::from_millis(10);
/// Space that must be free for a flight to be begun.
const MIN_FREE_BYTES: u64 = 32 << 20;

/// Where the log is kept.
#[derive(Debug, Clone)]
pub struct LogConfig {
    /// Folder of the flights.
    pub folder: PathBuf,
    /// The folder stays below this.
    pub max_bytes: u64,
    /// Name of this agent.
    pub agent_id: String,
    /// Wall time at flight time zero.
    pub boot_wall_time: WallTime,
}

/// What the other threads may know of the log.
#[derive(Debug, Default)]
pub struct LogState {
    error: Mutex<Option<String>>,
    /// Changes with every change of `error`.
    changes: AtomicU64,
    /// Messages written since the start.
    pub messages: AtomicU64,
    /// Last sequence that is in the file system; backfill waits for it.
    flushed: AtomicU64,
    /// The flight that is written; named before its file appears.
    current: Mutex<String>,
}

impl LogState {
    /// What is wrong with the log.
    pub fn error(&self) -> Option<String> {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Changes when [`LogState::error`] does; cheap to ask every tick.
    pub fn changes(&self) -> u64 {
        self.changes.load(Ordering::Acquire)
    }

    fn current(&self) -> MutexGuard<'_, String> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn report(&self, error: Option<String>) {
        let mut now = self.error.lock().unwrap_or_else(PoisonError::into_inner);
        if *now == error {
            return;
        }
        now.clone_from(&error);
        self.changes.fetch_add(1, Ordering::Release);
        // The flight thread reads it: what follows may wait for a terminal.
        drop(now);
        match error {
            Some(error) => tracing::error!(error, "onboard log"),
            None => tracing::info!("the onboard log is well again"),
        }
    }
}

/// Why there is no log.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The folder or a file cannot be used.
    #[error("onboard log {path}: {source}")]
    Io {
        /// Folder or file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// No room.
    #[error("onboard log {path}: {reason}")]
    Full {
        /// Folder.
        path: PathBuf,
        /// How much there is and how much is needed.
        reason: String,
    },
}

/// The running log.
#[derive(Debug)]
pub struct LogHandle {
    state: Arc<LogState>,
    archive: Arc<LogArchive>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    repair: Option<JoinHandle<()>>,
}

impl LogHandle {
    /// Its health.
    pub fn state(&self) -> &Arc<LogState> {
        &self.state
    }

    /// What answers backfill requests.
    pub fn archive(&self) -> Arc<LogArchive> {
        self.archive.clone()
    }

    /// Writes what is left, closes the file and waits for the thread.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Release);
        for thread in [self.thread.take(), self.repair.take()].into_iter().flatten() {
            if thread.join().is_err() {
                tracing::error!("a thread of the log died");
            }
        }
    }
}

impl Drop for LogHandle {
    fn drop(&mut self) {
        self.end();
    }
}

/// Starts the log on its own thread. A folder that cannot be used is reported through the state,
/// not here: the vehicle can still be looked at, and the pre-arm check says why it cannot fly.
///
/// # Errors
/// [`LogError::Io`] when no thread can be made.
pub fn spawn(config: LogConfig, ring: Consumer<u8>) -> Result<LogHandle, LogError> {
    let state = Arc::new(LogState::default());
    let stop = Arc::new(AtomicBool::new(false));
    let archive = Arc::new(LogArchive::new(config.folder.clone(), state.clone()));
    let io = |source| LogError::Io { path: config.folder.clone(), source };
    let usable = room::probe(&config);
    state.report(usable.err().map(|error| error.to_string()));
    // Found before the first flight begins: none of them is being written.
    let left = repair::unfinished(&config.folder);
    let repair = match left.is_empty() {
        true => None,
        false => {
            let repair = std::thread::Builder::new().name("log-repair".into());
            Some(repair.spawn(move || repair::finish_all(&left)).map_err(io)?)
        }
    };
    let syncer = Syncer::start().map_err(io)?;
    let mut log = Log {
        config: config.clone(),
        state: state.clone(),
        file: None,
        buffer: Vec::new(),
        syncer,
        in_flight: false,
        newest: 0,
    };
    let thread = {
        let stop = stop.clone();
        std::thread::Builder::new().name("log".into()).spawn(move || log.run(ring, &stop)).map_err(io)?
    };
    Ok(LogHandle { state, archive, stop, thread: Some(thread), repair })
}

struct Log {
    config: LogConfig,
    state: Arc<LogState>,
    file: Option<LogFile>,
    buffer: Vec<u8>,
    syncer: Syncer,
    /// Between its marks, written or not.
    in_flight: bool,
    /// Number of the newest flight in the folder; 0 while none is known.
    newest: u64,
}

impl Log {
    fn run(&mut self, mut ring: Consumer<u8>, stop: &AtomicBool) {
        // Looked up before anything flies, as far as the folder can be read already.
        self.newest = room::newest(&self.config.folder);
        let mut flushed = Instant::now();
        let mut looked = Instant::now();
        loop {
            // Asked before the ring is read: what was written before the stop is still taken.
            let last = stop.load(Ordering::Acquire);
            self.take(&mut ring);
            if flushed.elapsed() >= FLUSH_PERIOD {
                flushed = Instant::now();
                let syncer = self.syncer.clone();
                self.with_file(|file| file.flush(&syncer));
            }
            if looked.elapsed() >= LOOK_PERIOD {
                looked = Instant::now();
                self.keep_within_size();
                self.look_again();
            }
            if last {
                self.close();
                return;
            }
            std::thread::sleep(POLL_PERIOD);
        }
    }

    fn take(&mut self, ring: &mut Consumer<u8>) {
        self.buffer.clear();
        let slots = ring.slots();
        if let Ok(chunk) = ring.read_chunk(slots) {
            let (first, second) = chunk.as_slices();
            self.buffer.extend_from_slice(first);
            self.buffer.extend_from_slice(second);
            chunk.commit_all();
        }
        let buffer = std::mem::take(&mut self.buffer);
        for frame in decode_frames(&buffer) {
            match frame {
                Ok(frame) => self.frame(&frame),
                Err(error) => tracing::error!(%error, "the log ring holds no frame"),
            }
        }
        self.buffer = buffer;
    }

    fn frame(&mut self, frame: &Frame<'_>) {
        let mark = match frame.known_kind() {
            Some(Kind::Flight) => frame.message::<v1::FlightMark>().ok(),
            _ => None,
        };
        if let Some(mark) = mark.as_ref().filter(|mark| mark.last_sequence.is_none()) {
            self.close();
            self.in_flight = true;
            self.open(mark);
        }
        self.with_file(|file| file.write(frame));
        if self.file.is_some() {
            self.state.messages.fetch_add(1, Ordering::Relaxed);
        }
        if mark.is_some_and(|mark| mark.last_sequence.is_some()) {
            self.in_flight = false;
            self.close();
        }
    }

    fn open(&mut self, mark: &v1::FlightMark) {
        self.state.flushed.store(0, Ordering::Release);
        mark.flight_id.clone_into(&mut self.state.current());
        if self.newest == 0 {
            self.newest = room::newest(&self.config.folder);
        }
        self.newest += 1;
        let opened =
            room::make_room(&self.config, None).and_then(|()| LogFile::create(&self.config, mark, self.newest));
        match opened {
            Ok(file) => {
                self.state.report(None);
                self.file = Some(file);
            }
            Err(error) => self.fail(&error),
        }
    }

    fn close(&mut self) {
        self.with_file(LogFile::finish);
        self.file = None;
        self.state.current().clear();
    }

    fn keep_within_size(&mut self) {
        if let Some(file) = &self.file
            && let Err(error) = room::make_room(&self.config, Some(file.path()))
        {
            self.fail(&error);
        }
    }

    /// After a failure, and after the flight that it cost: can the next one be written? Without this a disk that has room again would keep the vehicle
    /// on the ground.
    fn look_again(&mut self) {
        if !self.in_flight && self.file.is_none() && self.state.error().is_some() && room::probe(&self.config).is_ok() {
            self.state.report(None);
        }
    }

    /// Does something to the open file; on failure the file is given up and the reason reported.
    fn with_file(&mut self, act: impl FnOnce(&mut LogFile) -> Result<(), LogError>) {
        let Some(file) = &mut self.file else { return };
        match act(file) {
            Ok(()) => self.state.flushed.store(file.flushed_sequence(), Ordering::Release),
            Err(error) => self.fail(&error),
        }
    }

    fn fail(&mut self, error: &LogError) {
        if let Some(mut file) = self.file.take() {
            file.give_up();
        }
        self.state.current().clear();
        self.state.report(Some(error.to_string()));
    }
}

#[cfg(test)]
mod tests;
