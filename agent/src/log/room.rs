//! Room for the next flight: what is deleted, and in which order.

use std::fs;
use std::path::{Path, PathBuf};

use plumbline_file::{free_bytes, metadata};

use super::writer::NUMBER;
use super::{LogConfig, LogError, MIN_FREE_BYTES};

/// Could a flight be begun now?
pub(super) fn probe(config: &LogConfig) -> Result<(), LogError> {
    fs::create_dir_all(&config.folder).map_err(|source| LogError::Io { path: config.folder.clone(), source })?;
    make_room(config, None)?;
    let path = config.folder.join("probe.tmp");
    let io = |source| LogError::Io { path: path.clone(), source };
    fs::write(&path, b"can be written").map_err(io)?;
    fs::remove_file(&path).map_err(io)
}

/// Stands beside a flight that the ground holds, too.
pub(super) fn kept_mark(path: &Path) -> PathBuf {
    path.with_extension("kept")
}

/// One file of the folder.
struct Kept {
    path: PathBuf,
    bytes: u64,
    /// Is it not known to be at a ground?
    only_here: bool,
}

impl Kept {
    /// What goes first is least. A flight's number says which is older; the date of its file does not: a wall clock may
    /// be set back, and a repair writes the file anew. Files without a number are from before there were any.
    fn rank(&self) -> (bool, u64, Option<std::time::SystemTime>) {
        let modified = fs::metadata(&self.path).and_then(|meta| meta.modified()).ok();
        (self.only_here, number(&self.path).unwrap_or(0), modified)
    }
}

/// Which flight of this folder it is.
fn number(path: &Path) -> Option<u64> {
    metadata(path)?.get(NUMBER)?.parse().ok()
}

/// The flights of `folder`. What was set aside takes room as well, and goes like any other.
fn flights(folder: &Path) -> std::io::Result<Vec<Kept>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "mcap" || extension == "corrupt") {
            let bytes = fs::metadata(&path)?.len();
            let only_here = !kept_mark(&path).exists();
            found.push(Kept { path, bytes, only_here });
        }
    }
    Ok(found)
}

/// Number of the newest flight of `folder`; 0 when none has one. Opens every file.
pub(super) fn newest(folder: &Path) -> u64 {
    let flights = flights(folder).unwrap_or_default();
    flights.iter().filter_map(|flight| number(&flight.path)).max().unwrap_or(0)
}

/// Deletes finished flights, those that the ground holds first and the oldest of each first, until the folder is below
/// its bound and the disk has some space left. `open` is never deleted.
pub(super) fn make_room(config: &LogConfig, open: Option<&Path>) -> Result<(), LogError> {
    let folder = &config.folder;
    let mut flights = flights(folder).map_err(|source| LogError::Io { path: folder.clone(), source })?;
    let mut used: u64 = flights.iter().map(|flight| flight.bytes).sum();
    // A new flight begins with some room to grow; an open one may fill the bound.
    let bound = if open.is_some() { config.max_bytes } else { config.max_bytes - config.max_bytes / 10 };
    let short = |used| used > bound || free_bytes(folder).is_some_and(|free| free < MIN_FREE_BYTES);
    if !short(used) {
        return Ok(());
    }
    flights.retain(|flight| Some(flight.path.as_path()) != open);
    flights.sort_by_cached_key(Kept::rank);
    for Kept { path, bytes, only_here } in flights {
        if only_here {
            tracing::warn!(flight = %path.display(), bytes, "deleted to make room: no ground is known to hold it");
        } else {
            tracing::info!(flight = %path.display(), bytes, "deleted to make room: the ground holds it");
        }
        fs::remove_file(&path).map_err(|source| LogError::Io { path: path.clone(), source })?;
        let _ = fs::remove_file(kept_mark(&path));
        used -= bytes;
        if !short(used) {
            return Ok(());
        }
    }
    let free = free_bytes(folder).map_or_else(|| "unknown".to_owned(), |free| (free >> 20).to_string());
    let reason = format!(
        "no room: {} MiB used of {} MiB, {free} MiB free on the disk, at least {} needed",
        used >> 20,
        config.max_bytes >> 20,
        MIN_FREE_BYTES >> 20
    );
    Err(LogError::Full { path: folder.clone(), reason })
}
