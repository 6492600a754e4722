//! Controllers: the wrench that brings the estimate to the setpoint.

pub mod gains;
pub mod hinf;
pub mod in_loop;
pub mod law;
pub mod lqg;
pub mod lqr_integral;
pub mod margins;
pub mod pid;
pub mod policy;
pub mod setpoint;
pub mod step_response;
pub mod structure;
pub mod trajectory;
pub mod tuning;

use nalgebra::Vector2;

use crate::estimate::Estimate;
use crate::types::{ControllerKind, Loops, Setpoint, Wrench};

/// What a controller has learned to give in the steady state, beyond the weight: handed on when another
/// one takes over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trim {
    /// N.
    pub thrust_n: f64,
    /// Against wind, world frame, m/s².
    pub acceleration_mps2: Vector2<f64>,
    /// N m.
    pub yaw_torque_nm: f64,
}

impl Default for Trim {
    fn default() -> Self {
        Self { thrust_n: 0.0, acceleration_mps2: Vector2::zeros(), yaw_torque_nm: 0.0 }
    }
}

/// A wrench counts as not given when it differs by this fraction of the weight, or N m.
const SHORTFALL: f64 = 1e-3;
/// Largest roll and pitch that a horizontal loop asks for, each, beside what the setpoint does, rad.
pub const TILT_FROM_POSITION_RAD: f64 = 0.30;
/// Thrust is raised for tilt up to this (60°), no further.
const COS_TILT_MIN: f64 = 0.5;

/// Which inputs (thrust, torque x, y, z) were not what was asked for, for anti-windup: what the mixer could not give, and thrust beside a
/// support.
fn short_of(asked: &Wrench, given: &Wrench, support_n: f64, weight_n: f64) -> [bool; 4] {
    let torque = asked.torque_flu_nm - given.torque_flu_nm;
    [
        (asked.thrust_n - given.thrust_n - support_n).abs() > SHORTFALL * weight_n,
        torque.x.abs() > SHORTFALL,
        torque.y.abs() > SHORTFALL,
        torque.z.abs() > SHORTFALL,
    ]
}

/// A controller that can be put in the loop.
pub trait Controller: Send {
    /// Which one it is.
    fn kind(&self) -> ControllerKind;

    /// The wrench for this tick. Never allocates. `dt_s` since the call before.
    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench;

    /// Told what the mixer could really give, and what else holds the vehicle up above its setpoint, N: for anti-windup.
    fn applied(&mut self, asked: &Wrench, given: &Wrench, support_n: f64);

    /// Integrators of x, y, z, yaw.
    fn integrator(&self) -> [f64; 4];

    /// Clears the integrators and any filter.
    fn reset(&mut self);

    /// What it has learned to give.
    fn trim(&self) -> Trim;

    /// Goes on from what the controller before it had learned to give.
    fn take_over(&mut self, trim: &Trim);
}
