//! Where the public recordings and the independent references lie, for tests, benches and reports.

use std::path::{Path, PathBuf};

/// Environment variable with the folder that holds `data` and `reference` (or with one of the two).
pub const VARIABLE: &str = "PLUMBLINE_DATA";

/// `file` (`data/…` or `reference/…`) in the folder named by [`VARIABLE`], or in `shared` beside the checkout.
/// Where it is absent: `None`, and a line on standard output that says that it was skipped.
pub fn shared(file: &str) -> Option<PathBuf> {
    // Some crate of the checkout, whichever includes this file.
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find(|folder| folder.join("Cargo.lock").exists());
    let beside = || checkout.unwrap_or(Path::new(".")).join("../shared");
    let root = std::env::var_os(VARIABLE).map_or_else(beside, PathBuf::from);
    let found = [root.join(file), root.join("..").join(file)].into_iter().find(|path| path.exists());
    if found.is_none() {
        println!("skipped: {} is absent", root.join(file).display());
    }
    found
}
