//! Experiments: many simulated flights, each a function of its set-up and its seed.
//!
//! [`flight`] flies one, [`judge`] says how it went, [`attacked`] draws what is done to its sensors, [`draw`] has the dice, the
//! work on all cores and the medians.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod attacked;
pub mod draw;
pub mod flight;
pub mod judge;
