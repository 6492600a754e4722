//! What measurement models are made of: what a sensor should read in a given state, and how that reading changes with
//! the state. The model of a kind is in its own file.
//!
//! Jacobians are with respect to position, velocity and the attitude error δφ about the **world** axes,
//! R = exp(δφ×) R̂; each is checked against finite differences by its own test.

use nalgebra::{UnitQuaternion, Vector3};

/// The part of the state that sensors see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kinematics {
    /// Position in the world frame ENU, m.
    pub position_enu_m: Vector3<f64>,
    /// Velocity in the world frame ENU, m/s.
    pub velocity_enu_mps: Vector3<f64>,
    /// Attitude.
    pub world_from_body: UnitQuaternion<f64>,
}

/// One scalar measurement linearised at a state: y ≈ ŷ + ∂y/∂p δp + ∂y/∂v δv + ∂y/∂φ δφ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Innovation y − ŷ, angles wrapped.
    pub innovation: f64,
    /// ∂y/∂p, row of H for position.
    pub d_position: Vector3<f64>,
    /// ∂y/∂v, row of H for velocity.
    pub d_velocity: Vector3<f64>,
    /// ∂y/∂φ, row of H for the attitude error about the world axes.
    pub d_attitude: Vector3<f64>,
}

impl Row {
    /// A row that sees nothing yet.
    pub fn new(innovation: f64) -> Self {
        Self { innovation, d_position: Vector3::zeros(), d_velocity: Vector3::zeros(), d_attitude: Vector3::zeros() }
    }

    /// With its position row.
    #[must_use]
    pub fn position(mut self, row: Vector3<f64>) -> Self {
        self.d_position = row;
        self
    }

    /// With its velocity row.
    #[must_use]
    pub fn velocity(mut self, row: Vector3<f64>) -> Self {
        self.d_velocity = row;
        self
    }

    /// With its attitude row.
    #[must_use]
    pub fn attitude(mut self, row: Vector3<f64>) -> Self {
        self.d_attitude = row;
        self
    }
}

/// Row of one position component; `axis` 0, 1, 2 is east, north, up.
pub fn position(state: &Kinematics, axis: usize, position_m: f64) -> Row {
    let mut row = Vector3::zeros();
    row[axis] = 1.0;
    Row::new(position_m - state.position_enu_m[axis]).position(row)
}

/// Row of one velocity component; `axis` 0, 1, 2 is east, north, up.
pub fn velocity(state: &Kinematics, axis: usize, velocity_mps: f64) -> Row {
    let mut row = Vector3::zeros();
    row[axis] = 1.0;
    Row::new(velocity_mps - state.velocity_enu_mps[axis]).velocity(row)
}

#[cfg(test)]
pub(crate) mod check {
    use super::*;

    /// Compares the row's Jacobians with central differences of the innovation (∂(y−ŷ) = −∂ŷ).
    pub(crate) fn jacobian(state: &Kinematics, row_at: impl Fn(&Kinematics) -> Row, tolerance: f64) {
        const STEP: f64 = 1e-6;
        let row = row_at(state);
        for axis in 0..3 {
            let mut e = Vector3::zeros();
            e[axis] = STEP;
            let shifted = |sign: f64, what: usize| {
                let mut s = *state;
                match what {
                    0 => s.position_enu_m += sign * e,
                    1 => s.velocity_enu_mps += sign * e,
                    _ => s.world_from_body = UnitQuaternion::from_scaled_axis(sign * e) * s.world_from_body,
                }
                row_at(&s).innovation
            };
            for (what, analytic) in [(0, row.d_position), (1, row.d_velocity), (2, row.d_attitude)] {
                let numeric = -(shifted(1.0, what) - shifted(-1.0, what)) / (2.0 * STEP);
                assert!(
                    (numeric - analytic[axis]).abs() < tolerance,
                    "block {what} axis {axis}: {numeric} numerically, {} analytically",
                    analytic[axis]
                );
            }
        }
    }

    #[test]
    fn positions_and_velocities_match_differences() {
        for axis in 0..3 {
            jacobian(&state(), |s| position(s, axis, 0.1), 1e-8);
            jacobian(&state(), |s| velocity(s, axis, 0.1), 1e-8);
        }
    }

    pub(crate) fn state() -> Kinematics {
        Kinematics {
            position_enu_m: Vector3::new(0.4, -1.2, 1.7),
            velocity_enu_mps: Vector3::new(0.3, 0.8, -0.2),
            world_from_body: UnitQuaternion::from_euler_angles(0.2, -0.3, 2.4),
        }
    }
}
