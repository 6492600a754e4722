//! Aiding: what every estimator that is corrected by position, velocity and height sensors shares.

pub mod freshness;
pub mod idle;
pub mod lever_arm;
