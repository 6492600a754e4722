//! The textbook: filters and their algebra, apart from any vehicle's sensors.

pub mod consistency;
pub mod ekf_hybrid;
pub mod innovations;
pub mod kalman;
pub mod low_pass;
pub mod lqe;
pub mod measurement;
pub mod mocap_recipe;
pub mod row;
pub mod ukf;
