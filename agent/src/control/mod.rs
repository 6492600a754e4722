//! Controllers: the wrench that brings the estimate to the setpoint.

pub mod gains;
pub mod lqr_integral;
pub mod setpoint;
pub mod step_response;

use nalgebra::Vector3;

use crate::estimate::Estimate;

/// Total thrust along body z and torque about the body axes FLU.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wrench {
    /// N.
    pub thrust_n: f64,
    /// N m.
    pub torque_flu_nm: Vector3<f64>,
}

/// What the controller is asked to hold; already limited.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Setpoint {
    /// Position in the world frame ENU, m; z is the altitude above the floor.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s, fed forward.
    pub velocity_enu_mps: Vector3<f64>,
    /// Roll, pitch, yaw, rad.
    pub roll_pitch_yaw_rad: Vector3<f64>,
    /// Collective thrust as a fraction of the weight; used only where altitude is not controlled.
    pub throttle: f64,
}

/// Which errors the loop closes; set by the flight mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Loops {
    /// x and y, through roll and pitch.
    pub horizontal: bool,
    /// Altitude, through thrust.
    pub altitude: bool,
}

/// A controller that can be put in the loop.
pub trait Controller: Send {
    /// The wrench for this tick. Never allocates. `dt_s` since the call before.
    fn control(&mut self, estimate: &Estimate, setpoint: &Setpoint, loops: Loops, dt_s: f64) -> Wrench;

    /// Told what the mixer could really give, for anti-windup.
    fn applied(&mut self, asked: &Wrench, given: &Wrench);

    /// Integrators of x, y, z, yaw.
    fn integrator(&self) -> [f64; 4];

    /// Clears the integrators and any filter.
    fn reset(&mut self);
}
