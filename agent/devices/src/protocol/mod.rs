//! What devices say on their wires, and what is said to them. Pure.
//!
//! One file a device: its decoder ([`crate::framer::Protocol`] for streams, a function for datagrams and registers) and the
//! encoder of the other side, which the wire rig speaks.

pub mod bno055;
pub mod gnss;
pub mod ina;
pub mod invensense;
pub mod mavlink;
pub mod mongoose;
pub mod natnet;
pub mod nmea;
pub mod pca9685;
pub mod pressure;
pub mod scan_height;
pub mod scip;
pub mod tfmini;
pub mod ubx;
pub mod vicon;
