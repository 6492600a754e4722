//! Where the public recordings and the independent references lie, for tests, benches and reports.

use std::path::{Path, PathBuf};

/// Environment variable with the folder that holds `data` and `reference` (or with one of the two).
pub const VARIABLE: &str = "PLUMBLINE_DATA";

/// `file` (`data/…` or `reference/…`) in the folder named by [`VARIABLE`], or in `shared` beside the checkout.
/// Where it is absent: `None`, and a line on standard output that says that it was skipped.
pub fn shared(file: &str) -> Option<PathBuf> {
    let root = std::env::var_os(VARIABLE)
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let found = [root.join(file), root.join("..").join(file)].into_iter().find(|path| path.exists());
    if found.is_none() {
        println!("skipped: {} is absent", root.join(file).display());
    }
    found
}
