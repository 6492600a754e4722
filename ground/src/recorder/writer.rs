//! Writes one flight file, so that a crash at any moment costs at most the last flush.
//!
//! `NoSeek` and `disable_seeking`: a chunk is written whole or not at all, and nothing written is
//! ever changed. Flushed every [`FLUSH_EVERY`], and then synced by another thread: a slow disk delays no flush.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, McapResult, WriteOptions};
use plumbline_file::{SyncedFile, Syncer};
use plumbline_proto::Kind;
use plumbline_proto::codec::Frame;
use plumbline_proto::descriptor::describing;
use plumbline_proto::time::{FlightTime, WallTime};

use super::identity::Identity;

/// Longest time a message waits in memory.
pub const FLUSH_EVERY: Duration = Duration::from_millis(150);
/// Ids of schemas of ours begin here, above those of others.
const FIRST_SCHEMA: u16 = 0x100;
/// Chunks are cut early beyond this many bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// A part with this many chunks is ended and another begun, after at least two and a half minutes: the writer keeps the
/// place of every channel in every chunk until the end, more than a kilobyte each.
const MOST_CHUNKS: u32 = 1024;

/// The settings every flight file is written with.
pub(super) fn options() -> WriteOptions {
    WriteOptions::new()
        .profile("plumbline")
        .library(concat!("plumbline-ground/", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .disable_seeking(true)
}

/// An MCAP writer that never seeks.
pub(super) type Mcap = mcap::Writer<NoSeek<BufWriter<File>>>;

/// An open flight file.
pub(super) struct FlightWriter {
    mcap: Mcap,
    /// The same file, for syncing.
    file: Arc<SyncedFile>,
    syncer: Syncer,
    boot: WallTime,
    channels: HashMap<(u16, u16), u16>,
    /// `None` until the first time: what waited for the file is written at once.
    flushed: Option<Instant>,
    chunks: u32,
    unflushed: bool,
    unsynced: bool,
}

impl FlightWriter {
    /// Creates `path`, which must not exist yet, with the identity of its flight in front.
    pub(super) fn create(path: &Path, identity: &Identity, syncer: &Syncer) -> McapResult<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        Self::on(file, path, identity, syncer)
    }

    fn on(file: File, path: &Path, identity: &Identity, syncer: &Syncer) -> McapResult<Self> {
        let mut mcap = options().create(NoSeek::new(BufWriter::new(file.try_clone()?)))?;
        mcap.write_metadata(&identity.to_metadata())?;
        mcap.flush()?;
        let boot = WallTime(identity.boot_wall_time_us);
        Ok(Self {
            mcap,
            file: SyncedFile::new(file, path),
            syncer: syncer.clone(),
            boot,
            channels: HashMap::new(),
            flushed: None,
            chunks: 0,
            unflushed: false,
            unsynced: true,
        })
    }

    /// Adds one message. It is on its way to the disk after the next [`FlightWriter::flush`].
    pub(super) fn write(&mut self, frame: &Frame<'_>, topic: &str) -> McapResult<()> {
        let key = (frame.kind, frame.instance);
        let channel_id = match self.channels.get(&key) {
            Some(id) => *id,
            None => {
                let id = self.channel(frame, topic)?;
                self.channels.insert(key, id);
                id
            }
        };
        let log_time = self.boot.at(FlightTime(frame.time_us)).as_nanos();
        // The file holds the low 32 bits; the flight's first sequence number gives the rest back.
        let sequence = frame.sequence as u32;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        self.mcap.write_to_known_channel(&header, frame.payload)?;
        self.unflushed = true;
        Ok(())
    }

    fn channel(&mut self, frame: &Frame<'_>, topic: &str) -> McapResult<u16> {
        let name = frame.known_kind().map(|kind| kind.message_name());
        let schema = name.map(|name| (name, "protobuf", describing(name)));
        channel(&mut self.mcap, schema, topic, "protobuf", &BTreeMap::new())
    }

    /// Is a flush due?
    pub(super) fn due(&self, now: Instant) -> bool {
        (self.unflushed || self.unsynced)
            && self.flushed.is_none_or(|at| now.saturating_duration_since(at) >= FLUSH_EVERY)
    }

    /// Ends the chunk, hands it to the system and has it synced.
    pub(super) fn flush(&mut self, now: Instant) -> McapResult<()> {
        if self.unflushed {
            self.mcap.flush()?;
            self.chunks += 1;
            self.unflushed = false;
            self.unsynced = true;
        }
        self.flushed = Some(now);
        if self.unsynced {
            self.unsynced = !self.file.sync(&self.syncer)?;
        }
        Ok(())
    }

    /// Has it grown so long that another part should go on? Only when nothing waits for its flush.
    pub(super) fn long(&self) -> bool {
        self.chunks >= MOST_CHUNKS && !self.unflushed
    }

    /// Bytes on disk.
    pub(super) fn size(&self) -> u64 {
        self.file.file().metadata().map_or(0, |m| m.len())
    }

    /// Writes the summary and syncs. The file is then whole; `end` is said at the end of a flight.
    pub(super) fn finish(mut self, end: Option<&Metadata>) -> McapResult<()> {
        if let Some(end) = end {
            self.mcap.write_metadata(end)?;
        }
        finish(self.mcap)
    }
}

/// Adds a channel, with a schema (name, encoding, data) or without one.
///
/// One of ours has the same id in every file: the parts of a flight can then be read one behind the other, as they are.
/// Ids of other channels, and those taken by others, are the next free ones.
pub(super) fn channel(
    mcap: &mut Mcap,
    schema: Option<(&str, &str, &[u8])>,
    topic: &str,
    encoding: &str,
    metadata: &BTreeMap<String, String>,
) -> McapResult<u16> {
    let ids = Kind::from_topic(topic).and_then(|(kind, instance)| {
        let (kind, instance) = (u8::try_from(kind.to_wire()).ok()?, u8::try_from(instance).ok()?);
        Some((FIRST_SCHEMA + u16::from(kind), u16::from_be_bytes([kind, instance])))
    });
    if let Some((schema_id, channel_id)) = ids {
        let schema_id = match schema {
            Some((name, encoding, data)) => mcap.add_schema_with_id(schema_id, name, encoding, data),
            None => Ok(0),
        };
        match schema_id.and_then(|schema| mcap.add_channel_with_id(channel_id, schema, topic, encoding, metadata)) {
            Err(McapError::ConflictingSchemas(_) | McapError::ConflictingChannels(_)) => {}
            outcome => return outcome,
        }
    }
    let schema_id = match schema {
        Some((name, encoding, data)) => mcap.add_schema(name, encoding, data)?,
        None => 0,
    };
    mcap.add_channel(schema_id, topic, encoding, metadata)
}

/// Completes a file: summary, footer, everything on the disk.
pub(super) fn finish(mut mcap: Mcap) -> McapResult<()> {
    mcap.finish()?;
    let file = mcap.into_inner().into_inner().into_inner().map_err(|e| e.into_error())?;
    file.sync_all()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(sequence: u64) -> Frame<'static> {
        Frame { kind: Kind::Event.to_wire(), instance: 0, sequence, time_us: sequence, payload: b"" }
    }

    #[test]
    fn a_full_disk_is_an_error_not_a_panic() {
        let file = File::options().write(true).open("/dev/full").unwrap();
        let error = FlightWriter::on(file, Path::new("/dev/full"), &Identity::default(), &Syncer::start().unwrap())
            .map(|_| ())
            .unwrap_err();
        let text = super::super::explain(&error);
        assert!(text.contains("No space left"), "{text}");
    }

    #[test]
    fn what_was_flushed_is_in_the_file_without_a_finish() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.part");
        let mut writer = FlightWriter::create(&path, &Identity::default(), &Syncer::start().unwrap()).unwrap();
        for n in 1..=10 {
            writer.write(&frame(n), "/event").unwrap();
        }
        writer.flush(Instant::now()).unwrap();
        writer.write(&frame(11), "/event").unwrap();
        let crashed = std::fs::read(&path).unwrap();
        let read = mcap::MessageStream::new_with_options(&crashed, mcap::read::Options::IgnoreEndMagic.into()).unwrap();
        let sequences: Vec<u32> = read.map_while(Result::ok).map(|m| m.sequence).collect();
        assert_eq!(sequences, (1..=10).collect::<Vec<_>>());
        std::mem::forget(writer);
    }
}
