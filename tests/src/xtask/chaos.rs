//! `cargo xtask chaos CAMPAIGN`: the promises of the link and the recordings under faults, one JSON line a figure.

use std::ffi::OsString;

use super::{Workspace, XtaskError, campaign, tools};

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

/// The campaigns, each a module in `tests/campaigns`.
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
    fn name(self) -> &'static str {
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
    start(workspace, options.campaign.name(), options.dev, &settings)
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
    start(workspace, "soak", options.dev, &[("PLUMBLINE_MINUTES", options.minutes)])
}

/// Runs a campaign with these numbers, and with the third-party reader: without pip it says itself what it skips.
fn start(workspace: &Workspace, name: &str, dev: bool, numbers: &[(&str, u64)]) -> Result<(), XtaskError> {
    let mut settings: Vec<_> = numbers.iter().map(|(key, value)| (*key, OsString::from(value.to_string()))).collect();
    settings.extend(tools::python(workspace).ok().map(|python| ("PLUMBLINE_PYTHON", python.into())));
    campaign::run(workspace, &campaign::Run { name, dev, arguments: &[], settings: &settings })
}
