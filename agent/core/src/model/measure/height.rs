//! Laser height: the sample is already the distance along the world's vertical, so y = z.

use nalgebra::Vector3;

use super::{Kinematics, Row};

/// Row of one height `height_m` above the floor.
pub fn height(state: &Kinematics, height_m: f64) -> Row {
    Row::new(height_m - state.position_enu_m.z).position(Vector3::z())
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences() {
        check::jacobian(&check::state(), |s| height(s, 1.5), 1e-8);
        assert!((height(&check::state(), 1.9).innovation - 0.2).abs() < 1e-12);
    }
}
