//! What there is of a flight, as one MCAP file to be read, without a second copy of it.
//!
//! A finished flight is its file. An unfinished one is its parts as they are, one behind the other: a channel has the same
//! id in each of them ([`super::writer::channel`]), so that only what closes a part (its summary) and what opens the next
//! (its header) is left out, and an end is put behind the last whole record. Parts only grow: what was once at a place
//! stays there, and a download that broke off goes on although the flight did, too.
//!
//! Messages recorded twice, as after a restart of the ground, are in there twice until the parts are merged; the
//! [reader](super::reader) passes on each once.

use std::fs::File;
use std::io::Read as _;
use std::os::unix::fs::{FileExt as _, MetadataExt as _};
use std::sync::Arc;

use mcap::records::{ChunkIndex, MetadataIndex, Record, op};
use mcap::{Channel, MAGIC, McapError, McapResult, Schema, Summary};
use plumbline_file::{MAX_RECORD, chunk_records};
use tokio::sync::OwnedSemaphorePermit;

use super::overview::Overview;
use super::store::Files;

/// Opcode and length before each record.
const HEAD: u64 = 9;
/// An end without a summary: `DataEnd` and `Footer`, all their fields zero, and the magic.
const END: [u8; 50] = {
    let mut end = [0; 50];
    (end[0], end[1]) = (op::DATA_END, 4);
    (end[13], end[14]) = (op::FOOTER, 20);
    let mut at = 0;
    while at < MAGIC.len() {
        end[42 + at] = MAGIC[at];
        at += 1;
    }
    end
};

/// A flight to be read. The files stay open: it goes on being readable when the flight is finished or deleted.
#[derive(Debug)]
pub struct Snapshot {
    segments: Vec<Segment>,
    /// Bytes of the segments.
    data: u64,
    /// What follows them.
    end: &'static [u8],
    /// Says which file this is, and how its bytes came to be.
    tag: String,
    /// What is where, when no file says so itself.
    summary: Option<Summary>,
    /// Of one that is finished: where what charts show of it is kept.
    pub(super) overview: Option<Overview>,
    /// Descriptors taken.
    pub(super) _descriptors: Option<OwnedSemaphorePermit>,
}

#[derive(Debug)]
struct Segment {
    file: File,
    from: u64,
    length: u64,
}

impl Snapshot {
    /// Opens these files of a flight.
    pub(super) fn open(files: &Files) -> McapResult<Self> {
        match &files.finished {
            Some(path) if files.parts.is_empty() => {
                let file = File::open(path)?;
                let meta = file.metadata()?;
                let tag = format!("{:x}.{:x}.{:x}", meta.ino(), meta.mtime(), meta.mtime_nsec());
                let segments = vec![Segment { file, from: 0, length: meta.len() }];
                Ok(Self {
                    segments,
                    data: meta.len(),
                    end: &[],
                    tag,
                    summary: None,
                    overview: None,
                    _descriptors: None,
                })
            }
            _ => Self::join(files),
        }
    }

    /// Opens one file by itself, finished or as a crash left it.
    ///
    /// # Errors
    /// It cannot be read, is no MCAP file of a version that is known, or holds no whole record.
    pub fn of(path: &std::path::Path) -> Result<Self, super::RecordingError> {
        let files = Files { finished: None, parts: vec![path.to_owned()] };
        let damaged = |reason| super::RecordingError::Damaged { path: path.to_owned(), reason };
        let mut begins = [0; MAGIC.len()];
        let read = File::open(path).and_then(|file| file.read_at(&mut begins, 0));
        let read = read.map_err(|error| damaged(super::explain(&error.into())))?;
        if read == MAGIC.len() && begins != *MAGIC {
            let text = String::from_utf8_lossy(&begins);
            return Err(damaged(format!(
                "begins with {text:?}, an MCAP file of version 0 with {:?}",
                "\u{fffd}MCAP0\r\n"
            )));
        }
        Self::join(&files).map_err(|error| damaged(super::explain(&error)))
    }

    fn join(files: &Files) -> McapResult<Self> {
        let mut joined = Self {
            segments: Vec::new(),
            data: 0,
            end: &END,
            tag: String::new(),
            summary: None,
            overview: None,
            _descriptors: None,
        };
        for path in files.finished.iter().chain(&files.parts) {
            let file = File::open(path)?;
            let Some(layout) = layout(&file)? else { continue };
            let summary = joined.summary.get_or_insert_default();
            if !compatible(summary, &layout.summary) {
                // Left by an older version, or another writer: what follows waits for the merging.
                break;
            }
            let from = if joined.segments.is_empty() { 0 } else { layout.body };
            if joined.segments.is_empty() {
                joined.tag = format!("{:x}.parts", file.metadata()?.ino());
            }
            let moved = |offset: u64| joined.data + offset.saturating_sub(from);
            summary.channels.extend(layout.summary.channels);
            summary.schemas.extend(layout.summary.schemas);
            summary.chunk_indexes.extend(
                layout
                    .summary
                    .chunk_indexes
                    .into_iter()
                    .map(|index| ChunkIndex { chunk_start_offset: moved(index.chunk_start_offset), ..index }),
            );
            summary.metadata_indexes.extend(
                layout.summary.metadata_indexes.into_iter().map(|m| MetadataIndex { offset: moved(m.offset), ..m }),
            );
            let length = layout.until.saturating_sub(from);
            joined.segments.push(Segment { file, from, length });
            joined.data += length;
        }
        if joined.segments.is_empty() { Err(McapError::UnexpectedEof) } else { Ok(joined) }
    }

    /// Bytes.
    pub fn length(&self) -> u64 {
        self.data + self.end.len() as u64
    }

    /// Will it grow no more?
    pub fn finished(&self) -> bool {
        self.end.is_empty()
    }

    /// Identifies these bytes; a snapshot of other bytes has another one.
    pub fn tag(&self) -> String {
        format!("\"{}.{:x}\"", self.tag, self.data)
    }

    /// Is one that was tagged so still the beginning of this one? Then this becomes it.
    pub fn go_back_to(&mut self, tag: &str) -> bool {
        let length = tag.trim_matches('"').strip_prefix(&self.tag).and_then(|rest| rest.strip_prefix('.'));
        match length.and_then(|length| u64::from_str_radix(length, 16).ok()) {
            Some(data) if data == self.data || (data < self.data && !self.end.is_empty()) => {
                self.data = data;
                true
            }
            _ => false,
        }
    }

    /// Reads from `offset` on, at least one byte where there is one.
    pub(super) fn read_at(&self, buffer: &mut [u8], offset: u64) -> std::io::Result<usize> {
        if offset >= self.data {
            let mut rest = usize::try_from(offset - self.data).ok().and_then(|at| self.end.get(at..)).unwrap_or(&[]);
            return rest.read(buffer);
        }
        let mut before = 0;
        for Segment { file, from, length } in &self.segments {
            let inside = offset - before;
            if inside < *length {
                let most = usize::try_from((length - inside).min(self.data - offset)).unwrap_or(usize::MAX);
                let most = most.min(buffer.len());
                return file.read_at(buffer.get_mut(..most).unwrap_or_default(), from + inside);
            }
            before += length;
        }
        Ok(0)
    }

    /// Fills `buffer` from `offset` on.
    pub(super) fn read_exact_at(&self, mut buffer: &mut [u8], mut offset: u64) -> std::io::Result<()> {
        while !buffer.is_empty() {
            match self.read_at(buffer, offset)? {
                0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
                got => {
                    offset += got as u64;
                    buffer = buffer.get_mut(got..).unwrap_or_default();
                }
            }
        }
        Ok(())
    }

    /// The piece that begins at `offset`: at most `most` bytes, none only at the end.
    ///
    /// # Errors
    /// Those of the disk.
    pub fn piece(&self, offset: u64, most: usize) -> std::io::Result<Vec<u8>> {
        let left = usize::try_from(self.length().saturating_sub(offset)).unwrap_or(usize::MAX);
        let mut piece = vec![0; left.min(most)];
        self.read_exact_at(&mut piece, offset)?;
        Ok(piece)
    }

    /// Everything.
    ///
    /// # Errors
    /// Those of the disk.
    pub fn bytes(&self) -> std::io::Result<Vec<u8>> {
        self.piece(0, usize::MAX)
    }

    /// What is where, when no file says so itself.
    pub(super) fn take_summary(&mut self) -> Option<Summary> {
        self.summary.take()
    }
}

/// Where the records of a file are.
struct Layout {
    /// Behind the header.
    body: u64,
    /// Behind the last record that belongs to no summary.
    until: u64,
    summary: Summary,
}

/// Finds the records of a part, which may be being written. `None` when there are none yet.
fn layout(file: &File) -> McapResult<Option<Layout>> {
    let length = file.metadata()?.len();
    let mut head = [0; HEAD as usize];
    let mut at = MAGIC.len() as u64;
    let mut body = None;
    let mut summary = Summary::default();
    while at + HEAD <= length {
        file.read_exact_at(&mut head, at)?;
        let [opcode, size @ ..] = head;
        let size = u64::from_le_bytes(size);
        let next = at.saturating_add(HEAD).saturating_add(size);
        // What is not there as a whole is being written, or was when the ground was killed.
        if next > length || matches!(opcode, op::DATA_END | op::FOOTER) {
            break;
        }
        if matches!(opcode, op::CHUNK | op::METADATA | op::SCHEMA | op::CHANNEL) && size <= MAX_RECORD as u64 {
            let mut record = vec![0; usize::try_from(size).unwrap_or(0)];
            file.read_exact_at(&mut record, at + HEAD)?;
            learn(&mut summary, opcode, &record, (at, next - at));
        }
        at = next;
        body = body.or(Some(at));
    }
    Ok(body.map(|body| Layout { body, until: at, summary }))
}

/// Adds a record that stands at `place` (offset and length). What is damaged is left out.
fn learn(summary: &mut Summary, opcode: u8, record: &[u8], (offset, length): (u64, u64)) {
    match mcap::parse_record(opcode, record) {
        Ok(Record::Chunk { header, .. }) => {
            let mut inside = Summary::default();
            let whole = chunk_records(record, |found| {
                declare(&mut inside, found);
                Ok(true)
            });
            if whole.is_err() {
                return;
            }
            summary.channels.extend(inside.channels);
            summary.schemas.extend(inside.schemas);
            summary.chunk_indexes.push(ChunkIndex {
                message_start_time: header.message_start_time,
                message_end_time: header.message_end_time,
                chunk_start_offset: offset,
                chunk_length: length,
                // Unknown: the reader looks into every chunk.
                message_index_offsets: Default::default(),
                message_index_length: 0,
                compression: header.compression,
                compressed_size: header.compressed_size,
                uncompressed_size: header.uncompressed_size,
            });
        }
        Ok(Record::Metadata(found)) => {
            summary.metadata_indexes.push(MetadataIndex { offset, length, name: found.name });
        }
        Ok(other) => declare(summary, other),
        Err(_) => {}
    }
}

fn declare(summary: &mut Summary, record: Record<'_>) {
    match record {
        Record::Schema { header, data } => {
            let data = std::borrow::Cow::Owned(data.into_owned());
            let schema = Schema { id: header.id, name: header.name, encoding: header.encoding, data };
            summary.schemas.insert(header.id, Arc::new(schema));
        }
        Record::Channel(found) => {
            let channel = Channel {
                id: found.id,
                topic: found.topic,
                schema: summary.schemas.get(&found.schema_id).cloned(),
                message_encoding: found.message_encoding,
                metadata: found.metadata,
            };
            summary.channels.insert(found.id, Arc::new(channel));
        }
        _ => {}
    }
}

/// Do the same ids stand for the same channels?
fn compatible(one: &Summary, other: &Summary) -> bool {
    other.channels.iter().all(|(id, channel)| one.channels.get(id).is_none_or(|known| known == channel))
}
