//! `plumbline-ground`: see [`cli`].

mod cli;

use std::process::ExitCode;

use clap::Parser as _;

/// One arena for all threads. By default each thread may get its own, and what one of them gave back the others cannot
/// use: two minutes of history, taken by changing threads, came to lie in memory twice and more.
fn share_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: sets a number of the allocator, before there are other threads.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

fn main() -> ExitCode {
    share_memory();
    match cli::Arguments::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(text) => {
            eprintln!("plumbline-ground: {text}");
            ExitCode::FAILURE
        }
    }
}
