//! `cargo xtask evaluate`: estimation and calibration against everything promised of them: references, recordings,
//! peers, the sources' tables, times.

use super::{Workspace, XtaskError, bench, campaign, reproduce};

/// The sources whose tables are about estimation.
const SOURCES: [&str; 2] = ["umasankar", "paternain"];

/// Which noise and flights.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Options {
    /// First seed of what is drawn: noise on GNSS, the flights of [Umasankar] and [Paternain].
    #[arg(long)]
    pub seed_base: Option<u64>,
}

/// Runs it all; JSON lines on standard output, reports under `target`.
///
/// # Errors
/// The first part that could not be run.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let seed_base = options.seed_base.map(|seed| ["--seed-base".to_owned(), seed.to_string()]);
    let arguments: Vec<&str> = seed_base.iter().flatten().map(String::as_str).collect();
    campaign::run(workspace, &campaign::Run { name: "evaluate", dev: false, arguments: &arguments, settings: &[] })?;
    bench::run(workspace, &bench::Options { name: Some("estimate".into()) })?;
    for source in SOURCES {
        let seed_base = options.seed_base;
        let options = reproduce::Options { source: Some(source.into()), seed_base, ..reproduce::Options::default() };
        reproduce::run(workspace, &options)?;
    }
    Ok(())
}
