//! Experiments: many flights, simulated or of recordings flown again, each a function of its plan, its index and its seed.
//!
//! ```text
//! plan.toml ─► plan (factors, conditions) ─► run (all cores) ─► store (a row a flight) ─┬─► summary ─► report.html, API
//!                                              ├ flight ─► judge ─► row                └─► parquet
//!                                              ├ expectation: what the model expects of each attack
//!                                              ├ open: one row, flown again ─► flight file (MCAP)
//!                                              ├ by_hand: flights of an operator on a vehicle, accepted one by one ─► row
//!                                              ├ import: a recording of another program, flown again ─► flight file
//!                                              └ trace: the first ones, flown again ─► errors over time
//! ```
//! [`flight`] flies one, [`judge`] says how it went, [`attacked`] draws what is done to its sensors, [`draw`] has the dice, the
//! work on all cores and the medians; [`recordings`] finds what is flown again; [`reception`] has what anyone would try first ([`monitor`]: χ² and CUSUM). The project's
//! own campaigns fly with these, too.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod attacked;
pub mod by_hand;
pub mod compare;
pub mod draw;
pub mod expectation;
pub mod flight;
pub mod import;
pub mod judge;
pub mod monitor;
pub mod open;
pub mod parquet;
pub mod part;
pub mod plan;
pub mod reception;
pub mod recordings;
pub mod report;
pub mod roc;
pub mod row;
pub mod run;
mod selector;
pub mod store;
pub mod summary;
pub mod ticks;
pub mod trace;
