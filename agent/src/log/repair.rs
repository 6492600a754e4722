//! Finishes what a killed agent left: an unfinished file gets its summary, so that any reader opens it.
//!
//! Works on files that nobody writes any more, on a thread of its own, and replaces a file only by renaming a complete
//! and synced one over it. What cannot be read at all is set aside as `*.corrupt`, never deleted.

use std::fs::{self, File};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use plumbline_proto::v1::BackfillRequest;

use super::LogError;
use super::archive;
use super::writer::LogFile;

/// The flights in `folder` that were not finished; half-made repairs of before are removed.
pub fn unfinished(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()) {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("tmp") => {
                let _ = fs::remove_file(path);
            }
            Some("mcap") if !finished(&path) => found.push(path),
            _ => {}
        }
    }
    found.sort();
    found
}

fn finished(path: &Path) -> bool {
    let file = || -> std::io::Result<bool> {
        let file = File::open(path)?;
        // The shortest finished file holds both magics.
        Ok(file.metadata()?.len() > 2 * mcap::MAGIC.len() as u64 && plumbline_file::ends_with_magic(&file))
    };
    file().unwrap_or(false)
}

/// Finishes each of `files`; what fails is reported and left as it is.
pub fn finish_all(files: &[PathBuf]) {
    for path in files {
        match finish(path) {
            Ok(messages) => tracing::warn!(file = %path.display(), messages, "an unfinished flight was finished"),
            Err(error) => tracing::error!(%error, "an unfinished flight stays as it is"),
        }
    }
}

/// Answers how many messages could be read.
fn finish(path: &Path) -> Result<u64, LogError> {
    let io = |source| LogError::Io { path: path.to_owned(), source };
    let whole = BackfillRequest { last_sequence: u64::MAX, ..BackfillRequest::default() };
    let Some(metadata) = plumbline_file::metadata(path) else {
        fs::rename(path, with_suffix(path, "corrupt")).map_err(io)?;
        return Ok(0);
    };
    let temporary = with_suffix(path, "tmp");
    let mut made = LogFile::create_at(temporary.clone(), &metadata)?;
    let (mut messages, mut failed) = (0, None);
    let read =
        archive::read(File::open(path).map_err(io)?, path, &mut archive::Known::default(), &whole, &mut |frame| {
            match made.write(frame) {
                Ok(()) => {
                    messages += 1;
                    ControlFlow::Continue(())
                }
                Err(error) => {
                    failed = Some(error);
                    ControlFlow::Break(())
                }
            }
        });
    if let Some(error) = failed {
        return Err(error);
    }
    made.finish()?;
    if let Err(reason) = read {
        // More than an end is missing: the original stays beside what could be read of it.
        tracing::error!(reason, "damaged, set aside as *.corrupt");
        fs::copy(path, with_suffix(path, "corrupt")).map_err(io)?;
    }
    fs::rename(&temporary, path).map_err(io)?;
    Ok(messages)
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(suffix);
    PathBuf::from(name)
}
