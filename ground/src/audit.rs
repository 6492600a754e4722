//! Who did what: every request that changes something, and every attempt to sign in, one JSON line each, appended to
//! `audit.jsonl` in the data folder. Nothing is ever taken out; a file that has grown to [`ROTATE_BYTES`] is kept under
//! the time of its end and a new one begun.
//!
//! A thread of its own writes: no command waits for a disk. Bound: [`MAX_QUEUED`] lines. Policy when full: the newest is
//! lost, counted, and the count is written with the next line.

use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use serde::Serialize;
use serde_json::Value;

use crate::sync::wall_time_us;

/// Lines that may wait for the disk.
const MAX_QUEUED: usize = 4096;
/// A file of this size is put away.
const ROTATE_BYTES: u64 = 64 << 20;
/// Most lines, and bytes, that are read back at once.
pub const MAX_READ: usize = 1000;
const READ_BYTES: u64 = 1 << 20;

/// One thing that somebody did.
#[derive(Debug, Clone, Serialize)]
pub struct Deed {
    /// When, µs since the Unix epoch.
    pub unix_us: u64,
    /// Account, or what an operator at this machine calls itself.
    pub who: String,
    /// Role.
    pub role: &'static str,
    /// From where.
    pub from: String,
    /// HTTP method.
    pub method: String,
    /// HTTP path.
    pub path: String,
    /// What was sent, where it is short and no secret.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub body: String,
    /// HTTP status of the answer.
    pub status: u16,
}

/// The log.
#[derive(Debug, Clone)]
pub struct Audit {
    path: PathBuf,
    queue: SyncSender<Deed>,
    lost: Arc<AtomicU64>,
}

impl Audit {
    /// The log of `data_folder`; begins its thread.
    ///
    /// # Errors
    /// No thread.
    pub fn open(data_folder: &Path) -> std::io::Result<Self> {
        let path = data_folder.join("audit.jsonl");
        let (queue, deeds) = sync_channel(MAX_QUEUED);
        let lost = Arc::new(AtomicU64::new(0));
        let writer = Writer { path: path.clone(), file: None, lost: lost.clone(), complained: false };
        std::thread::Builder::new().name("audit".into()).spawn(move || writer.run(&deeds))?;
        Ok(Self { path, queue, lost })
    }

    /// Writes a deed down. Never waits.
    pub fn record(&self, deed: Deed) {
        if self.queue.try_send(deed).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The last `count` deeds, oldest first. Reads the disk.
    ///
    /// # Errors
    /// The file cannot be read; that there is none is no error.
    pub fn last(&self, count: usize) -> std::io::Result<Vec<Value>> {
        let mut file = match File::open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(error),
        };
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(READ_BYTES)))?;
        let mut bytes = Vec::new();
        file.take(READ_BYTES).read_to_end(&mut bytes)?;
        // The first line may have lost its beginning, the last its end: neither is JSON then.
        let text = String::from_utf8_lossy(&bytes);
        let mut deeds: Vec<Value> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        deeds.drain(..deeds.len().saturating_sub(count.min(MAX_READ)));
        Ok(deeds)
    }
}

struct Writer {
    path: PathBuf,
    file: Option<File>,
    lost: Arc<AtomicU64>,
    complained: bool,
}

impl Writer {
    fn run(mut self, deeds: &Receiver<Deed>) {
        for deed in deeds {
            match self.write(&deed) {
                Ok(()) => self.complained = false,
                Err(error) => {
                    self.file = None;
                    self.lost.fetch_add(1, Ordering::Relaxed);
                    if !std::mem::replace(&mut self.complained, true) {
                        tracing::error!(path = %self.path.display(), %error, "the audit log cannot be written");
                    }
                }
            }
        }
    }

    fn write(&mut self, deed: &Deed) -> std::io::Result<()> {
        let mut line = serde_json::to_value(deed).unwrap_or_default();
        let lost = self.lost.swap(0, Ordering::Relaxed);
        if let Some(line) = line.as_object_mut()
            && lost > 0
        {
            line.insert("lost_before".into(), lost.into());
        }
        let written = self.append(&format!("{line}\n"));
        if written.is_err() {
            self.lost.fetch_add(lost, Ordering::Relaxed);
        }
        written
    }

    fn append(&mut self, line: &str) -> std::io::Result<()> {
        use std::os::unix::fs::OpenOptionsExt as _;
        if self.file.as_ref().is_some_and(|file| file.metadata().is_ok_and(|meta| meta.len() >= ROTATE_BYTES)) {
            self.file = None;
            std::fs::rename(&self.path, self.path.with_file_name(format!("audit-{}.jsonl", wall_time_us())))?;
        }
        if self.file.is_none() {
            self.file = Some(OpenOptions::new().append(true).create(true).mode(0o600).open(&self.path)?);
        }
        match &mut self.file {
            // One write: lines of a crash are whole or missing.
            Some(file) => file.write_all(line.as_bytes()),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deeds_are_appended_and_read_back() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("audit.jsonl"), "{\"before\":1}\n").unwrap();
        let audit = Audit::open(folder.path()).unwrap();
        for n in 0..50 {
            audit.record(Deed {
                unix_us: n,
                who: "ann".into(),
                role: "operator",
                from: "192.0.2.1".into(),
                method: "POST".into(),
                path: "/api/vehicles/iris-1/arm".into(),
                body: String::new(),
                status: 200,
            });
        }
        let begun = std::time::Instant::now();
        while audit.last(MAX_READ).unwrap().len() < 51 {
            assert!(begun.elapsed().as_secs() < 10, "{:?}", audit.last(MAX_READ));
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let last = audit.last(2).unwrap();
        assert_eq!((last[0]["unix_us"].as_u64(), last[1]["unix_us"].as_u64()), (Some(48), Some(49)));
        assert_eq!(audit.last(MAX_READ).unwrap()[0]["before"], 1, "what was there stays");
    }
}
