//! What charts show of a long flight as a whole, kept beside its file: to open the flight that is sent, instead of every message being read.
//!
//! First a line that says which file it is of and which program made it, then the codec batch. Whatever is of another file is made anew.

use std::fs;
use std::path::PathBuf;

use plumbline_file::write_atomically;

use super::export::WRITTEN;
use super::store::RecordingStore;

/// Where it is kept, or is to be.
#[derive(Debug)]
pub(super) struct Overview {
    path: PathBuf,
    /// Its first line.
    head: String,
    /// Whose disk has room for it, or not.
    store: RecordingStore,
}

impl Overview {
    /// Of the flight with this tag.
    pub(super) fn new(path: PathBuf, tag: &str, store: RecordingStore) -> Self {
        Self { path, head: format!("{tag} {WRITTEN}\n"), store }
    }

    /// The batch; `None` where none is kept, or another file's.
    pub(super) fn kept(&self) -> Option<Vec<u8>> {
        let mut all = fs::read(&self.path).ok()?;
        all.starts_with(self.head.as_bytes()).then(|| all.split_off(self.head.len()))
    }

    /// Keeps the batch. A disk without room for it has it made again each time.
    pub(super) fn keep(&self, batch: &[u8]) {
        if self.store.room_for(batch.len() as u64).is_err() {
            return;
        }
        if let Err(error) = write_atomically(&self.path, &[self.head.as_bytes(), batch].concat()) {
            tracing::warn!(path = %self.path.display(), %error, "what charts show of a flight is not kept");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_of_another_file_or_has_no_room_is_not_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flights/f1.overview");
        fs::create_dir(folder.path().join("flights")).unwrap();
        let of =
            |tag, reserve_bytes| Overview::new(path.clone(), tag, RecordingStore::new(folder.path(), reserve_bytes));
        assert_eq!(of("\"1\"", 0).kept(), None);
        of("\"1\"", u64::MAX).keep(b"batch");
        assert_eq!(of("\"1\"", 0).kept(), None, "no room");
        of("\"1\"", 0).keep(b"batch\nand more");
        assert_eq!(of("\"1\"", 0).kept().unwrap(), b"batch\nand more");
        assert_eq!(of("\"2\"", 0).kept(), None);
        of("\"2\"", 0).keep(b"other");
        assert_eq!((of("\"1\"", 0).kept(), of("\"2\"", 0).kept().unwrap()), (None, b"other".to_vec()));
    }
}
