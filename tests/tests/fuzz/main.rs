//! Whatever reads what others wrote, against damaged and odd input: no panic, no endless work, no unbounded memory.
//!
//! - [`decoders`]: valid bytes, damaged at random. What they reach ends at the first check that fails.
//! - [`devices`]: the same for what is on the wires of devices, which is found again after it, too.
//! - [`content`] and [`served`]: well-formed input whose content is odd, chosen field by field from the contract's own
//!   description, so that checksums, framing and types pass and what lies behind them is reached.
//!
//! Half a second for each in the test suite; `cargo xtask fuzz --minutes N` gives each of them so many minutes (of its
//! thread's processor time where it has but one thread), in pieces of a minute with a seed and a JSON line each: what was
//! done before an interruption counts, and `--seed` goes on from there. `--coverage` tells which lines they reach. A
//! failure says so in a JSON line and keeps the input in `target/fuzz`; once mended, the input goes into `tests/corpus`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod content;
mod damage;
mod decoders;
mod devices;
mod engine;
mod odd;
mod served;
