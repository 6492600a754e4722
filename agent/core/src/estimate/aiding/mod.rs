//! Aiding: what every estimator that is corrected by position, velocity and height sensors shares.

pub mod floor;
pub mod freshness;
pub mod idle;
pub mod lever_arm;
pub mod vibration;

use super::Channel;
use crate::types::CAMERAS;

/// Channels of a position.
pub const XYZ: [Channel; 3] = [Channel::X, Channel::Y, Channel::Z];
/// Channels of a velocity.
pub const VELOCITY: [Channel; 3] = [Channel::VelocityX, Channel::VelocityY, Channel::VelocityZ];
/// Channels of an attitude.
pub const ANGLES: [Channel; 3] = [Channel::Roll, Channel::Pitch, Channel::Yaw];
/// Channels of camera ranges.
pub const RANGES: [Channel; CAMERAS] = [Channel::Range1, Channel::Range2, Channel::Range3, Channel::Range4];
