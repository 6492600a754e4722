//! One flight's file.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use plumbline_file::{METADATA, SyncedFile, Syncer};
use plumbline_proto::codec::Frame;
use plumbline_proto::ids::FlightId;
use plumbline_proto::time::{FlightTime, WallTime};
use plumbline_proto::v1;

use super::records::{self, Channel, Chunk, Contents};
use super::{LogConfig, LogError};

/// Bytes of a chunk before compression; the flush period usually ends it earlier.
const CHUNK_BYTES: usize = 512 << 10;

/// What of the metadata says which flight is older, whatever the wall clock was set to: one more than that of the flight
/// before.
pub(super) const NUMBER: &str = "flight_number";

/// An open flight.
pub(super) struct LogFile {
    path: PathBuf,
    file: Arc<SyncedFile>,
    /// Bytes in the file up to the last whole chunk.
    position: u64,
    chunk: Chunk,
    /// What is about to be written.
    out: Vec<u8>,
    chunks: u32,
    span_ns: Option<(u64, u64)>,
    numbers: HashMap<(u16, u16), u16>,
    channels: Vec<Channel>,
    schemas: Vec<String>,
    boot_wall_time: WallTime,
    written: u64,
    flushed: u64,
    unsynced: bool,
}

impl LogFile {
    /// The file of the flight that `mark` opens, with its place among the flights of this folder.
    pub(super) fn create(config: &LogConfig, mark: &v1::FlightMark, number: u64) -> Result<Self, LogError> {
        let id = FlightId::new(mark.flight_id.as_str())
            .map_err(|error| LogError::Full { path: config.folder.clone(), reason: error.to_string() })?;
        let metadata = BTreeMap::from([
            ("flight_id".to_owned(), mark.flight_id.clone()),
            ("agent_id".to_owned(), config.agent_id.clone()),
            ("agent_version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("schema".to_owned(), plumbline_proto::SCHEMA.to_string()),
            (NUMBER.to_owned(), number.to_string()),
            ("first_sequence".to_owned(), mark.first_sequence.to_string()),
            ("boot_wall_time_us".to_owned(), config.boot_wall_time.0.to_string()),
        ]);
        Self::create_at(config.folder.join(format!("{id}.mcap")), &metadata)
    }

    /// A new file at `path` that says this of itself.
    pub(super) fn create_at(path: PathBuf, metadata: &BTreeMap<String, String>) -> Result<Self, LogError> {
        let boot_wall_time = metadata.get("boot_wall_time_us").and_then(|text| text.parse().ok()).unwrap_or_default();
        let made = || -> io::Result<_> {
            // `create_new`: a flight is never written over another one.
            let mut file = File::options().write(true).create_new(true).open(&path)?;
            let out = records::beginning(concat!("plumbline-agent ", env!("CARGO_PKG_VERSION")), METADATA, metadata);
            file.write_all(&out)?;
            Ok((SyncedFile::new(file, &path), out.len() as u64, Chunk::new()?))
        };
        let (file, position, chunk) = made().map_err(|source| LogError::Io { path: path.clone(), source })?;
        Ok(Self {
            path,
            file,
            position,
            chunk,
            out: Vec::new(),
            chunks: 0,
            span_ns: None,
            numbers: HashMap::new(),
            channels: Vec::new(),
            schemas: Vec::new(),
            boot_wall_time: WallTime(boot_wall_time),
            written: 0,
            flushed: 0,
            unsynced: false,
        })
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
        let Some(number) = self.channel(frame) else { return Ok(()) };
        let time_ns = self.boot_wall_time.at(FlightTime(frame.time_us)).as_nanos();
        self.chunk.message(number, frame.sequence as u32, time_ns, frame.payload);
        if let Some(channel) = self.channels.get_mut(usize::from(number)) {
            channel.messages += 1;
        }
        let (first, last) = self.span_ns.unwrap_or((time_ns, time_ns));
        self.span_ns = Some((first.min(time_ns), last.max(time_ns)));
        self.written = frame.sequence;
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    /// Hands what was written to the system, and has it synced by `syncer`.
    pub(super) fn flush(&mut self, syncer: &Syncer) -> Result<(), LogError> {
        self.end_chunk()?;
        if self.unsynced {
            let asked = self.file.sync(syncer).map_err(|source| self.io(source))?;
            self.unsynced = !asked;
        }
        Ok(())
    }

    fn end_chunk(&mut self) -> Result<(), LogError> {
        if self.chunk.len() > 0 {
            self.out.clear();
            let ended = self.chunk.end(&mut self.out).and_then(|()| self.file.file().write_all(&self.out));
            ended.map_err(|source| self.io(source))?;
            self.position += self.out.len() as u64;
            self.chunks += 1;
            self.unsynced = true;
        }
        self.flushed = self.written;
        Ok(())
    }

    /// Ends the file, so that any reader opens it.
    pub(super) fn finish(&mut self) -> Result<(), LogError> {
        self.end_chunk()?;
        self.summarize().map_err(|source| self.io(source))
    }

    /// Ends a file that cannot be gone on with at its last whole chunk. When that fails as well, the next start does it.
    pub(super) fn give_up(&mut self) {
        let ended = self.file.file().set_len(self.position).and_then(|()| self.summarize());
        if let Err(error) = ended {
            tracing::warn!(file = %self.path.display(), %error, "stays unfinished until the next start");
        }
    }

    fn summarize(&self) -> io::Result<()> {
        let contents = Contents {
            schemas: &self.schemas,
            channels: &self.channels,
            metadata: METADATA,
            chunks: self.chunks,
            span_ns: self.span_ns.unwrap_or_default(),
        };
        let mut file = self.file.file();
        file.seek(SeekFrom::Start(self.position))?;
        records::finish(file, File::open(&self.path)?, self.position, &contents)?;
        file.sync_all()
    }

    /// Number of the channel of a frame, which its first one opens.
    fn channel(&mut self, frame: &Frame<'_>) -> Option<u16> {
        let key = (frame.kind, frame.instance);
        if let Some(number) = self.numbers.get(&key) {
            return Some(*number);
        }
        let kind = frame.known_kind()?;
        let name = kind.message_name();
        let schema = match self.schemas.iter().position(|known| known == name) {
            Some(index) => index as u16 + 1,
            None => {
                self.schemas.push(name.to_owned());
                let number = self.schemas.len() as u16;
                records::schema(self.chunk.records(), number, name);
                number
            }
        };
        let number = u16::try_from(self.channels.len()).ok()?;
        let channel = Channel { topic: kind.topic(frame.instance), schema, messages: 0 };
        records::channel(self.chunk.records(), number, &channel);
        self.channels.push(channel);
        self.numbers.insert(key, number);
        Some(number)
    }

    fn io(&self, source: io::Error) -> LogError {
        LogError::Io { path: self.path.clone(), source }
    }
}
