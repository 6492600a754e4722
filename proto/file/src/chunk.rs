//! The records of one chunk of a flight file, with bounded lengths: a damaged length is an error and no allocation.

use std::io::Read;

use mcap::McapResult;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

/// Largest record or chunk that is read, bytes.
pub const MAX_RECORD: usize = 256 << 20;

/// Passes the records of a chunk, `data` being the chunk record as it stands in the file, to `each` until that says
/// `false`. The checksum is verified at the end of the chunk, after the records were passed.
///
/// # Errors
/// The chunk is damaged, or what `each` says.
pub fn chunk_records(data: &[u8], mut each: impl FnMut(Record<'_>) -> McapResult<bool>) -> McapResult<()> {
    // Start and end time, then the size unpacked: what is packed well could be unpacked without end.
    let unpacked = data.get(16..).and_then(<[u8]>::first_chunk::<8>).map_or(0, |bytes| u64::from_le_bytes(*bytes));
    if unpacked > MAX_RECORD as u64 {
        return Err(mcap::McapError::RecordTooLarge { opcode: op::CHUNK, len: unpacked });
    }
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(MAX_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    let [a, b, c, d, e, f, g, h] = (data.len() as u64).to_le_bytes();
    let head = [op::CHUNK, a, b, c, d, e, f, g, h];
    let mut source = head.as_slice().chain(data);
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(need) => {
                let got = source.read(reader.insert(need.min(MAX_RECORD)))?;
                reader.notify_read(got);
            }
            LinearReadEvent::Record { opcode, data } => {
                if !each(mcap::parse_record(opcode, data)?)? {
                    return Ok(());
                }
            }
        }
    }
    Ok(())
}
