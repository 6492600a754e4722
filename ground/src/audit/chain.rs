//! A chain of hashes over the lines: `chain of a line = SHA-256(chain of the line before ‖ the line without it)`.
//!
//! Whoever can write the file can also forge the whole chain: the last hash, kept elsewhere, is what a forged file or one
//! cut short at its end cannot show.

use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::tail;

/// Chain before the first line.
const GENESIS: &str = "0000000000000000000000000000000000000000000000000000000000000000";
const FIELD: &str = ",\"chain\":\"";

/// The line with its hash, and the hash.
pub(super) fn seal(before: &str, line: &str) -> (String, String) {
    let chain = link(before, line);
    let open = line.strip_suffix('}').unwrap_or(line);
    (format!("{open}{FIELD}{chain}\"}}"), chain)
}

fn link(before: &str, line: &str) -> String {
    let digest = Sha256::new_with_prefix(before).chain_update(line).finalize();
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A sealed line without its hash, and the hash.
fn unseal(sealed: &str) -> Option<(String, &str)> {
    let (open, rest) = sealed.rsplit_once(FIELD)?;
    let chain = rest.strip_suffix("\"}")?;
    (chain.len() == GENESIS.len()).then(|| (format!("{open}}}"), chain))
}

/// The files of a log, oldest first.
pub(super) fn files(data_folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(data_folder) else { return Vec::new() };
    let is_part = |name: &str| name.starts_with("audit-") && name.ends_with(".jsonl");
    let mut files: Vec<PathBuf> =
        entries.flatten().filter(|e| e.file_name().to_str().is_some_and(is_part)).map(|e| e.path()).collect();
    files.sort();
    files.push(data_folder.join("audit.jsonl"));
    files
}

/// Hash of the last line of a log.
pub(super) fn last(data_folder: &Path) -> String {
    let of = |path: &PathBuf| {
        let text = tail(path).unwrap_or_default();
        text.lines().rev().find_map(|line| unseal(line).map(|(_, chain)| chain.to_owned()))
    };
    files(data_folder).iter().rev().find_map(of).unwrap_or_else(|| GENESIS.to_owned())
}

/// What a walk along the chain found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Lines that hang together.
    pub chained: u64,
    /// Lines from before there was a chain.
    pub unchained: u64,
    /// Lines that a crash cut short.
    pub torn: u64,
    /// First line, and its file, that does not follow from the one before: it, or one before it, was changed or taken
    /// out.
    pub broken: Option<(String, u64)>,
    /// Hash of the last line.
    pub last: String,
}

/// Walks along the chain of a data folder's log. Reads all of it.
///
/// # Errors
/// A file cannot be read.
pub fn verify(data_folder: &Path) -> std::io::Result<Verdict> {
    let mut found = Verdict { last: GENESIS.to_owned(), ..Verdict::default() };
    for path in files(data_folder) {
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => return Err(error),
        };
        for (number, line) in BufReader::new(file).split(b'\n').enumerate() {
            let line = String::from_utf8_lossy(&line?).into_owned();
            match unseal(&line) {
                Some((body, chain)) if link(&found.last, &body) == chain => {
                    found.chained += 1;
                    chain.clone_into(&mut found.last);
                }
                None if found.chained == 0 => found.unchained += 1,
                None if serde_json::from_str::<serde_json::Value>(&line).is_err() => found.torn += 1,
                _ => {
                    let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
                    found.broken = Some((name, number as u64 + 1));
                    return Ok(found);
                }
            }
        }
    }
    Ok(found)
}
