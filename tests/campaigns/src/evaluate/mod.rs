//! `cargo xtask evaluate`: the estimators against independent references, public recordings and what peers reach on
//! them. Every figure is a JSON line with its target and whether it is met; the page has the errors over time.
//!
//! One file per group. Recordings are those found in the folders of the public data, whatever their names: the same
//! program runs on others. Parameters are the same for all of them. Noise is added to GNSS: `--seed-base N` adds another.

mod attitude;
mod calibration;
mod golden;
mod magnet;
mod position;
mod scored;

use std::path::PathBuf;

use plumbline_agent::recordings::shared;
use plumbline_support::effort::{Effort, Knows};
use plumbline_tests::report::{Report, ReportError};
use scored::Scored;

pub fn run() -> Result<(), ReportError> {
    let effort = Effort::of_program(Knows { seed: 1, flights: None, worlds: false, parts: false });
    let report = Report::open("evaluate", "estimation", "Estimation against references, recordings and peers")?;
    let mut scored = Scored::new(report);
    golden::golden(&mut scored);
    attitude::broad(&mut scored)?;
    magnet::standing_magnets(&mut scored);
    attitude::px4(&mut scored)?;
    position::rotorpy(&mut scored)?;
    position::phantom4(&mut scored, &effort)?;
    calibration::calibration(&mut scored);
    scored.finish()
}

/// The entries of a folder of the public data that `wanted` accepts, sorted; `None` where the folder is absent.
fn entries(folder: &str, wanted: impl Fn(&PathBuf) -> bool) -> Option<Vec<PathBuf>> {
    let read = std::fs::read_dir(shared(folder)?).ok()?;
    let mut paths: Vec<PathBuf> = read.filter_map(|entry| Some(entry.ok()?.path())).filter(wanted).collect();
    paths.sort();
    Some(paths)
}

/// Name of a file or folder without its extensions.
fn stem(path: &std::path::Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().unwrap_or_default().to_owned()
}
