//! Reads a finished flight file in the order of time, with memory for a few chunks.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::sync::Arc;

use mcap::records::Record;
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions, ReadOrder};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};
use mcap::{Channel, McapError, McapResult, Summary};

use super::identity::{BEGIN, Identity, widen};

/// Largest record or chunk read.
const MAX_RECORD: usize = 256 << 20;

/// One message of a file.
pub(super) struct Recorded<'a> {
    pub(super) channel: &'a Arc<Channel<'static>>,
    pub(super) sequence: u64,
    /// Flight time, µs since the agent's boot.
    pub(super) time_us: u64,
    pub(super) payload: &'a [u8],
}

/// An open flight file.
pub(super) struct FlightReader {
    file: File,
    summary: Summary,
    identity: Identity,
}

impl FlightReader {
    /// Reads the summary.
    pub(super) fn open(mut file: File) -> McapResult<Self> {
        let mut reader = SummaryReader::new();
        while let Some(event) = reader.next_event() {
            match event? {
                SummaryReadEvent::ReadRequest(need) => {
                    let got = file.read(reader.insert(need.min(MAX_RECORD)))?;
                    reader.notify_read(got);
                }
                SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
            }
        }
        let summary = reader.finish().ok_or(McapError::UnexpectedEof)?;
        let identity = read_identity(&mut file, &summary).unwrap_or_default();
        Ok(Self { file, summary, identity })
    }

    /// The file's channels by topic.
    pub(super) fn channels(&self) -> BTreeMap<String, Arc<Channel<'static>>> {
        self.summary.channels.values().map(|c| (c.topic.clone(), c.clone())).collect()
    }

    /// Flight time of the first message, µs.
    pub(super) fn start_us(&self) -> u64 {
        let start = self.summary.stats.as_ref().map_or(0, |s| s.message_start_time) / 1000;
        start.saturating_sub(self.identity.boot_wall_time_us)
    }

    /// Passes the messages of `topics` (all when `None`) to `each` in the order of time until it says
    /// `false`.
    pub(super) fn for_each(
        &mut self,
        topics: Option<&[String]>,
        mut each: impl FnMut(&Recorded<'_>) -> McapResult<bool>,
    ) -> McapResult<()> {
        if topics.is_some_and(<[String]>::is_empty) {
            // The reader would take an empty list for no filter.
            return Ok(());
        }
        let mut options =
            IndexedReaderOptions::new().with_order(ReadOrder::LogTime).with_record_length_limit(MAX_RECORD);
        if let Some(topics) = topics {
            options = options.include_topics(topics.iter().cloned());
        }
        let mut reader = IndexedReader::new_with_options(&self.summary, options)?;
        let near = self.identity.first_sequence.unwrap_or(0);
        let mut buffer = Vec::new();
        while let Some(event) = reader.next_event() {
            match event? {
                IndexedReadEvent::ReadChunkRequest { offset, length } => {
                    self.file.seek(SeekFrom::Start(offset))?;
                    buffer.resize(length, 0);
                    self.file.read_exact(&mut buffer)?;
                    reader.insert_chunk_record_data(offset, &buffer)?;
                }
                IndexedReadEvent::Message { header, data } => {
                    let Some(channel) = self.summary.channels.get(&header.channel_id) else { continue };
                    let recorded = Recorded {
                        channel,
                        sequence: widen(header.sequence, near),
                        time_us: (header.log_time / 1000).saturating_sub(self.identity.boot_wall_time_us),
                        payload: data,
                    };
                    if !each(&recorded)? {
                        return Ok(());
                    }
                }
            }
        }
        Ok(())
    }
}

fn read_identity(file: &mut File, summary: &Summary) -> Option<Identity> {
    let index = summary.metadata_indexes.iter().find(|index| index.name == BEGIN)?;
    let length = usize::try_from(index.length).ok().filter(|l| *l <= 1 << 20)?;
    let mut record = vec![0; length];
    file.seek(SeekFrom::Start(index.offset)).ok()?;
    file.read_exact(&mut record).ok()?;
    // opcode u8 | length u64 | body
    match mcap::parse_record(*record.first()?, record.get(9..)?).ok()? {
        Record::Metadata(metadata) => Some(Identity::from_metadata(&metadata.metadata)),
        _ => None,
    }
}
