//! Where the public recordings and the independent references lie, for tests, benches and reports.

use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Environment variable with the folder that holds `data` and `reference` (or with one of the two).
pub const VARIABLE: &str = "PLUMBLINE_DATA";

/// File to which a line is added for each thing that is absent: `cargo xtask test` counts the tests in it as skipped.
pub const SKIPPED: &str = "PLUMBLINE_SKIPPED";

/// `file` (`data/…` or `reference/…`) in the folder named by [`VARIABLE`], or in `shared` beside the checkout, or its
/// excerpt among the fixtures. Where it is absent: `None`, and a line that says that it was skipped.
pub fn shared(file: &str) -> Option<PathBuf> {
    // Some crate of the checkout, whichever includes this file.
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find(|folder| folder.join("Cargo.lock").exists());
    let checkout = checkout.unwrap_or(Path::new("."));
    let root = std::env::var_os(VARIABLE).map_or_else(|| checkout.join("../shared"), PathBuf::from);
    let excerpt = checkout.join("tests/fixtures").join(file);
    let whole = [root.join(file), root.join("..").join(file)].into_iter().find(|path| path.exists());
    let found = whole.or_else(|| Some(excerpt).filter(|path| path.is_file()));
    if found.is_none() {
        println!("{} is looked for", root.join(file).display());
        skipped(&format!("{file} is absent"));
    }
    found
}

/// Says that the test that runs on this thread is skipped, and why.
pub fn skipped(why: &str) {
    println!("skipped: {why}");
    let told = std::env::var_os(SKIPPED).and_then(|list| std::fs::File::options().append(true).open(list).ok());
    if let Some(mut list) = told {
        let test = std::thread::current().name().unwrap_or("?").to_owned();
        // One write: tests run beside each other.
        let _ = list.write_all(format!("{test}: {why}\n").as_bytes());
    }
}
