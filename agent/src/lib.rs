//! The agent: everything that runs on the vehicle. What computes is the crate `plumbline-core`, the simulator
//! `plumbline-sim`, what both ends of the radio need `plumbline-link`; their rooms are re-exported here.
//!
//! The DOWN lane, in flow order:
//! ```text
//! sense (raw ─► calibration) ─► attack ─► estimate ─► control ─► mix ─► actuate
//!              └───────────────────────┴───────────┴──────────┴────────┴─► telemetry ─► log, link
//! ```
//! Start reading at `core/src/flight.rs`: `Flight::step` is the whole tick.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub use plumbline_core::{
    attack, calibration, command, control, estimate, event, flight, frames, linalg, mix, model, sensor, supervisor,
    types, vehicle,
};
pub use plumbline_sim as sim;

pub mod config;
pub mod design;
pub mod link;
pub mod log;
pub mod offline;
pub mod recordings;
pub mod runner;
pub mod telemetry;
