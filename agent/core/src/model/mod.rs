//! Equations shared by estimators, controllers and the simulator. World ENU, body FLU, SI, radians.

pub mod airframe;
pub mod attitude;
pub mod battery;
pub mod declination;
pub mod discretize;
pub mod euler_body;
pub mod geodesy;
pub mod integrate;
pub mod linearize;
pub mod motor;
pub mod motor_curve;
pub mod rigid_body;
pub mod state_space;
pub mod trim;
pub mod zeros;
