//! `plumbline-campaigns NAME`: what takes minutes or hours and ends in figures: faults on purpose, soaking, the sources'
//! tables beside ours. `cargo xtask chaos`, `soak`, `reproduce` and `evaluate` build and start it.
//!
//! Ground and agent are taken from the folder that `PLUMBLINE_BINARIES` names, or from beside this program. Like a
//! test, a campaign panics where something is not as it must be.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod attacks;
mod chaos_clients;
mod chaos_clock;
mod chaos_disk;
mod chaos_jitter;
mod chaos_kill;
mod chaos_link;
mod chaos_power;
mod chaos_sensors;
mod clinic;
mod disk;
mod envelope;
mod evaluate;
mod figures;
mod paternain;
mod rotors;
mod soak;
mod strategies;
mod umasankar;
mod witness;

use std::process::{ExitCode, Termination as _};

/// A campaign's name and what runs it.
type Campaign = (&'static str, fn() -> ExitCode);

const CAMPAIGNS: [Campaign; 17] = [
    ("attacks", || attacks::run().report()),
    ("chaos_clients", chaos_clients::run),
    ("chaos_clock", chaos_clock::run),
    ("chaos_disk", chaos_disk::run),
    ("chaos_jitter", chaos_jitter::run),
    ("chaos_kill", chaos_kill::run),
    ("chaos_link", chaos_link::run),
    ("chaos_power", chaos_power::run),
    ("chaos_sensors", chaos_sensors::run),
    ("clinic", clinic::run),
    ("envelope", || envelope::run().report()),
    ("evaluate", || evaluate::run().report()),
    ("paternain", paternain::run),
    ("rotors", || rotors::run().report()),
    ("soak", soak::run),
    ("strategies", || strategies::run().report()),
    ("umasankar", umasankar::run),
];

fn main() -> ExitCode {
    let name = std::env::args().nth(1).unwrap_or_default();
    match CAMPAIGNS.iter().find(|(known, _)| *known == name) {
        Some((_, run)) => run(),
        None => {
            let names = CAMPAIGNS.map(|(known, _)| known).join(", ");
            eprintln!("no campaign is called `{name}`; there are: {names}");
            ExitCode::FAILURE
        }
    }
}
