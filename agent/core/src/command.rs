//! What a ground may ask of the agent, in the agent's own types, and the answer.
//!
//! The link converts from the wire; [`crate::flight::Flight::apply`] decides, between ticks.
//! Recording and replay controls belong to the runner and never reach the flight code.

use crate::attack::Schedule;
use crate::control::gains::Certified;
use crate::control::trajectory::Trajectory;
use crate::estimate::secure::Decoder;
use crate::event::Text;
use crate::types::{EstimatorKind, Mode};

/// One command.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "handed over once per command; a box would allocate")]
pub enum Command {
    /// Start the motors, when every check passes.
    Arm,
    /// Stop the motors; refused in the air (land, or cut).
    Disarm,
    /// Stop the motors now, whatever the state, and latch: the vehicle falls.
    CutMotors,
    /// Free the latch of a cut; only disarmed and standing still.
    ReleaseCut,
    /// The vehicle was put back where it began, by whoever simulates it: estimators begin anew, a cut is over.
    BeginAnew,
    /// Samples are corrected otherwise from now on: estimators begin anew; disarmed only.
    Recalibrated,
    /// Change the flight mode.
    SetMode(Mode),
    /// Change the setpoint; fields left out keep their value.
    Setpoint(SetpointChange),
    /// Fly this path from where the setpoint is; `None` stops one.
    Trajectory(Option<Trajectory>),
    /// Run this attack schedule, replacing the one before.
    Attack(Schedule),
    /// End every attack.
    AbortAttacks,
    /// Put this estimator in the loop.
    SelectEstimator(EstimatorKind),
    /// Solve this program in the secure estimator.
    SelectDecoder(Decoder),
    /// Use these gains. They were certified elsewhere ([`crate::control::gains::certify`] takes
    /// milliseconds); what depends on the gains in use is checked here.
    UseGains(Certified),
}

/// The fields of a setpoint to change.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SetpointChange {
    /// Altitude above the floor, m.
    pub altitude_m: Option<f64>,
    /// East, m.
    pub x_m: Option<f64>,
    /// North, m.
    pub y_m: Option<f64>,
    /// Roll, rad; where the horizontal position is not controlled.
    pub roll_rad: Option<f64>,
    /// Pitch, rad; where the horizontal position is not controlled.
    pub pitch_rad: Option<f64>,
    /// Yaw, rad.
    pub yaw_rad: Option<f64>,
    /// Collective thrust as a fraction of the weight; stabilise mode only.
    pub throttle: Option<f64>,
}

/// The answer to one command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ack {
    /// Was it done?
    pub accepted: bool,
    /// What was done, or why not, with the offending value.
    pub reason: Text,
}
