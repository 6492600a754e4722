//! The developer task runner: `cargo xtask run`, `cargo xtask test` and what they are made of.
//!
//! Its own dependencies are few, so that a fresh clone spends its first minute on the product and not on its tools.

mod error;
mod toolchain;
mod web;
mod workspace;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

pub use error::XtaskError;
pub use workspace::Workspace;

/// `cargo xtask`: build, run, test and measure Plumbline.
#[derive(Debug, Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Bundle the page into web/dist: wasm, bindings, hashed names, brotli.
    Web(web::Options),
}

/// Parses the arguments, runs the task, prints its error.
pub fn main() -> ExitCode {
    let Arguments { task } = Arguments::parse();
    let done = Workspace::find().and_then(|workspace| match task {
        Task::Web(options) => web::run(&workspace, &options).map(|_| ExitCode::SUCCESS),
    });
    done.unwrap_or_else(|error| {
        eprintln!("xtask: {error}");
        ExitCode::FAILURE
    })
}
