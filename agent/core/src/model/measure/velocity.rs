//! Velocity in the world frame, one axis at a time: GNSS velocity, and the pseudo-measurement "on average
//! the vehicle goes nowhere" that bounds tilt and velocity where nothing else does.

use nalgebra::Vector3;

use super::{Kinematics, Row};

/// Row of one velocity component; `axis` 0, 1, 2 is east, north, up.
pub fn velocity(state: &Kinematics, axis: usize, velocity_mps: f64) -> Row {
    let mut row = Vector3::zeros();
    row[axis] = 1.0;
    Row::new(velocity_mps - state.velocity_enu_mps[axis]).velocity(row)
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences() {
        for axis in 0..3 {
            check::jacobian(&check::state(), |s| velocity(s, axis, 0.1), 1e-8);
        }
    }
}
