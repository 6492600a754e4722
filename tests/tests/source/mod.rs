//! The source text of the tree, for the tests that read it.
#![allow(dead_code, reason = "each test uses its part")]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The checkout.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

/// Files that git tracks or would track, relative to the root.
pub fn files() -> Vec<PathBuf> {
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root())
        .output()
        .expect("git lists the tree");
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let names = String::from_utf8(listed.stdout).unwrap();
    let files: BTreeSet<_> = names.split('\0').filter(|name| !name.is_empty()).map(PathBuf::from).collect();
    files.into_iter().filter(|file| root().join(file).is_file()).collect()
}

/// Rust files under any of these files or folders, relative to the root.
pub fn rust_files(under: &[&str]) -> Vec<PathBuf> {
    let inside = |file: &PathBuf| under.iter().any(|place| file.starts_with(place));
    // `…/src/…/tests.rs`, and what lies in a folder `tests` there.
    let test = |file: &PathBuf| {
        let mut below = file.iter().skip_while(|part| *part != "src");
        below.any(|part| part == "tests" || part == "tests.rs")
    };
    let rust = |file: &PathBuf| file.extension().is_some_and(|extension| extension == "rs");
    files().into_iter().filter(rust).filter(inside).filter(|file| !test(file)).collect()
}

/// Lines of product code with their numbers: comments, and everything from a `#[cfg(test)] mod … {` on, left out.
pub fn code(file: &Path) -> Vec<(usize, String)> {
    let text = std::fs::read_to_string(root().join(file)).unwrap();
    let mut lines = Vec::new();
    let mut testing = false;
    for (index, line) in text.lines().enumerate() {
        if line.trim() == "#[cfg(test)]" {
            testing = true;
        } else if testing && line.contains("mod ") && line.ends_with('{') {
            break;
        } else {
            testing = false;
        }
        let code = line.split("//").next().unwrap_or_default();
        lines.push((index + 1, code.to_owned()));
    }
    lines
}
