//! The MCAP records of the onboard log, as bytes.
//!
//! The library's writer keeps the place of every channel in every chunk in memory until the end of the file: 30 MiB an
//! hour. Here a chunk is forgotten once it is written; the summary is made from the file itself when it is finished.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};

use mcap::MAGIC;
use mcap::records::op;
use plumbline_proto::descriptor::describing;

/// Of every record: its kind and its length.
const HEADER_BYTES: u64 = 9;
const COMPRESSION: &str = "zstd";

/// Adds a record whose content `body` writes.
pub(super) fn record(out: &mut Vec<u8>, opcode: u8, body: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let at = out.len();
    out.extend_from_slice(&[0; 8]);
    body(out);
    let length = (out.len() - at - 8) as u64;
    out[at..at + 8].copy_from_slice(&length.to_le_bytes());
}

fn text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
}

/// What `body` writes, with its length in bytes in front.
fn sized(out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let at = out.len();
    out.extend_from_slice(&[0; 4]);
    body(out);
    let length = (out.len() - at - 4) as u32;
    out[at..at + 4].copy_from_slice(&length.to_le_bytes());
}

/// What a file begins with.
pub(super) fn beginning(library: &str, name: &str, metadata: &BTreeMap<String, String>) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    record(&mut out, op::HEADER, |out| {
        text(out, "plumbline");
        text(out, library);
    });
    record(&mut out, op::METADATA, |out| {
        text(out, name);
        sized(out, |out| metadata.iter().for_each(|(key, value)| [key, value].into_iter().for_each(|t| text(out, t))));
    });
    out
}

/// One channel.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    pub(super) topic: String,
    /// Number of its schema, from one.
    pub(super) schema: u16,
    pub(super) messages: u64,
}

/// Adds the schema of this number.
pub(super) fn schema(out: &mut Vec<u8>, number: u16, name: &str) {
    record(out, op::SCHEMA, |out| {
        out.extend_from_slice(&number.to_le_bytes());
        text(out, name);
        text(out, "protobuf");
        sized(out, |out| out.extend_from_slice(describing(name)));
    });
}

/// Adds the channel of this number.
pub(super) fn channel(out: &mut Vec<u8>, number: u16, channel: &Channel) {
    record(out, op::CHANNEL, |out| {
        out.extend_from_slice(&number.to_le_bytes());
        out.extend_from_slice(&channel.schema.to_le_bytes());
        text(out, &channel.topic);
        text(out, "protobuf");
        sized(out, |_| {});
    });
}

/// The chunk being filled; its memory is used again for the next one.
pub(super) struct Chunk {
    records: Vec<u8>,
    /// Time and place of the messages of each channel.
    places: Vec<Vec<(u64, u64)>>,
    /// First and last time, ns.
    span_ns: Option<(u64, u64)>,
    compressor: zstd::bulk::Compressor<'static>,
    packed: Vec<u8>,
}

impl Chunk {
    pub(super) fn new() -> io::Result<Self> {
        let compressor = zstd::bulk::Compressor::new(1)?;
        Ok(Self { records: Vec::new(), places: Vec::new(), span_ns: None, compressor, packed: Vec::new() })
    }

    /// Room for schemas and channels, which stand before their first message.
    pub(super) fn records(&mut self) -> &mut Vec<u8> {
        &mut self.records
    }

    pub(super) fn message(&mut self, channel: u16, sequence: u32, time_ns: u64, payload: &[u8]) {
        let index = usize::from(channel);
        if self.places.len() <= index {
            self.places.resize(index + 1, Vec::new());
        }
        self.places[index].push((time_ns, self.records.len() as u64));
        let (first, last) = self.span_ns.unwrap_or((time_ns, time_ns));
        self.span_ns = Some((first.min(time_ns), last.max(time_ns)));
        record(&mut self.records, op::MESSAGE, |out| {
            out.extend_from_slice(&channel.to_le_bytes());
            out.extend_from_slice(&sequence.to_le_bytes());
            // Logged and published: the agent does both when it senses.
            out.extend_from_slice(&time_ns.to_le_bytes());
            out.extend_from_slice(&time_ns.to_le_bytes());
            out.extend_from_slice(payload);
        });
    }

    /// Adds the chunk with the index of its messages to `out` and begins the next one.
    pub(super) fn end(&mut self, out: &mut Vec<u8>) -> io::Result<()> {
        let (first, last) = self.span_ns.take().unwrap_or_default();
        self.packed.clear();
        self.packed.reserve(zstd::zstd_safe::compress_bound(self.records.len()));
        self.compressor.compress_to_buffer(&self.records, &mut self.packed)?;
        record(out, op::CHUNK, |out| {
            out.extend_from_slice(&first.to_le_bytes());
            out.extend_from_slice(&last.to_le_bytes());
            out.extend_from_slice(&(self.records.len() as u64).to_le_bytes());
            out.extend_from_slice(&crc32fast::hash(&self.records).to_le_bytes());
            text(out, COMPRESSION);
            out.extend_from_slice(&(self.packed.len() as u64).to_le_bytes());
            out.extend_from_slice(&self.packed);
        });
        for (number, places) in self.places.iter_mut().enumerate().filter(|(_, places)| !places.is_empty()) {
            record(out, op::MESSAGE_INDEX, |out| {
                out.extend_from_slice(&(number as u16).to_le_bytes());
                sized(out, |out| {
                    for (time_ns, place) in places.drain(..) {
                        out.extend_from_slice(&time_ns.to_le_bytes());
                        out.extend_from_slice(&place.to_le_bytes());
                    }
                });
            });
        }
        self.records.clear();
        Ok(())
    }

    pub(super) fn len(&self) -> usize {
        self.records.len()
    }
}

/// What the summary says beside the places of the chunks.
pub(super) struct Contents<'a> {
    /// Name of each schema, the first being number one.
    pub(super) schemas: &'a [String],
    pub(super) channels: &'a [Channel],
    /// Of the metadata record.
    pub(super) metadata: &'a str,
    pub(super) chunks: u32,
    pub(super) span_ns: (u64, u64),
}

/// Counts and sums up what goes by.
struct Tally<W> {
    inner: W,
    position: u64,
    crc: crc32fast::Hasher,
}

impl<W: Write> Write for Tally<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.position += written as u64;
        self.crc.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// Ends `file`, whose data end at `position` where it stands: the summary, from what `written`, the same file from its
/// beginning, holds.
pub(super) fn finish(file: &File, written: File, position: u64, contents: &Contents<'_>) -> io::Result<()> {
    let mut scratch = Vec::new();
    record(&mut scratch, op::DATA_END, |out| out.extend_from_slice(&[0; 4]));
    let mut out = BufWriter::with_capacity(1 << 16, file);
    out.write_all(&scratch)?;
    let summary_start = position + scratch.len() as u64;
    let mut out = Tally { inner: out, position: summary_start, crc: crc32fast::Hasher::new() };
    let mut groups = Vec::new();
    let mut group = |opcode: u8, out: &mut Tally<_>, bytes: &[u8]| -> io::Result<()> {
        groups.push((opcode, out.position, bytes.len() as u64));
        out.write_all(bytes)
    };

    scratch.clear();
    for (number, name) in (1..).zip(contents.schemas) {
        schema(&mut scratch, number, name);
    }
    group(op::SCHEMA, &mut out, &scratch)?;
    scratch.clear();
    (0..).zip(contents.channels).for_each(|(number, one)| channel(&mut scratch, number, one));
    group(op::CHANNEL, &mut out, &scratch)?;
    scratch.clear();
    record(&mut scratch, op::STATISTICS, |out| {
        let messages: u64 = contents.channels.iter().map(|channel| channel.messages).sum();
        out.extend_from_slice(&messages.to_le_bytes());
        out.extend_from_slice(&(contents.schemas.len() as u16).to_le_bytes());
        for count in [contents.channels.len() as u32, 0, 1, contents.chunks] {
            out.extend_from_slice(&count.to_le_bytes());
        }
        out.extend_from_slice(&contents.span_ns.0.to_le_bytes());
        out.extend_from_slice(&contents.span_ns.1.to_le_bytes());
        sized(out, |out| {
            for (number, channel) in (0_u16..).zip(contents.channels) {
                out.extend_from_slice(&number.to_le_bytes());
                out.extend_from_slice(&channel.messages.to_le_bytes());
            }
        });
    });
    group(op::STATISTICS, &mut out, &scratch)?;
    let chunks_start = out.position;
    let metadata = chunk_indexes(written, position, &mut out)?;
    let chunks_length = out.position - chunks_start;
    scratch.clear();
    record(&mut scratch, op::METADATA_INDEX, |out| {
        out.extend_from_slice(&metadata.0.to_le_bytes());
        out.extend_from_slice(&metadata.1.to_le_bytes());
        text(out, contents.metadata);
    });
    group(op::METADATA_INDEX, &mut out, &scratch)?;
    groups.push((op::CHUNK_INDEX, chunks_start, chunks_length));

    let offsets_start = out.position;
    scratch.clear();
    for (opcode, start, length) in groups.into_iter().filter(|(.., length)| *length > 0) {
        record(&mut scratch, op::SUMMARY_OFFSET, |out| {
            out.push(opcode);
            out.extend_from_slice(&start.to_le_bytes());
            out.extend_from_slice(&length.to_le_bytes());
        });
    }
    // Of the footer its checksum covers all but itself.
    scratch.push(op::FOOTER);
    scratch.extend_from_slice(&20_u64.to_le_bytes());
    scratch.extend_from_slice(&summary_start.to_le_bytes());
    scratch.extend_from_slice(&offsets_start.to_le_bytes());
    out.write_all(&scratch)?;
    let Tally { mut inner, crc, .. } = out;
    inner.write_all(&crc.finalize().to_le_bytes())?;
    inner.write_all(MAGIC)?;
    inner.flush()
}

/// Writes the index of every chunk of a file whose data end at `end`; answers where its metadata are, and their length.
fn chunk_indexes(file: File, end: u64, out: &mut impl Write) -> io::Result<(u64, u64)> {
    let mut source = BufReader::with_capacity(1 << 12, file);
    let mut place = MAGIC.len() as u64;
    source.seek_relative(place as i64)?;
    let mut metadata = (0, 0);
    let mut chunk: Option<Found> = None;
    let mut scratch = Vec::new();
    while place < end {
        let opcode = bytes::<1>(&mut source)?[0];
        let length = u64::from_le_bytes(bytes(&mut source)?);
        let mut read = 0;
        match opcode {
            op::CHUNK => {
                if let Some(chunk) = chunk.take() {
                    chunk.write(&mut scratch, place, out)?;
                }
                let header = bytes::<28>(&mut source)?;
                source.seek_relative(4 + COMPRESSION.len() as i64)?;
                let packed = bytes(&mut source)?;
                read = 28 + 4 + COMPRESSION.len() as u64 + 8;
                chunk = Some(Found { place, length: HEADER_BYTES + length, header, packed, indexes: Vec::new() });
            }
            op::MESSAGE_INDEX => {
                let number = u16::from_le_bytes(bytes(&mut source)?);
                read = 2;
                if let Some(chunk) = &mut chunk {
                    chunk.indexes.push((number, place));
                }
            }
            op::METADATA => metadata = (place, HEADER_BYTES + length),
            _ => {}
        }
        let rest = length.checked_sub(read).and_then(|rest| i64::try_from(rest).ok());
        source.seek_relative(rest.ok_or(io::ErrorKind::InvalidData)?)?;
        place += HEADER_BYTES + length;
    }
    if let Some(chunk) = chunk {
        chunk.write(&mut scratch, place, out)?;
    }
    Ok(metadata)
}

fn bytes<const N: usize>(source: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    source.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// A chunk of a file.
struct Found {
    place: u64,
    length: u64,
    /// Start, end and unpacked size stand in front; a checksum follows.
    header: [u8; 28],
    packed: [u8; 8],
    indexes: Vec<(u16, u64)>,
}

impl Found {
    /// Writes its index; its message indexes end at `end`.
    fn write(&self, scratch: &mut Vec<u8>, end: u64, out: &mut impl Write) -> io::Result<()> {
        scratch.clear();
        record(scratch, op::CHUNK_INDEX, |out| {
            out.extend_from_slice(&self.header[..16]);
            out.extend_from_slice(&self.place.to_le_bytes());
            out.extend_from_slice(&self.length.to_le_bytes());
            sized(out, |out| {
                for (number, place) in &self.indexes {
                    out.extend_from_slice(&number.to_le_bytes());
                    out.extend_from_slice(&place.to_le_bytes());
                }
            });
            out.extend_from_slice(&(end - self.place - self.length).to_le_bytes());
            text(out, COMPRESSION);
            out.extend_from_slice(&self.packed);
            out.extend_from_slice(&self.header[16..24]);
        });
        out.write_all(scratch)
    }
}
