//! Fault detection and isolation: what compares sensors with one another, for every estimator.

pub mod baseline;
pub mod consensus;
pub mod cusum;
pub mod isolation;
pub mod stuck;
pub mod synchronous;
