//! Range from a motion-capture camera to the markers' centroid: y = ‖p − c‖ ([Umasankar] Eq. 13).
//!
//! The mean of the four marker ranges is not the centroid's range (errata 9, up to 2.54 mm): the sample
//! here is the centroid's.

use nalgebra::{Matrix3, Vector3};

use super::{Kinematics, Row};
use crate::types::CAMERAS;

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

/// Position from four ranges by Gauss–Newton, started in the middle of the floor; `None` when it does not
/// settle or a range is not finite.
pub fn trilaterate(
    cameras_enu_m: &[Vector3<f64>; CAMERAS],
    range_m: &[f64; CAMERAS],
    sigma_m: &[f64; CAMERAS],
) -> Option<Vector3<f64>> {
    let mut p = cameras_enu_m.iter().sum::<Vector3<f64>>() / CAMERAS as f64;
    p.z = 1.0;
    for _ in 0..20 {
        let mut information = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for ((range, camera), sigma) in range_m.iter().zip(cameras_enu_m).zip(sigma_m) {
            let (predicted, gradient) = predict(&p, camera);
            let w = 1.0 / (sigma * sigma);
            information += gradient * gradient.transpose() * w;
            right += gradient * (range - predicted) * w;
        }
        let step = information.cholesky()?.solve(&right);
        p += step;
        if step.norm() < 1e-6 {
            return p.iter().all(|x| x.is_finite()).then_some(p);
        }
    }
    None
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

    #[test]
    fn four_ranges_give_the_position() {
        let o = crate::sensor::SensorModel::default().camera_ranges;
        for p in [Vector3::new(0.3, -2.0, 1.2), Vector3::new(-4.0, 5.0, 0.0), Vector3::new(6.0, 1.0, 3.0)] {
            let ranges = o.cameras_enu_m.map(|c| (p - c).norm());
            let found = trilaterate(&o.cameras_enu_m, &ranges, &o.sigma_m).unwrap();
            assert!((found - p).norm() < 1e-6, "{found} for {p}");
            assert!(trilaterate(&o.cameras_enu_m, &[f64::NAN, 1.0, 1.0, 1.0], &o.sigma_m).is_none());
        }
    }
}
