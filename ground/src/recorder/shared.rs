//! The seam of an archive that several grounds share: what the recorder asks of it, and what it asks of the recorder.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::path::Path;

use super::{Flight, Labels, RecorderHandle, RecordingError};

/// Flights of several grounds, kept where all of them reach it.
pub trait SharedArchive: Debug + Send + Sync {
    /// The flights in it, as this ground was told last; waits for no network.
    ///
    /// # Errors
    /// [`RecordingError`] of what was told.
    fn flights(&self) -> Result<Vec<Flight>, RecordingError>;

    /// One of them, likewise.
    ///
    /// # Errors
    /// [`RecordingError`] of what was told.
    fn flight(&self, id: &str) -> Result<Option<Flight>, RecordingError>;

    /// Copies the file of a flight to `path`. Waits for the network.
    ///
    /// # Errors
    /// [`RecordingError::Archive`]: nothing is at `path` that could be taken for it.
    fn fetch(&self, id: &str, path: &Path) -> Result<(), RecordingError>;

    /// Changes name and notes of a flight that is only there. Waits for the network.
    ///
    /// # Errors
    /// [`RecordingError::Archive`]: they are as they were.
    fn label(&self, id: &str, labels: &Labels) -> Result<(), RecordingError>;

    /// Deletes a flight for every ground; one that is not there is none. Waits for the network.
    ///
    /// # Errors
    /// [`RecordingError::Archive`]: it may be there still.
    fn delete(&self, id: &str) -> Result<(), RecordingError>;
}

impl RecorderHandle {
    /// All flights, newest first: of this ground, and of the archive that it shares with others. Asks the disk.
    ///
    /// # Errors
    /// [`RecordingError`] of either.
    pub fn flights(&self) -> Result<Vec<Flight>, RecordingError> {
        let mut flights = self.desk.index.list()?;
        let Some(archive) = &self.desk.archive else { return Ok(flights) };
        let shared: BTreeMap<String, Flight> =
            archive.flights()?.into_iter().map(|flight| (flight.id.clone(), flight)).collect();
        for flight in &mut flights {
            flight.ground = shared.get(&flight.id).and_then(|shared| shared.ground.clone());
        }
        let here: BTreeSet<String> = flights.iter().map(|flight| flight.id.clone()).collect();
        flights.extend(shared.into_values().filter(|flight| !here.contains(&flight.id)));
        flights.sort_by(|a, b| (b.started_unix_us, &b.id).cmp(&(a.started_unix_us, &a.id)));
        Ok(flights)
    }

    /// Is it in the archive as it is here, where there is one?
    pub(super) fn is_shared(&self, flight: &Flight) -> Result<bool, RecordingError> {
        let Some(archive) = &self.desk.archive else { return Ok(true) };
        Ok(archive.flight(&flight.id)?.is_some_and(|shared| shared.messages >= flight.messages))
    }

    /// Fetches a flight that is only in the archive. Waits for the network.
    pub(super) fn fetched(&self, id: &str) -> Result<(), RecordingError> {
        let Some(archive) = self.desk.archive.as_ref().filter(|_| !self.desk.store.has(id)) else { return Ok(()) };
        let Some(flight) = archive.flight(id)? else { return Ok(()) };
        // One at a time: whoever asks for the same one finds it.
        let _turn = crate::sync::lock(&self.desk.fetching);
        if self.desk.store.has(id) {
            return Ok(());
        }
        if !self.ready() {
            return Err(RecordingError::NotReady);
        }
        self.room_for(flight.size_bytes)?;
        let scratch = self.scratch()?;
        let file = scratch.path().join("fetched.mcap");
        archive.fetch(id, &file)?;
        self.desk.store.label(id, &Labels { name: flight.name, notes: flight.notes })?;
        self.adopt(id, &file)
    }
}
