//! Attitude and bias in motion, at rest, and near iron.

use super::*;
use crate::frames::{from_roll_pitch_yaw, wrap_pi};

const FIELD: Vector3<f64> = Vector3::new(0.0, 20.0, -42.0);

/// Turns slowly with a gyroscope bias; the errors of heading and inclination at the end, rad.
fn fly(seconds: f64, bias: Vector3<f64>, disturb_after_s: f64) -> (f64, f64, Vqf) {
    let mut filter = Vqf::new(VqfOptions { period_s: 0.01, ..VqfOptions::default() });
    let attitude = |t: f64| from_roll_pitch_yaw(&Vector3::new(0.5 * (0.8 * t).sin(), 0.4 * (0.5 * t).cos(), 0.6 * t));
    let h = 0.01;
    let mut t = 0.0;
    while t < seconds {
        let q = attitude(t);
        let rate = (attitude(t - h).inverse() * q).scaled_axis() / h;
        let sway = Vector3::new((3.0 * t).sin(), (2.3 * t).cos(), 0.5 * (4.0 * t).sin());
        let force = q.inverse() * (Vector3::new(0.0, 0.0, 9.81) + sway);
        let iron = if t > disturb_after_s { Vector3::new(40.0, 0.0, 10.0) } else { Vector3::zeros() };
        let field = q.inverse() * (FIELD + iron);
        filter.push(h, &(rate + bias), &force, Some(&field));
        t += h;
    }
    let error = attitude(t - h) * filter.world_from_body().inverse();
    let heading = 2.0 * error.k.atan2(error.w);
    let inclination = 2.0 * error.w.hypot(error.k).min(1.0).acos();
    (wrap_pi(heading), inclination, filter)
}

#[test]
fn attitude_and_bias_are_found_in_motion() {
    let bias = Vector3::new(0.01, -0.008, 0.0);
    let (heading, inclination, filter) = fly(120.0, bias, f64::INFINITY);
    assert!(heading.abs() < 1.0 * DEGREE && inclination < 0.7 * DEGREE, "{heading} {inclination}");
    assert!((filter.gyro_bias_radps() - bias).amax() < 0.15 * DEGREE, "{}", filter.gyro_bias_radps());
    assert!(!filter.field_disturbed());
}

#[test]
fn iron_nearby_is_rejected_and_heading_holds() {
    let (heading, inclination, filter) = fly(55.0, Vector3::zeros(), 40.0);
    assert!(filter.field_disturbed());
    // The iron turns the field by 63°; 15 s on the gyroscope alone cost about 3°.
    assert!(heading.abs() < 3.5 * DEGREE && inclination < 0.7 * DEGREE, "{heading} {inclination}");
}

#[test]
fn at_rest_the_bias_is_the_mean_rate() {
    let bias = Vector3::new(0.005, 0.01, -0.012);
    let mut filter = Vqf::new(VqfOptions::default());
    for _ in 0..4000 {
        filter.push(0.005, &bias, &Vector3::new(0.0, 0.0, 9.81), Some(&FIELD));
    }
    assert!(filter.at_rest() && (filter.gyro_bias_radps() - bias).amax() < 0.05 * DEGREE);
}
