//! What stands at the two ends of a file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _, SeekFrom};
use std::path::Path;

use mcap::MAGIC;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::MAX_RECORD;

/// Name of the metadata record at the beginning of a file, which makes it answer for itself.
pub const METADATA: &str = "plumbline";

/// Records in front of which the metadata stand: the header and what another writer may put beside it.
const RECORDS_BEFORE: usize = 4;

/// What the file at `path` says of itself at its beginning; `None` when it does not, or cannot be read.
pub fn metadata(path: &Path) -> Option<BTreeMap<String, String>> {
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_emit_chunks(true)
        .with_record_length_limit(MAX_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    let mut source = BufReader::new(File::open(path).ok()?);
    let mut records = 0;
    while let Some(Ok(event)) = reader.next_event() {
        match event {
            LinearReadEvent::ReadRequest(need) => {
                let got = source.read(reader.insert(need.min(MAX_RECORD))).ok()?;
                reader.notify_read(got);
            }
            LinearReadEvent::Record { opcode, data } => {
                if let Ok(Record::Metadata(found)) = mcap::parse_record(opcode, data)
                    && found.name == METADATA
                {
                    return Some(found.metadata);
                }
                records += 1;
                if records > RECORDS_BEFORE {
                    return None;
                }
            }
        }
    }
    None
}

/// Does `file` end as a finished one does? Moves the place where it is read.
pub fn ends_with_magic(mut file: &File) -> bool {
    let mut tail = [0; MAGIC.len()];
    let end = -(MAGIC.len() as i64);
    file.seek(SeekFrom::End(end)).is_ok() && file.read_exact(&mut tail).is_ok() && tail == *MAGIC
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_says_what_it_is_and_whether_it_was_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.mcap");
        let said = BTreeMap::from([("flight_id".to_owned(), "f".to_owned())]);
        let mut writer = mcap::Writer::new(std::io::BufWriter::new(File::create(&path).unwrap())).unwrap();
        let record = mcap::records::Metadata { name: METADATA.into(), metadata: said.clone() };
        writer.write_metadata(&record).unwrap();
        writer.flush().unwrap();
        assert_eq!(metadata(&path), Some(said.clone()));
        assert!(!ends_with_magic(&File::open(&path).unwrap()), "it is still written");
        writer.finish().unwrap();
        drop(writer);
        assert!(ends_with_magic(&File::open(&path).unwrap()));
        assert_eq!(metadata(&path), Some(said));
        std::fs::write(&path, b"no flight").unwrap();
        assert_eq!(metadata(&path), None);
        assert!(!ends_with_magic(&File::open(&path).unwrap()));
    }
}
