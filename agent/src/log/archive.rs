//! Reads frames back out of the log, for backfill.

use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use plumbline_proto::Kind;
use plumbline_proto::codec::{Frame, MAX_PAYLOAD};
use plumbline_proto::ids::FlightId;
use plumbline_proto::v1::BackfillRequest;

use super::LogState;
use super::writer::METADATA;
use crate::link::backfill::Archive;

/// Longest wait for the writer to flush what is asked for.
const FLUSH_WAIT: Duration = Duration::from_secs(1);

/// The flights of one log folder.
#[derive(Debug)]
pub struct LogArchive {
    folder: PathBuf,
    state: Arc<LogState>,
}

impl LogArchive {
    pub(super) fn new(folder: PathBuf, state: Arc<LogState>) -> Self {
        Self { folder, state }
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
            Ok(file) => read(file, &path, request, sink),
            // Rotated away, or never written: everything is unavailable.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(format!("{}: {error}", path.display())),
        }
    }
}

/// Passes the messages of a file, finished or not, in the order they were written.
fn read(
    mut file: File,
    path: &Path,
    request: &BackfillRequest,
    sink: &mut dyn FnMut(&Frame<'_>) -> ControlFlow<()>,
) -> Result<(), String> {
    let options = LinearReaderOptions::default().with_skip_end_magic(true).with_record_length_limit(16 * MAX_PAYLOAD);
    let mut reader = LinearReader::new_with_options(options);
    let mut channels: Vec<Option<(u16, u16)>> = Vec::new();
    let mut first_sequence = request.first_sequence;
    let mut boot_wall_time_us = 0;
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(bytes)) => {
                let read = file.read(reader.insert(bytes)).map_err(|error| format!("{}: {error}", path.display()))?;
                reader.notify_read(read);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                // A record we do not know is skipped, as everywhere.
                let Ok(record) = mcap::parse_record(opcode, data) else { continue };
                match record {
                    Record::Metadata(metadata) if metadata.name == METADATA => {
                        let number = |key: &str| metadata.metadata.get(key).and_then(|text| text.parse::<u64>().ok());
                        first_sequence = number("first_sequence").unwrap_or(first_sequence);
                        boot_wall_time_us = number("boot_wall_time_us").unwrap_or(0);
                    }
                    Record::Channel(channel) => {
                        let index = usize::from(channel.id);
                        if channels.len() <= index {
                            channels.resize(index + 1, None);
                        }
                        if let Some(slot) = channels.get_mut(index) {
                            *slot = Kind::from_topic(&channel.topic).map(|(kind, n)| (kind.to_wire(), n));
                        }
                    }
                    Record::Message { header, data } => {
                        let Some(Some((kind, instance))) = channels.get(usize::from(header.channel_id)) else {
                            continue;
                        };
                        // The file keeps the low 32 bits; a flight is shorter than their range.
                        let since_first = header.sequence.wrapping_sub(first_sequence as u32);
                        let sequence = first_sequence + u64::from(since_first);
                        if sequence > request.last_sequence {
                            return Ok(());
                        }
                        if sequence < request.first_sequence {
                            continue;
                        }
                        let time_us = (header.log_time / 1000).saturating_sub(boot_wall_time_us);
                        let frame = Frame { kind: *kind, instance: *instance, sequence, time_us, payload: &data };
                        if sink(&frame).is_break() {
                            return Ok(());
                        }
                    }
                    _ => {}
                }
            }
            // The file ends in the middle of a chunk: it is still written, or its writer was killed.
            Err(mcap::McapError::UnexpectedEof) => return Ok(()),
            Err(error) => return Err(format!("{}: {error}", path.display())),
        }
    }
    Ok(())
}
