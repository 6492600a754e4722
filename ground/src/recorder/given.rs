//! What the keeper of an archive that grounds share asks of the recorder.

use std::path::PathBuf;

use super::{Flight, RecorderHandle, RecordingError};

impl RecorderHandle {
    /// Counts what is entered into the index: while it stays, no finished flight of this ground has changed.
    pub(crate) fn generation(&self) -> u64 {
        self.desk.index.generation()
    }

    /// A flight in this ground's folder. Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError::Index`].
    pub(crate) fn flight_here(&self, id: &str) -> Result<Option<Flight>, RecordingError> {
        Ok(self.desk.index.get(id)?)
    }

    /// The flights in this ground's folder. Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError::Index`].
    pub(crate) fn flights_here(&self) -> Result<Vec<Flight>, RecordingError> {
        Ok(self.desk.index.list()?)
    }

    /// The file of a flight, where it is finished and no part of it waits to be merged.
    pub(crate) fn finished(&self, id: &str) -> Option<PathBuf> {
        let files = self.desk.store.files(id);
        files.finished.filter(|_| files.parts.is_empty())
    }
}
