//! The agent: everything that runs on the vehicle. What computes is the crate `plumbline-core`, the simulator
//! `plumbline-sim`, what the ground runs on recordings and designs as well `plumbline-analysis`; their rooms are
//! re-exported here. What both ends of the radio need is `plumbline-link`.
//!
//! The DOWN lane, in flow order:
//! ```text
//! sense (raw ─► calibration) ─► attack ─► estimate ─► control ─► mix ─► actuate
//!              └───────────────────────┴───────────┴──────────┴────────┴─► telemetry ─► log, link
//! ```
//! Start reading at `core/src/flight.rs`: `Flight::step` is the whole tick.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub use plumbline_analysis::{design, envelope, offline, recordings};
pub use plumbline_core::{
    attack, calibration, command, control, estimate, event, flight, frames, linalg, mix, model, sensor, supervisor,
    types, vehicle,
};
pub use plumbline_sim as sim;

pub mod config;
pub mod link;
pub mod log;
pub mod runner;
pub mod telemetry;
