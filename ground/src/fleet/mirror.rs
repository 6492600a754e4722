//! What this ground was told of the shared index last: its list of flights when nothing else answers.

use std::path::Path;
use std::sync::Mutex;

use rusqlite::{Connection, OptionalExtension as _, Row, params};

use serde::{Deserialize, Serialize};

use super::FleetError;
use crate::recorder::{Flight, Labels};
use crate::sync::lock;

const COLUMNS: &str = "id, revision, ground, object, sha256, size, messages, name, notes, flight, deleted";

/// One flight as the shared index has it, and as it lies beside its file.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) struct Entry {
    pub(super) id: String,
    /// Counts all changes of the index.
    #[serde(skip)]
    pub(super) revision: i64,
    /// The ground that recorded it.
    pub(super) ground: String,
    /// Its file in the storage.
    pub(super) object: String,
    /// Of that file.
    pub(super) sha256: String,
    /// Of that file, bytes.
    pub(super) size: i64,
    /// In that file.
    pub(super) messages: i64,
    pub(super) name: String,
    pub(super) notes: String,
    /// The rest, JSON.
    #[serde(with = "json")]
    pub(super) flight: String,
    /// There is none any more: nobody brings it back.
    #[serde(skip)]
    pub(super) deleted: bool,
}

impl Entry {
    pub(super) fn labels(&self) -> Labels {
        Labels { name: self.name.clone(), notes: self.notes.clone() }
    }

    /// As a list shows it.
    fn flight(self) -> Option<Flight> {
        let flight: Flight = serde_json::from_str(&self.flight).ok()?;
        let size_bytes = u64::try_from(self.size).unwrap_or(0);
        Some(Flight { name: self.name, notes: self.notes, size_bytes, ground: Some(self.ground), away: true, ..flight })
    }
}

/// Text that is JSON, as the JSON that it is.
mod json {
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer, ser::Error as _};
    use serde_json::Value;

    pub(super) fn serialize<S: Serializer>(text: &str, to: S) -> Result<S::Ok, S::Error> {
        serde_json::from_str::<Value>(text).map_err(S::Error::custom)?.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
        Value::deserialize(from).map(|value| value.to_string())
    }
}

/// The copy.
#[derive(Debug)]
pub(super) struct Mirror(Mutex<Connection>);

fn here(error: rusqlite::Error) -> FleetError {
    FleetError::Here(format!("copy of the shared index: {error}"))
}

impl Mirror {
    /// Of `data_folder`; one that cannot be read is begun anew, because all of it can be had again.
    ///
    /// # Errors
    /// [`FleetError::Here`].
    pub(super) fn open(data_folder: &Path) -> Result<Self, FleetError> {
        let path = data_folder.join("fleet.sqlite");
        let connection = prepare(&path).or_else(|error| {
            tracing::warn!(%error, "copy of the shared index begun anew");
            let _ = std::fs::remove_file(&path);
            prepare(&path)
        });
        Ok(Self(Mutex::new(connection.map_err(here)?)))
    }

    /// Begins anew where it is of another database.
    pub(super) fn be_of(&self, database: &str) -> Result<(), FleetError> {
        let mut connection = lock(&self.0);
        let change = connection.transaction().map_err(here)?;
        let known: Option<String> =
            change.query_row("SELECT id FROM source", [], |row| row.get(0)).optional().map_err(here)?;
        if known.as_deref() != Some(database) {
            change.execute_batch("DELETE FROM flights; DELETE FROM source").map_err(here)?;
            change.execute("INSERT INTO source (id, taken) VALUES (?1, 0)", [database]).map_err(here)?;
        }
        change.commit().map_err(here)
    }

    /// All changes up to this one are here; own ones may be that are later.
    pub(super) fn taken(&self) -> Result<i64, FleetError> {
        let connection = lock(&self.0);
        connection.query_row("SELECT coalesce(max(taken), 0) FROM source", [], |row| row.get(0)).map_err(here)
    }

    pub(super) fn set_taken(&self, revision: i64) -> Result<(), FleetError> {
        lock(&self.0).execute("UPDATE source SET taken = ?1", [revision]).map(drop).map_err(here)
    }

    pub(super) fn take(&self, e: &Entry) -> Result<(), FleetError> {
        let text = format!("INSERT OR REPLACE INTO flights ({COLUMNS}) VALUES (?1,?2,?3,?4,?5,?6,?7,?8,?9,?10,?11)");
        let values = params![
            e.id, e.revision, e.ground, e.object, e.sha256, e.size, e.messages, e.name, e.notes, e.flight, e.deleted
        ];
        lock(&self.0).execute(&text, values).map(drop).map_err(here)
    }

    /// A flight, deleted or not.
    pub(super) fn entry(&self, id: &str) -> Result<Option<Entry>, FleetError> {
        let connection = lock(&self.0);
        let text = format!("SELECT {COLUMNS} FROM flights WHERE id = ?1");
        let mut query = connection.prepare_cached(&text).map_err(here)?;
        query.query_row([id], read).optional().map_err(here)
    }

    /// All that are not deleted.
    pub(super) fn flights(&self) -> Result<Vec<Flight>, FleetError> {
        let connection = lock(&self.0);
        let text = format!("SELECT {COLUMNS} FROM flights WHERE NOT deleted");
        let mut query = connection.prepare_cached(&text).map_err(here)?;
        let entries: Result<Vec<Entry>, _> = query.query_map([], read).and_then(Iterator::collect);
        Ok(entries.map_err(here)?.into_iter().filter_map(Entry::flight).collect())
    }

    /// One that is not deleted.
    pub(super) fn flight(&self, id: &str) -> Result<Option<Flight>, FleetError> {
        Ok(self.entry(id)?.filter(|entry| !entry.deleted).and_then(Entry::flight))
    }
}

fn prepare(path: &Path) -> rusqlite::Result<Connection> {
    let connection = Connection::open(path)?;
    let _mode: String = connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0))?;
    connection.execute_batch(
        "PRAGMA synchronous = NORMAL;
         CREATE TABLE IF NOT EXISTS source (id TEXT NOT NULL, taken INTEGER NOT NULL) STRICT;
         CREATE TABLE IF NOT EXISTS flights (
            id TEXT PRIMARY KEY, revision INTEGER NOT NULL, ground TEXT NOT NULL, object TEXT NOT NULL, sha256 TEXT NOT NULL,
            size INTEGER NOT NULL, messages INTEGER NOT NULL, name TEXT NOT NULL, notes TEXT NOT NULL, flight TEXT NOT NULL,
            deleted INTEGER NOT NULL) STRICT",
    )?;
    Ok(connection)
}

fn read(row: &Row<'_>) -> rusqlite::Result<Entry> {
    Ok(Entry {
        id: row.get(0)?,
        revision: row.get(1)?,
        ground: row.get(2)?,
        object: row.get(3)?,
        sha256: row.get(4)?,
        size: row.get(5)?,
        messages: row.get(6)?,
        name: row.get(7)?,
        notes: row.get(8)?,
        flight: row.get(9)?,
        deleted: row.get(10)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_of_one_database_and_outlives_the_ground() {
        let folder = tempfile::tempdir().unwrap();
        let entry = |id: &str, revision, deleted| {
            let flight = serde_json::to_string(&Flight { id: id.into(), ..Flight::default() }).unwrap();
            Entry { id: id.into(), revision, flight, name: "first".into(), deleted, ..Entry::default() }
        };
        let mirror = Mirror::open(folder.path()).unwrap();
        mirror.be_of("one").unwrap();
        mirror.take(&entry("a", 1, false)).unwrap();
        mirror.take(&entry("b", 2, true)).unwrap();
        mirror.set_taken(2).unwrap();
        mirror.take(&entry("a", 3, false)).unwrap();
        drop(mirror);
        let mirror = Mirror::open(folder.path()).unwrap();
        mirror.be_of("one").unwrap();
        assert_eq!((mirror.taken().unwrap(), mirror.entry("a").unwrap()), (2, Some(entry("a", 3, false))));
        let listed: Vec<_> = mirror.flights().unwrap().into_iter().map(|f| (f.id, f.name, f.away)).collect();
        assert_eq!(listed, [("a".to_owned(), "first".to_owned(), true)]);
        assert!(mirror.flight("b").unwrap().is_none() && mirror.entry("b").unwrap().is_some());
        mirror.be_of("another").unwrap();
        assert_eq!((mirror.taken().unwrap(), mirror.flights().unwrap().len()), (0, 0));
        drop(mirror);
        std::fs::write(folder.path().join("fleet.sqlite"), b"this is no database, but long enough to look like one")
            .unwrap();
        assert_eq!(Mirror::open(folder.path()).unwrap().taken().unwrap(), 0);
    }
}
