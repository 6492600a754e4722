//! Raw to SI: what hardware and simulator share inside `sense()` and `actuate()`.

pub mod motor_curve;
