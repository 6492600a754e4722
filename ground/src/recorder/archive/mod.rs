//! Flights kept elsewhere: a backup folder, one tar of many, and what is deleted here when.
//!
//! A backup is a folder of `ID.mcap`, `ID.json` (name and notes) and `SHA256SUMS`, which `sha256sum --check` reads as well. A
//! [`tar`](Tar) has the same files: unpacked, it is a backup.

mod retention;
mod tar;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{Read, Write as _};
use std::path::{Path, PathBuf};

use plumbline_file::write_atomically;
use plumbline_proto::ids::FlightId;
use sha2::{Digest as _, Sha256};

use super::RecordingError;
use super::store::RecordingStore;

pub(crate) use retention::Pruner;
pub use retention::{Retention, due};
pub use tar::Tar;

/// The file of hashes.
pub const SUMS: &str = "SHA256SUMS";
/// Bytes read at once.
const PIECE: usize = 256 << 10;

/// What was done with the flights of a folder.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Outcome {
    /// Files that were copied.
    pub copied: Vec<String>,
    /// How many were there already, the same.
    pub same: usize,
    /// Flights passed over, each with the reason.
    pub left: Vec<(String, String)>,
}

/// Copies every finished flight of `data_folder` that `wanted` (all, where it is empty) names and that `backup` does not hold the same.
///
/// The ground may run: a finished file is only ever replaced as a whole.
///
/// # Errors
/// [`RecordingError`] of the first file that cannot be copied; those before it are in the backup.
pub fn back_up(data_folder: &Path, backup: &Path, wanted: &[String]) -> Result<Outcome, RecordingError> {
    let store = RecordingStore::new(data_folder, 0);
    let flights = store.list();
    known(wanted, |id| flights.contains_key(id))?;
    fs::create_dir_all(backup).map_err(|e| io(backup, e))?;
    let mut sums = Sums::read(backup)?;
    let mut outcome = Outcome::default();
    for (id, files) in flights.iter().filter(|(id, _)| wanted.is_empty() || wanted.contains(id)) {
        let Some(finished) = files.finished.as_ref().filter(|_| files.parts.is_empty()) else {
            outcome.left.push((id.clone(), "it is being recorded, or filled".into()));
            continue;
        };
        let labels = store.folder().join(format!("{id}.json"));
        for from in [finished, &labels].into_iter().filter(|path| path.exists()) {
            let Some(name) = from.file_name().and_then(|name| name.to_str()) else { continue };
            let target = backup.join(name);
            // A copy that was cut has another length; one changed otherwise is what `check` finds.
            let length = |path: &Path| fs::metadata(path).map(|meta| meta.len()).ok();
            if length(&target) == length(from) && sums.0.get(name) == Some(&hash(from)?) {
                outcome.same += 1;
                continue;
            }
            let sum = copy(from, &target, None)?;
            sums.0.insert(name.to_owned(), sum);
            sums.write(backup)?;
            outcome.copied.push(name.to_owned());
        }
    }
    Ok(outcome)
}

/// Reads every file of a backup. Answers how many are as they were, and what is wrong with each of the others.
///
/// # Errors
/// [`RecordingError`] when its list of hashes cannot be read.
pub fn check(backup: &Path) -> Result<(usize, Vec<String>), RecordingError> {
    let sums = Sums::read_present(backup)?;
    let mut wrong = Vec::new();
    for (name, expected) in &sums.0 {
        match hash(&backup.join(name)) {
            Ok(found) if found == *expected => {}
            Ok(found) => wrong.push(format!("{name}: has {found}, was {expected}")),
            Err(error) => wrong.push(error.to_string()),
        }
    }
    Ok((sums.0.len() - wrong.len(), wrong))
}

/// How many flights a backup holds, by its own list; none of them is read.
///
/// # Errors
/// [`RecordingError`] when there is no such list, or it cannot be read.
pub fn listed(backup: &Path) -> Result<usize, RecordingError> {
    Ok(Sums::read_present(backup)?.0.keys().filter(|name| name.ends_with(".mcap")).count())
}

/// Puts flights of a backup that `data_folder` does not have back there. None is ever replaced; no ground may run.
///
/// # Errors
/// [`RecordingError`] when a ground runs, a flight is not in the backup, or a file of it is not what it was; what was put back
/// before stays.
pub fn restore(backup: &Path, data_folder: &Path, wanted: &[String]) -> Result<Outcome, RecordingError> {
    let _held = super::folder::lock(data_folder).map_err(|error| RecordingError::Invalid(error.to_string()))?;
    let sums = Sums::read_present(backup)?;
    known(wanted, |id| sums.0.contains_key(&format!("{id}.mcap")))?;
    let store = RecordingStore::new(data_folder, 0);
    store.probe()?;
    let here: BTreeSet<String> = store.list().into_keys().collect();
    let mut outcome = Outcome::default();
    for (name, expected) in &sums.0 {
        let id = id_of(name).unwrap_or_default();
        if !wanted.is_empty() && !wanted.iter().any(|wanted| wanted == id) {
            continue;
        }
        let target = store.folder().join(name);
        if here.contains(id) || target.exists() {
            outcome.left.push((name.clone(), "it is there already".into()));
            continue;
        }
        copy(&backup.join(name), &target, Some(expected))?;
        outcome.copied.push(name.clone());
    }
    Ok(outcome)
}

fn known(wanted: &[String], there: impl Fn(&str) -> bool) -> Result<(), RecordingError> {
    match wanted.iter().find(|id| !there(id)) {
        Some(id) => Err(RecordingError::Unknown(crate::names::clip(id))),
        None => Ok(()),
    }
}

/// The flight whose file this is.
fn id_of(name: &str) -> Option<&str> {
    let id = name.strip_suffix(".mcap").or_else(|| name.strip_suffix(".json"))?;
    FlightId::new(id).is_ok().then_some(id)
}

/// Hash of each file, by its name.
#[derive(Debug, Default)]
struct Sums(BTreeMap<String, String>);

impl Sums {
    /// Of a backup; empty where none has been begun.
    fn read(backup: &Path) -> Result<Self, RecordingError> {
        let path = backup.join(SUMS);
        if path.exists() { Self::read_present(backup) } else { Ok(Self::default()) }
    }

    fn read_present(backup: &Path) -> Result<Self, RecordingError> {
        let path = backup.join(SUMS);
        let text = fs::read_to_string(&path).map_err(|e| io(&path, e))?;
        let mut sums = BTreeMap::new();
        for (number, line) in text.lines().enumerate() {
            let whole = line.split_once("  ").filter(|(sum, name)| {
                sum.len() == 64 && sum.bytes().all(|digit| digit.is_ascii_hexdigit()) && id_of(name).is_some()
            });
            let Some((sum, name)) = whole else {
                let reason = format!("line {}: {:?} is no hash and flight file", number + 1, crate::names::clip(line));
                return Err(RecordingError::Damaged { path, reason });
            };
            sums.insert(name.to_owned(), sum.to_ascii_lowercase());
        }
        Ok(Self(sums))
    }

    fn text(&self) -> String {
        self.0.iter().map(|(name, sum)| format!("{sum}  {name}\n")).collect()
    }

    fn write(&self, backup: &Path) -> Result<(), RecordingError> {
        let path = backup.join(SUMS);
        write_atomically(&path, self.text().as_bytes()).map_err(|e| io(&path, e))
    }
}

/// A hash, as it is written.
pub(crate) fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// SHA-256 of what is left to be read, and how many bytes that is.
///
/// # Errors
/// Those of the disk.
pub(crate) fn hash_of(file: impl Read) -> std::io::Result<(String, u64)> {
    let (mut hash, mut size) = (Sha256::new(), 0);
    pieces(file, std::convert::identity, |piece| {
        hash.update(piece);
        size += piece.len() as u64;
        Ok(())
    })?;
    Ok((hex(hash), size))
}

/// SHA-256 of a file.
fn hash(path: &Path) -> Result<String, RecordingError> {
    File::open(path).and_then(hash_of).map(|(hash, _)| hash).map_err(|e| io(path, e))
}

/// Copies a file beside its place, syncs it, reads it back, and only then gives it its name. It stays as old as it was. Answers
/// its hash.
fn copy(from: &Path, to: &Path, expected: Option<&str>) -> Result<String, RecordingError> {
    let mut temporary = to.as_os_str().to_owned();
    temporary.push(".tmp");
    let temporary = PathBuf::from(temporary);
    let copied = copy_to(from, &temporary, expected);
    match copied {
        Ok(sum) => {
            fs::rename(&temporary, to).map_err(|e| io(to, e))?;
            if let Some(folder) = to.parent() {
                File::open(folder).and_then(|folder| folder.sync_all()).map_err(|e| io(folder, e))?;
            }
            Ok(sum)
        }
        Err(error) => {
            // It is of no use; that it could not be removed is the lesser trouble.
            let _ = fs::remove_file(&temporary);
            Err(error)
        }
    }
}

fn copy_to(from: &Path, temporary: &Path, expected: Option<&str>) -> Result<String, RecordingError> {
    let mut file = File::create(temporary).map_err(|e| io(temporary, e))?;
    let mut read = Sha256::new();
    let original = File::open(from).map_err(|e| io(from, e))?;
    pieces(
        &original,
        |e| io(from, e),
        |piece| {
            read.update(piece);
            file.write_all(piece).map_err(|e| io(temporary, e))
        },
    )?;
    // The age of a flight is that of its file where the vehicle's clock was behind.
    let modified = original.metadata().and_then(|meta| meta.modified()).map_err(|e| io(from, e))?;
    file.set_modified(modified).and_then(|()| file.sync_all()).map_err(|e| io(temporary, e))?;
    let read = hex(read);
    let differs = |path: &Path, found: &str, expected: &str| {
        Err(RecordingError::Damaged { path: path.to_owned(), reason: format!("has {found}, was {expected}") })
    };
    if let Some(expected) = expected
        && read != expected
    {
        return differs(from, &read, expected);
    }
    let written = hash(temporary)?;
    if written == read { Ok(read) } else { differs(temporary, &written, &read) }
}

/// Passes on a file piece by piece.
fn pieces<E>(
    mut file: impl Read,
    unread: impl Fn(std::io::Error) -> E,
    mut take: impl FnMut(&[u8]) -> Result<(), E>,
) -> Result<(), E> {
    let mut buffer = vec![0; PIECE];
    loop {
        match file.read(&mut buffer).map_err(&unread)? {
            0 => return Ok(()),
            length => take(buffer.get(..length).unwrap_or_default())?,
        }
    }
}

fn io(path: &Path, source: std::io::Error) -> RecordingError {
    RecordingError::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests;
