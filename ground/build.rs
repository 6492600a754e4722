//! Makes an empty asset folder, so that a plain `cargo build` works before the page is built.
use std::{env, fs, path::PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let dist = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("../web/dist");
    fs::create_dir_all(&dist)?;
    println!("cargo:rerun-if-changed=build.rs");
    // A ground that is not released reads the page from there as it is now.
    if env::var("PROFILE")? == "release" {
        println!("cargo:rerun-if-changed={}", dist.display());
    }
    Ok(())
}
