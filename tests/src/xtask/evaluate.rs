//! `cargo xtask evaluate`: estimation and calibration against everything promised of them: references, recordings,
//! peers, the sources' tables, times.

use super::{Workspace, XtaskError, bench, campaign, reproduce};

/// The sources whose tables are about estimation.
const SOURCES: [&str; 2] = ["umasankar", "paternain"];

/// Runs it all; JSON lines on standard output, reports under `target`.
///
/// # Errors
/// The first part that could not be run.
pub fn run(workspace: &Workspace) -> Result<(), XtaskError> {
    campaign::run(workspace, &campaign::Run { name: "evaluate", dev: false, arguments: &[], settings: &[] })?;
    bench::run(workspace, &bench::Options { name: Some("estimate".into()) })?;
    for source in SOURCES {
        reproduce::run(
            workspace,
            &reproduce::Options { source: Some(source.into()), ..reproduce::Options::default() },
        )?;
    }
    Ok(())
}
