//! Reading numeric CSV tables, gzipped or not, by column name.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::RecordingError;

/// Longest table, unpacked, bytes: a day of one IMU at 100 Hz.
const MOST_BYTES: u64 = 1 << 30;

fn io(path: &Path) -> impl Fn(std::io::Error) -> RecordingError + '_ {
    move |source| RecordingError::Io { path: path.to_owned(), source }
}

/// Opens `path`, undoing gzip where its first bytes say so.
pub(super) fn reader(path: &Path) -> Result<Box<dyn Read>, RecordingError> {
    let open = || File::open(path).map_err(io(path));
    let mut magic = [0; 2];
    let is_gzip = open()?.read_exact(&mut magic).is_ok() && magic == [0x1f, 0x8b];
    let file = BufReader::new(open()?);
    let inner: Box<dyn Read> = if is_gzip { Box::new(MultiGzDecoder::new(file)) } else { Box::new(file) };
    Ok(Box::new(Bounded { inner, left: MOST_BYTES }))
}

/// Fails where there is more: a few bytes of gzip can be any number of bytes.
struct Bounded {
    inner: Box<dyn Read>,
    left: u64,
}

impl Read for Bounded {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.left = self.left.checked_sub(count as u64).ok_or_else(|| {
            let text = format!("it has more than {MOST_BYTES} bytes, unpacked");
            std::io::Error::new(std::io::ErrorKind::InvalidData, text)
        })?;
        Ok(count)
    }
}

/// The first `n` bytes, decompressed.
pub(super) fn head(path: &Path, n: usize) -> Result<Vec<u8>, RecordingError> {
    let mut bytes = Vec::with_capacity(n);
    reader(path)?.take(n as u64).read_to_end(&mut bytes).map_err(io(path))?;
    Ok(bytes)
}

/// One row of a table.
pub(super) struct Row<'a> {
    path: &'a Path,
    line: u64,
    columns: &'a [usize],
    names: &'a [&'a str],
    record: &'a csv::StringRecord,
}

impl Row<'_> {
    /// The value of the `i`-th column asked for; NaN where the field says so or is empty.
    pub fn get(&self, i: usize) -> Result<f64, RecordingError> {
        let text = self.columns.get(i).and_then(|c| self.record.get(*c)).unwrap_or_default().trim();
        if text.is_empty() {
            return Ok(f64::NAN);
        }
        text.parse().map_err(|_| {
            let name = self.names.get(i).copied().unwrap_or_default();
            RecordingError::malformed(self.path, format!("line {}: {name} is {text:?}, not a number", self.line))
        })
    }

    /// Three columns from `i` on.
    pub fn vector(&self, i: usize) -> Result<nalgebra::Vector3<f64>, RecordingError> {
        Ok(nalgebra::Vector3::new(self.get(i)?, self.get(i + 1)?, self.get(i + 2)?))
    }
}

/// Calls `each` with every row, columns in the order of `names`.
///
/// A last line cut short (a truncated file) is left out; returns how many rows were read and
/// whether the last was cut.
pub(super) fn for_each_row(
    path: &Path,
    names: &[&str],
    mut each: impl FnMut(&Row<'_>) -> Result<(), RecordingError>,
) -> Result<(usize, bool), RecordingError> {
    let mut table = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::Headers).from_reader(reader(path)?);
    let header = table.headers().map_err(|e| RecordingError::malformed(path, e.to_string()))?.clone();
    let columns = names
        .iter()
        .map(|name| {
            header.iter().position(|h| h == *name).ok_or_else(|| {
                let found: Vec<_> = header.iter().take(6).collect();
                RecordingError::malformed(path, format!("no column {name:?}; the first are {found:?}"))
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut record = csv::StringRecord::new();
    let mut rows = 0;
    loop {
        match table.read_record(&mut record) {
            Ok(true) if record.len() < header.len() => return Ok((rows, true)),
            Ok(true) => {
                let line = record.position().map_or(0, csv::Position::line);
                each(&Row { path, line, columns: &columns, names, record: &record })?;
                rows += 1;
            }
            Ok(false) => return Ok((rows, false)),
            // A gzip stream that ends early: keep what was read.
            Err(e) if rows > 0 && e.is_io_error() => return Ok((rows, true)),
            Err(e) => return Err(RecordingError::malformed(path, format!("after {rows} rows: {e}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_the_most_is_refused_and_not_cut() {
        let read = |left| {
            let mut text = String::new();
            let mut bounded = Bounded { inner: Box::new(&b"t_s,x\n0,1\n"[..]), left };
            bounded.read_to_string(&mut text).map(|_| text)
        };
        assert_eq!(read(10).unwrap(), "t_s,x\n0,1\n");
        assert!(read(9).unwrap_err().to_string().contains("unpacked"));
    }
}
