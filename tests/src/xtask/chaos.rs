//! `cargo xtask chaos CAMPAIGN`: the promises of the link and the recordings under faults, one JSON line a figure.

use std::process::Stdio;

use super::{Workspace, XtaskError, tools, workspace};

/// Which faults, and how many.
#[derive(Debug, Clone, clap::Args)]
pub struct Options {
    /// What goes wrong.
    pub campaign: Campaign,
    /// Chooses the accidents.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How often ground or agent is killed (kill: 20), the power fails (power: 20), the motors are cut beneath each load
    /// (clients: 20), a random walk is flown (sensors: 10 000).
    #[arg(long)]
    pub rounds: Option<u64>,
    /// Length of each phase, s (link: 15, jitter: 7); simulated hours of drift (clock: 25).
    #[arg(long)]
    pub seconds: Option<u64>,
    /// Build without optimisation: starts sooner after a change.
    #[arg(long)]
    pub dev: bool,
}

/// The campaigns, each a program in `tests/campaigns`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Campaign {
    /// A bad radio: loss, bursts, reordering, fades.
    Link,
    /// Ground and agent killed in flight.
    Kill,
    /// The power fails in flight: only what was synced is left.
    Power,
    /// Full and read-only data folders.
    Disk,
    /// The flight thread's timing beside a dead ground, a full link, a slow disk.
    Jitter,
    /// The motor cut beneath the loads of hostile and clumsy clients.
    Clients,
    /// Random commands, lost sensors, weak motors, stalls: the failsafe table's invariants.
    Sensors,
    /// Clocks that drift, stand, are slewed or set; a ground that is stopped.
    Clock,
}

impl Campaign {
    fn program(self) -> &'static str {
        match self {
            Campaign::Link => "chaos_link",
            Campaign::Kill => "chaos_kill",
            Campaign::Power => "chaos_power",
            Campaign::Disk => "chaos_disk",
            Campaign::Jitter => "chaos_jitter",
            Campaign::Clients => "chaos_clients",
            Campaign::Sensors => "chaos_sensors",
            Campaign::Clock => "chaos_clock",
        }
    }
}

/// Builds the programs and runs the campaign.
///
/// # Errors
/// What could not be built, or a promise that was broken.
pub fn run(workspace: &Workspace, options: &Options) -> Result<(), XtaskError> {
    let mut settings = vec![("PLUMBLINE_SEED", options.seed)];
    settings.extend(options.rounds.map(|rounds| ("PLUMBLINE_ROUNDS", rounds)));
    settings.extend(options.seconds.map(|seconds| ("PLUMBLINE_SECONDS", seconds)));
    program(workspace, options.campaign.program(), options.dev, &settings)
}

/// How long to soak.
#[derive(Debug, Clone, clap::Args)]
pub struct SoakOptions {
    /// Length, min; memory is judged from 20 on.
    #[arg(long, default_value_t = 60)]
    pub minutes: u64,
    /// Build without optimisation: starts sooner after a change.
    #[arg(long)]
    pub dev: bool,
}

/// Builds the programs and soaks them.
///
/// # Errors
/// What could not be built, or a promise that was broken.
pub fn soak(workspace: &Workspace, options: &SoakOptions) -> Result<(), XtaskError> {
    program(workspace, "soak", options.dev, &[("PLUMBLINE_MINUTES", options.minutes)])
}

/// Builds ground and agent, then builds and runs a campaign with these settings.
fn program(workspace: &Workspace, name: &str, dev: bool, settings: &[(&str, u64)]) -> Result<(), XtaskError> {
    let (profile, folder) = if dev { ("dev", "debug") } else { ("release", "release") };
    let programs = ["--bin", "plumbline-ground", "--bin", "plumbline-agent"];
    let build = ["build", "--locked", "--workspace", "--profile", profile];
    workspace::run(workspace.cargo().args(build).args(programs))?;
    let mut cargo = workspace.cargo();
    cargo.args(["bench", "--locked", "--workspace", "--bench", name]);
    cargo.args(["--profile", if dev { "dev" } else { "bench" }]).stdin(Stdio::null());
    cargo.env("PLUMBLINE_BINARIES", workspace.target.join(folder));
    if let Ok(python) = tools::python(workspace) {
        cargo.env("PLUMBLINE_PYTHON", python);
    }
    settings.iter().for_each(|(key, value)| {
        cargo.env(key, value.to_string());
    });
    workspace::run(&mut cargo)
}
