//! The command line: serving is what happens without a subcommand; tools are subcommands, one file each.

mod account;
mod agents;
mod archive;
mod audit;
mod check;
mod doctor;
mod experiment;
mod export;
#[cfg(feature = "many")]
mod many;
mod serve;
mod settings;

use std::path::PathBuf;

use clap::{Parser, Subcommand};

/// The ground server of Plumbline: records flights, passes commands, serves the page.
#[derive(Debug, Parser)]
#[command(name = "plumbline-ground", version, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    #[command(subcommand)]
    tool: Option<Tool>,
    #[command(flatten)]
    serve: serve::ServeArguments,
}

#[derive(Debug, Subcommand)]
enum Tool {
    /// Makes and changes the accounts that people sign in with.
    Account(account::AccountArguments),
    /// Copies flights to a backup folder, checks it, and puts them back.
    Archive(archive::ArchiveArguments),
    /// Says whether the audit log was changed.
    Audit(audit::AuditArguments),
    /// Says whether flight files are whole; one JSON line for each.
    Check(check::CheckArguments),
    /// Flies plans of many flights, simulated or recorded; reports, and opens any of them.
    Experiment(experiment::ExperimentArguments),
    /// Says whether a ground would start here and record, and what to do where it would not.
    Doctor(doctor::DoctorArguments),
    /// Writes flights as tables (CSV, Parquet, MATLAB), ROS 2 bags or scenes for Foxglove.
    Export(export::ExportArguments),
    /// Takes jobs of experiments from a NATS server, until it is ended.
    #[cfg(feature = "many")]
    Worker(many::WorkerArguments),
    /// Pairs the agent that shows this code.
    Pair(agents::PairArguments),
    /// Shows this ground's fingerprint; trusts or revokes agents.
    Identity(agents::IdentityArguments),
}

/// Where the ground keeps everything.
#[derive(Debug, Clone, clap::Args)]
pub struct DataFolder {
    /// Folder of flight files, index, gains book, identities, accounts and audit log.
    #[arg(long = "data", value_name = "DIR", default_value = "./data")]
    data: PathBuf,
}

impl Arguments {
    /// Does what is asked.
    ///
    /// # Errors
    /// A sentence for people.
    pub fn run(self) -> Result<(), String> {
        match self.tool {
            Some(Tool::Account(arguments)) => account::run(arguments),
            Some(Tool::Archive(arguments)) => archive::run(&arguments),
            Some(Tool::Audit(arguments)) => audit::run(&arguments),
            Some(Tool::Check(arguments)) => check::run(&arguments),
            Some(Tool::Experiment(arguments)) => experiment::run(&arguments),
            Some(Tool::Doctor(arguments)) => doctor::run(&arguments),
            Some(Tool::Export(arguments)) => export::run(&arguments),
            #[cfg(feature = "many")]
            Some(Tool::Worker(arguments)) => many::work(&arguments),
            Some(Tool::Pair(arguments)) => agents::pair(&arguments),
            Some(Tool::Identity(arguments)) => agents::identity(&arguments),
            None => serve::run(&self.serve),
        }
    }
}
