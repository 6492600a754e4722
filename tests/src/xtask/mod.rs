//! The developer task runner: `cargo xtask run`, `cargo xtask test` and what they are made of.
//!
//! Its own dependencies are few, so that a fresh clone spends its first minute on the product and not on its tools.

mod bench;
mod browser;
mod campaign;
mod chaos;
mod error;
mod evaluate;
mod fuzz;
mod package;
mod ports;
mod progress;
mod python;
mod reproduce;
mod run;
mod signals;
mod tally;
mod test;
mod toolchain;
mod tools;
mod web;
mod workspace;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

pub use error::XtaskError;
pub use workspace::{Workspace, forget_cargo_run};

/// `cargo xtask`: build, run, test and measure Plumbline.
#[derive(Debug, Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Build everything, start the ground with a simulated quadrotor on strings (or a replay), print the address.
    Run(run::Options),
    /// Every check there is: format, clippy, all tests, the browser. Closing line: `N passed, N failed`.
    Test(test::Options),
    /// Measure what is promised: JSON lines.
    Bench(bench::Options),
    /// Rewrite the committed expectations (wire snapshots, the picture of the rooms) from what the code does now; the commit explains.
    Bless,
    /// The sources' figures beside ours.
    Reproduce(reproduce::Options),
    /// Faults on purpose: what is promised of link and recordings, as JSON lines.
    Chaos(chaos::Options),
    /// Many viewers for long: memory, missed ticks, a complete recording, as JSON lines.
    Soak(chaos::SoakOptions),
    /// Every decoder against damaged input, each for so many minutes, as JSON lines.
    Fuzz(fuzz::FuzzOptions),
    /// Estimators and calibrations against references, recordings, peers and sources: JSON lines and a report.
    Evaluate(evaluate::Options),
    /// What CI runs: `test`.
    Ci,
    /// Debian packages of ground and agent, with their systemd units, for this computer or for the vehicle's.
    Package(package::Options),
    /// Bundle the page into web/dist: wasm, bindings, hashed names, brotli.
    Web(web::Options),
}

/// Parses the arguments, runs the task, prints its error.
pub fn main() -> ExitCode {
    let Arguments { task } = Arguments::parse();
    let done = Workspace::find().and_then(|workspace| match task {
        Task::Run(options) => run::run(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Test(options) => Ok(verdict(test::run(&workspace, &options))),
        Task::Bless => bless(&workspace).map(|()| ExitCode::SUCCESS),
        Task::Bench(options) => bench::run(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Reproduce(options) => reproduce::run(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Chaos(options) => chaos::run(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Soak(options) => chaos::soak(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Fuzz(options) => fuzz::fuzz(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Evaluate(options) => evaluate::run(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Ci => Ok(verdict(test::run(&workspace, &test::Options::default()))),
        Task::Package(options) => package::package(&workspace, &options).map(|()| ExitCode::SUCCESS),
        Task::Web(options) => web::run(&workspace, &options).map(|()| ExitCode::SUCCESS),
    });
    done.unwrap_or_else(|error| {
        eprintln!("xtask: {error}");
        ExitCode::FAILURE
    })
}

fn verdict(good: bool) -> ExitCode {
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn bless(workspace: &Workspace) -> Result<(), XtaskError> {
    let mut cargo = workspace.cargo();
    // The whole workspace: with fewer packages other features would have everything built again.
    cargo.args(["test", "--locked", "--workspace"]);
    cargo.args(["--test", "wire_snapshots", "--test", "rooms"]);
    workspace::run(cargo.env("PLUMBLINE_BLESS", "1"))
}
