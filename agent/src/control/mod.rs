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

use nalgebra::{Vector2, Vector3};

pub use plumbline_proto::v1::ControllerKind;

use crate::estimate::Estimate;
use crate::model::GRAVITY_MPS2;

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
    /// In the world frame ENU, m/s², fed forward: upwards as thrust, sideways as tilt.
    pub acceleration_enu_mps2: Vector3<f64>,
    /// Roll, pitch, yaw, rad.
    pub roll_pitch_yaw_rad: Vector3<f64>,
    /// Collective thrust as a fraction of the weight; used only where altitude is not controlled.
    pub throttle: f64,
}

impl Setpoint {
    /// Roll and pitch asked for at a heading, rad; while x and y are controlled with what the acceleration takes.
    pub fn tilt_rad(&self, loops: Loops, heading_rad: f64) -> Vector2<f64> {
        let asked = self.roll_pitch_yaw_rad.xy();
        if !loops.horizontal {
            return asked;
        }
        let a = self.acceleration_enu_mps2 / GRAVITY_MPS2;
        let (sin, cos) = heading_rad.sin_cos();
        asked + Vector2::new(sin * a.x - cos * a.y, cos * a.x + sin * a.y)
    }
}

/// Which errors the loop closes; set by the flight mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Loops {
    /// x and y, through roll and pitch.
    pub horizontal: bool,
    /// Altitude, through thrust.
    pub altitude: bool,
}

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
