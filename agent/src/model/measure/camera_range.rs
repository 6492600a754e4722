//! Range from a motion-capture camera to the markers' centroid: y = ‖p − c‖ ([Umasankar] Eq. 13).
//!
//! The mean of the four marker ranges is not the centroid's range (errata 9, up to 2.54 mm): the sample
//! here is the centroid's.

use nalgebra::Vector3;

use super::{Kinematics, Row};

/// Range to `camera_enu_m` and its gradient ∂r/∂p (a unit vector; zero at the camera itself).
pub fn predict(position_enu_m: &Vector3<f64>, camera_enu_m: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let d = position_enu_m - camera_enu_m;
    let range_m = d.norm();
    if range_m > 1e-9 { (range_m, d / range_m) } else { (0.0, Vector3::zeros()) }
}

/// Row of one range.
pub fn range(state: &Kinematics, camera_enu_m: &Vector3<f64>, range_m: f64) -> Row {
    let (predicted, gradient) = predict(&state.position_enu_m, camera_enu_m);
    Row::new(range_m - predicted).position(gradient)
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn jacobian_matches_differences() {
        check::jacobian(&check::state(), |s| range(s, &Vector3::new(10.0, -10.0, 10.0), 17.0), 1e-7);
        let at_camera = range(&check::state(), &check::state().position_enu_m, 1.0);
        assert!(at_camera.innovation.is_finite() && at_camera.d_position.norm() == 0.0);
    }
}
