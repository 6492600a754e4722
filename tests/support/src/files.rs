//! What is really in a file: every message, finished file or not.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::Command;

use mcap::records::Record;
use plumbline_agent::recordings::skipped;

/// One message as the file holds it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Logged {
    /// As in the file, `/control` say.
    pub topic: String,
    /// Wall time by the agent's clock, µs.
    pub wall_us: u64,
    /// The encoded message.
    pub data: Vec<u8>,
}

/// Messages by (low half of the) sequence number; a repeated number must repeat its message.
pub fn messages(file: &[u8]) -> BTreeMap<u32, Logged> {
    let mut found: BTreeMap<u32, Logged> = BTreeMap::new();
    let options = mcap::read::Options::IgnoreEndMagic.into();
    let Ok(stream) = mcap::MessageStream::new_with_options(file, options) else { return found };
    for message in stream.map_while(Result::ok) {
        let logged = Logged {
            topic: message.channel.topic.clone(),
            wall_us: message.log_time / 1000,
            data: message.data.into_owned(),
        };
        if let Some(before) = found.insert(message.sequence, logged.clone()) {
            assert_eq!(before, logged, "sequence {} stands for two messages", message.sequence);
        }
    }
    found
}

/// All messages of the files of one folder whose names begin with `prefix`.
pub fn messages_of(folder: &Path, prefix: &str) -> BTreeMap<u32, Logged> {
    let mut found = BTreeMap::new();
    for path in paths(folder, |name| name.starts_with(prefix) && (name.ends_with(".mcap") || name.ends_with(".part"))) {
        found.extend(messages(&std::fs::read(path).unwrap()));
    }
    found
}

/// Files of a folder, sorted by name.
pub fn paths(folder: &Path, wanted: impl Fn(&str) -> bool) -> Vec<std::path::PathBuf> {
    let entries = std::fs::read_dir(folder).map(|entries| entries.flatten().map(|e| e.path()).collect::<Vec<_>>());
    let mut paths = entries.unwrap_or_default();
    paths.retain(|path| path.file_name().and_then(|name| name.to_str()).is_some_and(&wanted));
    paths.sort();
    paths
}

/// Does the file end as a finished one does, with a summary?
pub fn finished(file: &[u8]) -> bool {
    matches!(mcap::Summary::read(file), Ok(Some(summary)) if summary.stats.is_some())
        && mcap::read::LinearReader::new(file).is_ok_and(|mut records| {
            records.all(|record| record.is_ok_and(|record| !matches!(record, Record::Unknown { .. })))
        })
}

/// Messages by topic, of a finished file.
pub fn counts(file: &[u8]) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for message in mcap::MessageStream::new(file).unwrap() {
        *counts.entry(message.unwrap().channel.topic.clone()).or_insert(0) += 1;
    }
    counts
}

/// A Python that has the third-party reader: `PLUMBLINE_PYTHON`, or any. Where there is none, says that it is skipped.
pub fn python() -> Option<OsString> {
    python_with("mcap.reader")
}

/// The same, with other modules.
pub fn python_with(modules: &str) -> Option<OsString> {
    let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
    let import = format!("import {modules}");
    let reads = Command::new(&python).args(["-c", &import]).output().is_ok_and(|ran| ran.status.success());
    if !reads {
        skipped(&format!("no Python with {modules}; `cargo xtask` provides one"));
    }
    reads.then_some(python)
}

/// What `rosbags` finds in a bag: see `tests/browser/bag.py`.
///
/// # Errors
/// What it says of a file that it does not open.
pub fn bag_by(python: &OsStr, file: &Path) -> Result<serde_json::Value, String> {
    read_by(python, "bag.py", &[file.as_os_str()])
}

/// What other people's readers find in the same table as CSV, Parquet and .mat: see `tests/browser/tables.py`.
///
/// # Errors
/// What they say of a file that they do not open.
pub fn tables_by(python: &OsStr, files: [&Path; 3], column: &str, text: &str) -> Result<serde_json::Value, String> {
    let [csv, parquet, mat] = files.map(Path::as_os_str);
    read_by(python, "tables.py", &[csv, parquet, mat, OsStr::new(column), OsStr::new(text)])
}

/// What Octave finds in a .mat file: see `tests/browser/table.m`. Where it is not installed, `None`, and that it is skipped.
///
/// # Errors
/// What it says of a file that it does not open.
pub fn table_by_octave(file: &Path, column: &str) -> Option<Result<serde_json::Value, String>> {
    let octave = OsStr::new("octave-cli");
    if !Command::new(octave).arg("--version").output().is_ok_and(|ran| ran.status.success()) {
        skipped("octave-cli is not installed");
        return None;
    }
    Some(read_by(octave, "table.m", &[file.as_os_str(), OsStr::new(column)]))
}

/// What pymavlink finds at the ground that speaks to `port` of this machine: see `tests/browser/mavlink.py`.
///
/// # Errors
/// What it says when something does not come.
pub fn mavlink_by(python: &OsStr, port: u16) -> Result<serde_json::Value, String> {
    read_by(python, "mavlink.py", &[OsStr::new(&port.to_string())])
}

/// What MAVProxy or MAVSDK finds at the ground that speaks to `port` of this machine: see `tests/browser/stations.py`.
///
/// # Errors
/// What it says when something does not come.
pub fn station_by(python: &OsStr, station: &str, port: u16) -> Result<serde_json::Value, String> {
    read_by(python, "stations.py", &[OsStr::new(station), OsStr::new(&port.to_string())])
}

fn read_by(program: &OsStr, script: &str, arguments: &[&OsStr]) -> Result<serde_json::Value, String> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../browser").join(script);
    let ran = Command::new(program).arg(script).args(arguments).output().unwrap();
    if !ran.status.success() {
        return Err(String::from_utf8_lossy(&ran.stderr).into_owned());
    }
    Ok(serde_json::from_slice(&ran.stdout).unwrap())
}

/// What the third-party reader of MCAP finds in what is exported for Foxglove: see `tests/browser/scene.py`.
///
/// # Errors
/// What it says of a file that it does not open.
pub fn scene_by(python: &OsStr, file: &Path) -> Result<serde_json::Value, String> {
    read_by(python, "scene.py", &[file.as_os_str()])
}

/// Messages by topic, as the third-party reader of [`python`] counts them.
///
/// # Errors
/// What the reader says of a file that it does not open.
pub fn counts_by(python: &OsStr, file: &Path) -> Result<BTreeMap<String, u64>, String> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../browser/count.py");
    let ran = Command::new(python).arg(script).arg(file).output().unwrap();
    if !ran.status.success() {
        return Err(format!("{}: {}", file.display(), String::from_utf8_lossy(&ran.stderr)));
    }
    Ok(serde_json::from_slice(&ran.stdout).unwrap())
}
