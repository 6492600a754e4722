//! `plumbline-ground`: see [`cli`].
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod cli;

use std::process::ExitCode;

use clap::Parser as _;

/// Large blocks come from the system and go back to it whole.
const LARGE_BYTES: i32 = 128 << 10;

/// One arena for all threads. By default each thread may get its own, and what one of them gave back the others cannot
/// use: two minutes of history, taken by changing threads, came to lie in memory twice and more. And by default the
/// first large block given back makes all others come from the arena, too, which they leave in pieces.
fn share_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: sets numbers of the allocator, before there are other threads.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1);
        libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BYTES);
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
