//! The whole system through real processes and sockets, and the developer task runner.
//!
//! - [`harness`]: start a ground and a vehicle, speak to them.
//! - `report`: what a campaign found, as JSON lines, CSV and a page with plots.
//! - [`xtask`]: what `cargo xtask …` does.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod harness;
#[cfg(feature = "report")]
pub mod report;
pub mod xtask;
