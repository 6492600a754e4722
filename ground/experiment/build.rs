//! A hash of everything that decides how a flight goes and what is expected of it: the sources of the agent, its simulator and worlds, the model of an
//! attack, the readers of recordings, of this crate, and
//! the versions of what others wrote. A result never mixes flights of two programs.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// What is hashed, from this crate's folder.
const SOURCES: [&str; 7] = [
    "../../agent/analysis/src/envelope",
    "../../agent/analysis/src/recordings",
    "../../agent/core/src",
    "../../agent/sim",
    "../../agent/src",
    "../../proto/schema",
    "src",
];
const LOCK: &str = "../../Cargo.lock";

fn main() -> std::io::Result<()> {
    let mut files = vec![PathBuf::from(LOCK)];
    for folder in SOURCES {
        println!("cargo::rerun-if-changed={folder}");
        gather(Path::new(folder), &mut files)?;
    }
    println!("cargo::rerun-if-changed={LOCK}");
    files.sort();
    let mut hash = Sha256::new();
    for file in files {
        let content = std::fs::read(&file)?;
        hash.update(file.to_string_lossy().as_bytes());
        hash.update((content.len() as u64).to_le_bytes());
        hash.update(content);
    }
    let hex: String = hash.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    println!("cargo::rustc-env=PLUMBLINE_SOURCES={hex}");
    Ok(())
}

fn gather(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            gather(&path, files)?;
        } else if path
            .extension()
            .is_some_and(|extension| extension == "rs" || extension == "toml" || extension == "proto")
        {
            files.push(path);
        }
    }
    Ok(())
}
