//! Flights as one tar (POSIX.1-1988 ustar), made as it is read: nothing is copied to the disk. A header says how long its file
//! is, so that what a flight is exported to is made twice, the first time to be measured.

use sha2::{Digest as _, Sha256};

use super::super::{Export, Format, Labels, RecorderHandle, RecordingError, Selection, Sink};
use super::{SUMS, Sums, hex};

/// Everything in a tar comes in blocks of this size, bytes.
const BLOCK: usize = 512;
/// Bytes of a flight read at once.
const PIECE: usize = 64 << 10;
/// Name, and ending, of a flight's own file.
const OWN: &str = "mcap";
/// Most flights of one tar.
const MAX_FLIGHTS: usize = 500;

/// Flights that are there, to be written as one tar.
#[derive(Debug)]
pub struct Tar {
    recorder: RecorderHandle,
    ids: Vec<String>,
    /// What each is exported to; `None` for its own file.
    format: Option<Format>,
}

impl Tar {
    /// Of these flights, with commas between their ids, each as a format by its name or, without one, as it is.
    ///
    /// # Errors
    /// [`RecordingError`] when one is not there or cannot be exported so, none is named, too many are, or there is no such
    /// format.
    pub fn new(recorder: RecorderHandle, ids: &str, format: Option<&str>) -> Result<Self, RecordingError> {
        let mut ids: Vec<String> = ids.split(',').filter(|id| !id.is_empty()).map(str::to_owned).collect();
        ids.sort();
        ids.dedup();
        if ids.is_empty() || ids.len() > MAX_FLIGHTS {
            let text = format!("ids names {} flights: 1 to {MAX_FLIGHTS} are needed", ids.len());
            return Err(RecordingError::Invalid(text));
        }
        let format = match format.filter(|name| *name != OWN) {
            None => None,
            Some(name) => {
                let unknown = || {
                    let known = Format::ALL.map(Format::name).join(", ");
                    RecordingError::Invalid(format!("format {:?} is none of {OWN}, {known}", crate::names::clip(name)))
                };
                Some(Format::ALL.into_iter().find(|format| format.name() == name).ok_or_else(unknown)?)
            }
        };
        let tar = Self { recorder, ids, format };
        for id in &tar.ids {
            tar.recorder.flight(id)?;
            if let Some(format) = format {
                tar.export(id, format)?;
            }
        }
        Ok(tar)
    }

    fn export(&self, id: &str, format: Format) -> Result<Export, RecordingError> {
        Export::wide(self.recorder.open(id)?, Selection::default(), format)
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
            let modified_s = flight.started_unix_us / 1_000_000;
            let name = format!("{id}.{}", self.format.map_or(OWN, Format::ending));
            let (size, hash) = match self.format {
                None => {
                    let open = self.recorder.open(id)?;
                    let size = open.length();
                    let hash = file(&name, size, modified_s, sink, |sink| {
                        let mut at = 0;
                        while at < size {
                            let read = open.piece(at, PIECE);
                            let piece =
                                read.map_err(|e| RecordingError::Io { path: name.clone().into(), source: e })?;
                            at += piece.len() as u64;
                            if !sink(piece) {
                                break;
                            }
                        }
                        Ok(())
                    });
                    (size, hash?)
                }
                Some(format) => {
                    let export = self.export(id, format)?;
                    let mut size = 0;
                    export.write(&mut |piece| {
                        size += piece.len() as u64;
                        true
                    })?;
                    (size, file(&name, size, modified_s, sink, |sink| export.write(sink))?)
                }
            };
            let Some(hash) = hash else { return Ok(()) };
            sums.0.insert(name, hash);
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

/// Sends a file of that size, which `content` gives piece by piece. Its hash; `None` when nobody listens any more.
fn file(
    name: &str,
    size: u64,
    modified_s: u64,
    sink: &mut Sink<'_>,
    content: impl FnOnce(&mut Sink<'_>) -> Result<(), RecordingError>,
) -> Result<Option<String>, RecordingError> {
    if !sink(header(name, size, modified_s).to_vec()) {
        return Ok(None);
    }
    let (mut hash, mut sent, mut listening) = (Sha256::new(), 0, true);
    content(&mut |piece: Vec<u8>| {
        sent += piece.len() as u64;
        hash.update(&piece);
        listening = sent <= size && sink(piece);
        listening
    })?;
    if sent > size || (listening && sent < size) {
        let reason = format!("came to {sent} bytes, and to {size} when it was measured");
        return Err(RecordingError::Damaged { path: name.into(), reason });
    }
    Ok(listening.then(|| hex(hash)))
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

    /// GIVEN a file that comes out longer or shorter than it was measured THEN the tar breaks off, and says why.
    #[test]
    fn a_file_that_is_not_as_long_as_it_was_is_an_error() {
        let sent = |pieces: &[usize], size| {
            let mut all = Vec::new();
            let content = |sink: &mut Sink<'_>| {
                pieces.iter().all(|length| sink(vec![7; *length]));
                Ok(())
            };
            let mut sink = |piece: Vec<u8>| {
                all.extend(piece);
                true
            };
            let hash = file("f1.csv", size, 0, &mut sink, content);
            (hash, all.len())
        };
        let (hash, length) = sent(&[600, 400], 1000);
        assert_eq!((hash.unwrap(), length), (Some(hex(Sha256::new_with_prefix([7_u8; 1000]))), BLOCK + 1000));
        for pieces in [[600, 399], [600, 401]] {
            let (error, length) = sent(&pieces, 1000);
            let error = error.unwrap_err().to_string();
            assert!(error.contains("f1.csv") && error.contains("to 1000 when"), "{error}");
            assert!(length <= BLOCK + 1000, "{length}: nothing of it looks like the next file");
        }
    }

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
