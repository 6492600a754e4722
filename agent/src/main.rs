//! `plumbline-agent`: chooses a vehicle, starts the flight thread beside log and link.

#![warn(clippy::print_stdout)]

mod cli;

use std::error::Error;
use std::io::{self, IsTerminal as _};
use std::process::ExitCode;

use clap::Parser;
use tracing_subscriber::EnvFilter;

/// What a shell says of a program whose reader went away: 128 and SIGPIPE.
const READER_GONE: u8 = 141;

fn main() -> ExitCode {
    let arguments = cli::Arguments::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let colours = io::stderr().is_terminal();
    // A thread of its own writes: a terminal that takes no more lines (Ctrl-S, a full pipe) holds up no flight.
    let (writer, _written) = tracing_appender::non_blocking(io::stderr());
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer).with_ansi(colours).init();
    match arguments.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if reader_gone(&*error) => ExitCode::from(READER_GONE),
        Err(error) => {
            eprintln!("plumbline-agent: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Did whoever read the output have enough of it, as `head` does?
fn reader_gone(error: &(dyn Error + 'static)) -> bool {
    let mut causes = std::iter::successors(Some(error), |error: &&(dyn Error + 'static)| (*error).source());
    causes.any(|cause| cause.downcast_ref().is_some_and(|e: &io::Error| e.kind() == io::ErrorKind::BrokenPipe))
}
