//! Reads a flight in the order of time, with memory for a few chunks.

use std::collections::BTreeMap;
use std::io::SeekFrom;
use std::sync::Arc;

use mcap::records::Record;
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions, ReadOrder};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};
use mcap::{Channel, McapError, McapResult, Summary};
use plumbline_file::{MAX_RECORD, METADATA};

use super::identity::{Identity, widen};
use super::intervals::IntervalSet;
use super::snapshot::Snapshot;

/// One message of a file.
pub(super) struct Recorded<'a> {
    pub(super) channel: &'a Arc<Channel<'static>>,
    pub(super) sequence: u64,
    /// Flight time, µs since the agent's boot.
    pub(super) time_us: u64,
    pub(super) payload: &'a [u8],
}

/// An open flight.
pub(super) struct FlightReader {
    flight: Snapshot,
    summary: Summary,
    identity: Identity,
    /// Of several parts, which may hold a message twice.
    joined: bool,
}

impl FlightReader {
    /// Reads the summary.
    pub(super) fn open(mut flight: Snapshot) -> McapResult<Self> {
        let known = flight.take_summary();
        let joined = known.is_some();
        let summary = known.map_or_else(|| read_summary(&flight), Ok)?;
        let identity = read_identity(&flight, &summary).unwrap_or_default();
        Ok(Self { flight, summary, identity, joined })
    }

    /// The file's channels by topic.
    pub(super) fn channels(&self) -> BTreeMap<String, Arc<Channel<'static>>> {
        self.summary.channels.values().map(|c| (c.topic.clone(), c.clone())).collect()
    }

    /// Flight time of the first message, µs.
    pub(super) fn start_us(&self) -> u64 {
        let chunks = self.summary.chunk_indexes.iter().filter(|chunk| chunk.message_end_time > 0);
        let start = chunks.map(|chunk| chunk.message_start_time).min().unwrap_or(0) / 1000;
        start.saturating_sub(self.identity.boot_wall_time_us)
    }

    /// Flight time of the last message, µs.
    pub(super) fn end_us(&self) -> u64 {
        let end = self.summary.chunk_indexes.iter().map(|chunk| chunk.message_end_time).max().unwrap_or(0) / 1000;
        end.saturating_sub(self.identity.boot_wall_time_us)
    }

    /// When the agent booted, µs since the Unix epoch.
    pub(super) fn boot_us(&self) -> u64 {
        self.identity.boot_wall_time_us
    }

    /// Passes the messages of `topics` (all when `None`) to `each` in the order of time until it says
    /// `false`.
    pub(super) fn for_each(
        &self,
        topics: Option<&[String]>,
        each: impl FnMut(&Recorded<'_>) -> McapResult<bool>,
    ) -> McapResult<()> {
        self.for_each_in(topics, (0, u64::MAX), each)
    }

    /// The same of a range of flight time, µs, both ends included; chunks outside it are not read.
    pub(super) fn for_each_in(
        &self,
        topics: Option<&[String]>,
        (from_us, to_us): (u64, u64),
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
        let log_time = |time_us: u64| time_us.checked_add(self.identity.boot_wall_time_us)?.checked_mul(1000);
        if let Some(from) = log_time(from_us).filter(|_| from_us > 0) {
            options = options.starting_at(from);
        }
        if let Some(after) = to_us.checked_add(1).and_then(log_time) {
            options = options.ending_before(after);
        }
        let mut reader = IndexedReader::new_with_options(&self.summary, options)?;
        let near = self.identity.first_sequence.unwrap_or(0);
        let mut buffer = Vec::new();
        let mut have = IntervalSet::default();
        while let Some(event) = reader.next_event() {
            match event? {
                IndexedReadEvent::ReadChunkRequest { offset, length } => {
                    buffer.resize(length, 0);
                    self.flight.read_exact_at(&mut buffer, offset)?;
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
                    // Other writers' files number nothing: 0 is always new.
                    if self.joined && header.sequence != 0 && have.insert(recorded.sequence, recorded.sequence) == 0 {
                        continue;
                    }
                    if !each(&recorded)? {
                        return Ok(());
                    }
                }
            }
        }
        Ok(())
    }
}

fn read_summary(flight: &Snapshot) -> McapResult<Summary> {
    let mut reader = SummaryReader::new();
    let mut at = 0_u64;
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(need) => {
                let got = flight.read_at(reader.insert(need.min(MAX_RECORD)), at)?;
                reader.notify_read(got);
                at += got as u64;
            }
            SummaryReadEvent::SeekRequest(to) => {
                at = match to {
                    SeekFrom::Start(to) => to,
                    SeekFrom::End(by) => flight.length().saturating_add_signed(by),
                    SeekFrom::Current(by) => at.saturating_add_signed(by),
                };
                reader.notify_seeked(at);
            }
        }
    }
    reader.finish().ok_or(McapError::UnexpectedEof)
}

fn read_identity(flight: &Snapshot, summary: &Summary) -> Option<Identity> {
    let index = summary.metadata_indexes.iter().find(|index| index.name == METADATA)?;
    let length = usize::try_from(index.length).ok().filter(|l| *l <= 1 << 20)?;
    let mut record = vec![0; length];
    flight.read_exact_at(&mut record, index.offset).ok()?;
    // opcode u8 | length u64 | body
    match mcap::parse_record(*record.first()?, record.get(9..)?).ok()? {
        Record::Metadata(metadata) => Some(Identity::from_metadata(&metadata.metadata)),
        _ => None,
    }
}
