//! Devices of a real vehicle.
//!
//! ```text
//! port ─► framer ─► protocol ─► driver ─► reader thread (stamp, clock) ─► queue ─► HardwareVehicle::sense
//! HardwareVehicle::actuate ─► pipe ─► motor guard (a process of its own) ─► PWM
//! ```
//! - [`protocol`]: bytes to readings and back, one file a device. Pure: no port, no clock, no allocation for a frame.
//! - [`framer`]: finds the frames of any of them in a stream, through garbage.
//! - [`port`]: serial ports, sockets, I²C, behind two narrow traits.
//! - [`driver`]: a device on its port: opens, identifies, configures, polls. One file a device.
//! - [`clock`]: the device's clock as flight time. [`reader`]: the thread that owns a driver. `asking`: when a device that is asked is asked. `following`: when ticks are due beside one that talks by itself.
//! - [`spec`]: `[[device]]` and `[motors]` of a configuration, checked.
//! - [`scheduling`]: which of the threads comes first.
//! - [`motors`]: pulses, and the guard that stops them. [`autopilot`]: body rates and thrust, or a pose, instead. [`vehicle`]: all of it as a [`plumbline_core::vehicle::Vehicle`].

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod asking;
pub mod autopilot;
pub mod clock;
pub mod driver;
pub mod fault;
mod following;
pub mod framer;
pub mod motors;
pub mod port;
pub mod protocol;
pub mod reader;
pub mod reading;
pub mod scheduling;
pub mod spec;
pub mod vehicle;

pub use fault::{DeviceError, Fault};
pub use reading::Reading;
