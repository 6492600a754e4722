//! `plumbline-ground`: see [`cli`].

mod cli;

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    match cli::Arguments::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(text) => {
            eprintln!("plumbline-ground: {text}");
            ExitCode::FAILURE
        }
    }
}
