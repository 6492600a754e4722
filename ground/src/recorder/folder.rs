//! The data folder: held by one ground alone, on a disk with some space.

use std::fs::File;
use std::path::Path;

/// Holds the data folder for this ground alone.
pub(super) fn lock(folder: &Path) -> Result<Option<File>, crate::GroundError> {
    let open = || {
        std::fs::create_dir_all(folder)?;
        File::options().write(true).create(true).truncate(false).open(folder.join("lock"))
    };
    // A folder that cannot be written is said loudly by the recorder; flying goes on.
    let Ok(file) = open() else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
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
