//! The folder of flight files (the seam called `RecordingStore`).
//!
//! | file | what |
//! |---|---|
//! | `ID.mcap` | a finished flight |
//! | `ID.001.part` … | being written, or left by a crash; merged into `ID.mcap` |
//! | `ID.json` | name and notes, by people |
//! | `ID.overview` | what charts show of it as a whole, to be made anew at any time |
//! | `*.tmp` | being made, or sent by a client; never the only copy; removed at start |
//! | `*.corrupt` | damaged; what could be read of it is in `ID.mcap` |
//!
//! A file is replaced only by renaming a complete and synced one over it, and parts are removed only
//! after that: a crash in between merges once more, and messages are told apart by their sequence
//! numbers.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mcap::McapResult;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use plumbline_file::write_atomically;
use plumbline_proto::ids::FlightId;
use serde::{Deserialize, Serialize};
use tempfile::TempDir;
use tokio::sync::Semaphore;

use super::RecordingError;
use super::folder::free_bytes;
use super::identity::Identity;
use super::overview::Overview;
use super::reading::{Reading, gather};
use super::snapshot::Snapshot;
use super::writer;

/// Longest name of a flight, characters.
pub const MAX_NAME: usize = 200;
/// Longest notes, characters.
pub const MAX_NOTES: usize = 100_000;

/// A file being merged is synced each time this much was added, bytes: all of it at once would hold up the disk for
/// the files being recorded.
const SYNC_BYTES: usize = 8 << 20;
/// Files larger than this together are not merged while the ground is ending: the next start does that.
const LATER_BYTES: u64 = 64 << 20;

/// Most files open for reading by clients, which leaves descriptors for those being recorded.
const MAX_READ_FILES: usize = 768;

/// What people wrote about a flight.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Labels {
    /// Name.
    #[serde(default)]
    pub name: String,
    /// Notes.
    #[serde(default)]
    pub notes: String,
}

/// The folder.
#[derive(Debug, Clone)]
pub(super) struct RecordingStore {
    folder: PathBuf,
    /// What is left free on the disk for flights being recorded, bytes.
    reserve_bytes: u64,
    /// For files being read by clients.
    descriptors: Arc<Semaphore>,
}

/// The files of one flight.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Files {
    pub(super) finished: Option<PathBuf>,
    pub(super) parts: Vec<PathBuf>,
}

impl Files {
    /// Number of the next part.
    pub(super) fn next_part(&self) -> u32 {
        self.parts.iter().map(|path| number(path)).max().unwrap_or(0).saturating_add(1)
    }

    /// Without the parts from number `part` on.
    pub(super) fn before(mut self, part: u32) -> Self {
        self.parts.retain(|path| number(path) < part);
        self
    }

    /// What the first readable one of them says of itself.
    pub(super) fn identity(&self) -> Identity {
        self.finished.iter().chain(&self.parts).find_map(|path| Identity::of(path)).unwrap_or_default()
    }
}

/// Number of a part; 0 for one that somebody else has named.
fn number(part: &Path) -> u32 {
    part.file_stem().and_then(|stem| stem.to_str()?.rsplit('.').next()?.parse().ok()).unwrap_or(0)
}

impl RecordingStore {
    pub(super) fn new(data_folder: &Path, reserve_bytes: u64) -> Self {
        let descriptors = Arc::new(Semaphore::new(MAX_READ_FILES));
        Self { folder: data_folder.join("flights"), reserve_bytes, descriptors }
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Makes sure that the folder exists and can be written. The data folder around it is made at the start and never
    /// again: one that was moved away or unmounted is missed loudly, not begun anew beside itself.
    pub(super) fn probe(&self) -> Result<(), RecordingError> {
        match fs::create_dir(&self.folder) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => return Err(io(&self.folder, error)),
            _ => {}
        }
        let probe = self.folder.join("probe.tmp");
        fs::write(&probe, b"can be written").map_err(|e| io(&probe, e))?;
        fs::remove_file(&probe).map_err(|e| io(&probe, e))
    }

    pub(super) fn finished_path(&self, id: &str) -> PathBuf {
        self.folder.join(format!("{id}.mcap"))
    }

    fn overview_path(&self, id: &str) -> PathBuf {
        self.folder.join(format!("{id}.overview"))
    }

    /// The part of a flight with this number.
    pub(super) fn part_path(&self, id: &str, number: u32) -> PathBuf {
        self.folder.join(format!("{id}.{number:03}.part"))
    }

    /// Every flight with files here.
    pub(super) fn list(&self) -> BTreeMap<String, Files> {
        let mut flights: BTreeMap<String, Files> = BTreeMap::new();
        let Ok(entries) = fs::read_dir(&self.folder) else { return flights };
        for path in entries.flatten().map(|entry| entry.path()) {
            let Some(name) = path.file_name().and_then(|n| n.to_str()).map(str::to_owned) else { continue };
            if let Some(id) = name.strip_suffix(".mcap").filter(|id| FlightId::new(*id).is_ok()) {
                flights.entry(id.to_owned()).or_default().finished = Some(path);
            } else if let Some((id, _)) = name.strip_suffix(".part").and_then(|n| n.rsplit_once('.'))
                && FlightId::new(id).is_ok()
            {
                flights.entry(id.to_owned()).or_default().parts.push(path);
            }
        }
        flights.values_mut().for_each(|files| files.parts.sort());
        flights
    }

    /// The files of one flight.
    pub(super) fn files(&self, id: &str) -> Files {
        self.list().remove(id).unwrap_or_default()
    }

    /// Is anything of a flight here? Unlike [`RecordingStore::files`] it lists no folder where it is finished.
    pub(super) fn has(&self, id: &str) -> bool {
        self.finished_path(id).exists() || self.files(id) != Files::default()
    }

    /// Removes what was being made when the ground ended, and what charts show of flights that somebody took away.
    pub(super) fn sweep(&self) {
        let Ok(entries) = fs::read_dir(&self.folder) else { return };
        for path in entries.flatten().map(|entry| entry.path()) {
            let alone = path.extension().is_some_and(|e| e == "overview") && !path.with_extension("mcap").exists();
            if alone || path.extension().is_some_and(|e| e == "tmp") {
                let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            }
        }
    }

    /// A folder for what is being made, which goes with its end.
    pub(super) fn scratch(&self) -> Result<TempDir, RecordingError> {
        let made = tempfile::Builder::new().prefix("incoming-").suffix(".tmp").tempdir_in(&self.folder);
        made.map_err(|error| io(&self.folder, error))
    }

    /// Names of the files set aside.
    pub(super) fn set_aside(&self) -> Vec<String> {
        let Ok(entries) = fs::read_dir(&self.folder) else { return Vec::new() };
        let name = |entry: fs::DirEntry| entry.file_name().to_str().map(str::to_owned);
        let mut names: Vec<_> = entries.flatten().filter_map(name).filter(|n| n.ends_with(".corrupt")).collect();
        names.sort();
        names
    }

    /// Reads all messages of a flight's files, each once, without writing.
    pub(super) fn read(&self, files: &Files) -> Result<Reading, RecordingError> {
        let gathered = gather(files, None, |_, _, _| Ok(())).map_err(|e| damaged_file(&self.folder, e));
        gathered.map(|(reading, _)| reading)
    }

    /// Merges these files of a flight, up to message `last`, into one finished file. Answers what it holds.
    ///
    /// # Errors
    /// [`RecordingError::Stopped`] when it would take long and `stopping` is set; [`RecordingError::Io`] where the disk has
    /// no room for a second copy beside what is reserved for recording. The files stay as they are.
    pub(super) fn merge(
        &self,
        id: &str,
        files: &Files,
        last: Option<u64>,
        stopping: &AtomicBool,
    ) -> Result<Reading, RecordingError> {
        let size = self.size(files);
        let later = || size > LATER_BYTES && stopping.load(Ordering::Acquire);
        let temporary = self.folder.join(format!("{id}.merge.tmp"));
        self.room_for(size)?;
        let merged = self.write_merged(files, id, last, &temporary, later);
        let merged = if later() { Err(RecordingError::Stopped) } else { merged };
        // What was begun would only fill the disk.
        let (reading, damaged) = merged.inspect_err(|_| drop(fs::remove_file(&temporary)))?;
        let finished = self.finished_path(id);
        if reading.learner.messages() == 0 {
            fs::remove_file(&temporary).map_err(|e| io(&temporary, e))?;
        } else {
            for (path, _) in damaged.iter().filter(|(path, _)| *path == finished) {
                // The original stays beside the repaired file; a link, so that no moment is without one.
                let aside = aside(path);
                let _ = fs::remove_file(&aside);
                fs::hard_link(path, &aside).map_err(|e| io(path, e))?;
            }
            fs::rename(&temporary, &finished).map_err(|e| io(&finished, e))?;
            self.sync_folder()?;
        }
        // A file that was finished once and gives nothing now is evidence: it is never removed.
        let empty = files.finished.iter().filter(|_| reading.learner.messages() == 0);
        for path in files.parts.iter().chain(empty) {
            let damage = damaged.iter().find(|(damaged, _)| damaged == path).map(|(_, reason)| reason.as_str());
            match damage.or((*path == finished).then_some("no message can be read")) {
                Some(reason) => {
                    tracing::error!(file = %path.display(), reason, "damaged, set aside as *.corrupt");
                    fs::rename(path, aside(path)).map_err(|e| io(path, e))?;
                }
                None => fs::remove_file(path).map_err(|e| io(path, e))?,
            }
        }
        Ok(reading)
    }

    /// Has the disk room for so many bytes more, beside what is reserved for recording?
    ///
    /// # Errors
    /// [`RecordingError::Io`] with what is free and what is needed.
    pub(super) fn room_for(&self, bytes: u64) -> Result<(), RecordingError> {
        let (free, needed) = (free_bytes(&self.folder), bytes.saturating_add(self.reserve_bytes));
        if free >= needed {
            return Ok(());
        }
        let text = format!("{free} bytes are free, {needed} are needed");
        Err(io(&self.folder, std::io::Error::new(std::io::ErrorKind::StorageFull, text)))
    }

    /// Makes the only, finished part of a flight its file.
    pub(super) fn promote(&self, id: &str, part: &Path) -> Result<(), RecordingError> {
        let finished = self.finished_path(id);
        fs::rename(part, &finished).map_err(|e| io(&finished, e))?;
        self.sync_folder()
    }

    /// Opens a flight for reading: its finished file, or the parts written so far.
    pub(super) fn open(&self, id: &str) -> Result<Snapshot, RecordingError> {
        let files = self.files(id);
        if files == Files::default() {
            return Err(RecordingError::Unknown(id.to_owned()));
        }
        let count = u32::try_from(files.parts.len() + 1).unwrap_or(u32::MAX);
        let descriptors = self.descriptors.clone().try_acquire_many_owned(count).map_err(|_| RecordingError::Busy)?;
        let mut snapshot = Snapshot::open(&files).map_err(|e| damaged_file(&self.folder.join(id), e))?;
        snapshot._descriptors = Some(descriptors);
        snapshot.overview =
            snapshot.finished().then(|| Overview::new(self.overview_path(id), &snapshot.tag(), self.clone()));
        Ok(snapshot)
    }

    /// Removes every file of a flight.
    pub(super) fn delete(&self, id: &str) -> Result<(), RecordingError> {
        let files = self.files(id);
        for path in files.finished.iter().chain(&files.parts) {
            fs::remove_file(path).map_err(|e| io(path, e))?;
        }
        for path in [self.folder.join(format!("{id}.json")), self.overview_path(id)] {
            match fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(io(&path, error)),
                _ => {}
            }
        }
        self.sync_folder()
    }

    /// Name and notes of a flight.
    pub(super) fn labels(&self, id: &str) -> Labels {
        let text = fs::read(self.folder.join(format!("{id}.json"))).unwrap_or_default();
        serde_json::from_slice(&text).unwrap_or_default()
    }

    /// Keeps name and notes of a flight.
    pub(super) fn label(&self, id: &str, labels: &Labels) -> Result<(), RecordingError> {
        let path = self.folder.join(format!("{id}.json"));
        let text = serde_json::to_vec_pretty(labels).unwrap_or_default();
        write_atomically(&path, &text).map_err(|e| io(&path, e))
    }

    /// Size of a flight's files, bytes.
    pub(super) fn size(&self, files: &Files) -> u64 {
        let size = |path: &PathBuf| fs::metadata(path).map_or(0, |m| m.len());
        files.finished.iter().chain(&files.parts).map(size).sum()
    }

    /// Bytes that a flight takes on the disk: its files, and what charts show of it.
    pub(super) fn taken(&self, id: &str, files: &Files) -> u64 {
        self.size(files) + fs::metadata(self.overview_path(id)).map_or(0, |m| m.len())
    }

    fn write_merged(
        &self,
        files: &Files,
        id: &str,
        last: Option<u64>,
        path: &Path,
        given_up: impl Fn() -> bool,
    ) -> Result<(Reading, Vec<(PathBuf, String)>), RecordingError> {
        let attempt = || -> McapResult<(Reading, Vec<(PathBuf, String)>)> {
            let mut identity = files.identity();
            if identity.flight_id.is_empty() {
                id.clone_into(&mut identity.flight_id);
            }
            let file = File::create(path)?;
            let mut mcap = writer::options().create(NoSeek::new(BufWriter::new(file.try_clone()?)))?;
            mcap.write_metadata(&identity.to_metadata())?;
            let mut channels: HashMap<String, u16> = HashMap::new();
            let mut unsynced = 0;
            let (reading, damaged) = gather(files, last, |channel, header, data| {
                let channel_id = match channels.get(&channel.topic) {
                    Some(id) => *id,
                    None => {
                        let schema = channel.schema.as_deref().map(|s| (&*s.name, &*s.encoding, &*s.data));
                        let (topic, encoding) = (&channel.topic, &channel.message_encoding);
                        let id = writer::channel(&mut mcap, schema, topic, encoding, &channel.metadata)?;
                        channels.insert(channel.topic.clone(), id);
                        id
                    }
                };
                unsynced += data.len();
                if unsynced > SYNC_BYTES {
                    unsynced = 0;
                    if given_up() {
                        return Err(std::io::Error::from(std::io::ErrorKind::Interrupted).into());
                    }
                    mcap.flush()?;
                    file.sync_data()?;
                }
                mcap.write_to_known_channel(&MessageHeader { channel_id, ..*header }, data)
            })?;
            mcap.write_metadata(&reading.ending().to_metadata())?;
            writer::finish(mcap)?;
            Ok((reading, damaged))
        };
        attempt().map_err(|e| damaged_file(path, e))
    }

    fn sync_folder(&self) -> Result<(), RecordingError> {
        File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(|e| io(&self.folder, e))
    }
}

fn io(path: &Path, source: std::io::Error) -> RecordingError {
    RecordingError::Io { path: path.to_owned(), source }
}

fn aside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".corrupt");
    PathBuf::from(name)
}

fn damaged_file(path: &Path, error: mcap::McapError) -> RecordingError {
    match error {
        mcap::McapError::Io(source) => io(path, source),
        other => RecordingError::Damaged { path: path.to_owned(), reason: other.to_string() },
    }
}
