//! The heart: one tick, and the commands between ticks.

pub mod report;

pub use report::{Check, Failsafe, FlightStatus, GainsInUse, StepReport};
