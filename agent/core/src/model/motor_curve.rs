//! Command ─► rotor speed, and back: a straight line at nominal voltage (\[Clinic\] 5.5).
//!
//! The command is the pulse width scaled to 0..1. A brushless motor's speed at a given command is proportional to the
//! voltage, hence `voltage_ratio` = voltage / nominal voltage.

use serde::Deserialize;

/// A command that keeps a motor turning at the foot of its line.
pub const SMALLEST_RUNNING_COMMAND: f64 = 1e-6;

/// A motor's measured line, at nominal voltage.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorCurve {
    /// Speed just above command 0, rad/s.
    pub offset_radps: f64,
    /// Speed gained from command 0 to command 1, rad/s.
    pub slope_radps: f64,
}

impl MotorCurve {
    /// Steady speed for `command` (clipped to 0..1), rad/s. 0 stands still.
    pub fn speed_radps(&self, command: f64, voltage_ratio: f64) -> f64 {
        if command > 0.0 {
            (self.offset_radps + self.slope_radps * command.min(1.0)).max(0.0) * voltage_ratio
        } else {
            0.0
        }
    }

    /// The command (0..1) that gives `speed_radps`; below the line's start the smallest running
    /// command, 0 only when asked to stand still.
    pub fn command(&self, speed_radps: f64, voltage_ratio: f64) -> f64 {
        if speed_radps <= 0.0 || voltage_ratio <= 0.0 || self.slope_radps <= 0.0 {
            return 0.0;
        }
        ((speed_radps / voltage_ratio - self.offset_radps) / self.slope_radps).clamp(SMALLEST_RUNNING_COMMAND, 1.0)
    }

    /// Fastest steady speed at nominal voltage, rad/s.
    pub fn full_speed_radps(&self) -> f64 {
        self.speed_radps(1.0, 1.0)
    }
}
