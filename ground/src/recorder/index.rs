//! The index of flights (the seam called `FlightIndex`): SQLite, rebuilt from the files whenever it
//! is missing, damaged, or does not match them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use rusqlite::{Connection, OptionalExtension, params};

use super::flight::Flight;
use super::store::Labels;
use crate::sync::lock;

/// Bumped when the table or the record changes: an index of another number is rebuilt.
const VERSION: i64 = 2;

/// Which state of a file an entry describes: size and modification time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Stamp {
    pub(super) size: i64,
    pub(super) modified_ns: i64,
}

impl Stamp {
    /// Of a file; `None` when it cannot be read.
    pub(super) fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        let modified = metadata.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
        Some(Self { size: metadata.len() as i64, modified_ns: modified.as_nanos() as i64 })
    }
}

/// The index.
#[derive(Debug)]
pub(super) struct FlightIndex {
    connection: Mutex<Connection>,
    /// Changes of finished flights since the start.
    changes: AtomicU64,
}

impl FlightIndex {
    /// Opens the index in `data_folder`; a damaged one is set aside and begun anew, and where no file
    /// can be written the index lives in memory.
    pub(super) fn open(data_folder: &Path) -> rusqlite::Result<Self> {
        let path = data_folder.join("index.sqlite");
        let connection = match Self::prepare(&path) {
            Ok(connection) => connection,
            Err(error) => {
                tracing::error!(path = %path.display(), %error, "index of flights cannot be used, it is rebuilt");
                set_aside(&path);
                Self::prepare(&path).or_else(|error| {
                    tracing::error!(%error, "index of flights is kept in memory only");
                    let connection = Connection::open_in_memory()?;
                    create(&connection)?;
                    Ok::<_, rusqlite::Error>(connection)
                })?
            }
        };
        Ok(Self { connection: Mutex::new(connection), changes: AtomicU64::default() })
    }

    fn prepare(path: &Path) -> rusqlite::Result<Connection> {
        let connection = Connection::open(path)?;
        connection.busy_timeout(std::time::Duration::from_secs(2))?;
        let _mode: String = connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0))?;
        connection.execute_batch("PRAGMA synchronous = NORMAL")?;
        let version: i64 = connection.query_row("PRAGMA user_version", [], |row| row.get(0))?;
        if version != VERSION {
            connection.execute_batch("DROP TABLE IF EXISTS flights")?;
        }
        let sound: String = connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
        if sound != "ok" {
            return Err(rusqlite::Error::InvalidParameterName(sound));
        }
        create(&connection)?;
        Ok(connection)
    }

    /// Counts changes of flights that are finished.
    #[cfg(feature = "many")]
    pub(super) fn generation(&self) -> u64 {
        self.changes.load(Ordering::Acquire)
    }

    /// Counts a change.
    fn changed<T>(&self, change: rusqlite::Result<T>) -> rusqlite::Result<()> {
        self.changes.fetch_add(1, Ordering::AcqRel);
        change.map(drop)
    }

    /// Enters or replaces a flight. Name and notes keep what [`FlightIndex::label`] said last.
    pub(super) fn put(&self, flight: &Flight, stamp: Stamp) -> rusqlite::Result<()> {
        let text = serde_json::to_string(flight).unwrap_or_default();
        let change = lock(&self.connection).execute(
            "INSERT INTO flights (id, started_us, size, modified_ns, name, notes, flight) VALUES (?1,?2,?3,?4,?5,?6,?7)
             ON CONFLICT (id) DO UPDATE SET started_us = ?2, size = ?3, modified_ns = ?4, flight = ?7",
            params![
                flight.id,
                flight.started_unix_us as i64,
                stamp.size,
                stamp.modified_ns,
                flight.name,
                flight.notes,
                text
            ],
        );
        // One that is being recorded is renewed all the time, and is nobody else's yet.
        if stamp == Stamp::default() { change.map(drop) } else { self.changed(change) }
    }

    /// Changes name and notes.
    pub(super) fn label(&self, id: &str, labels: &Labels) -> rusqlite::Result<()> {
        let change = lock(&self.connection)
            .execute("UPDATE flights SET name = ?2, notes = ?3 WHERE id = ?1", params![id, labels.name, labels.notes]);
        self.changed(change)
    }

    /// One flight.
    pub(super) fn get(&self, id: &str) -> rusqlite::Result<Option<Flight>> {
        let connection = lock(&self.connection);
        let mut query = connection.prepare_cached("SELECT flight, name, notes FROM flights WHERE id = ?1")?;
        Ok(query.query_row([id], read).optional()?.flatten())
    }

    /// The state of the file that the entry of `id` describes.
    pub(super) fn stamp(&self, id: &str) -> rusqlite::Result<Option<Stamp>> {
        let connection = lock(&self.connection);
        let stamp = |row: &rusqlite::Row<'_>| Ok(Stamp { size: row.get(0)?, modified_ns: row.get(1)? });
        connection.query_row("SELECT size, modified_ns FROM flights WHERE id = ?1", [id], stamp).optional()
    }

    /// When the finished file of each flight was written, µs since the Unix epoch; 0 where there is none.
    pub(super) fn written_us(&self) -> rusqlite::Result<BTreeMap<String, u64>> {
        let connection = lock(&self.connection);
        let mut query = connection.prepare_cached("SELECT id, modified_ns FROM flights")?;
        let written = |row: &rusqlite::Row<'_>| {
            let (id, modified_ns): (String, i64) = (row.get(0)?, row.get(1)?);
            Ok((id, modified_ns as u64 / 1000))
        };
        query.query_map([], written)?.collect()
    }

    /// All flights, newest first.
    pub(super) fn list(&self) -> rusqlite::Result<Vec<Flight>> {
        let connection = lock(&self.connection);
        let mut query =
            connection.prepare_cached("SELECT flight, name, notes FROM flights ORDER BY started_us DESC, id DESC")?;
        let flights = query.query_map([], read)?.collect::<rusqlite::Result<Vec<_>>>()?;
        Ok(flights.into_iter().flatten().collect())
    }

    /// Forgets a flight.
    pub(super) fn remove(&self, id: &str) -> rusqlite::Result<()> {
        let change = lock(&self.connection).execute("DELETE FROM flights WHERE id = ?1", [id]);
        self.changed(change)
    }
}

fn create(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(&format!(
        "CREATE TABLE IF NOT EXISTS flights (
            id TEXT PRIMARY KEY, started_us INTEGER NOT NULL, size INTEGER NOT NULL, modified_ns INTEGER NOT NULL,
            name TEXT NOT NULL, notes TEXT NOT NULL, flight TEXT NOT NULL) STRICT;
         CREATE INDEX IF NOT EXISTS flights_by_start ON flights (started_us);
         PRAGMA user_version = {VERSION};"
    ))
}

fn read(row: &rusqlite::Row<'_>) -> rusqlite::Result<Option<Flight>> {
    let text: String = row.get(0)?;
    let Ok(mut flight) = serde_json::from_str::<Flight>(&text) else { return Ok(None) };
    flight.name = row.get(1)?;
    flight.notes = row.get(2)?;
    Ok(Some(flight))
}

fn set_aside(path: &Path) {
    for suffix in ["", "-wal", "-shm"] {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        let from = PathBuf::from(name.clone());
        name.push(".corrupt");
        let _ = fs::rename(from, PathBuf::from(name));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(id: &str, started_unix_us: u64) -> Flight {
        Flight { id: id.into(), started_unix_us, name: "first".into(), ..Flight::default() }
    }

    #[test]
    fn labels_outlive_updates_and_restarts() {
        let folder = tempfile::tempdir().unwrap();
        let index = FlightIndex::open(folder.path()).unwrap();
        index.put(&flight("a", 1), Stamp::default()).unwrap();
        index.put(&flight("b", 2), Stamp { size: 7, modified_ns: 8 }).unwrap();
        index.label("a", &Labels { name: "step test".into(), notes: "windy".into() }).unwrap();
        index.put(&flight("a", 3), Stamp::default()).unwrap();
        drop(index);
        let index = FlightIndex::open(folder.path()).unwrap();
        let ids: Vec<_> = index.list().unwrap().into_iter().map(|f| (f.id, f.name)).collect();
        assert_eq!(ids, [("a".into(), "step test".into()), ("b".into(), "first".to_owned())]);
        assert_eq!(index.stamp("b").unwrap(), Some(Stamp { size: 7, modified_ns: 8 }));
        index.remove("a").unwrap();
        assert_eq!(index.get("a").unwrap(), None);
    }

    #[test]
    fn a_damaged_index_is_set_aside_and_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("index.sqlite"), b"this is no database, but long enough to look like one")
            .unwrap();
        let index = FlightIndex::open(folder.path()).unwrap();
        assert!(index.list().unwrap().is_empty());
        assert!(folder.path().join("index.sqlite.corrupt").exists());
        index.put(&flight("a", 1), Stamp::default()).unwrap();
    }
}
