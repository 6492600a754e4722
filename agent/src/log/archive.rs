//! Reads frames back out of the log, for backfill.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use plumbline_file::{MAX_RECORD, METADATA, chunk_records};
use plumbline_proto::Kind;
use plumbline_proto::codec::Frame;
use plumbline_proto::ids::FlightId;
use plumbline_proto::v1::BackfillRequest;

use super::{LogState, room};
use crate::link::backfill::Archive;

/// Longest wait for the writer to flush what is asked for.
const FLUSH_WAIT: Duration = Duration::from_secs(1);

/// Flights whose chunks are remembered; the one asked for longest ago is forgotten.
const REMEMBERED: usize = 4;
/// Of the file: magic, and opcode with length before each record.
const MAGIC_LEN: u64 = 8;
const RECORD_HEADER_LEN: u64 = 9;

/// The flights of one log folder.
#[derive(Debug)]
pub struct LogArchive {
    folder: PathBuf,
    state: Arc<LogState>,
    /// Flight and what is known of its file, latest last.
    known: Mutex<Vec<(String, Known)>>,
}

impl LogArchive {
    pub(super) fn new(folder: PathBuf, state: Arc<LogState>) -> Self {
        Self { folder, state, known: Mutex::default() }
    }

    /// The flights in `folder`, which nobody writes to.
    pub fn at(folder: &Path) -> Self {
        Self::new(folder.to_owned(), Arc::default())
    }
}

impl LogArchive {
    fn take_known(&self, flight_id: &str) -> Known {
        let mut all = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let index = all.iter().position(|(id, _)| id == flight_id);
        index.map_or_else(Known::default, |index| all.remove(index).1)
    }

    fn keep_known(&self, flight_id: &str, known: Known, sound: bool) {
        let mut all = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        // A file that was repaired meanwhile has other chunks, and one that failed may be repaired soon.
        if !sound {
            return;
        }
        all.retain(|(id, _)| id != flight_id);
        all.push((flight_id.to_owned(), known));
        if all.len() > REMEMBERED {
            all.remove(0);
        }
    }
}

impl Archive for LogArchive {
    fn read(
        &self,
        request: &BackfillRequest,
        sink: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>,
    ) -> Result<(), String> {
        let id = FlightId::new(request.flight_id.as_str()).map_err(|error| error.to_string())?;
        let path = self.folder.join(format!("{id}.mcap"));
        // Young messages may still be in the writer's chunk, a young flight still in its ring.
        let asked = Instant::now();
        while asked.elapsed() < FLUSH_WAIT {
            let written = *self.state.current() == request.flight_id;
            if !written && path.exists()
                || written && self.state.flushed.load(Ordering::Acquire) >= request.last_sequence
            {
                break;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        match File::open(&path) {
            Ok(file) => {
                // Taken out while it is used: a request at the same time begins anew, and the better of both stays.
                let mut known = self.take_known(&request.flight_id);
                let outcome = read(file, &path, &mut known, request, sink);
                self.keep_known(&request.flight_id, known, outcome.is_ok());
                outcome
            }
            // Rotated away, or never written: everything is unavailable.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(format!("{}: {error}", path.display())),
        }
    }

    fn kept(&self, flight_id: &str) {
        let Ok(id) = FlightId::new(flight_id) else { return };
        let path = self.folder.join(format!("{id}.mcap"));
        if path.exists()
            && let Err(error) = File::create(room::kept_mark(&path))
        {
            tracing::warn!(flight = flight_id, %error, "it is not noted that the ground holds this flight");
        }
    }
}

/// What is known of a file after reading some of it, so that the next request begins near what it asks for.
#[derive(Debug, Default)]
pub(super) struct Known {
    /// First sequence number and place of each chunk read so far, both rising.
    chunks: Vec<(u64, u64)>,
    channels: Vec<Option<(u16, u16)>>,
    first_sequence: u64,
    boot_wall_time_us: u64,
}

impl Known {
    /// Where to begin reading for `sequence`.
    fn place(&self, sequence: u64) -> u64 {
        let after = self.chunks.partition_point(|(first, _)| *first <= sequence);
        after.checked_sub(1).and_then(|index| self.chunks.get(index)).map_or(0, |(_, place)| *place)
    }

    fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Metadata(metadata) if metadata.name == METADATA => {
                let number = |key: &str| metadata.metadata.get(key).and_then(|text| text.parse::<u64>().ok());
                self.first_sequence = number("first_sequence").unwrap_or_default();
                self.boot_wall_time_us = number("boot_wall_time_us").unwrap_or_default();
            }
            Record::Channel(channel) => {
                let index = usize::from(channel.id);
                if self.channels.len() <= index {
                    self.channels.resize(index + 1, None);
                }
                if let Some(slot) = self.channels.get_mut(index) {
                    *slot = Kind::from_topic(&channel.topic).map(|(kind, n)| (kind.to_wire(), n));
                }
            }
            _ => {}
        }
    }

    /// The frame of a message; `None` of a kind that is not known.
    fn frame<'a>(&self, header: &MessageHeader, data: &'a [u8]) -> Option<Frame<'a>> {
        let (kind, instance) = (*self.channels.get(usize::from(header.channel_id))?)?;
        // The file keeps the low 32 bits; a flight is shorter than their range.
        let since_first = header.sequence.wrapping_sub(self.first_sequence as u32);
        let time_us = (header.log_time / 1000).saturating_sub(self.boot_wall_time_us);
        let sequence = self.first_sequence + u64::from(since_first);
        Some(Frame { kind, instance, sequence, time_us, payload: data })
    }
}

/// Passes the messages of a file, finished or not, in the order they were written. Chunks before what is asked for are
/// skipped as far as they are `known`.
pub(super) fn read(
    mut file: File,
    path: &Path,
    known: &mut Known,
    request: &BackfillRequest,
    sink: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>,
) -> Result<(), String> {
    let failed = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let mut place = known.place(request.first_sequence);
    file.seek(SeekFrom::Start(place)).map_err(|error| failed(&error))?;
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(place > 0)
        .with_skip_end_magic(true)
        .with_emit_chunks(true)
        .with_record_length_limit(MAX_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    if place == 0 {
        place = MAGIC_LEN;
    }
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(bytes)) => {
                let read = file.read(reader.insert(bytes)).map_err(|error| failed(&error))?;
                reader.notify_read(read);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                let here = place;
                place += RECORD_HEADER_LEN + data.len() as u64;
                let flow = if opcode == op::CHUNK {
                    chunk(data, here, known, request, sink).map_err(|error| failed(&error))?
                } else {
                    // A record we do not know is skipped, as everywhere.
                    if let Ok(record) = mcap::parse_record(opcode, data) {
                        known.learn(&record);
                    }
                    ControlFlow::Continue(())
                };
                if flow.is_break() {
                    return Ok(());
                }
            }
            // The file ends in the middle of a chunk: it is still written, or its writer was killed.
            Err(mcap::McapError::UnexpectedEof) => return Ok(()),
            Err(error) => return Err(failed(&error)),
        }
    }
    Ok(())
}

/// Passes the messages of one chunk, which begins at `here`; breaks when there is nothing more to pass.
fn chunk(
    data: &[u8],
    here: u64,
    known: &mut Known,
    request: &BackfillRequest,
    sink: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>,
) -> mcap::McapResult<ControlFlow<()>> {
    let mut first = true;
    let mut flow = ControlFlow::Continue(());
    chunk_records(data, |record| {
        let Record::Message { header, data } = &record else {
            known.learn(&record);
            return Ok(true);
        };
        let Some(frame) = known.frame(header, data) else { return Ok(true) };
        let new = |last: &(u64, u64)| last.0 < frame.sequence && last.1 < here;
        if std::mem::take(&mut first) && known.chunks.last().is_none_or(new) {
            known.chunks.push((frame.sequence, here));
        }
        let over = frame.sequence > request.last_sequence
            || frame.sequence >= request.first_sequence && sink(&frame).is_break();
        if over {
            flow = ControlFlow::Break(());
        }
        Ok(!over)
    })?;
    Ok(flow)
}
