//! Small files, written whole.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

/// Writes a file so that a crash leaves the old or the new content, never a part; its folder is made where there is none. Of several
/// that write it at once, also from other processes, each writes all of it, one after the other.
///
/// # Errors
/// The disk.
pub fn write_atomically(path: &Path, content: &[u8]) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let mut name = path.as_os_str().to_owned();
    name.push(".tmp");
    let temporary = PathBuf::from(name);
    let mut file = held(&temporary)?;
    file.write_all(content)?;
    file.sync_all()?;
    fs::rename(&temporary, path)
}

/// Begins a file that nobody else is writing. Its name is always the same, so that crashes leave at most one; whoever comes second
/// waits until the first has renamed it, and begins another.
fn held(path: &Path) -> io::Result<File> {
    loop {
        let file = File::options().write(true).create(true).truncate(false).open(path)?;
        // Not every disk knows locks: there, as if nobody else wrote.
        let _ = file.lock();
        let opened = file.metadata()?;
        match fs::metadata(path) {
            Ok(named) if (named.dev(), named.ino()) == (opened.dev(), opened.ino()) => {
                file.set_len(0)?;
                return Ok(file);
            }
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_writers_of_a_file_each_write_all_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("made/here/f.json");
        std::thread::scope(|scope| {
            for writer in 1..=8_u8 {
                let path = &path;
                scope.spawn(move || {
                    for _ in 0..10 {
                        write_atomically(path, &vec![writer; 1000 * usize::from(writer)]).unwrap();
                        let read = fs::read(path).unwrap();
                        assert_eq!(read, vec![read[0]; 1000 * usize::from(read[0])]);
                    }
                });
            }
        });
        let left: Vec<_> = fs::read_dir(path.parent().unwrap()).unwrap().flatten().map(|e| e.file_name()).collect();
        assert_eq!(left, ["f.json"]);
        // What a crash left is no part of what is written next.
        fs::write(path.with_extension("json.tmp"), [7; 5000]).unwrap();
        write_atomically(&path, b"short").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"short");
    }
}
