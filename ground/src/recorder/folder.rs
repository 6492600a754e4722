//! The data folder: held by one ground alone, on a disk with some space.

use std::fs::File;
use std::path::Path;

/// A data folder that is held.
#[derive(Debug)]
pub(super) struct Held(File);

impl Drop for Held {
    fn drop(&mut self) {
        // A program that is just being started has a copy of the file for a moment, which would hold the lock after this one is closed.
        let _ = self.0.unlock();
    }
}

/// Holds the data folder for this ground alone.
pub(super) fn lock(folder: &Path) -> Result<Option<Held>, crate::GroundError> {
    let open = || {
        std::fs::create_dir_all(folder)?;
        File::options().write(true).create(true).truncate(false).open(folder.join("lock"))
    };
    // A folder that cannot be written is said loudly by the recorder; flying goes on.
    let Ok(file) = open() else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(Held(file))),
        Err(std::fs::TryLockError::WouldBlock) => Err(crate::GroundError::Locked {
            folder: folder.to_owned(),
            source: std::io::Error::from(std::io::ErrorKind::WouldBlock),
        }),
        Err(std::fs::TryLockError::Error(_)) => Ok(None),
    }
}

/// Free space of the disk that holds `folder`, bytes; of its nearest parent where it does not exist.
pub(super) fn free_bytes(folder: &Path) -> u64 {
    let existing = folder.ancestors().find(|path| path.exists()).unwrap_or(Path::new("/"));
    plumbline_file::free_bytes(existing).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// GIVEN a program that was started while a folder was held WHEN the folder is let go of THEN another may hold it at once.
    #[test]
    fn a_folder_let_go_of_is_free_though_a_program_started_meanwhile_has_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let held = lock(folder.path()).unwrap().unwrap();
        let inherited = held.0.try_clone().unwrap();
        assert!(lock(folder.path()).is_err());
        drop(held);
        assert!(lock(folder.path()).unwrap().is_some());
        drop(inherited);
    }
}
