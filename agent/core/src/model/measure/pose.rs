//! Attitude given whole (motion capture): three angles about the heading frame's axes.
//!
//! δφ = log(R_measured R̂ᵀ) is the rotation, about world axes, from the estimate to the measurement. Its
//! components along the vehicle's heading, to its left and up are, for small errors, the errors of roll,
//! pitch and yaw.

use nalgebra::{UnitQuaternion, Vector3};

use super::{Kinematics, Row};
use crate::frames::roll_pitch_yaw;

/// Rows of roll, pitch and yaw.
pub fn attitude(state: &Kinematics, measured: &UnitQuaternion<f64>) -> [Row; 3] {
    let error = (measured * state.world_from_body.inverse()).scaled_axis();
    let (sin_yaw, cos_yaw) = roll_pitch_yaw(&state.world_from_body).z.sin_cos();
    let axes = [Vector3::new(cos_yaw, sin_yaw, 0.0), Vector3::new(-sin_yaw, cos_yaw, 0.0), Vector3::z()];
    axes.map(|axis| Row::new(axis.dot(&error)).attitude(axis))
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences_at_the_estimate() {
        // The row is linearised at zero error, where an update that is accepted lands.
        let measured = check::state().world_from_body;
        for i in 0..3 {
            check::jacobian(&check::state(), |s| attitude(s, &measured)[i], 1e-6);
        }
    }

    #[test]
    fn a_pure_yaw_error_is_seen_by_yaw_alone() {
        let state = check::state();
        let measured = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.05) * state.world_from_body;
        let rows = attitude(&state, &measured);
        assert!(rows[0].innovation.abs() < 1e-12 && rows[1].innovation.abs() < 1e-12);
        assert!((rows[2].innovation - 0.05).abs() < 1e-12);
    }
}
