//! How long flights are kept. Without a limit nothing is ever deleted; with one, what is due is told [`Retention::notice`] before it
//! goes: in the log, in the audit log and at `/api/v1/archive/due`.
//!
//! Never due is a flight that is recorded or filled, is not complete, or that people have named or annotated; nor, where a backup is
//! configured, one that is not in there the same. Of what is in the archive of a fleet only this ground's copy is deleted, and no
//! copy that the archive lacks.
//!
//! A flight is as old as its end by the vehicle's clock, or as its file where that is younger: a clock may be years behind.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use plumbline_file::write_atomically;
use plumbline_rest::flight::Due;

use super::super::{Completeness, Flight, RecorderHandle, RecordingError};
use super::{Sums, hash};
use crate::sync::lock;

/// What is kept how long.
#[derive(Debug, Clone, PartialEq)]
pub struct Retention {
    /// Longer than this after their end flights are due.
    pub age: Option<Duration>,
    /// More than this in all, bytes, makes the oldest due.
    pub bytes: Option<u64>,
    /// Only flights that this backup holds are due.
    pub backup: Option<PathBuf>,
    /// So long before it is deleted a flight is told to be due.
    pub notice: Duration,
    /// How often it is looked.
    pub every: Duration,
}

impl Default for Retention {
    fn default() -> Self {
        let (day, hour) = (Duration::from_secs(86_400), Duration::from_secs(3600));
        Self { age: None, bytes: None, backup: None, notice: day, every: hour }
    }
}

impl Retention {
    /// Is anything ever deleted?
    pub fn limits(&self) -> bool {
        self.age.is_some() || self.bytes.is_some()
    }
}

/// The flights that a policy deletes, the oldest first; when it does is not said yet. `written_us` says when the file of each
/// was written, µs since the Unix epoch.
pub fn due(flights: &[Flight], written_us: &BTreeMap<String, u64>, policy: &Retention, now_unix_us: u64) -> Vec<Due> {
    let here = || flights.iter().filter(|flight| !flight.away);
    let mut oldest: Vec<&Flight> = here().collect();
    oldest.sort_by_key(|flight| (since_us(flight, written_us), &flight.id));
    let mut total: u64 = here().map(|flight| flight.size_bytes).sum();
    let mut found = Vec::new();
    for flight in oldest {
        let age = Duration::from_micros(now_unix_us.saturating_sub(since_us(flight, written_us)));
        let why = if policy.age.is_some_and(|most| age > most) {
            format!("ended {:.1} days ago", age.as_secs_f64() / 86_400.0)
        } else if let Some(most) = policy.bytes.filter(|most| total > *most) {
            format!("flights take {total} bytes, {most} are allowed")
        } else {
            continue;
        };
        if kept(flight) {
            continue;
        }
        total = total.saturating_sub(flight.size_bytes);
        found.push(Due { id: flight.id.clone(), bytes: flight.size_bytes, why, ..Due::default() });
    }
    found
}

/// Is it never due?
fn kept(flight: &Flight) -> bool {
    flight.completeness != Completeness::Complete || !flight.name.is_empty() || !flight.notes.is_empty()
}

/// From when on its age counts, µs since the Unix epoch.
fn since_us(flight: &Flight, written_us: &BTreeMap<String, u64>) -> u64 {
    let ended = flight.started_unix_us.saturating_add((flight.duration_s * 1e6) as u64);
    ended.max(written_us.get(&flight.id).copied().unwrap_or(0))
}

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

/// Carries a policy out.
#[derive(Debug)]
pub(crate) struct Pruner {
    policy: Retention,
    recorder: RecorderHandle,
    /// When each flight that is due was told to be, µs since the Unix epoch; outlives the ground. Never locked while the disk is asked.
    told: Mutex<BTreeMap<String, u64>>,
    path: PathBuf,
}

impl Pruner {
    pub(crate) fn open(data_folder: &Path, policy: Retention, recorder: RecorderHandle) -> Self {
        let path = data_folder.join("retention.json");
        let told = std::fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
        Self { policy, recorder, told: Mutex::new(told.unwrap_or_default()), path }
    }

    pub(crate) fn every(&self) -> Duration {
        self.policy.every
    }

    /// What is due, and when each of it goes.
    pub(crate) fn due(&self, now_unix_us: u64) -> Result<Vec<Due>, RecordingError> {
        let told = lock(&self.told).clone();
        let timed = |due: Due| {
            let told = told.get(&due.id).copied();
            Due { deleted_unix_us: told.map(|told| told.saturating_add(micros(self.policy.notice))), ..due }
        };
        let (flights, written_us) = (self.recorder.flights()?, self.recorder.desk.index.written_us()?);
        Ok(due(&flights, &written_us, &self.policy, now_unix_us).into_iter().map(timed).collect())
    }

    /// Writes into `flights` when each of them is deleted as things are, at the earliest. One that only their sum makes due has no
    /// time before it is told.
    pub(crate) fn date(&self, flights: &mut [Flight], now_unix_us: u64) -> Result<(), RecordingError> {
        if !self.policy.limits() {
            return Ok(());
        }
        let due: BTreeMap<String, Due> = self.due(now_unix_us)?.into_iter().map(|due| (due.id.clone(), due)).collect();
        let written_us = self.recorder.desk.index.written_us()?;
        let kept_us = self.policy.age.map(|age| micros(age.saturating_add(self.policy.notice)));
        for flight in flights.iter_mut().filter(|flight| !flight.away && !kept(flight)) {
            let since = since_us(flight, &written_us);
            let told = due.get(&flight.id).and_then(|due| due.deleted_unix_us);
            flight.deleted_unix_us = told.or_else(|| kept_us.map(|kept| since.saturating_add(kept)));
        }
        Ok(())
    }

    /// Deletes what was told long enough ago, and tells what is due now. Answers what it told and deleted. Asks the disk.
    pub(crate) fn pass(&self, now_unix_us: u64) -> Result<(Vec<Due>, Vec<Due>), RecordingError> {
        // An index that lacks flights says too little of what there is.
        if !self.policy.limits() || !self.recorder.ready() {
            return Ok((Vec::new(), Vec::new()));
        }
        let all = self.due(now_unix_us)?;
        let before = lock(&self.told).clone();
        let mut since_when = BTreeMap::new();
        let (mut told, mut deleted) = (Vec::new(), Vec::new());
        for due in all {
            let Some(since) = before.get(&due.id).copied() else {
                since_when.insert(due.id.clone(), now_unix_us);
                told.push(due);
                continue;
            };
            let late = due.deleted_unix_us.is_some_and(|at| at <= now_unix_us);
            let gone = late
                && self.delete(&due.id).unwrap_or_else(|error| {
                    tracing::error!(flight = due.id, %error, "retention");
                    false
                });
            if gone {
                deleted.push(due);
            } else {
                since_when.insert(due.id, since);
            }
        }
        lock(&self.told).clone_from(&since_when);
        if since_when != before {
            let text = serde_json::to_vec(&since_when).unwrap_or_default();
            write_atomically(&self.path, &text)
                .map_err(|source| RecordingError::Io { path: self.path.clone(), source })?;
        }
        Ok((told, deleted))
    }

    /// Deletes a flight here, where it is in the backup and the archive if there has to be one. Answers whether it did.
    fn delete(&self, id: &str) -> Result<bool, RecordingError> {
        let may = self.recorder.is_shared(&self.recorder.flight(id)?)? && self.backed_up(id)?;
        // Asked last: somebody may have named it since it was due, or while the backup was read.
        let may = may && !kept(&self.recorder.flight(id)?);
        if may {
            self.recorder.delete_here(id)?;
        }
        Ok(may)
    }

    /// Is it in the backup as it is here, where there has to be one?
    fn backed_up(&self, id: &str) -> Result<bool, RecordingError> {
        let Some(backup) = &self.policy.backup else { return Ok(true) };
        let name = format!("{id}.mcap");
        let sums = Sums::read(backup)?;
        let Some(expected) = sums.0.get(&name) else { return Ok(false) };
        let here = hash(&self.recorder.desk.store.finished_path(id))?;
        Ok(here == *expected && hash(&backup.join(&name)).is_ok_and(|there| there == here))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GroundConfig;
    use crate::recorder::index::Stamp;
    use crate::recorder::{Labels, start};

    #[test]
    fn a_flight_that_is_named_before_it_is_deleted_stays() {
        let folder = tempfile::tempdir().unwrap();
        let recorder = start(&GroundConfig::new(folder.path()), None).unwrap();
        let handle = recorder.handle();
        while !handle.ready() {
            std::thread::sleep(Duration::from_millis(1));
        }
        let index = handle.desk.index.clone();
        let flight = Flight { id: "f1".into(), completeness: Completeness::Complete, ..Flight::default() };
        index.put(&flight, Stamp { size: 1, modified_ns: 1 }).unwrap();
        let pruner = Pruner::open(folder.path(), Retention::default(), handle);
        index.label("f1", &Labels { name: "figure 3".into(), notes: String::new() }).unwrap();
        assert!(!pruner.delete("f1").unwrap() && index.get("f1").unwrap().is_some());
        index.label("f1", &Labels::default()).unwrap();
        assert!(pruner.delete("f1").unwrap() && index.get("f1").unwrap().is_none());
        recorder.finish();
    }
}
