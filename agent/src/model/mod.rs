//! Equations shared by estimators, controllers and the simulator.

pub mod measure;
