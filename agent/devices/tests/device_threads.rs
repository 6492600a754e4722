//! What runs beside the flight thread: clocks, readers, the guard of the motors.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod threads;
