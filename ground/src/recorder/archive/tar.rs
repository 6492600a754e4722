//! Flights as one tar (POSIX.1-1988 ustar), made as it is read: nothing is copied to the disk.

use sha2::{Digest as _, Sha256};

use super::super::{Labels, RecorderHandle, RecordingError, Sink};
use super::{SUMS, Sums, hex};

/// Everything in a tar comes in blocks of this size, bytes.
const BLOCK: usize = 512;
/// Bytes of a flight read at once.
const PIECE: usize = 64 << 10;
/// Most flights of one tar.
const MAX_FLIGHTS: usize = 500;

/// Flights that are there, to be written as one tar.
#[derive(Debug)]
pub struct Tar {
    recorder: RecorderHandle,
    ids: Vec<String>,
}

impl Tar {
    /// Of these flights, with commas between their ids.
    ///
    /// # Errors
    /// [`RecordingError`] when one is not there, none is named, or too many are.
    pub fn new(recorder: RecorderHandle, ids: &str) -> Result<Self, RecordingError> {
        let mut ids: Vec<String> = ids.split(',').filter(|id| !id.is_empty()).map(str::to_owned).collect();
        ids.sort();
        ids.dedup();
        if ids.is_empty() || ids.len() > MAX_FLIGHTS {
            let text = format!("ids names {} flights: 1 to {MAX_FLIGHTS} are needed", ids.len());
            return Err(RecordingError::Invalid(text));
        }
        for id in &ids {
            recorder.flight(id)?;
        }
        Ok(Self { recorder, ids })
    }

    /// Says which bytes it will have; nothing while one of its flights still grows.
    ///
    /// # Errors
    /// [`RecordingError`] when a flight cannot be read.
    pub fn tag(&self) -> Result<Option<String>, RecordingError> {
        let mut tag = String::new();
        for id in &self.ids {
            let flight = self.recorder.flight(id)?;
            let open = self.recorder.open(id)?;
            if !open.finished() {
                return Ok(None);
            }
            let labels = (&flight.name, &flight.notes, flight.started_unix_us);
            tag += &format!("{id} {} {labels:?}\n", open.tag());
        }
        Ok(Some(tag))
    }

    /// Writes it. Each flight is opened when it is its turn, so that many of them hold one descriptor.
    ///
    /// # Errors
    /// [`RecordingError`] when a flight was deleted meanwhile, or cannot be read.
    pub fn write(self, sink: &mut Sink<'_>) -> Result<(), RecordingError> {
        let mut sums = Sums::default();
        for id in &self.ids {
            let flight = self.recorder.flight(id)?;
            let (name, modified_s) = (format!("{id}.mcap"), flight.started_unix_us / 1_000_000);
            let open = self.recorder.open(id)?;
            let size = open.length();
            let mut hash = Sha256::new();
            let mut at = 0;
            if !sink(header(&name, size, modified_s).to_vec()) {
                return Ok(());
            }
            while at < size {
                let piece =
                    open.piece(at, PIECE).map_err(|source| RecordingError::Io { path: name.clone().into(), source })?;
                hash.update(&piece);
                at += piece.len() as u64;
                if !sink(piece) {
                    return Ok(());
                }
            }
            sums.0.insert(name, hex(hash));
            let mut more = vec![0; padding(size)];
            if !flight.name.is_empty() || !flight.notes.is_empty() {
                let labels = Labels { name: flight.name, notes: flight.notes };
                let text = serde_json::to_vec_pretty(&labels).unwrap_or_default();
                let name = format!("{id}.json");
                put(&mut more, &name, &text, modified_s);
                sums.0.insert(name, hex(Sha256::new_with_prefix(&text)));
            }
            if !sink(more) {
                return Ok(());
            }
        }
        let mut end = Vec::new();
        put(&mut end, SUMS, sums.text().as_bytes(), 0);
        end.resize(end.len() + 2 * BLOCK, 0);
        sink(end);
        Ok(())
    }
}

/// Appends a whole file.
fn put(out: &mut Vec<u8>, name: &str, content: &[u8], modified_s: u64) {
    let size = content.len() as u64;
    out.extend_from_slice(&header(name, size, modified_s));
    out.extend_from_slice(content);
    out.resize(out.len() + padding(size), 0);
}

/// Zeros behind a file of `size` bytes.
fn padding(size: u64) -> usize {
    (BLOCK - (size % BLOCK as u64) as usize) % BLOCK
}

/// What stands before a file. Its name has at most 99 characters: a flight's id has 64.
fn header(name: &str, size: u64, modified_s: u64) -> [u8; BLOCK] {
    let mut header = [0; BLOCK];
    let mut put = |at: usize, bytes: &[u8]| {
        for (place, byte) in header.iter_mut().skip(at).zip(bytes) {
            *place = *byte;
        }
    };
    put(0, name.as_bytes());
    put(100, b"0000644\0");
    put(108, b"0000000\0");
    put(116, b"0000000\0");
    put(124, &number(size));
    put(136, &number(modified_s));
    // The sum is taken with blanks in its own place.
    put(148, b"        ");
    put(156, b"0");
    put(257, b"ustar\x0000");
    let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
    for (place, byte) in header.iter_mut().skip(148).zip(format!("{sum:06o}\0 ").bytes()) {
        *place = byte;
    }
    header
}

/// Eleven octal digits, or, beyond them, binary, as GNU tar and bsdtar read it.
fn number(value: u64) -> [u8; 12] {
    let mut field = [0; 12];
    if value < 1 << 33 {
        for (place, byte) in field.iter_mut().zip(format!("{value:011o}").bytes()) {
            *place = byte;
        }
    } else {
        field[0] = 0x80;
        for (place, byte) in field.iter_mut().skip(4).zip(value.to_be_bytes()) {
            *place = byte;
        }
    }
    field
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_what_gnu_tar_writes() {
        let header = header("f1.mcap", 1234, 1_700_000_000);
        assert_eq!(&header[124..136], b"00000002322\0");
        // printf x > f1.mcap; tar --format=ustar --owner=0 --group=0 --mode=644 … gives the same sum for the same fields.
        let sum: u32 =
            header.iter().enumerate().map(|(at, b)| if (148..156).contains(&at) { 32 } else { u32::from(*b) }).sum();
        assert_eq!(&header[148..156], format!("{sum:06o}\0 ").as_bytes());
        assert_eq!([padding(0), padding(1), padding(512), padding(513)], [0, 511, 0, 511]);
        assert_eq!(number(9 << 30)[..5], [0x80, 0, 0, 0, 0]);
        assert_eq!(number((1 << 33) - 1), *b"77777777777\0");
    }
}
