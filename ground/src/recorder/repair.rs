//! Reads a flight file for what it holds, whatever state it is in.
//!
//! A file that ends in the middle (a crash, a power cut) gives every message up to its last whole
//! chunk. A chunk whose checksum is wrong is left out and the rest is read. Nothing here panics or
//! reads without bound, whatever the bytes.

use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::Path;
use std::sync::Arc;

use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, McapError, McapResult, Schema};
use plumbline_file::{MAX_RECORD, METADATA, chunk_records, ends_with_magic};

use super::identity::{END, Ending, Identity};

/// What is wrong with a file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) enum Damage {
    /// Nothing: it was finished and is whole.
    #[default]
    None,
    /// It ends in the middle, as a crash leaves it.
    Unfinished,
    /// Bytes are not what was written.
    Corrupt(String),
}

/// What a file says of itself, beside its messages.
#[derive(Debug, Default)]
pub(super) struct Scan {
    pub(super) identity: Option<Identity>,
    pub(super) ending: Option<Ending>,
    pub(super) damage: Damage,
    pub(super) messages: u64,
}

/// Passes every readable message of `path` to `each`, in file order.
///
/// # Errors
/// Those of opening and reading the file, and those of `each`; damage is not an error.
pub(super) fn scan(
    path: &Path,
    mut each: impl FnMut(&Arc<Channel<'static>>, &MessageHeader, &[u8]) -> McapResult<()>,
) -> McapResult<Scan> {
    let file = File::open(path)?;
    let mut found = Scan::default();
    let mut channels = Channels::default();
    let options = LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(MAX_RECORD);
    let mut source = BufReader::with_capacity(1 << 18, &file);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        let record = match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let got = source.read(reader.insert(need.min(MAX_RECORD)))?;
                reader.notify_read(got);
                continue;
            }
            Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => {
                // Checksums are known only at the end of a chunk: nothing of it is used before.
                let mut records = Vec::new();
                match chunk_records(data, |record| {
                    records.push(record.into_owned());
                    Ok(true)
                }) {
                    Ok(()) => {
                        for record in records {
                            take(record, &mut channels, &mut found, &mut each)?;
                        }
                    }
                    Err(error) => found.damage = Damage::Corrupt(format!("{}: {error}", chunk_name(data))),
                }
                continue;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => mcap::parse_record(opcode, data),
            Err(error) => Err(error),
        };
        match record {
            Ok(record) => take(record, &mut channels, &mut found, &mut each)?,
            Err(McapError::UnexpectedEof) if !ends_with_magic(&file) => {
                if found.damage == Damage::None {
                    found.damage = Damage::Unfinished;
                }
                return Ok(found);
            }
            Err(error) => {
                found.damage = Damage::Corrupt(error.to_string());
                return Ok(found);
            }
        }
    }
    Ok(found)
}

/// For messages: the chunk, by the time it begins with.
fn chunk_name(data: &[u8]) -> String {
    let start = data.first_chunk::<8>().map_or(0, |bytes| u64::from_le_bytes(*bytes));
    format!("the chunk of {start} ns")
}

#[derive(Default)]
struct Channels {
    schemas: HashMap<u16, Arc<Schema<'static>>>,
    channels: HashMap<u16, Arc<Channel<'static>>>,
}

fn take(
    record: Record<'_>,
    known: &mut Channels,
    found: &mut Scan,
    each: &mut impl FnMut(&Arc<Channel<'static>>, &MessageHeader, &[u8]) -> McapResult<()>,
) -> McapResult<()> {
    match record {
        Record::Schema { header, data } => {
            let schema = Schema {
                id: header.id,
                name: header.name,
                encoding: header.encoding,
                data: Cow::Owned(data.into_owned()),
            };
            known.schemas.entry(schema.id).or_insert_with(|| Arc::new(schema));
        }
        Record::Channel(c) => {
            let channel = Channel {
                id: c.id,
                topic: c.topic,
                schema: known.schemas.get(&c.schema_id).cloned(),
                message_encoding: c.message_encoding,
                metadata: c.metadata,
            };
            known.channels.entry(channel.id).or_insert_with(|| Arc::new(channel));
        }
        Record::Message { header, data } => match known.channels.get(&header.channel_id) {
            Some(channel) => {
                found.messages += 1;
                each(channel, &header, &data)?;
            }
            None => found.damage = Damage::Corrupt(format!("a message of unknown channel {}", header.channel_id)),
        },
        Record::Metadata(m) if m.name == METADATA => found.identity = Some(Identity::from_metadata(&m.metadata)),
        Record::Metadata(m) if m.name == END => found.ending = Some(Ending::from_metadata(&m.metadata)),
        _ => {}
    }
    Ok(())
}
