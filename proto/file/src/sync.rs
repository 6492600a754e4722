//! Syncs files to the disk on a thread of its own: a slow disk must not delay the next flush, which is what a killed
//! program loses.
//!
//! Bound: [`MAX_FILES`] files waiting, each once. Policy when full: the file says so and asks again at its next flush.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Most files waiting: more vehicles than a ground serves.
const MAX_FILES: usize = 128;
/// After each sync the disk is left alone for as long as it took, and no longer than this.
const LONGEST_REST: Duration = Duration::from_secs(1);

/// A file being written whose bytes outlive a power cut soon after each [`SyncedFile::sync`].
#[derive(Debug)]
pub struct SyncedFile {
    file: File,
    /// The folder, until the file's name in it is on the disk, too.
    folder: Mutex<Option<PathBuf>>,
    /// Asked for and not yet begun.
    waiting: AtomicBool,
    failed: Mutex<Option<io::Error>>,
}

impl SyncedFile {
    /// `file`, just made at `path`.
    pub fn new(file: File, path: &Path) -> Arc<Self> {
        let folder = path.parent().map(Path::to_owned);
        Arc::new(Self { file, folder: Mutex::new(folder), waiting: AtomicBool::new(false), failed: Mutex::new(None) })
    }

    /// The file.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Has everything written so far synced soon. Never waits. `false`: too many files wait, ask again.
    ///
    /// # Errors
    /// What an earlier sync said.
    pub fn sync(self: &Arc<Self>, by: &Syncer) -> io::Result<bool> {
        if let Some(error) = self.failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(error);
        }
        // One that waits will take what was written since.
        if self.waiting.swap(true, Ordering::AcqRel) {
            return Ok(true);
        }
        let accepted = by.queue.try_send(self.clone()).is_ok();
        if !accepted {
            self.waiting.store(false, Ordering::Release);
        }
        Ok(accepted)
    }

    fn sync_now(&self) -> io::Result<()> {
        self.waiting.store(false, Ordering::Release);
        self.file.sync_data()?;
        let mut folder = self.folder.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(path) = folder.as_deref() {
            File::open(path)?.sync_all()?;
            *folder = None;
        }
        Ok(())
    }
}

/// The thread; ends when dropped and idle.
#[derive(Debug, Clone)]
pub struct Syncer {
    queue: SyncSender<Arc<SyncedFile>>,
}

impl Syncer {
    /// Starts the thread.
    ///
    /// # Errors
    /// No thread.
    pub fn start() -> io::Result<Self> {
        let (queue, files) = sync_channel::<Arc<SyncedFile>>(MAX_FILES);
        std::thread::Builder::new().name("sync".into()).spawn(move || {
            for file in files {
                let begun = Instant::now();
                if let Err(error) = file.sync_now() {
                    *file.failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                }
                // A slow disk has half its time for others.
                std::thread::sleep(begun.elapsed().min(LONGEST_REST));
            }
        })?;
        Ok(Self { queue })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_waits_once_and_a_full_queue_says_so() {
        let folder = tempfile::tempdir().unwrap();
        // Nobody takes anything out.
        let (queue, files) = sync_channel(1);
        let syncer = Syncer { queue };
        let made = |name: &str| {
            let path = folder.path().join(name);
            SyncedFile::new(File::create(&path).unwrap(), &path)
        };
        let (first, second) = (made("first"), made("second"));
        assert!(first.sync(&syncer).unwrap() && first.sync(&syncer).unwrap());
        assert!(!second.sync(&syncer).unwrap(), "only one fits");
        files.recv().unwrap().sync_now().unwrap();
        assert!(first.folder.lock().unwrap().is_none(), "its name is on the disk");
        assert!(second.sync(&syncer).unwrap());
        drop(files);
        assert!(!first.sync(&syncer).unwrap(), "without the thread nothing is synced");
    }
}
