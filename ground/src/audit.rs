//! Who did what: every request that changes something, every one that is refused, and everybody who signs in or out, one
//! JSON line each, appended to `audit.jsonl` in the data folder. Nothing is ever taken out; a file that has grown to
//! [`ROTATE_BYTES`] is kept under the time of its end and a new one begun.
//!
//! Each line carries a hash of itself and of the line before ([`chain`]), so that a line changed or taken out later
//! shows; [`verify`] walks the chain. Refused requests are gathered by address and status ([`refusals`]): a stranger
//! cannot fill the disk.
//!
//! A thread of its own writes, and syncs within [`SYNC_EVERY`]: no command waits for a disk. Bound: [`MAX_QUEUED`]
//! lines. Policy when full: the newest is lost, counted, and the count is written with the next line.

mod chain;
mod refusals;

use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::IgnoredAny;
use serde_json::Value;

pub use chain::{Verdict, verify};
use refusals::Refusals;

use crate::sync::{lock, wall_time_us};

/// Lines that may wait for the disk.
const MAX_QUEUED: usize = 4096;
/// A file of this size is put away.
const ROTATE_BYTES: u64 = 64 << 20;
/// Most bytes of a file's end that are looked at for its last line.
const READ_BYTES: u64 = 1 << 20;
/// Bytes read back at once.
const BLOCK: u64 = 64 << 10;
/// What was written is on the disk after this long.
pub const SYNC_EVERY: Duration = Duration::from_secs(1);
/// Fields of a body that are never written down.
const SECRETS: [&str; 3] = ["password", "code", "secret"];
/// Bodies up to this length are written down.
const MAX_BODY: usize = 1024;

/// One thing that somebody did, or was refused.
#[derive(Debug, Clone, PartialEq, Serialize)]
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
    /// What was sent, where it is short, without its secrets.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub body: String,
    /// HTTP status of the answer.
    pub status: u16,
    /// How many like this there were, where they are gathered: this is the last of them.
    #[serde(skip_serializing_if = "once")]
    pub times: u64,
}

fn once(times: &u64) -> bool {
    *times == 1
}

/// A body as it may be written down: short, JSON, without its secrets.
pub fn redacted(body: &[u8]) -> String {
    fn redact(value: &mut Value) {
        match value {
            Value::Object(fields) => fields.iter_mut().for_each(|(name, value)| {
                if SECRETS.contains(&name.as_str()) {
                    *value = "redacted".into();
                } else {
                    redact(value);
                }
            }),
            Value::Array(items) => items.iter_mut().for_each(redact),
            _ => {}
        }
    }
    if body.is_empty() {
        return String::new();
    }
    match serde_json::from_slice(body) {
        Ok(mut value) if body.len() <= MAX_BODY => {
            redact(&mut value);
            value.to_string()
        }
        _ => format!("{} bytes", body.len()),
    }
}

#[derive(Debug)]
enum Input {
    Deed(Box<Deed>),
    /// Write and sync everything, then answer.
    Flush(SyncSender<()>),
}

/// The log.
#[derive(Debug, Clone)]
pub struct Audit {
    folder: PathBuf,
    queue: SyncSender<Input>,
    lost: Arc<AtomicU64>,
    refusals: Arc<Mutex<Refusals>>,
}

impl Audit {
    /// The log of `data_folder`; begins its thread.
    ///
    /// # Errors
    /// No thread.
    pub fn open(data_folder: &Path) -> std::io::Result<Self> {
        let path = data_folder.join("audit.jsonl");
        let (queue, inputs) = sync_channel(MAX_QUEUED);
        let lost = Arc::new(AtomicU64::new(0));
        let refusals = Arc::new(Mutex::new(Refusals::default()));
        let writer = Writer {
            path,
            file: None,
            chain: chain::last(data_folder),
            lost: lost.clone(),
            refusals: refusals.clone(),
            complained: false,
            unsynced: None,
        };
        std::thread::Builder::new().name("audit".into()).spawn(move || writer.run(&inputs))?;
        Ok(Self { folder: data_folder.to_owned(), queue, lost, refusals })
    }

    /// Writes a deed down. Never waits.
    pub fn record(&self, deed: Deed) {
        if self.queue.try_send(Input::Deed(Box::new(deed))).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Waits until everything is on the disk: the last thing a ground does.
    pub fn flush(&self) {
        let (answer, answered) = sync_channel(1);
        if self.queue.send(Input::Flush(answer)).is_ok() {
            let _ = answered.recv();
        }
    }

    /// Writes down that a request was refused: the first of an address and status at once, further ones together.
    pub fn refuse(&self, deed: Deed) {
        if let Some(first) = lock(&self.refusals).take(deed, Instant::now()) {
            tracing::warn!(from = first.from, who = first.who, path = first.path, status = first.status, "refused");
            self.record(first);
        }
    }

    /// The last `limit` deeds before the last `offset`, oldest first, of those in all files of the log whose line `found` takes.
    /// Reads the disk.
    ///
    /// # Errors
    /// A file cannot be read; that there is none is no error.
    pub fn page(&self, offset: usize, limit: usize, found: impl Fn(&str) -> bool) -> std::io::Result<Vec<Value>> {
        let (mut before, mut deeds) = (offset, Vec::new());
        for path in chain::files(&self.folder).iter().rev() {
            if deeds.len() >= limit {
                break;
            }
            // A line that a crash cut short is no deed.
            backwards(path, |line| {
                if !std::str::from_utf8(line).is_ok_and(&found) {
                    // Not asked for.
                } else if before > 0 {
                    before -= usize::from(serde_json::from_slice::<IgnoredAny>(line).is_ok());
                } else if deeds.len() < limit {
                    deeds.extend(serde_json::from_slice::<Value>(line));
                }
                deeds.len() < limit
            })?;
        }
        deeds.reverse();
        Ok(deeds)
    }
}

/// Shows `take` the lines of a file, the last first, while it wants more; a file that is not there has none.
fn backwards(path: &Path, mut take: impl FnMut(&[u8]) -> bool) -> std::io::Result<()> {
    use std::os::unix::fs::FileExt as _;
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error),
    };
    let mut at = file.metadata()?.len();
    // The end of a line whose beginning has not been read yet.
    let mut rest = Vec::new();
    while at > 0 {
        let length = at.min(BLOCK);
        at -= length;
        let mut block = vec![0; length as usize];
        file.read_exact_at(&mut block, at)?;
        block.append(&mut rest);
        let begin = if at == 0 { Some(0) } else { block.iter().position(|byte| *byte == b'\n').map(|end| end + 1) };
        let whole = begin.and_then(|begin| block.get(begin..)).unwrap_or_default();
        if !whole.rsplit(|byte| *byte == b'\n').all(&mut take) {
            return Ok(());
        }
        block.truncate(begin.unwrap_or(block.len()));
        rest = block;
    }
    Ok(())
}

/// The end of a file; empty where there is none.
fn tail(path: &Path) -> std::io::Result<String> {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(String::new()),
        Err(error) => return Err(error),
    };
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(READ_BYTES)))?;
    let mut bytes = Vec::new();
    file.take(READ_BYTES).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

struct Writer {
    path: PathBuf,
    file: Option<File>,
    /// Hash of the last line.
    chain: String,
    lost: Arc<AtomicU64>,
    refusals: Arc<Mutex<Refusals>>,
    complained: bool,
    /// Since when something is not synced.
    unsynced: Option<Instant>,
}

impl Writer {
    fn run(mut self, inputs: &Receiver<Input>) {
        loop {
            match inputs.recv_timeout(SYNC_EVERY / 2) {
                Ok(Input::Deed(deed)) => self.take(&deed),
                Ok(Input::Flush(answer)) => {
                    self.catch_up(true);
                    let _ = answer.send(());
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.catch_up(true),
            }
            self.catch_up(false);
        }
    }

    /// Writes what was gathered, and syncs: what is due, or `all`.
    fn catch_up(&mut self, all: bool) {
        let gathered = lock(&self.refusals).due(Instant::now(), all);
        for deed in gathered {
            tracing::warn!(from = deed.from, status = deed.status, times = deed.times, "refused again");
            self.take(&deed);
        }
        if self.unsynced.is_some_and(|since| all || since.elapsed() >= SYNC_EVERY / 2) {
            self.unsynced = None;
            if let Some(Err(error)) = self.file.as_ref().map(File::sync_data) {
                self.complain(&error);
            }
        }
    }

    fn take(&mut self, deed: &Deed) {
        match self.write(deed) {
            Ok(()) => {
                self.complained = false;
                self.unsynced.get_or_insert_with(Instant::now);
            }
            Err(error) => {
                self.file = None;
                self.lost.fetch_add(1, Ordering::Relaxed);
                self.complain(&error);
            }
        }
    }

    fn complain(&mut self, error: &std::io::Error) {
        if !std::mem::replace(&mut self.complained, true) {
            tracing::error!(path = %self.path.display(), %error, "the audit log cannot be written");
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
        let (line, chain) = chain::seal(&self.chain, &line.to_string());
        let written = self.append(&format!("{line}\n"));
        match written {
            Ok(()) => self.chain = chain,
            Err(_) => drop(self.lost.fetch_add(lost, Ordering::Relaxed)),
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
            let mut file = OpenOptions::new().append(true).create(true).mode(0o600).open(&self.path)?;
            // What a crash cut short stays a line of its own.
            if !tail(&self.path)?.is_empty() && !tail(&self.path)?.ends_with('\n') {
                file.write_all(b"\n")?;
            }
            self.file = Some(file);
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

    pub(super) fn deed(unix_us: u64) -> Deed {
        Deed {
            unix_us,
            who: "ann".into(),
            role: "operator",
            from: "192.0.2.1".into(),
            method: "POST".into(),
            path: "/api/v1/vehicles/iris-1/arm".into(),
            body: String::new(),
            status: 200,
            times: 1,
        }
    }

    #[test]
    fn deeds_are_appended_chained_and_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("audit.jsonl");
        std::fs::write(&path, "{\"before\":1}\n").unwrap();
        let audit = Audit::open(folder.path()).unwrap();
        (0..50).for_each(|n| audit.record(deed(n)));
        audit.flush();
        assert_eq!(audit.page(0, 1000, |_| true).unwrap().len(), 51);
        let last = audit.page(0, 2, |_| true).unwrap();
        assert_eq!((last[0]["unix_us"].as_u64(), last[1]["unix_us"].as_u64()), (Some(48), Some(49)));
        assert_eq!(audit.page(0, 1000, |_| true).unwrap()[0]["before"], 1, "what was there stays");
        // A crash cuts a line short; the next start goes on after it.
        drop(audit);
        let mut text = std::fs::read_to_string(&path).unwrap();
        text.push_str("{\"unix_us\":50,\"wh");
        std::fs::write(&path, &text).unwrap();
        let audit = Audit::open(folder.path()).unwrap();
        audit.record(deed(51));
        audit.flush();
        let verdict = verify(folder.path()).unwrap();
        assert_eq!((verdict.chained, verdict.unchained, verdict.torn, verdict.broken), (51, 1, 1, None));
        // A line changed, and one taken out, show.
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("\"unix_us\":7,", "\"unix_us\":8,")).unwrap();
        assert_eq!(verify(folder.path()).unwrap().broken, Some(("audit.jsonl".into(), 9)));
        let without: String =
            text.lines().filter(|l| !l.contains("\"unix_us\":30,")).map(|l| format!("{l}\n")).collect();
        std::fs::write(&path, without).unwrap();
        assert_eq!(verify(folder.path()).unwrap().broken, Some(("audit.jsonl".into(), 32)));
    }

    #[test]
    fn pages_follow_each_other_over_blocks_files_and_torn_lines() {
        let folder = tempfile::tempdir().unwrap();
        let line = |n: u64| format!("{{\"unix_us\":{n},\"body\":\"{}\"}}\n", "x".repeat((n as usize * 37) % 900));
        let text = |range: std::ops::Range<u64>| range.map(line).collect::<String>();
        let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
        write("audit-1700000000000001.jsonl", text(0..400));
        write("audit-1700000000000002.jsonl", text(400..700) + "{\"unix_us\":9999,\"wh");
        let last = text(700..1500);
        assert!(last.len() as u64 > 3 * BLOCK, "several blocks");
        write("audit.jsonl", last + "{\"unix_us\":9999,\"wh");
        let audit = Audit::open(folder.path()).unwrap();
        let page = |offset, limit| {
            let deeds = audit.page(offset, limit, |_| true).unwrap();
            deeds.iter().map(|deed| deed["unix_us"].as_u64().unwrap()).collect::<Vec<_>>()
        };
        let all: Vec<u64> = (0..1500).collect();
        for (offset, limit) in [(0, 1), (0, 1000), (700, 200), (799, 2), (1000, 1000), (1499, 5), (1500, 5), (0, 5000)]
        {
            let end = 1500 - offset.min(1500);
            assert_eq!(page(offset, limit), all[end.saturating_sub(limit)..end], "{offset} {limit}");
        }
        // Pages of any size are all of it, once.
        let mut whole = Vec::new();
        while whole.len() < 1500 {
            whole.splice(0..0, page(whole.len(), 170));
        }
        assert_eq!(whole, all);
        // Those that are searched for are passed over and counted alone.
        let fifth = |line: &str| {
            line.split(['{', ',']).any(|part| part.starts_with("\"unix_us\":") && part.ends_with(['0', '5']))
        };
        let found = audit.page(10, 3, fifth).unwrap();
        assert_eq!(found.iter().map(|deed| deed["unix_us"].as_u64().unwrap()).collect::<Vec<_>>(), [1435, 1440, 1445]);
    }

    #[test]
    fn refusals_of_one_address_are_a_line_at_once_and_one_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let audit = Audit::open(folder.path()).unwrap();
        for n in 0..100_000 {
            audit.refuse(Deed { who: format!("guess {n}"), status: 401, ..deed(n) });
        }
        audit.flush();
        let text = std::fs::read_to_string(folder.path().join("audit.jsonl")).unwrap();
        assert!(text.lines().count() == 2 && text.contains("\"times\":99999") && text.len() < 1000, "{text}");
    }

    #[test]
    fn secrets_are_not_written_down() {
        let body = br#"{"code":"ABCD-EFGH","nested":[{"password":"x"}],"mode":"hold"}"#;
        assert_eq!(redacted(body), r#"{"code":"redacted","mode":"hold","nested":[{"password":"redacted"}]}"#);
        assert_eq!(redacted(b"name=ann&password=secret"), "24 bytes");
        assert_eq!(redacted(&[b'1'; 2000]), "2000 bytes");
        assert_eq!(redacted(b""), "");
    }
}
