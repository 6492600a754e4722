//! Syncs files to the disk on a thread of its own: a slow disk must not delay the next flush, which is what a killed
//! program loses.
//!
//! Bound: one file waiting and one being synced. Policy when full: not asked again; the next time covers it.

use std::fs::File;
use std::io;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

/// The thread; ends when dropped and idle.
#[derive(Debug, Clone)]
pub struct Syncer {
    queue: SyncSender<Arc<File>>,
    failed: Arc<Mutex<Option<io::Error>>>,
}

impl Syncer {
    /// Starts the thread.
    ///
    /// # Errors
    /// No thread.
    pub fn start() -> io::Result<Self> {
        let (queue, files) = sync_channel::<Arc<File>>(1);
        let failed = Arc::new(Mutex::new(None));
        let syncer = Self { queue, failed: failed.clone() };
        std::thread::Builder::new().name("sync".into()).spawn(move || {
            for file in files {
                if let Err(error) = file.sync_data() {
                    *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                }
            }
        })?;
        Ok(syncer)
    }

    /// Has `file` synced soon. Never waits.
    ///
    /// # Errors
    /// What an earlier sync said.
    pub fn sync(&self, file: &Arc<File>) -> io::Result<()> {
        let _ = self.queue.try_send(file.clone());
        match self.failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }
}
