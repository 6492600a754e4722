//! The agent: everything that runs on the vehicle.
//!
//! The DOWN lane, in flow order:
//! ```text
//! sense (raw ─► calibration) ─► attack ─► estimate ─► control ─► mix ─► actuate
//!              └───────────────────────┴───────────┴──────────┴────────┴─► telemetry ─► log, link
//! ```
//! Start reading at `flight.rs`: `Flight::step` is the whole tick.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod attack;
pub mod calibration;
pub mod command;
pub mod config;
pub mod control;
pub mod design;
pub mod estimate;
pub mod event;
pub mod failsafe;
pub mod flight;
pub mod frames;
pub mod linalg;
pub mod link;
pub mod log;
pub mod mix;
pub mod model;
pub mod offline;
pub mod recordings;
pub mod runner;
pub mod telemetry;
pub mod vehicle;
