//! The program of all campaigns, `plumbline-campaigns`: built once, started with a campaign's name.

use std::ffi::OsString;
use std::process::{Command, Stdio};

use super::{Workspace, XtaskError, workspace};

const PROGRAM: &str = "plumbline-campaigns";

/// A campaign and how it is run.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// Its name among those of the program.
    pub name: &'a str,
    /// Without optimisation: starts sooner after a change.
    pub dev: bool,
    /// Its arguments.
    pub arguments: &'a [&'a str],
    /// Its environment variables.
    pub settings: &'a [(&'a str, OsString)],
}

/// Builds ground, agent and the campaigns, then runs one of them. Built with the whole workspace: a package alone would
/// ask other features of the libraries, and build them again.
///
/// # Errors
/// What could not be built, or a campaign that failed.
pub fn run(workspace: &Workspace, run: &Run) -> Result<(), XtaskError> {
    let (profile, folder) = if run.dev { ("dev", "debug") } else { ("release", "release") };
    let mut build = workspace.cargo();
    build.args(["build", "--locked", "--workspace", "--profile", profile]);
    build.args(["--bin", "plumbline-ground", "--bin", "plumbline-agent", "--bin", PROGRAM]);
    workspace::run(&mut build)?;
    let binaries = workspace.target.join(folder);
    let mut campaign = Command::new(binaries.join(format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX)));
    campaign.arg(run.name).args(run.arguments).envs(run.settings.iter().cloned());
    campaign.current_dir(&workspace.root).env("PLUMBLINE_BINARIES", &binaries).stdin(Stdio::null());
    workspace::run(&mut campaign)
}
