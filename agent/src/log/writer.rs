//! One flight's file, and the room for it.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};
use mcap::{Compression, WriteOptions, Writer};
use plumbline_proto::codec::Frame;
use plumbline_proto::descriptor::FILE_DESCRIPTOR_SET;
use plumbline_proto::ids::FlightId;
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::v1;

use super::{LogConfig, LogError, MIN_FREE_BYTES, Syncer};

/// Bytes of a chunk before compression; the flush period usually ends it earlier.
const CHUNK_BYTES: u64 = 512 << 10;

/// Name of the metadata record that makes a file answer for itself.
pub(super) const METADATA: &str = "plumbline";

/// An open flight.
pub(super) struct LogFile {
    path: PathBuf,
    writer: Writer<NoSeek<File>>,
    file: Arc<File>,
    channels: HashMap<(u16, u16), u16>,
    schemas: HashMap<u16, u16>,
    boot_wall_time: WallTime,
    written: u64,
    flushed: u64,
}

impl LogFile {
    pub(super) fn create(config: &LogConfig, mark: &v1::FlightMark) -> Result<Self, LogError> {
        let id = FlightId::new(mark.flight_id.as_str())
            .map_err(|error| LogError::Full { path: config.folder.clone(), reason: error.to_string() })?;
        let metadata = BTreeMap::from([
            ("flight_id".to_owned(), mark.flight_id.clone()),
            ("agent_id".to_owned(), config.agent_id.clone()),
            ("agent_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("schema".to_owned(), plumbline_proto::SCHEMA.to_string()),
            ("first_sequence".to_owned(), mark.first_sequence.to_string()),
            ("boot_wall_time_us".to_owned(), config.boot_wall_time.0.to_string()),
        ]);
        Self::create_at(config.folder.join(format!("{id}.mcap")), metadata)
    }

    /// A new file at `path` that says this of itself.
    pub(super) fn create_at(path: PathBuf, metadata: BTreeMap<String, String>) -> Result<Self, LogError> {
        let boot_wall_time = metadata.get("boot_wall_time_us").and_then(|text| text.parse().ok()).unwrap_or_default();
        let io = |source| LogError::Io { path: path.clone(), source };
        // `create_new`: a flight is never written over another one.
        let file = File::options().write(true).create_new(true).open(&path).map_err(io)?;
        let second = file.try_clone().map_err(io)?;
        let writer = WriteOptions::new()
            .profile("plumbline")
            .library(concat!("plumbline-agent ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            // The place of every message, by channel and chunk, would be kept in memory until the end of the flight: 30 MiB
            // an hour. The chunks' own index remains.
            .emit_message_indexes(false)
            .disable_seeking(true)
            .create(NoSeek::new(file))
            .map_err(mcap_error(&path))?;
        let mut log = Self {
            path,
            writer,
            file: Arc::new(second),
            channels: HashMap::new(),
            schemas: HashMap::new(),
            boot_wall_time: WallTime(boot_wall_time),
            written: 0,
            flushed: 0,
        };
        log.writer.write_metadata(&Metadata { name: METADATA.to_owned(), metadata }).map_err(mcap_error(&log.path))?;
        Ok(log)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Last sequence handed to the system.
    pub(super) fn flushed_sequence(&self) -> u64 {
        self.flushed
    }

    pub(super) fn write(&mut self, frame: &Frame<'_>) -> Result<(), LogError> {
        // Kinds of this build only: the frames come from our own telemetry.
        let Some(channel_id) = self.channel(frame)? else { return Ok(()) };
        let log_time = self.boot_wall_time.at(FlightTime(frame.time_us)).as_nanos();
        let header = MessageHeader { channel_id, sequence: frame.sequence as u32, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, frame.payload).map_err(mcap_error(&self.path))?;
        self.written = frame.sequence;
        Ok(())
    }

    pub(super) fn flush(&mut self) -> Result<(), LogError> {
        self.writer.flush().map_err(mcap_error(&self.path))?;
        self.flushed = self.written;
        Ok(())
    }

    /// Flushes, and has the file synced by `syncer`.
    pub(super) fn sync(&mut self, syncer: &Syncer) -> Result<(), LogError> {
        self.flush()?;
        syncer.sync(&self.file).map_err(|source| LogError::Io { path: self.path.clone(), source })
    }

    pub(super) fn finish(&mut self) -> Result<(), LogError> {
        self.writer.finish().map_err(mcap_error(&self.path))?;
        self.flushed = self.written;
        self.file.sync_all().map_err(|source| LogError::Io { path: self.path.clone(), source })
    }

    fn channel(&mut self, frame: &Frame<'_>) -> Result<Option<u16>, LogError> {
        let key = (frame.kind, frame.instance);
        if let Some(id) = self.channels.get(&key) {
            return Ok(Some(*id));
        }
        let Some(kind) = frame.known_kind() else { return Ok(None) };
        let schema = match self.schemas.get(&frame.kind) {
            Some(id) => *id,
            None => {
                let id = self
                    .writer
                    .add_schema(kind.message_name(), "protobuf", FILE_DESCRIPTOR_SET)
                    .map_err(mcap_error(&self.path))?;
                self.schemas.insert(frame.kind, id);
                id
            }
        };
        let id = self
            .writer
            .add_channel(schema, &kind.topic(frame.instance), "protobuf", &BTreeMap::new())
            .map_err(mcap_error(&self.path))?;
        self.channels.insert(key, id);
        Ok(Some(id))
    }
}

fn mcap_error(path: &Path) -> impl FnOnce(mcap::McapError) -> LogError + '_ {
    move |error| match error {
        mcap::McapError::Io(source) => LogError::Io { path: path.to_owned(), source },
        other => LogError::Mcap { path: path.to_owned(), source: Box::new(other) },
    }
}

/// Could a flight be begun now?
pub(super) fn probe(config: &LogConfig) -> Result<(), LogError> {
    fs::create_dir_all(&config.folder).map_err(|source| LogError::Io { path: config.folder.clone(), source })?;
    make_room(config, None)?;
    let path = config.folder.join("probe.tmp");
    let io = |source| LogError::Io { path: path.clone(), source };
    fs::write(&path, b"can be written").map_err(io)?;
    fs::remove_file(&path).map_err(io)
}

/// Stands beside a flight that the ground holds, too.
pub(super) fn kept_mark(path: &Path) -> PathBuf {
    path.with_extension("kept")
}

/// Deletes finished flights, those that the ground holds first and the oldest of each first, until the folder is below its bound and the disk has some
/// space left. `open` is never deleted.
pub(super) fn make_room(config: &LogConfig, open: Option<&Path>) -> Result<(), LogError> {
    let folder = &config.folder;
    let io = |source| LogError::Io { path: folder.clone(), source };
    let mut flights = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        // What was set aside takes room as well, and goes like any other.
        if path.extension().is_some_and(|extension| extension == "mcap" || extension == "corrupt") {
            let meta = fs::metadata(&path).map_err(io)?;
            let kept = kept_mark(&path).exists();
            flights.push((!kept, meta.modified().map_err(io)?, meta.len(), path));
        }
    }
    flights.sort();
    let mut used: u64 = flights.iter().map(|(_, _, bytes, _)| bytes).sum();
    let mut oldest = flights.iter().filter(|(.., path)| Some(path.as_path()) != open);
    // A new flight begins with some room to grow; an open one may fill the bound.
    let bound = if open.is_some() { config.max_bytes } else { config.max_bytes - config.max_bytes / 10 };
    while used > bound || free_bytes(folder).is_some_and(|free| free < MIN_FREE_BYTES) {
        let Some((only_here, _, bytes, path)) = oldest.next() else {
            let free = free_bytes(folder).map_or_else(|| "unknown".to_owned(), |free| (free >> 20).to_string());
            let reason = format!(
                "no room: {} MiB used of {} MiB, {free} MiB free on the disk, at least {} needed",
                used >> 20,
                config.max_bytes >> 20,
                MIN_FREE_BYTES >> 20
            );
            return Err(LogError::Full { path: folder.clone(), reason });
        };
        if *only_here {
            tracing::warn!(flight = %path.display(), bytes, "deleted to make room: no ground is known to hold it");
        } else {
            tracing::info!(flight = %path.display(), bytes, "deleted to make room: the ground holds it");
        }
        fs::remove_file(path).map_err(|source| LogError::Io { path: path.clone(), source })?;
        let _ = fs::remove_file(kept_mark(path));
        used -= bytes;
    }
    Ok(())
}

fn free_bytes(folder: &Path) -> Option<u64> {
    use std::os::unix::ffi::OsStrExt;
    let path = std::ffi::CString::new(folder.as_os_str().as_bytes()).ok()?;
    let mut stat = std::mem::MaybeUninit::<libc::statvfs>::uninit();
    // SAFETY: `path` is a C string and `stat` has room for the answer, which is read only on success.
    let stat = unsafe {
        if libc::statvfs(path.as_ptr(), stat.as_mut_ptr()) != 0 {
            return None;
        }
        stat.assume_init()
    };
    Some(stat.f_bavail as u64 * stat.f_frsize as u64)
}
