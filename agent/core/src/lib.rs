//! The pure core of the agent: what computes, and knows neither runtime, sockets, files nor clocks.
//!
//! The DOWN lane, in flow order:
//! ```text
//! sense (raw ─► calibration) ─► attack ─► estimate ─► control ─► mix ─► actuate
//! ```
//! Start reading at `flight.rs`: `Flight::step` is the whole tick. The rooms stand below in their order: each may use
//! only those above it in this list.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod types;

pub mod event;

pub mod frames;

pub mod linalg;

pub mod model;

pub mod sensor;

pub mod calibration;

pub mod attack;

pub mod estimate;

pub mod control;

pub mod mix;

pub mod supervisor;

pub mod command;

pub mod flight;

pub mod vehicle;

#[cfg(test)]
#[path = "../../analysis/src/recordings/shared.rs"]
mod shared;
