//! What tests, benches and campaigns share. Like a test, it panics where something is not as it must be.
//!
//! - [`flown`], [`walk`]: scenarios and random walks flown in this process, every tick kept.
//! - [`headless`]: scripted flights in this process for benches and reports, nothing kept.
//! - [`envelope`]: how far attacks push that nobody sees, flown.
//! - [`rotors`]: rotors that lose thrust, flown.
//! - [`calibrations`]: files as a fit makes them.
//! - [`effort`]: what a campaign is asked: seeds, flights, world, part.
//! - [`counting`]: an allocator that counts.
//! - [`system`], [`files`], [`kill`]: ground and agent as processes, what they record, and what a kill costs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod calibrations;
pub mod counting;
pub mod effort;
#[cfg(feature = "envelope")]
pub mod envelope;
#[cfg(feature = "system")]
pub mod files;
pub mod flown;
pub mod headless;
#[cfg(feature = "system")]
pub mod kill;
#[cfg(feature = "envelope")]
pub mod rotors;
#[cfg(feature = "system")]
pub mod system;
pub mod walk;

use std::path::{Path, PathBuf};

/// The scenario of that name, with or without its extension, in `tests/scenarios`.
pub fn scenario_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios").join(name).with_extension("toml")
}

/// Memory of a process as the system tells it under `key` (`VmRSS`, `RssAnon`), MiB; 0 where it does not.
pub fn memory_mib(process: u32, key: &str) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':')).unwrap_or("0");
    line.trim().trim_end_matches("kB").trim().parse::<f64>().unwrap_or(0.0) / 1024.0
}
