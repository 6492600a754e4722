//! Experiments flown to their ends.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod envelope;
mod experiment;
mod recordings;
mod rotors;
