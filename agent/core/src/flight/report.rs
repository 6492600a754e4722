//! What one tick and the flight as a whole have to say; telemetry turns these into messages.

use arrayvec::ArrayVec;
use plumbline_proto::ids::GainsRevision;
use plumbline_proto::time::FlightTime;

use crate::control::step_response::StepResponse;
use crate::estimate::Estimate;
use crate::event::Text;
use crate::sensor::SensorFrame;
use crate::types::{EstimatorKind, Mode, MotorCommand, Setpoint, Wrench};

pub use plumbline_proto::v1::Failsafe;

/// Most pre-arm checks.
pub const MAX_CHECKS: usize = 16;

/// One tick; its time is that of the frame. Estimates are read from [`super::Flight::estimates`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StepReport {
    /// The frame from before the attack: one recorded flight can be flown again under another one.
    pub sensed: SensorFrame,
    /// The frame the estimators saw.
    pub received: SensorFrame,
    /// Flight mode in this tick.
    pub mode: Mode,
    /// Are the motors allowed to turn?
    pub armed: bool,
    /// The setpoint after limits and rate limits, as used in this tick.
    pub setpoint: Setpoint,
    /// Wrench asked for by the controller; zero while disarmed.
    pub wrench: Wrench,
    /// Wrench the mixer could give.
    pub given: Wrench,
    /// What the mixer tells the motors.
    pub commanded: MotorCommand,
    /// The same under attack: goes to `Vehicle::actuate`.
    pub command: MotorCommand,
    /// What the vehicle said it applied after the tick before, as if nothing were attacked.
    pub applied: MotorCommand,
    /// Could the mixer not give what was asked?
    pub saturated: bool,
    /// Integrators of x, y, z (m s) and yaw (rad s).
    pub integrator: [f64; 4],
    /// The response to the last altitude step, while it is measured: about 10 Hz and when it ends.
    pub step_response: Option<StepResponse>,
}

/// What an autopilot flies by whose own controller flies: see [`crate::types::Actuation::Pose`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guide<'a> {
    /// By the estimator in the loop.
    pub estimate: &'a Estimate,
    /// The setpoint of this tick; `None` while the vehicle shall stay on the ground.
    pub setpoint: Option<&'a Setpoint>,
}

/// One pre-arm check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Short name.
    pub name: &'static str,
    /// Passed?
    pub passed: bool,
    /// Why it fails, or what was measured, with the value.
    pub reason: Text,
}

/// The flight as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightStatus {
    /// Time of the last tick.
    pub time: FlightTime,
    /// Flight mode.
    pub mode: Mode,
    /// Are the motors allowed to turn?
    pub armed: bool,
    /// Is a motor cut latched?
    pub cut_latched: bool,
    /// Failsafe acting now.
    pub failsafe: Failsafe,
    /// Why it acts, with the value; empty when none does.
    pub failsafe_reason: Text,
    /// On the ground and armed: disarms itself after this time, s.
    pub disarms_in_s: Option<f64>,
    /// Pre-arm checks.
    pub checks: ArrayVec<Check, MAX_CHECKS>,
    /// Do they all pass?
    pub ready_to_arm: bool,
    /// Battery voltage, V; `None` when not measured, or not any more.
    pub battery_v: Option<f64>,
    /// Charge left, 0 to 1, from the voltage; `None` when not measured.
    pub battery_fraction: Option<f64>,
    /// Estimator in the loop.
    pub estimator_in_loop: EstimatorKind,
    /// Deadline misses since boot, as told by the runner.
    pub deadline_misses: u64,
    /// Revision of the gains in use.
    pub gains_revision: GainsRevision,
}
